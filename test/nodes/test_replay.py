"""The replay by clock and the settings of identification_node, without ROS."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import Drive, ParameterError, simulate
from valve_sim.nodes.diagnostics import Level
from valve_sim.nodes.identification_work import (
    Replay,
    Task,
    fit_or_diagnose,
    measured_reading,
    measured_voltages,
    read_recording,
    replay_status,
    timeline,
)
from valve_sim.nodes.realtime import ClockReading
from valve_sim.nodes.settings import IdentificationSettings
from valve_sim.recordings import Signal, Trace, write_bag

TIMES = np.arange(40) / 1e3
TRACE = Trace("test", Drive.of([0.0, 0.0205], [9.0, 0.0]), TIMES, np.zeros(40), epoch_ns=5)
MILLISECOND = 1_000_000


class FakeClock:
    """Moves only when slept on, and by what `lateness` says beyond the deadline."""

    def __init__(self, lateness: Callable[[int], int] = lambda deadline: 0, *, is_simulated: bool = False) -> None:
        self.now = 1_000
        self._lateness, self._is_simulated = lateness, is_simulated

    def read(self) -> ClockReading:
        return ClockReading(self.now, self._is_simulated)

    def sleep_until(self, time: int) -> None:
        self.now = time + self._lateness(time)

    def wake(self) -> None:
        pass


class Notes:
    """What was played, and when."""

    def __init__(self, clock: FakeClock) -> None:
        self.clock = clock
        self.played: list[tuple[int, str, int]] = []
        self.failures: list[Exception] = []
        self.ends = 0

    def prepare(self) -> None:
        assert not self.played

    def play(self, place: int) -> None:
        kind, index = ("command", -1 - place) if place < 0 else ("sample", place)
        self.played.append((self.clock.now, kind, index))

    def end(self) -> None:
        self.ends += 1

    def fail(self, error: Exception) -> None:
        self.failures.append(error)


def play(clock: FakeClock, rate: float) -> tuple[Replay, Notes]:
    notes = Notes(clock)
    replay = Replay(
        clock, TRACE, rate=rate, loop=False, prepare=notes.prepare, play=notes.play, end=notes.end, fail=notes.fail
    )
    replay.run()
    assert notes.ends == 1
    assert notes.failures == []
    assert replay.is_done
    return replay, notes


def test_a_command_comes_before_the_sample_of_its_time() -> None:
    places = timeline(TRACE, 1.0)[1].tolist()
    assert places[:2] == [-1, 0]
    assert places.index(-2) == places.index(20) + 1 == places.index(21) - 1


@pytest.mark.parametrize("rate", [1.0, 0.1])
def test_everything_is_played_at_its_own_time(rate: float) -> None:
    _, notes = play(FakeClock(), rate)
    samples = [(time, index) for time, kind, index in notes.played if kind == "sample"]
    assert [index for _, index in samples] == list(range(40))
    assert [time for time, _ in samples] == [1_000 + round(index * MILLISECOND / rate) for index in range(40)]


def test_lateness_does_not_accumulate_and_leaves_nothing_out() -> None:
    def lateness(deadline: int) -> int:
        return 5 * MILLISECOND if deadline == 1_000 + 10 * MILLISECOND else 1_000

    replay, notes = play(FakeClock(lateness), 1.0)
    samples = {index: time for time, kind, index in notes.played if kind == "sample"}
    assert samples[10] == samples[15] == 1_000 + 15 * MILLISECOND
    assert samples[39] == 1_000 + 39 * MILLISECOND + 1_000
    assert replay.timing.look(0).overruns == 4


def test_late_samples_are_a_warning_and_a_replay_as_fast_as_possible_is_never_late() -> None:
    clock = FakeClock(lambda deadline: 20 * MILLISECOND)
    replay, _ = play(clock, 1.0)
    replay.is_done = False
    status = replay_status(replay, clock.now, "declared")
    assert status.level is Level.WARN
    assert "late" in status.message
    fast, notes = play(FakeClock(), 0.0)
    assert {time for time, _, _ in notes.played} == {1_000}
    assert len(notes.played) == fast.samples == 42
    fast.is_done = False
    assert replay_status(fast, 0, "declared").level is Level.OK


def test_a_recording_of_the_current_alone_is_replayed_and_fitted(tmp_path: Path) -> None:
    declared = load_valve(config_path("energy_consistent.yaml"))
    drive = Drive.of([5e-3, 30e-3], [9.0, 0.0])
    times = np.arange(300) / 5e3
    valve = declared.with_values(main_damping=5.0)
    current = simulate(valve, drive, times).coil_current + 1e-3 * np.random.default_rng(2).standard_normal(300)
    voltage = Signal(times[::2], np.where((times >= 5e-3) & (times < 30e-3), 9.0, 0.0)[::2])
    written = Trace(
        "coil", drive, times[:0], times[:0], coil_current=Signal(times, current), coil_voltage=voltage, epoch_ns=10**9
    )
    write_bag(tmp_path / "coil.mcap", written)
    trace = read_recording(IdentificationSettings(str(tmp_path / "coil.mcap")), declared)
    assert sorted(timeline(trace, 1.0)[1].tolist()) == [-2, -1, *range(300)]
    sample = measured_reading(trace, 100)
    assert (sample.time, sample.coil_current) == (trace.sample_times[100], pytest.approx(current[100], abs=1e-6))
    assert np.isnan(sample.pilot_position)
    assert np.isfinite(measured_voltages(trace)).tolist() == [True, False] * 150
    outcome = fit_or_diagnose(trace, declared, IdentificationSettings(), tmp_path, lambda what, fraction: None)
    assert outcome.report["rmse_ma"]["after"] == pytest.approx(1.0, rel=0.15)
    assert outcome.valve.parameters.main_damping == pytest.approx(5.0, abs=0.6)


def test_a_task_says_how_far_it_is_and_how_it_ended() -> None:
    seen: list[Any] = []
    task = Task(lambda progress: (progress("fit", 0.5), seen.append(task.status))[0] or "found", _keep(seen))
    task.run()
    assert seen[0].values == {"doing": "fit", "progress (%)": "50"}
    assert seen[1:] == [("found", True)]
    assert task.status.level is Level.OK


def test_a_task_that_fails_says_why_and_one_that_is_stopped_says_nothing() -> None:
    ends: list[Any] = []

    def refuse(progress: Any) -> str:
        raise ParameterError("no")

    failing = Task(refuse, _keep(ends))
    failing.run()
    assert ends == [("no", False)]
    assert failing.status.level is Level.ERROR
    stopped = Task(lambda progress: str(progress("fit", 0.5)), _keep(ends))
    stopped.stop(0.0)
    stopped.run()
    assert len(ends) == 1


def _keep(ends: list[Any]) -> Callable[[str, bool], None]:
    return lambda words, is_good: ends.append((words, is_good))
