"""Whole runs of a valve as a caller sees them: what is shown, from when on, what is logged, how failures are told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import (
    Drive,
    EventKind,
    Reading,
    SimulationError,
    Stepper,
    Valve,
    simulate,
)

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
STROKE = Drive.of([2e-3, 22e-3], [9.0, 0.0])
TIMES = np.linspace(0.0, 0.05, 501)


def valve_with(**effects: dict[str, float]) -> Valve:
    return Valve(CALIBRATED.parameters, effects)


def test_a_command_acts_from_its_own_time_on() -> None:
    assert Drive.of([1.0, 2.0], [9.0, 5.0]).at([0.0, 1.0, 1.5, 2.0, 9.0]).tolist() == [0.0, 9.0, 9.0, 5.0, 5.0]
    assert Drive.of(1.0, 9.0).at(1.0) == 9.0


def test_a_run_starts_with_the_first_command_or_sample() -> None:
    early, late = np.linspace(-0.01, 0.05, 601), np.linspace(0.01, 0.05, 401)
    for times in (early, late):
        shown = simulate(CALIBRATED, STROKE, times)
        whole = simulate(CALIBRATED, STROKE, times, start_time=-0.01)
        np.testing.assert_allclose(shown.pilot_position, whole.pilot_position, rtol=0.0, atol=1e-12)
    # Rest before the first command changes nothing but the clock; a pressure that acts from lift-off neither.
    assert simulate(CALIBRATED, Drive.of([], []), []).events == ()


def test_a_late_sensor_shows_positions_late_and_nothing_else() -> None:
    delay = 3e-3
    late, prompt = (simulate(valve_with(sensor_delay={"delay": one}), STROKE, TIMES) for one in (delay, 0.0))
    before = simulate(CALIBRATED, STROKE, TIMES - delay, start_time=-delay)
    np.testing.assert_allclose(late.pilot_position, before.pilot_position, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(late.main_position, before.main_position, rtol=0.0, atol=1e-12)
    for field in ("pilot_velocity", "coil_current", "attraction", "phase"):
        np.testing.assert_array_equal(getattr(late, field), getattr(prompt, field))
    assert late.events == prompt.events


SENSORS: list[dict[str, dict[str, float]]] = [
    {},
    {"sensor_delay": {"delay": 1e-3}},
    {"sensor_bandwidth": {"cutoff_frequency": 500.0}},
    {"sensor_delay": {"delay": 3e-3}, "sensor_bandwidth": {"cutoff_frequency": 500.0}, "sensor_gain": {"gain": 1.02}},
]


def stepped(valve: Valve, changes: Sequence[tuple[float, Valve]], times: Sequence[float]) -> list[Reading]:
    """What a stepper shows of a stroke in which the valve becomes another at some times, s."""
    stepper = Stepper(valve)
    waiting = sorted(
        [
            *(
                (time, partial(stepper.command, time, volts))
                for time, volts in zip(STROKE.times, STROKE.volts, strict=True)
            ),
            *((time, partial(stepper.set_valve, other, time)) for time, other in changes),
        ],
        key=lambda change: change[0],
    )
    readings = []
    for time in times:
        while waiting and waiting[0][0] <= time:
            waiting.pop(0)[1]()
        readings.append(stepper.advance(time))
    return readings


@pytest.mark.parametrize(
    "effects", [*SENSORS, {"coil_heating": {"temperature_rate": 99.0, "cooling_time_constant": 1.0}}]
)
def test_a_valve_exchanged_for_its_like_changes_nothing(effects: dict[str, dict[str, float]]) -> None:
    valve, times = valve_with(**effects), TIMES.tolist()
    alone = stepped(valve, [], times)
    exchanged = stepped(valve, [(time, valve) for time in np.linspace(1e-3, 29e-3, 57)], times)
    for field in ("pilot_position", "main_position", "pilot_velocity", "coil_current", "phase"):
        shown, expected = ([getattr(reading, field) for reading in run] for run in (exchanged, alone))
        assert shown == pytest.approx(expected, rel=1e-6, abs=1e-9), field


@pytest.mark.parametrize(("effects", "moment"), list(zip(SENSORS, [5.5e-3, 9.5e-3, 15e-3, 27e-3], strict=True)))
def test_another_valve_takes_over_without_a_jump_of_what_is_shown(
    effects: dict[str, dict[str, float]], moment: float
) -> None:
    valve = valve_with(**effects)
    other = valve.with_values(spring_rate=900.0, main_damping=9.0, pilot_mass=0.05, a0=4.0, coil_time_constant=3e-3)
    before, after = stepped(valve, [(moment + 1e-12, other)], [moment, moment + 2e-12])
    for field in ("pilot_position", "main_position", "pilot_velocity", "coil_current"):
        assert getattr(after, field) == pytest.approx(getattr(before, field), abs=1e-9), field


def test_a_late_sensor_shows_an_exchange_late() -> None:
    delay, moment = 3e-3, 9.5e-3
    late, prompt = (
        stepped(valve, [(moment, valve.with_values(spring_rate=900.0))], times)
        for valve, times in (
            (valve_with(sensor_delay={"delay": delay}), TIMES.tolist()),
            (CALIBRATED, np.maximum(TIMES - delay, 0.0).tolist()),
        )
    )
    for field in ("pilot_position", "main_position"):
        shown, expected = ([getattr(reading, field) for reading in run] for run in (late, prompt))
        assert shown == pytest.approx(expected, abs=1e-12), field


def test_a_sensor_that_becomes_late_or_slow_goes_on_from_what_it_showed() -> None:
    for effects in SENSORS[1:3]:
        before, after, later = stepped(CALIBRATED, [(9.5e-3, valve_with(**effects))], [9.5e-3 - 1e-9, 9.5e-3, 10e-3])
        assert after.pilot_position == pytest.approx(before.pilot_position, abs=1e-8)
        assert after.main_position == pytest.approx(before.main_position, abs=1e-8)
        assert later.pilot_position >= after.pilot_position
    longer = valve_with(sensor_delay={"delay": 2e-3})
    shown = stepped(valve_with(sensor_delay={"delay": 1e-3}), [(9e-3, longer)], np.arange(7e-3, 14e-3, 1e-4).tolist())
    positions = [reading.pilot_position for reading in shown]
    assert min(np.diff(positions)) > -1e-15, "a delay that grows makes nobody go back"
    assert positions[25] == pytest.approx(positions[29], abs=1e-15), "it stands still until the delay has caught up"
    assert positions[32] > positions[29] + 1e-6


def test_the_outlet_keeps_its_pressure_when_the_gas_is_declared_warmer() -> None:
    valve = load_valve(config_path("gas_tank_1.yaml"))
    assert valve.gas is not None
    stepper = Stepper(valve)
    stepper.command(0.0, 9.0)
    before = stepper.advance(0.05)
    stepper.set_valve(replace(valve, gas=valve.gas._replace(inlet_temperature=330.0)), 0.05)
    assert stepper.advance(0.05).outlet_pressure == pytest.approx(before.outlet_pressure, rel=1e-6)
    assert stepper.advance(0.06).outlet_pressure > before.outlet_pressure


def test_more_events_than_the_log_has_room_for_at_first_are_all_told() -> None:
    valve = valve_with(stop_bounce={"restitution_stop": 0.995, "restitution_seat": 0.0})
    events = simulate(valve, Drive.of([0.0], [9.0]), [0.5]).events
    bounces = [event for event in events if event.kind is EventKind.BOUNCED_AT_STOP]
    assert len(bounces) > 256
    assert events[-1].kind is EventKind.REACHED_STOP
    assert [event.time for event in events] == sorted(event.time for event in events)


@pytest.mark.parametrize(
    ("valve", "opens"),
    [
        (CALIBRATED, True),
        (Valve(), False),
        (CALIBRATED.with_values(seat_load=3.0), True),
        (CALIBRATED.with_values(seat_load=3.1), False),
        (valve_with(eddy_lag={"time_constant": 0.05}), True),
        (CALIBRATED.with_values(coil_time_constant=0.1), True),
    ],
)
def test_a_valve_opens_where_the_reference_voltage_held_for_ever_lifts_it(valve: Valve, opens: bool) -> None:
    assert valve.can_open() is opens


def test_a_gap_beyond_the_stroke_is_told_before_anything_runs() -> None:
    parameters = CALIBRATED.parameters
    effects = {"gap_offset": {"offset": parameters.stroke - parameters.pilot_gap}}
    with pytest.raises(SimulationError, match=r"the simulation cannot start: pilot_gap .* is not inside stroke"):
        simulate(Valve(parameters, effects), STROKE, TIMES)
