"""Whole runs of a valve as a caller sees them: what is shown, from when on, what is logged, how failures are told."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valve_sim.model import (
    Drive,
    Event,
    EventKind,
    ParameterError,
    Response,
    SimulationError,
    Stepper,
    Valve,
    published_times,
    simulate,
    simulate_many,
)
from valve_sim.model.sensitivities import NUMBERS, has_sensitivities, numbers_of, rated_slopes
from valve_sim.model.simulation import rated_current

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


def test_a_stepper_with_a_late_sensor_shows_what_a_whole_run_does() -> None:
    valve = valve_with(sensor_delay={"delay": 3e-3})
    whole = simulate(valve, STROKE, TIMES, start_time=0.0)
    stepper, commands = Stepper(valve), list(zip(STROKE.times.tolist(), STROKE.volts.tolist(), strict=True))
    for time, position, main in zip(TIMES.tolist(), whole.pilot_position, whole.main_position, strict=True):
        while commands and commands[0][0] <= time:
            stepper.command(*commands.pop(0))
        reading = stepper.advance(time)
        assert (reading.pilot_position, reading.main_position) == pytest.approx((position, main), abs=1e-12)


def test_more_events_than_the_log_has_room_for_at_first_are_all_told() -> None:
    valve = valve_with(stop_bounce={"restitution_stop": 0.995, "restitution_seat": 0.0})
    events = simulate(valve, Drive.of([0.0], [9.0]), [0.5]).events
    bounces = [event for event in events if event.kind is EventKind.BOUNCED_AT_STOP]
    assert len(bounces) > 256
    assert events[-1].kind is EventKind.REACHED_STOP
    assert [event.time for event in events] == sorted(event.time for event in events)


def test_the_first_event_of_some_kinds_is_found() -> None:
    nothing = np.empty(0)
    events = tuple(Event(float(at), kind, 0.0, 0.0) for at, kind in enumerate(EventKind))
    response = Response(nothing, nothing, nothing, nothing, nothing, nothing, nothing.astype(np.uint8), events)
    kinds = list(EventKind)
    assert response.first(kinds[4], kinds[2]) == 2.0
    assert math.isnan(Response(*[nothing] * 6, nothing.astype(np.uint8), ()).first(kinds[0]))
    times = {EventKind.PICKED_UP, EventKind.HELD_AT_GAP}, {EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP}
    assert published_times(response) == tuple(min(kinds.index(kind) for kind in these) for these in times)


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


@pytest.mark.parametrize("threads", [None, 1, 3])
def test_many_valves_are_shown_as_each_alone(threads: int | None) -> None:
    valves = [valve_with(sensor_delay={"delay": 1e-3 * number}) for number in range(5)]
    many = simulate_many(valves, STROKE, TIMES, threads=threads)
    for valve, shown in zip(valves, many, strict=True):
        np.testing.assert_allclose(shown, simulate(valve, STROKE, TIMES).pilot_position, rtol=0.0, atol=1e-12)


def test_of_many_valves_the_one_that_fails_is_named() -> None:
    records = np.concatenate([CALIBRATED.record() for _ in range(7)])
    records["pilot_mass"][4] = 1e-300
    with pytest.raises(SimulationError, match=r"^parameter set 4: the simulation stopped early"):
        simulate_many(records, STROKE, TIMES, threads=2)


@pytest.mark.parametrize("offset", [0.0, 1e-6])
def test_a_gap_beyond_the_stroke_is_told_before_anything_runs(offset: float) -> None:
    parameters = CALIBRATED.parameters
    effects = {"gap_offset": {"offset": parameters.stroke - parameters.pilot_gap + offset}}
    with pytest.raises(SimulationError, match=r"the simulation cannot start: pilot_gap .* is not inside stroke"):
        simulate(Valve(parameters, effects), STROKE, TIMES)


def test_an_unknown_scalar_is_no_value_of_a_valve() -> None:
    with pytest.raises(ParameterError, match=r"valve\.a4: no such parameter"):
        CALIBRATED.with_values(a4=1.0)
    assert CALIBRATED.with_values(a2=7.0).parameters.attraction_polynomial[2] == 7.0


# -- which derivatives are known ---------------------------------------------------------------------------------------


def direction(valve: Valve, name: str, effect: str = "") -> np.ndarray:
    """The derivative of a valve's numbers along a declared value, or along an effect's."""
    found = []
    for sign in (1.0, -1.0):
        values = valve.declared()
        moved = valve.with_values(**{name: values[name] * (1.0 + 1e-6 * sign)}) if not effect else Valve(
            valve.parameters, {**valve.effects, effect: {**valve.effects.get(effect, {}), name: 1e-6 * (1.0 + sign)}}
        )  # fmt: skip
        found.append(numbers_of(moved.record()))
    return (found[0] - found[1]).reshape(1, NUMBERS)


def test_derivatives_to_what_is_off_and_works_otherwise_on_either_side_are_not_known() -> None:
    known = [
        (CALIBRATED, "pilot_mass", "", True),
        (CALIBRATED, "coil_time_constant", "", True),
        (CALIBRATED.with_values(coil_time_constant=0.0), "spring_rate", "", True),
        (CALIBRATED, "time_constant", "eddy_lag", False),
        (valve_with(coil_heating={"temperature_rate": 5.0, "cooling_time_constant": 3.0}), "pilot_mass", "", False),
        (valve_with(sensor_bandwidth={"cutoff_frequency": 50.0}), "pilot_mass", "", True),
    ]
    for valve, name, effect, is_known in known:
        assert has_sensitivities(valve.record(), direction(valve, name, effect)).tolist() == [is_known], (name, effect)


def test_the_rated_current_falls_as_its_resistance_rises() -> None:
    record = CALIBRATED.record()
    for name in ("coil_resistance", "reference_voltage", "pilot_mass"):
        above, below = record.copy(), record.copy()
        step = 1e-6 * record[name][0]
        above[name] += step
        below[name] -= step
        slope = (numbers_of(above) - numbers_of(below)).reshape(1, NUMBERS) / (2.0 * step)
        expected = (rated_current(above) - rated_current(below)) / (2.0 * step)
        assert rated_slopes(record, slope)[0] == pytest.approx(expected, rel=1e-6, abs=1e-12)
