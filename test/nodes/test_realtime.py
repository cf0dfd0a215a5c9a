"""Keeping pace, without ROS and without waiting: every clock here is moved by hand."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from valve_sim.nodes.realtime import (
    ClockReading,
    Decimator,
    Restart,
    Schedule,
    TimedQueue,
    TimingRecord,
    Worker,
    why_restart,
)

MILLISECOND = 1_000_000
SECOND = 1_000_000_000


@pytest.mark.parametrize("rate", [1.0, 7919.0])
def test_every_deadline_is_handed_out_once_and_none_drifts(rate: float) -> None:
    generator = np.random.default_rng(1)
    schedule, now, times = Schedule(rate, 17), 17, []
    while now < 20 * SECOND:
        assert schedule.drop_overdue(now) == 0
        while schedule.next <= now:
            times.append(schedule.take())
        now += int(generator.integers(1, 400 * MILLISECOND))
    assert times == [17 + round(k * SECOND / rate) for k in range(len(times))]


def test_of_a_long_backlog_the_newest_half_second_is_made_up_for() -> None:
    schedule = Schedule(1000.0, 0)
    assert schedule.backlog == SECOND // 2
    assert schedule.drop_overdue(2 * SECOND) == 2001 - 500
    assert schedule.drop_overdue(2 * SECOND) == 0
    assert [schedule.take() for _ in range(500)] == [k * MILLISECOND for k in range(1501, 2001)]
    assert schedule.next == 2 * SECOND + MILLISECOND


@pytest.mark.parametrize(
    ("last", "now", "why"),
    [
        (None, (5, False), ""),
        ((5, False), (5, False), None),
        ((5, True), (4, True), "the clock jumped back by 1e-09 s"),
        ((5, True), (5 + 60 * SECOND, True), None),
        ((0, True), (61 * SECOND, True), "the clock jumped ahead by 61 s"),
        ((5, True), (6, False), "use_sim_time was changed"),
    ],
)
def test_when_a_clock_cannot_be_followed(last: tuple[int, bool] | None, now: tuple[int, bool], why: str | None) -> None:
    before = None if last is None else ClockReading(*last)
    assert why_restart(before, ClockReading(*now)) == why


def test_timing_counts_rate_lateness_overruns_and_losses() -> None:
    record = TimingRecord()
    first = record.look(0)
    assert math.isnan(first.rate)
    assert math.isnan(first.lateness)
    for index in range(1000):
        record.note(2 * MILLISECOND if index >= 990 else 1000, MILLISECOND)
    record.note_lost(7)
    timing = record.look(SECOND)
    assert timing.rate == 1000.0
    assert timing.lateness == 2e-3
    assert (timing.overruns, timing.lost, timing.lost_now) == (10, 7, 7)
    assert (timing.steps_now, timing.overruns_now) == (1000, 10)
    assert record.look(2 * SECOND)[2:] == (10, 7, 0, 0, 0)


def test_requests_that_come_late_are_delivered_in_the_order_of_their_times() -> None:
    queue, got = TimedQueue(), list[tuple[int, str]]()
    for time, kind in ((5, "reset"), (9, "valve"), (3, "command"), (5, "command"), (7, "command")):
        queue.post(time, kind, lambda time, kind=kind: got.append((time, kind)))
    queue.deliver(4, 6)
    assert got == [(4, "command"), (5, "reset"), (5, "command")], "none as of before what has been reached"
    queue.deliver(6, 7)
    assert got[3:] == [(7, "command")]
    queue.clear()
    queue.deliver(7, 100)
    assert len(got) == 4


class ScriptedClock:
    """Shows one reading of a script after another; ends the worker when the script is over."""

    def __init__(self, script: list[ClockReading | None]) -> None:
        self.script = script
        self.at = 0
        self.stop: Callable[[], None] = lambda: None

    def read(self) -> ClockReading | None:
        return self.script[min(self.at, len(self.script) - 1)]

    def sleep_until(self, time: int) -> None:
        self.at += 1
        if self.at >= len(self.script):
            self.stop()

    def wake(self) -> None:
        pass


class Run:
    """A worker run in this thread, to the end of a script."""

    def __init__(self, script: list[ClockReading | None], rate: float = 1000.0) -> None:
        self.clock = ScriptedClock(script)
        self.log: list[object] = []
        self.worker = Worker(
            self.clock,
            rate,
            prepare=lambda: self.log.append("prepared"),
            restart=self.log.append,
            step=self.step,
            fail=self.log.append,
        )
        self.clock.stop = lambda: self.worker.stop(0.0) and None
        self.rates: dict[int, float] = {}

    def step(self, time: int) -> None:
        self.log.append(time)
        if time in self.rates:
            self.worker.set_rate(self.rates[time])


def simulated(milliseconds: float) -> ClockReading:
    return ClockReading(int(milliseconds * MILLISECOND), True)


def test_ticks_of_a_simulated_clock_are_not_lateness_of_this_machine() -> None:
    run, tick = Run([simulated(at) for at in range(0, 2000, 25)]), 25
    run.worker.run()
    timing = run.worker.timing.look(0)
    assert (timing.steps_now, timing.lateness, timing.overruns) == (2000 - tick + 1, 0.0, 0)


def test_steps_during_which_a_simulated_clock_goes_on_are_late_by_that() -> None:
    run = Run([simulated(0), simulated(25), simulated(25)])
    slow = run.clock.read

    def read_later() -> ClockReading | None:
        reading = slow()
        assert reading is not None
        behind = 3 * len(run.log) if run.clock.at == 1 and len(run.log) > 3 else 0
        return ClockReading(reading.nanoseconds + behind * MILLISECOND, True)

    run.clock.read = read_later  # type: ignore[method-assign]
    run.worker.run()
    assert run.worker.timing.look(0).overruns > 20


def test_a_slower_topic_has_a_sample_in_each_of_its_periods() -> None:
    thinning = Decimator(100.0)
    due = [step for step in range(40) if thinning.is_due(1_700_000_000_003_456_789 + step * 1_000_000)]
    assert due[0] == 0
    assert [after - before for before, after in itertools.pairwise(due[1:])] == [10, 10, 10]
    assert [thinning.is_due(step * 20_000_000) for step in (3, 4, 2)] == [True] * 3, "slow steps, and a clock set back"
    assert not thinning.is_due(40_000_000)


BACK = Restart(simulated(1), "the clock jumped back by 0.5 s")


@pytest.mark.parametrize(
    ("readings", "rates", "steps", "lost"),
    [
        ([None, None, 3, 5], {}, [3, 4, 5], 0),
        ([500, 501, 1, 2], {}, [500, 501, BACK, 1, 2], 0),
        ([0, 400, 3400], {}, [*range(401), *range(2901, 3401)], 2500),
        ([0, 1, 2, 10], {MILLISECOND: 250.0}, [0, 1, 2, 6, 10], 0),
    ],
    ids=["it waits for /clock", "it jumps back", "a leap of seconds is reported", "another rate goes on"],
)
def test_a_clock_is_followed(
    readings: list[float | None], rates: dict[int, float], steps: list[object], lost: int
) -> None:
    run = Run([None if reading is None else simulated(reading) for reading in readings])
    run.rates = rates
    run.worker.run()
    assert run.log[2:] == [step * MILLISECOND if isinstance(step, int) else step for step in steps]
    assert run.worker.timing.look(0).lost == lost
