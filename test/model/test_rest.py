"""A valve at rest: it stays on its seat, long rests cost next to nothing, and nothing is missed in them."""

from __future__ import annotations

import bisect
from collections.abc import Mapping

import numpy as np
import pytest

from valve_sim.model import CATALOGUE, Drive, Effect, EventKind, Parameter, Phase, Stepper, Valve, simulate
from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, where
from valve_sim.model.core_types import Outcome
from valve_sim.model.simulation import TOLERANCE, commands_of

HOUR = 3600.0
MOST = 100_000
"""Steps: an hour in steps of `LONGEST_REST` would take eighteen times as many."""
PULSE = Drive.of([0.0, 0.03], [9.0, 0.0])
CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
RESTING = {
    "plain": {},
    "constant force": {"constant_force": {"force": -0.1}},
    "friction": {"coulomb_friction": {"force": 0.1}},
    "eddy currents": {"eddy_lag": {"time_constant": 3e-4}},
    "heating": {"coil_heating": {"temperature_rate": 100.0, "cooling_time_constant": 60.0}},
}


def steps(valve: Valve, until: float) -> int:
    """The fewest steps between two commands with which a pulse, and the rest after it, can be simulated."""
    plan, commands = valve.plan(), commands_of(PULSE)

    def suffice(most: int) -> bool:
        block = plan.block(valve.numbers(), TOLERANCE, 0.0)
        own, none = block.ctypes.data, block.ctypes.data
        outcome = plan.entry("drive")(
            own, none, commands.ctypes.data, len(commands), until, most, none, 0, none, 1, none, none, 0, none, none,
            none, none, 0,
        )  # fmt: skip
        return bool(outcome == Outcome.FINISHED)

    return bisect.bisect_left(range(MOST), True, key=suffice)


@pytest.mark.parametrize("volts", [7.0, 14.0])
def test_a_valve_without_seat_load_rests_when_its_current_has_gone(volts: float) -> None:
    response = simulate(CALIBRATED, Drive.of([0.0, 0.03], [volts, 0.0]), np.arange(0.06, 20.0, 0.1))
    assert np.all(response.phase == Phase.CLOSED)
    assert np.all(response.pilot_position == 0.0)
    assert response.events[-1].kind is EventKind.SEATED


@pytest.mark.parametrize("time_constant", [0.5e-3, 3e-3])
def test_the_pilot_is_never_seated_and_unseated_at_one_time(time_constant: float) -> None:
    valve = CALIBRATED.with_values(coil_time_constant=time_constant)
    kinds = {}
    for event in simulate(valve, PULSE, [0.2]).events:
        kinds.setdefault(event.time, []).append(event.kind)
    assert [found for found in kinds.values() if EventKind.SEATED in found and len(found) > 1] == []


def test_a_nanonewton_lifts_the_pilot_and_less_does_not() -> None:
    for force, is_lifted in ((0.9e-9, False), (1.1e-9, True)):
        still = Valve().with_values(a0=force, a1=0.0, a2=0.0, a3=0.0)
        assert bool(simulate(still, Drive.of([0.0], [9.0]), [1.0]).events) is is_lifted


@pytest.mark.parametrize("name", RESTING)
def test_an_hour_of_rest_takes_no_more_steps_than_a_few_strokes(name: str) -> None:
    valve = Valve(CALIBRATED.parameters, RESTING[name])
    stroke = steps(valve, 0.1)
    assert 20 < stroke < 500
    assert steps(valve, HOUR) < 3 * stroke


@pytest.mark.parametrize("name", RESTING)
def test_how_a_long_rest_is_cut_changes_nothing(name: str) -> None:
    valve = Valve(CALIBRATED.parameters, RESTING[name])
    drive = Drive.of([0.0, 0.03, 500.0, 500.03], [9.0, 0.0, 9.0, 0.0])
    times = np.concatenate([np.geomspace(1e-3, 499.0, 60), 500.0 + np.arange(1, 60) * 1e-3])
    whole = simulate(valve, drive, times, start_time=0.0)
    stepper, waiting = Stepper(valve), list(zip(drive.times.tolist(), drive.volts.tolist(), strict=True))
    for index, moment in enumerate(times.tolist()):
        while waiting and waiting[0][0] <= moment:
            stepper.command(*waiting.pop(0))
        reading = stepper.advance(moment)
        assert reading.pilot_position == pytest.approx(whole.pilot_position[index], abs=1e-12)
        assert reading.pilot_velocity == whole.pilot_velocity[index]
        assert reading.phase == whole.phase[index]


@pytest.mark.parametrize(("force", "equalisation_time"), [(20.0, 50.0), (3e3, 300.0)])
def test_what_lifts_after_minutes_does_so_to_the_nanosecond(force: float, equalisation_time: float) -> None:
    effects: Mapping[str, Mapping[str, float]] = {
        "pressure_force": {"force": force, "equalisation_time": equalisation_time}
    }
    valve = Valve(CALIBRATED.with_values(coil_time_constant=0.0, pilot_damping=30.0).parameters, effects)
    response = simulate(valve, Drive.of([0.0], [9.0]), [HOUR])
    d, gap = valve.declared(), valve.parameters.pilot_gap
    pull = sum(d[f"a{n}"] * gap**n for n in range(4)) - d["spring_preload"] - d["spring_rate"] * gap
    assert response.first(EventKind.HELD_AT_GAP) < 1.0
    assert response.first(EventKind.LIFTED) == pytest.approx(equalisation_time * np.log(force / pull), abs=2e-9)


def test_a_term_of_time_is_watched_all_through_a_rest() -> None:
    def knock(m: Motion, own: Own) -> Node:
        return where(m.t > 599.0, where(m.t < 599.005, own.force, 0.0), 0.0)

    CATALOGUE.register(Effect("knock", "a force for 5 ms", (Parameter("force", "N", "up"),), "test", force=knock))
    try:
        valve = Valve(CALIBRATED.parameters, {"knock": {"force": 1.0}})
        response = simulate(valve, Drive.of([0.0], [0.0]), [600.0])
    finally:
        CATALOGUE.unregister("knock")
    assert response.first(EventKind.UNSEATED) == pytest.approx(599.0, abs=1e-9)
