"""How much each sample of a coarse sensor counts: copies of one reading are one measurement."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, effective_rmse, rmse
from valve_sim.identification.plants.protocol import Array, Channel

STEP = 5e-6
OPEN = 1.23e-3
SAMPLES = 1000
CLOSING = np.concatenate([np.full(200, OPEN), np.linspace(OPEN, 0.0, 600), np.zeros(200)])


def problem(data: Array, quiet: Array, declared: Array) -> Problem:
    """Of readings, where the declared model shows something, and a model of its own what `shown` holds."""
    groups = np.zeros(SAMPLES, dtype=np.int64)
    channel = Channel("seen", "position", np.arange(SAMPLES) / 2e4, STEP * np.round(data / STEP), quiet, groups)
    plant = SimpleNamespace(channels=[channel], predict=lambda values: [values.get("shown", declared)])
    return Problem(plant, noises={"position": Noise(1e-6, 1e-6, (), STEP, 200)})  # type: ignore[arg-type]


def weights(data: Array, quiet: Array, declared: Array) -> Array:
    """Of the only channel."""
    return problem(data, quiet, declared).weight(0)


def fit(of: Problem, shown: Array) -> Fit:
    """One that predicts this."""
    return cast("Fit", SimpleNamespace(problem=of, values={"shown": shown}, shown=lambda: [shown]))


def test_a_valve_that_stays_where_the_declared_one_moves_counts_once() -> None:
    """As it does with so much residual magnetism that it never closes."""
    late = np.arange(SAMPLES) >= 800
    found = weights(np.full(SAMPLES, OPEN), late, CLOSING)
    # The first steps may be those of a valve that begins to close.
    assert np.sum(found[220:] ** 2) == pytest.approx(780 / SAMPLES, rel=0.05)


def test_models_are_not_compared_by_copies_of_a_rounding_error() -> None:
    """The true stop is 2 µm beyond what a coarse sensor reads there, for as long as the valve is open."""
    truth = CLOSING + 2e-6 * (CLOSING / OPEN)
    readings = problem(truth, np.arange(SAMPLES) < 200, CLOSING)
    true, at_the_reading = fit(readings, truth), fit(readings, CLOSING)
    assert rmse(true) > rmse(at_the_reading)
    assert effective_rmse(true) < 0.99 * effective_rmse(at_the_reading)
