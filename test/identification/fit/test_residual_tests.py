"""Is a residual white? The tests' p-values against SciPy's F distribution, on residuals that are made up."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy import stats

from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.residual_tests import (
    whiteness,
)
from valve_sim.identification.plants.protocol import Array

COUNT, QUIET = 800, 400
NONE = np.zeros(COUNT, dtype=bool)


def made_up(*quiet: Array, weights: Array | None = None, samples: int = QUIET) -> Problem:
    """A problem with a channel for each mask of quiet samples."""
    channels = [SimpleNamespace(data=np.zeros(len(mask)), quiet=mask) for mask in quiet]
    noises = {"position": SimpleNamespace(samples=samples), "current": SimpleNamespace(samples=10 * samples)}
    shown = SimpleNamespace(
        plant=SimpleNamespace(channels=channels), noises=noises,
        weight=lambda index: np.ones(len(quiet[index])) if weights is None else weights,
    )  # fmt: skip
    return cast("Problem", shown)


def noise(seed: int = 0, count: int = COUNT) -> Array:
    """White noise of exactly the variance 1, so that no test is far off by chance."""
    values = np.random.default_rng(seed).standard_normal(count)
    return np.asarray(values / math.sqrt(float(np.mean(values**2))))


def expected(values: Array, free: int, samples: int = QUIET) -> float:
    """The smallest p-value of the three tests, times three."""
    tests = [values, *(values.reshape(-1, block).mean(axis=1) * math.sqrt(block) for block in (4, 16))]
    found = []
    for tested in tests:
        freedom = len(tested) - free
        found.append(stats.f.sf(float(np.sum(tested**2)) / freedom, freedom, samples))
    return min(1.0, 3.0 * min(found))


@pytest.mark.parametrize(("size", "free"), [(1.0, 0), (1.1, 3), (1.2, 20)])
def test_the_p_value_is_that_of_the_most_telling_f_test(size: float, free: int) -> None:
    values = size * noise()
    found = whiteness(made_up(NONE), values, free)
    assert found.p_value == pytest.approx(expected(values, free), rel=1e-6)


@pytest.mark.parametrize("block", [4, 16])
def test_a_slow_residual_of_the_size_of_noise_is_not_white(block: int) -> None:
    values = np.repeat(noise(1, COUNT // block), block)
    found = whiteness(made_up(NONE), values, 0)
    assert not found.is_white
    assert found.worst == f"the residual drifts over {block} samples"


@pytest.mark.parametrize(("count", "is_tested"), [(49, False), (50, True)])
def test_too_few_samples_tell_nothing(count: int, is_tested: bool) -> None:
    found = whiteness(made_up(np.zeros(count, dtype=bool)), 10.0 * noise(2, count), 0)
    assert found.is_white is not is_tested
    assert (found.worst == "too few samples in motion to tell") is not is_tested
    if not is_tested:
        assert found.p_value == 1.0
