"""Force maps are reported over the range that the data visited, and not beyond, where only smoothness holds them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from valve_sim.identification.fit.curves import Unexplained
from valve_sim.identification.reporting.force_curves import MovingSamples, force_curve

KNOTS = 8
POINTS = 141
STROKE = 1.23e-3


def moving(position: np.ndarray, velocity: np.ndarray, current: float = 1.0) -> MovingSamples:
    count = len(position)
    gap = (position > 0.26e-3).astype(np.int64)
    return MovingSamples(position, velocity, np.linspace(0.0, 0.1, count), np.full(count, current), gap)


def entry(variable: str, low: float, high: float, force: np.ndarray) -> Unexplained:
    """A curve through eight values, drawn as finely as a fit's."""
    at = np.linspace(low, high, POINTS)
    force = np.interp(at, np.linspace(low, high, KNOTS), force)
    return Unexplained(variable, tuple(at.tolist()), tuple(force.tolist()), 100.0)


def test_a_knot_that_the_data_never_reached_counts_for_nothing() -> None:
    """Partial strokes up to half the travel; the fit left 17,000 N at the stop."""
    force = np.array([0.15, 0.15, 0.15, 0.15, 0.15, 0.15, 0.15, 17e3])
    there = np.linspace(0.0, 0.5 * STROKE, 400)
    curve = force_curve(entry("x", 0.0, STROKE, force), moving(there, np.full(400, 0.1)))
    assert curve.rms == pytest.approx(0.15, rel=0.05)
    assert np.nanmax(curve.force) == pytest.approx(0.15, rel=0.05)
    assert np.isnan(curve.force[curve.at > 0.55 * 1e3 * STROKE]).all()
    assert "0.6" in curve.where.split(" to ")[1]
    assert np.flatnonzero(np.isfinite(curve.force)).max() < len(curve.at) // 2 + 5


def test_gaps_between_visits_are_left_open() -> None:
    force = np.full(KNOTS, 0.2)
    there = np.concatenate([np.linspace(0.0, 0.2e-3, 200), np.linspace(1.0e-3, STROKE, 200)])
    curve = force_curve(entry("x", 0.0, STROKE, force), moving(there, np.full(400, 0.1)))
    between = (curve.at > 0.25) & (curve.at < 0.95)
    assert np.isnan(curve.force[between]).all()
    assert np.isfinite(curve.force[~between]).sum() > 20


def test_what_a_damping_would_be_is_no_force_without_a_name() -> None:
    speeds = np.concatenate([np.linspace(-0.4, -0.01, 300), np.linspace(0.01, 0.4, 300)])
    # 12 N·s/m and a friction of 0.1 N, as a damping: 0.1 N over the speed.
    damped = 12.0 + 0.1 / np.maximum(np.abs(np.linspace(-0.4, 0.4, KNOTS)), 0.05)
    there = np.linspace(0.0, STROKE, 600)
    curve = force_curve(entry("v", -0.4, 0.4, damped), moving(there, speeds))
    # 2.8 N as it stands; what is left is what of a friction no damping is.
    assert 0.02 < curve.rms < 0.2
    level = force_curve(entry("x·v", 0.0, STROKE, np.full(KNOTS, 3.0)), moving(there, speeds))
    assert level.rms == pytest.approx(0.0, abs=1e-9)


def test_a_force_that_goes_with_the_current_is_told_as_it_acts() -> None:
    there = np.linspace(0.0, STROKE, 400)
    curve = force_curve(entry("x·u²", 0.0, STROKE, np.full(KNOTS, 2.0)), moving(there, np.full(400, 0.1), 0.5))
    assert curve.rms == pytest.approx(0.5)
    idle = force_curve(entry("x·u²", 0.0, STROKE, np.full(KNOTS, 2.0)), moving(there, np.full(400, 0.1), 0.01))
    assert np.isnan(idle.force).all()
    assert idle.where == "no place that the data visited"


def test_the_band_is_two_standard_errors() -> None:
    errors = tuple(np.linspace(0.01, 0.08, POINTS).tolist())
    there = np.linspace(0.0, STROKE, 400)
    made = replace(entry("x", 0.0, STROKE, np.full(KNOTS, 0.2)), stderr=errors)
    curve = force_curve(made, moving(there, np.full(400, 0.1)))
    assert curve.band == pytest.approx(2.0 * np.array(errors))
    assert np.isnan(force_curve(replace(made, stderr=()), moving(there, np.full(400, 0.1))).band).all()
