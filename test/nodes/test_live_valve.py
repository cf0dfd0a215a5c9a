"""The valve that lives by a clock, against the model's own simulation."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import Drive, Phase, Reading, SimulationError, Stepper, Valve, simulate
from valve_sim.nodes.live_machine import Step
from valve_sim.nodes.live_valve import LiveValve, self_test
from valve_sim.nodes.realtime import NANOSECONDS

START = 1_700_000_000 * NANOSECONDS
MILLISECOND = 1_000_000
CONFIG = Path(__file__).parents[2] / "config"


def started(**options: float) -> LiveValve:
    live = LiveValve(default_valve(), **options)
    live.restart(START, START)
    return live


def run(live: LiveValve, milliseconds: list[float]) -> list[Step[Reading]]:
    return [live.step(START + round(time * MILLISECOND)) for time in milliseconds]


def test_commands_act_at_their_own_time_however_time_is_cut() -> None:
    generator = np.random.default_rng(1)
    live, cuts = started(), np.sort(generator.uniform(0.0, 60.0, 100))
    live.command(START + 1_234_567, 9.0)
    live.command(START + 30_000_001, 0.0)
    steps = run(live, list(cuts))
    times = [(round(cut * MILLISECOND)) / NANOSECONDS for cut in cuts]
    expected = simulate(default_valve(), Drive.of([1.234567e-3, 30.000001e-3], [9.0, 0.0]), times, start_time=0.0)
    found = [step.reading.pilot_position for step in steps]
    assert np.max(np.abs(found - expected.pilot_position)) < 1e-12
    assert [step.stamp for step in steps] == [START + round(cut * MILLISECOND) for cut in cuts]


def test_each_change_of_the_voltage_is_two_readings_of_the_coil_a_nanosecond_apart() -> None:
    live = started()
    live.command(START + 1_234_567, 9.0)
    live.command(START + 2_000_000, 9.0)
    live.command(START + 30_000_001, 0.0)
    first, second, third = run(live, [0.0, 2.0, 40.0])
    assert first.switches == ()
    assert [(stamp - START, coil.voltage) for stamp, coil in second.switches] == [(1_234_566, 0.0), (1_234_567, 9.0)]
    assert [(stamp - START, coil.voltage) for stamp, coil in third.switches] == [(30_000_000, 9.0), (30_000_001, 0.0)]
    assert third.switches[0][1].current == third.switches[1][1].current == pytest.approx(0.9, abs=1e-3)


def test_no_phase_is_left_out_by_a_slow_rate() -> None:
    live = started()
    live.command(START, 9.0)
    steps = run(live, [0.0, 100.0, 200.0])
    assert steps[0].phases in ((Phase.CLOSED,), (Phase.CLOSED, Phase.PILOT), (Phase.PILOT,))
    assert [phase for step in steps for phase in step.phases][-3:] == [Phase.PILOT, Phase.MAIN, Phase.OPEN]
    assert steps[2].phases == ()
    assert live.strokes == 1


@pytest.mark.parametrize(("delay", "cutoff"), [(0.0, math.inf), (1e-3, 400.0)])
def test_parameters_change_without_a_jump_in_state(delay: float, cutoff: float) -> None:
    valve = dataclasses.replace(
        default_valve(), effects={"sensor_delay": {"delay": delay}, "sensor_bandwidth": {"cutoff_frequency": cutoff}}
    )
    live = LiveValve(valve)
    live.restart(START, START)
    live.command(START, 9.0)
    before = run(live, [0.0, 7.0])[-1].reading
    live.go_on_as(START + 7 * MILLISECOND, valve.with_values(spring_rate=2000.0, coil_time_constant=5e-3))
    after = run(live, [7.0])[-1].reading
    for name in ("pilot_position", "main_position", "pilot_velocity", "coil_current"):
        assert getattr(after, name) == pytest.approx(getattr(before, name), abs=1e-9)
    assert live.valve.parameters.spring_rate == 2000.0
    assert run(live, [9.9 + 1e3 * delay])[-1].reading.pilot_position != pytest.approx(1.23e-3, abs=1e-6)


def test_a_jump_of_the_clock_starts_anew_and_forgets_what_was_stored() -> None:
    live = started()
    live.command(START, 9.0)
    run(live, [50.0])
    live.command(START + 60 * MILLISECOND, 9.0)
    live.restart(MILLISECOND, MILLISECOND)
    step = live.step(100 * MILLISECOND)
    assert (step.stamp, step.reading.phase, live.volts) == (100 * MILLISECOND, Phase.CLOSED, 0.0)
    assert step.phases == (Phase.CLOSED,)


def test_a_command_given_before_the_clock_began_is_kept() -> None:
    live = LiveValve(default_valve(), command_timeout=0.03)
    live.command(0, 9.0)
    live.restart(START, START)
    assert run(live, [20.0])[-1].reading.phase is Phase.OPEN
    assert not live.timed_out


@pytest.mark.parametrize(
    ("requests", "expected"),
    [
        ([("command", 9.0), ("limit", 7.0), ("limit", 30.0)], (0.0, None)),
        ([("limit", 7.0), ("limit", 20.0)], (0.0, None)),
        ([("limit", 7.0), ("command", 5.0)], (5.0, START + MILLISECOND)),
        ([("command", 9.0), ("reset", 0.0)], (0.0, None)),
        ([("reset", 0.0), ("command", 9.0)], (9.0, START + MILLISECOND)),
        ([("command", 9.0), ("limit", 12.0)], (9.0, START + MILLISECOND)),
        ([("limit", 7.0), ("reset", 0.0), ("limit", 30.0), ("command", 11.0)], (11.0, START + MILLISECOND)),
    ],
)
def test_of_what_is_asked_at_one_time_the_order_counts(
    requests: list[tuple[str, float]], expected: tuple[float, int | None]
) -> None:
    live = started(max_voltage=30.0)
    live.command(START, 8.0)
    run(live, [0.5])
    for what, value in requests:
        if what == "reset":
            live.reset(START + MILLISECOND)
        else:
            getattr(live, what)(START + MILLISECOND, value)
    run(live, [2.0])
    assert (live.volts, live.last_command) == expected


def test_what_switches_the_coil_off_without_a_command_is_said_once() -> None:
    live = started(command_timeout=0.02, max_voltage=30.0)
    live.command(START, 9.0)
    said = [step.switched_off for step in run(live, [0.0, 10.0, 25.0, 30.0])]
    assert said == ["", "", "no command for 0.02 s (command_timeout), 9 V held", ""]
    live.command(START + 31 * MILLISECOND, -9.0)
    live.limit(START + 32 * MILLISECOND, 7.0)
    (step, after) = run(live, [33.0, 60.0])
    assert step.switched_off == "max_voltage was set to 7 V, below the 9 V that held"
    assert (after.switched_off, live.withdrawn, live.volts) == ("", -9.0, 0.0)
    live.command(START + 61 * MILLISECOND, 0.0)
    assert [step.switched_off for step in run(live, [62.0, 90.0])] == ["", ""], "0 V needs no switching off"
    assert live.withdrawn == 0.0


@pytest.mark.parametrize("shift", [3_600 * NANOSECONDS, -5 * MILLISECOND])
def test_stamps_follow_a_clock_that_was_set_and_the_valve_does_not_notice(shift: int) -> None:
    live, other = started(command_timeout=0.05), started(command_timeout=0.05)
    for each in (live, other):
        each.command(START, 9.0)
    before, expected = run(live, [0.0, 5.0]), run(other, [0.0, 5.0])
    live.shift_stamps(shift)
    for each in (live, other):
        each.command(START + 8 * MILLISECOND, 12.0)
    before, expected = before + run(live, [10.0, 80.0]), expected + run(other, [10.0, 80.0])
    assert [step.reading for step in before] == [step.reading for step in expected]
    shifts = [step.stamp - unshifted.stamp for step, unshifted in zip(before, expected, strict=True)]
    assert shifts == [0, 0, shift, shift]
    switches = [[stamp - shift for stamp, _ in step.switches] for step in before[2:]]
    assert switches == [[stamp for stamp, _ in step.switches] for step in expected[2:]]
    assert [len(found) for found in switches] == [2, 2]


def test_a_simulation_that_fails_puts_the_valve_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    live = started()
    live.command(START, 9.0)
    run(live, [20.0])
    advance, calls = Stepper.advance, []

    def fails_once(self: Stepper, time: float) -> object:
        calls.append(time)
        if len(calls) == 1:
            raise SimulationError("too stiff")
        return advance(self, time)

    monkeypatch.setattr(Stepper, "advance", fails_once)
    step = run(live, [21.0])[0]
    assert step.failure == "too stiff"
    assert (step.reading.phase, live.failures, live.last_command) == (Phase.CLOSED, 1, None)
    assert run(live, [22.0])[0].failure == ""


def with_gas(**options: float) -> LiveValve:
    live = LiveValve(load_valve(CONFIG / "hydrogen_70mpa.yaml"), **options)
    live.restart(START, START)
    return live


def test_the_tank_pressure_is_followed_from_its_own_time_on_however_time_is_cut() -> None:
    cuts = list(np.linspace(0.0, 800.0, 161))
    live = with_gas()
    live.command(START, 9.0)
    assert live.set_pressure("inlet_pressure", START + 600_000_001, 60e6)
    assert live.set_pressure("inlet_pressure", START + 799_000_001, 65e6)
    reading = run(live, cuts)[-1].reading
    stepper = Stepper(load_valve(CONFIG / "hydrogen_70mpa.yaml"))
    stepper.command(0.0, 9.0)
    stepper.supply(0.600000001, 60e6)
    stepper.supply(0.799000001, 65e6)
    expected = stepper.advance(0.8)
    assert (reading.phase, live.pressures()["inlet_pressure"]) == (Phase.OPEN, 65e6)
    assert 61e6 < reading.outlet_pressure < 65.001e6
    assert reading.outlet_pressure == pytest.approx(expected.outlet_pressure, rel=1e-6)
    assert reading.mass_flow == pytest.approx(expected.mass_flow, rel=1e-4)


@pytest.mark.parametrize("pressure", [math.nan, math.inf, -70e6, 999.0, 1e308])
def test_a_pressure_that_no_tank_has_is_ignored(pressure: float) -> None:
    live = with_gas()
    assert live.set_pressure("inlet_pressure", START, 60e6)
    assert live.set_pressure("demand_pressure", START, 2e6)
    assert not live.set_pressure("inlet_pressure", START, pressure)
    assert not live.set_pressure("demand_pressure", START, pressure)
    run(live, [1.0])
    assert (live.pressures()["inlet_pressure"], live.pressures()["demand_pressure"]) == (60e6, 2e6)


@pytest.mark.parametrize(
    ("name", "heard", "declared", "delay"),
    [("demand_pressure", 5e6, 2e6, 0.0), ("inlet_pressure", 0.2e6, 50e6, 0.01)],
)
def test_a_pressure_is_followed_through_a_reset_until_another_is_declared(
    name: str, heard: float, declared: float, delay: float
) -> None:
    """Of a valve whose outlet takes the pressure at that end: closed before its demand, or open before its tank."""
    is_demand = name == "demand_pressure"
    valve = load_valve(CONFIG / ("gas_tank_1.yaml" if is_demand else "hydrogen_70mpa.yaml"))
    assert valve.gas is not None
    gas = valve.gas._replace(demand_orifice_diameter=1e-3) if is_demand else valve.gas
    effects = {"sensor_delay": {"delay": delay}} if delay else {}
    live = LiveValve(dataclasses.replace(valve, gas=gas, effects=effects))
    live.restart(START, START)
    live.set_pressure(name, START + MILLISECOND, heard)
    run(live, [200.0])
    live.reset(START + 200 * MILLISECOND)
    live.command(START + 201 * MILLISECOND, 0.0 if is_demand else 9.0)
    step = run(live, [400.0])[-1]
    assert (step.failure, live.pressures()[name]) == ("", heard)
    assert step.reading.outlet_pressure == pytest.approx(heard, rel=1e-6)
    live.go_on_as(START + 400 * MILLISECOND, live.valve.with_values(main_damping=3.5))
    run(live, [401.0])
    assert live.pressures()[name] == heard
    other = dataclasses.replace(live.valve, gas=gas._replace(**{name: declared}))
    live.go_on_as(START + 401 * MILLISECOND, other)
    outlet = run(live, [600.0])[-1].reading.outlet_pressure
    assert live.pressures()[name] == declared
    assert outlet == pytest.approx(declared, rel=1e-9) if is_demand else outlet > 1.001 * heard


def test_each_pressure_that_is_obeyed_is_told_with_the_time_from_which_it_holds() -> None:
    """A monitor that knows them steps its model as the valve does, however late either was told."""
    live = LiveValve(load_valve(config_path("gas_tank_2.yaml")), scale=2.0)
    live.restart(1_000, 5_000_000)
    live.step(1_000_000)
    live.set_pressure("demand_pressure", 900_000, 12e6)  # heard before the last step: from that on
    live.set_pressure("inlet_pressure", 1_200_000, 25e6)
    live.set_pressure("demand_pressure", 1_700_000, 13e6)
    live.set_pressure("demand_pressure", 3_000_000, 11e6)
    first, second, third = (live.step(clock).obeyed for clock in (2_000_000, 3_500_000, 4_000_000))
    stamps = {clock: 5_000_000 + 2 * (clock - 1_000) for clock in (1_000_000, 1_200_000, 1_700_000, 3_000_000)}
    assert first == (
        ("demand_pressure", stamps[1_000_000], 12e6),
        ("inlet_pressure", stamps[1_200_000], 25e6),
        ("demand_pressure", stamps[1_700_000], 13e6),
    )
    assert second == (("demand_pressure", stamps[3_000_000], 11e6),) and third == ()


def test_a_tank_pressure_does_not_delay_the_end_of_a_command() -> None:
    live = with_gas(command_timeout=0.02)
    live.command(START, 9.0)
    live.set_pressure("inlet_pressure", START + 50 * MILLISECOND, 60e6)
    (step,) = run(live, [60.0])
    stamp, coil = step.switches[-1]
    assert (stamp - START, coil.voltage, coil.time) == (20 * MILLISECOND, 0.0, pytest.approx(0.02))


def test_a_flood_while_the_clock_stands_still_fills_no_memory() -> None:
    live = with_gas(max_voltage=30.0)
    run(live, [0.0])
    for index in range(2_000):
        live.command(START + MILLISECOND, 5.0 + index % 20)
        live.set_pressure("inlet_pressure", START + MILLISECOND, 10e6 + index)
    assert len(live._requests) == 2
    run(live, [2.0])
    assert (live.volts, live.pressures()["inlet_pressure"]) == (24.0, 10e6 + 1_999)


GAS_35 = load_valve(CONFIG / "hydrogen_35mpa.yaml")
GAS_70 = load_valve(CONFIG / "hydrogen_70mpa.yaml")


def orifices(**diameters: float) -> Valve:
    assert GAS_70.gas is not None
    return dataclasses.replace(GAS_70, gas=GAS_70.gas._replace(**diameters))


@pytest.mark.parametrize(
    ("valve", "passed", "says"),
    [
        (default_valve(), True, "at 9 V: main plunger picked up after 5.300 ms, stop reached after 9.900 ms"),
        (default_valve().with_values(a0=0.0), False, "stop reached never"),
        (GAS_35, True, "stop reached after 548."),
        (orifices(pilot_orifice_diameter=0.23e-3), False, "the outlet is at 0.1 MPa"),
        (orifices(demand_orifice_diameter=1e-3), False, "MPa, the tank at 70 MPa"),
    ],
    ids=["opens", "cannot", "when the pressure has equalised", "held shut", "never equal"],
)
def test_the_self_test_answers_with_event_times(valve: Valve, passed: bool, says: str) -> None:
    has_passed, summary = self_test(valve)
    assert has_passed == passed
    assert says in summary
