"""Recordings too long to hold all derivatives: pieces of a run, sums over them, and the fit by these alone."""

from __future__ import annotations

import tracemalloc
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation import problem as problems
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants import valve_pieces
from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Valve
from valve_sim.traces import Signal, Trace

BOTH = ("pilot_damping", "main_damping")
USUAL_PIECES = valve_pieces.SAMPLES
DIRECTIONS = [Direction({name: 1.0}, 1e-7) for name in (*BOTH, "clock_offset[0]")]


@pytest.fixture(scope="module")
def trace() -> Trace:
    return recorded()


@pytest.fixture(autouse=True)
def _short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(valve_pieces, "SAMPLES", 2)  # fewer than what colours the noise


def with_delay(valve: Valve) -> Valve:
    return Valve(valve.parameters, {"sensor_delay": {"delay": 0.3e-3}})


# An offset of 0 puts samples at the very times of commands.
@pytest.mark.parametrize(("offset", "is_late"), [(0.0, False), (3.7e-5, True)])
def test_pieces_are_to_the_last_digit_what_one_run_gives(trace: Trace, offset: float, is_late: bool) -> None:
    valve = default_valve().exact()
    # The current is sampled between the positions, and what it is does not matter here.
    current = Signal(trace.times[::2] + 1e-5, np.cos(trace.times[::2]))
    plant = ValvePlant([replace(trace, coil_current=current), trace], with_delay(valve) if is_late else valve)
    values: Mapping[str, float] = {"pilot_damping": 1.1, "main_damping": 3.9, "clock_offset[0]": offset}
    shown, derivatives = plant.predict(values), plant.sensitivities(values, DIRECTIONS).columns
    pieces = list(plant.pieces(values, DIRECTIONS) or ())
    for channel, (whole, columns) in enumerate(zip(shown, derivatives, strict=True)):
        own = [piece for piece in pieces if piece.channel == channel]
        assert len(own) > 2
        assert np.array_equal(np.concatenate([piece.shown for piece in own]), whole)
        assert np.array_equal(np.concatenate([piece.columns for piece in own]), columns)
        assert [piece.start for piece in own] == np.cumsum([0, *(len(piece.shown) for piece in own[:-1])]).tolist()


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
