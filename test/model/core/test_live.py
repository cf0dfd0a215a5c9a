"""A valve that is stepped live is the whole run, to the last bit, whoever looks when; changes come without a jump."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model.core.cases import CALIBRATED, drawn
from valve_sim.model import Stepper, Valve
from valve_sim.model.core_types import Phase
from valve_sim.model.errors import SimulationError
from valve_sim.model.parameters import ValveParameters
from valve_sim.model.runs import Directions, Run
from valve_sim.model.simulation import commands_of


def test_a_stop_that_moved_inwards_takes_the_plungers_along() -> None:
    stepper = Stepper(CALIBRATED)
    stepper.command(0.0, 9.0)
    assert stepper.advance(0.02).phase is Phase.OPEN
    stepper.set_valve(CALIBRATED.with_values(stroke=1.1e-3), 0.02)
    reading = stepper.advance(0.02)
    assert (reading.pilot_position, reading.phase) == (1.1e-3, Phase.OPEN)


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
