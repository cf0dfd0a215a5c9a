"""Recordings too long to hold all derivatives: the fit by sums over pieces of a run alone."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation import problem as problems
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants import valve_pieces
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.traces import Trace

BOTH = ("pilot_damping", "main_damping")
USUAL_PIECES = valve_pieces.SAMPLES


@pytest.fixture(scope="module")
def trace() -> Trace:
    return recorded()


@pytest.fixture(autouse=True)
def _short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(valve_pieces, "SAMPLES", 2)  # fewer than what colours the noise


@pytest.mark.parametrize("free", [BOTH, (*BOTH, "coil_heating.temperature_rate")])
def test_a_fit_by_sums_ends_where_one_by_rows_does(
    trace: Trace, free: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = Problem(ValvePlant([trace], default_valve()))
    by_rows = fit(problem, free, {}, nuisances=problem.plant.nuisances)
    monkeypatch.setattr(problems, "LONG", 0)
    by_sums = fit(problem, free, {}, nuisances=problem.plant.nuisances)
    assert by_sums.derivatives.at_hand is by_sums.left.at_hand is None  # no rows were held
    assert by_sums.converged
    assert by_sums.chi2 == pytest.approx(by_rows.chi2, abs=0.02)
    for name in free:
        assert abs(by_sums.values[name] - by_rows.values[name]) < 0.02 * by_rows.stderr(name)
    assert by_sums.residuals == pytest.approx(problem.residuals(by_sums.values), abs=1e-9)
    assert by_sums.jacobian.shape == by_rows.jacobian.shape


@pytest.mark.long
def test_memory_holds_no_column_of_a_tolerance(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    """Residuals come in pieces, so that twelve tolerances take no more memory than what a piece of them does."""
    monkeypatch.setattr(valve_pieces, "SAMPLES", USUAL_PIECES)
    times = np.linspace(trace.times[0], trace.times[-1], 4 * problems.LONG)
    position = np.interp(times, trace.times, trace.pilot_position)
    plant = ValvePlant([replace(trace, times=times, pilot_position=position, main_position=None)], default_valve())
    assert len(plant.nuisances) > 8
    fit(Problem(plant), BOTH, {}, nuisances=plant.nuisances)  # what is compiled on the way counts no more
    problem = Problem(plant)
    assert problem.is_long
    tracemalloc.start()
    try:
        fit(problem, BOTH, {}, nuisances=plant.nuisances)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 60 * len(times)
