"""A valve that is stepped live is the whole run, to the last bit, whoever looks when; changes come without a jump."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.core.cases import CALIBRATED, STROKE, drawn
from valve_sim.model import TOLERANCE, Stepper, Valve, simulate
from valve_sim.model.core_types import Phase
from valve_sim.model.errors import SimulationError
from valve_sim.model.live import Live
from valve_sim.model.parameters import ValveParameters
from valve_sim.model.runs import Directions, Run
from valve_sim.model.simulation import commands_of


@settings(max_examples=30)
@given(st.lists(st.floats(0.0, 0.03), max_size=12).map(sorted))
def test_samples_do_not_depend_on_each_other(looks: list[float]) -> None:
    """Cut invariance: one sample among others is that sample alone."""
    valve = Valve(
        CALIBRATED.parameters, {"sensor_bandwidth": {"cutoff_frequency": 900.0}, "sensor_delay": {"delay": 2e-4}}
    )
    together = simulate(valve, STROKE, np.array([*looks, 0.031]), start_time=0.0)
    for look, shown in zip(looks, together.pilot_position, strict=False):
        assert simulate(valve, STROKE, [look], start_time=0.0).pilot_position[0] == shown


def test_a_stop_that_moved_inwards_takes_the_plungers_along() -> None:
    stepper = Stepper(CALIBRATED)
    stepper.command(0.0, 9.0)
    assert stepper.advance(0.02).phase is Phase.OPEN
    stepper.set_valve(CALIBRATED.with_values(stroke=1.1e-3), 0.02)
    reading = stepper.advance(0.02)
    assert (reading.pilot_position, reading.phase) == (1.1e-3, Phase.OPEN)


def test_a_million_random_steps_stay_finite_and_inside() -> None:
    valve = Valve(CALIBRATED.parameters, {"stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.3}})
    live, random, time = Live.at_rest(valve, 0.0, TOLERANCE), np.random.default_rng(5), 0.0
    for command in range(2000):
        volts = float(random.choice([0.0, 9.0, -9.0, 12.0]))
        live.step(time, commit=True)
        live.command(volts)
        row = live.row
        for delay in random.uniform(0.0, 1e-4, 50).tolist():
            time += delay
            assert live.advance(time) == 0
            assert -1e-9 <= row[0] <= 1.23e-3 + 1e-9 and np.isfinite(row[:8]).all()
        if command % 500 == 0:
            live = live.as_valve(valve, TOLERANCE)


def test_a_gap_outside_the_stroke_is_refused_and_changes_nothing() -> None:
    stepper = Stepper(CALIBRATED)
    with pytest.raises(SimulationError, match="not inside"):
        stepper.set_valve(Valve(ValveParameters(pilot_gap=2e-3)), 1e-3)
    assert stepper.valve is CALIBRATED and stepper.advance(2e-3).phase is Phase.CLOSED


@settings(max_examples=20)
@given(cuts=st.lists(st.floats(0.0, 0.03), max_size=6).map(sorted), seed=st.integers(0, 20))
def test_a_run_in_pieces_is_the_whole_run_with_its_derivatives(cuts: list[float], seed: int) -> None:
    valve, drive, times = drawn("random", seed)
    names = ["a0", "main_damping", "stroke"]
    along, commands = Directions.of(valve, drive, names), commands_of(drive)
    whole = Run(valve, 0.0, directions=along).piece(commands, 0.031, times[times <= 0.031], times[times <= 0.031])
    run, found, begun = Run(valve, 0.0, directions=along), list[np.ndarray](), 0.0
    for cut in [*cuts, 0.031]:
        own, due = (times >= begun) & (times < cut), commands[(commands[:, 0] >= begun) & (commands[:, 0] < cut)]
        part = run.piece(due, cut, times[own], times[own])
        found.append(np.column_stack([part.positions, part.of_positions, part.currents, part.of_currents]))
        begun = cut
    expected = np.column_stack([whole.positions, whole.of_positions, whole.currents, whole.of_currents])
    assert np.array_equal(np.concatenate(found), expected)
