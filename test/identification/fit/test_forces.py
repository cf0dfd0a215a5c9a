"""What a force without a name adds to the evidence of a fit, beside the same worked out in full."""

from __future__ import annotations

import math

import numpy as np
import pytest

from identification.fit.linear_plant import COLUMNS, LinearPlant, measured, problem_of
from identification.freed import fit
from valve_sim.identification.fit.forces import LOG_PRIOR, SIZES, gain
from valve_sim.identification.plants.protocol import Array

SPLINES = 6
FURTHER = COLUMNS[:, 1 : 1 + SPLINES]
APART = np.subtract.outer(np.arange(SPLINES), np.arange(SPLINES))
COVARIANCES = [np.exp(-0.5 * np.square(APART / length)) for length in (0.5, 2.0)]


@pytest.mark.parametrize("size", [0.0, 0.02, 0.4])
def test_a_force_gains_what_its_process_gains(size: float) -> None:
    shape = np.sin(np.arange(SPLINES))
    gaussian = fit(problem_of(LinearPlant(measured() + size * FURTHER @ shape)), ("level",), {}).gaussian
    left, moved = gaussian.left_at_best, gaussian.sums.moved[:, :-1]
    # What the fit can follow is none of it.
    kept = np.eye(len(left)) - moved @ np.linalg.solve(gaussian.M, moved.T)

    def in_full(covariance: Array, scale: float) -> float:
        root = scale * FURTHER @ np.linalg.cholesky(covariance)
        inside = np.eye(SPLINES) + root.T @ kept @ root
        pull = root.T @ left
        return float(0.5 * pull @ np.linalg.solve(inside, pull) - 0.5 * np.linalg.slogdet(inside)[1])

    logs = [in_full(one, scale) + prior for one in COVARIANCES for scale, prior in zip(SIZES, LOG_PRIOR, strict=True)]
    expected = float(np.logaddexp.reduce(logs)) - math.log(len(COVARIANCES))
    found = gain(gaussian, FURTHER, COVARIANCES)
    assert found == pytest.approx(expected, abs=1e-3)
    assert (found > 0.0) == (size > 0.1)


def test_what_the_fit_can_follow_gains_nothing_by_rounding() -> None:
    gaussian = fit(problem_of(LinearPlant(measured())), ("level",), {}).gaussian
    moved = gaussian.sums.moved[:, :-1]
    followed = 1e14 * moved @ np.random.default_rng(1).standard_normal((moved.shape[1], SPLINES))
    assert gain(gaussian, followed, COVARIANCES) < 0.0


def test_sizes_have_the_probability_one() -> None:
    assert math.fsum(np.exp(LOG_PRIOR)) == pytest.approx(1.0, abs=0.1)
