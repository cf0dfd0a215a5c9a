"""The valve that lives by a clock, against the model's own simulation."""

from __future__ import annotations

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, Phase, SimulationError, Stepper, simulate
from valve_sim.nodes.live_valve import LiveValve, Step, Timeline, self_test
from valve_sim.nodes.realtime import NANOSECONDS

START = 1_700_000_000 * NANOSECONDS
MILLISECOND = 1_000_000


def started(**options: float) -> LiveValve:
    live = LiveValve(default_valve(), **options)
    live.restart(START, START)
    return live


def run(live: LiveValve, milliseconds: list[float]) -> list[Step]:
    return [live.step(START + round(time * MILLISECOND)) for time in milliseconds]


def test_time_goes_by_the_scale_without_a_jump() -> None:
    line = Timeline(START, 5, 2.0)
    assert line.model_time(START + NANOSECONDS) == 2.0
    line.set_scale(START + NANOSECONDS, 0.5)
    assert line.model_time(START + NANOSECONDS) == 2.0
    assert line.model_time(START + 3 * NANOSECONDS) == 3.0
    assert line.stamp(START + 3 * NANOSECONDS) == 5 + 3 * NANOSECONDS


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_commands_act_at_their_own_time_however_time_is_cut(seed: int) -> None:
    generator = np.random.default_rng(seed)
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
    assert second.reading.coil_voltage == 9.0
    assert third.reading.coil_voltage == 0.0


def test_a_switch_at_a_sample_is_not_told_twice_and_stamps_ascend() -> None:
    live = started()
    live.command(START + 2 * MILLISECOND, 9.0)
    steps = run(live, [0.0, 2.0])
    live.command(START + 2 * MILLISECOND, 0.0)
    steps += run(live, [3.0])
    stamps = [stamp - START for step in steps for stamp in [*(stamp for stamp, _ in step.switches), step.stamp]]
    assert stamps == sorted(set(stamps))
    assert [[coil.voltage for _, coil in step.switches] for step in steps] == [[], [0.0], [0.0]]


def test_no_phase_is_left_out_by_a_slow_rate() -> None:
    live = started()
    live.command(START, 9.0)
    steps = run(live, [0.0, 100.0, 200.0])
    assert steps[0].phases in ((Phase.CLOSED,), (Phase.CLOSED, Phase.PILOT), (Phase.PILOT,))
    assert [phase for step in steps for phase in step.phases][-3:] == [Phase.PILOT, Phase.MAIN, Phase.OPEN]
    assert steps[2].phases == ()
    assert live.strokes == 1


def test_the_coil_is_de_energised_when_commands_stop() -> None:
    live = started(command_timeout=0.02)
    live.command(START, 9.0)
    steps = run(live, [0.0, 15.0, 25.0, 70.0])
    assert [live_volts > 0.0 for live_volts in (steps[1].reading.coil_current, steps[2].reading.coil_current)] == [
        True
    ] * 2
    assert live.timed_out
    expected = simulate(default_valve(), Drive.of([0.0, 0.02], [9.0, 0.0]), [0.025, 0.07])
    assert [step.reading.pilot_position for step in steps[2:]] == pytest.approx(expected.pilot_position, abs=1e-12)
    live.command(START + 71 * MILLISECOND, 9.0)
    run(live, [72.0])
    assert not live.timed_out
    assert live.volts == 9.0


def test_parameters_change_without_a_jump_in_state() -> None:
    live = started()
    live.command(START, 9.0)
    before = run(live, [0.0, 7.0])[-1].reading
    live.set_valve(START + 7 * MILLISECOND, default_valve().with_values(spring_rate=2000.0, coil_time_constant=5e-3))
    after = run(live, [7.0])[-1].reading
    for name in ("pilot_position", "pilot_velocity", "coil_current"):
        assert getattr(after, name) == pytest.approx(getattr(before, name), abs=1e-9)
    assert live.valve.parameters.spring_rate == 2000.0
    assert run(live, [9.9])[-1].reading.pilot_position != pytest.approx(1.23e-3, abs=1e-6)


def test_a_reset_forgets_state_and_command() -> None:
    live = started()
    live.command(START, 9.0)
    assert run(live, [50.0])[-1].reading.phase is Phase.OPEN
    live.reset(START + 50 * MILLISECOND)
    reading = run(live, [51.0])[-1].reading
    assert (reading.phase, reading.pilot_position, reading.coil_current) == (Phase.CLOSED, 0.0, 0.0)
    assert live.last_command is None


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


def test_the_self_test_answers_with_event_times() -> None:
    result = self_test(default_valve())
    assert result.passed
    assert "at 9 V: main plunger picked up after 5.300 ms, stop reached after 9.900 ms" in result.summary
    failed = self_test(default_valve().with_values(a0=0.0))
    assert not failed.passed
    assert "stop reached never" in failed.summary
