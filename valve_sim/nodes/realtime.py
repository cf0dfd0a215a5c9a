"""Keeping pace with a clock, without ROS: deadlines that do not drift, a bounded backlog, and timing statistics.

A ROS timer drops late ticks, so ticks are never counted here: the clock is read, and whatever has become due since is
handed out, each with the time that it stands for.
"""

from __future__ import annotations

import gc
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from typing import Final, NamedTuple, Protocol

from valve_sim.nodes.threads import Fail, StoppableThread

NANOSECONDS: Final = 1_000_000_000
LAST_STAMP: Final = 2**31 * NANOSECONDS - 1
"""ns, in 2038: a stamp has 32 bits for seconds. At a thousand times real time a node reaches that in days."""
LISTENERS_SECONDS: Final = 0.5
"""s to wait for the discovery of subscribers, which takes up to a quarter of a second."""
BACKLOG_SECONDS: Final = 0.5
"""s: samples that are overdue for longer are dropped; the model is stepped over them nevertheless."""
LONGEST_LEAP_SECONDS: Final = 60.0
"""s: a clock that moves further between two readings has been set."""
_LONGEST_LEAP: Final = round(LONGEST_LEAP_SECONDS * NANOSECONDS)


class Schedule:
    """Absolute deadlines start + k / rate, rounded to ns one by one, so that nothing accumulates.

    `next` is the clock time of the next one, ns. For `backlog`, ns, a deadline may be overdue; one always may.
    """

    def __init__(self, rate: float, start: int, backlog: float = BACKLOG_SECONDS) -> None:
        self.next, self.rate = start, rate
        self._start, self._index = start, 0
        self.backlog = round(max(1, int(backlog * rate)) * NANOSECONDS / rate)

    def take(self) -> int:
        """The next deadline, ns; each is handed out once."""
        time = self.next
        self._index += 1
        self.next = self._start + round(self._index * NANOSECONDS / self.rate)
        return time

    def drop_overdue(self, now: int) -> int:
        """Drop the deadlines that are overdue for as long as the backlog at `now`, ns; how many."""
        lost = 0
        while now - self.next >= self.backlog:
            self.take()
            lost += 1
        return lost


class Timing(NamedTuple):
    """Timing statistics since the last reading.

    Attributes:
        rate: steps a second of the clock that were made, Hz; nan without a second look.
        lateness: 99th percentile of how late steps began, s; nan without steps.
        overruns: steps, in all, that began more than a period late.
        lost: steps, in all, that were given up.
        lost_now: those of them since the last look.
        steps_now, overruns_now: steps since the last look, and those of them that began more than a period late.
    """

    rate: float
    lateness: float
    overruns: int
    lost: int
    lost_now: int
    steps_now: int = 0
    overruns_now: int = 0


class TimingRecord:
    """Counters of the stepping thread, read by another once a second or so."""

    def __init__(self) -> None:
        self._late: list[int] = []
        self._looked_at: int | None = None
        self._overruns = 0
        self._overruns_before = 0
        self._lost = 0
        self._lost_before = 0

    def note(self, lateness: int, period: float) -> None:
        """One step that began `lateness` ns after its deadline; the period is in ns."""
        self._late.append(lateness)
        if lateness > period:
            self._overruns += 1

    def note_lost(self, count: int) -> None:
        """Count steps that were dropped."""
        self._lost += count

    def look(self, now: int) -> Timing:
        """Statistics since the last reading; `now` in ns of the clock that the steps follow."""
        late, self._late = sorted(self._late), []
        elapsed = 0 if self._looked_at is None else now - self._looked_at
        self._looked_at = now
        lost_now, self._lost_before = self._lost - self._lost_before, self._lost
        overruns = self._overruns
        overruns_now, self._overruns_before = overruns - self._overruns_before, overruns
        rate = len(late) * NANOSECONDS / elapsed if elapsed > 0 else math.nan
        lateness = late[min(len(late) - 1, int(0.99 * len(late)))] / NANOSECONDS if late else math.nan
        return Timing(rate, lateness, overruns, self._lost, lost_now, len(late), overruns_now)


class ClockReading(NamedTuple):
    """The time of a clock, ns, and whether it is simulated time."""

    nanoseconds: int
    is_simulated: bool


class Arrival(NamedTuple):
    """When a message came.

    Attributes:
        received: when the middleware received it, ns of the system's clock; 0 where it does not say.
        reading: what the node's clock showed when this process took it; None before the first /clock.
    """

    received: int
    reading: ClockReading | None


class PaceClock(Protocol):
    """The clock that a `Worker` follows."""

    def read(self) -> ClockReading | None:
        """The time; None before the first /clock message."""

    def sleep_until(self, time: int) -> None:
        """Return at this time of the clock, ns, or earlier."""

    def wake(self) -> None:
        """Make `sleep_until` return soon."""


class Restart(NamedTuple):
    """The clock can no longer be followed as before; the reason is empty at the first start."""

    reading: ClockReading
    reason: str


class Worker(StoppableThread):
    """A thread that steps something at a steady rate of a clock, Hz.

    `prepare` is called first, in the thread; `restart` before the first step, and whenever the clock jumped or was
    exchanged; `step` with each deadline, ns of the clock.
    """

    def __init__(
        self,
        clock: PaceClock,
        rate: float,
        *,
        prepare: Callable[[], None],
        restart: Callable[[Restart], None],
        step: Callable[[int], None],
        fail: Fail,
    ) -> None:
        super().__init__("valve stepper", self._follow, fail)
        self.timing = TimingRecord()
        self._clock = clock
        self._rate = rate
        self._prepare = prepare
        self._restart = restart
        self._step = step

    def set_rate(self, rate: float) -> None:
        """Set the rate of the steps, Hz."""
        self._rate = rate
        self.wake()

    def wake(self) -> None:
        """Interrupt the wait for the next step."""
        self._clock.wake()

    def _follow(self) -> None:
        self._prepare()
        gc.freeze()  # what is loaded stays: collecting it would stop the steps for tens of milliseconds
        last, schedule = None, Schedule(self._rate, 0)
        while not self.is_stopping:
            reading = self._clock.read()
            if reading is None:
                self._clock.sleep_until(0)
                continue
            reason = why_restart(last, reading)
            if reason is not None:
                self._restart(Restart(reading, reason))
                schedule = Schedule(self._rate, reading.nanoseconds)
            elif schedule.rate != self._rate:
                # Continue where the old rate would have: no deadline twice, none left out.
                schedule = Schedule(self._rate, schedule.next)
            last = reading
            self._catch_up(schedule, reading)
            self._clock.sleep_until(schedule.next)

    def _catch_up(self, schedule: Schedule, reading: ClockReading) -> None:
        """Make the steps up to a reading of the clock.

        Simulated time moves by whole ticks, so that a step can be made only once /clock has passed it: it is late by
        what the clock goes on between that and the step, and the length of a tick says nothing about this machine.
        """
        until, is_simulated = reading
        if until - schedule.next > schedule.backlog:
            self.timing.note_lost(schedule.drop_overdue(until))
        now, period = until, NANOSECONDS / schedule.rate
        while schedule.next <= until and not self.is_stopping:
            time = schedule.take()
            self.timing.note(now - (until if is_simulated else time), period)
            self._step(time)
            if schedule.next <= until and (later := self._clock.read()):
                now = later.nanoseconds


def why_restart(last: ClockReading | None, now: ClockReading) -> str | None:
    """Why the model must restart between these readings of a clock; None if it need not, empty at the first one."""
    if last is None:
        return ""
    if now.is_simulated != last.is_simulated:
        return "use_sim_time was changed"
    moved = now.nanoseconds - last.nanoseconds
    if 0 <= moved <= _LONGEST_LEAP:
        return None
    seconds = abs(moved) / NANOSECONDS
    return f"the clock jumped back by {seconds:g} s" if moved < 0 else f"the clock jumped ahead by {seconds:g} s"


class ClockJumpedError(Exception):
    """The clock by which something is played can no longer be followed; the message says why."""


def when_due(clock: PaceClock, offsets: Sequence[int], is_stopped: Callable[[], bool]) -> Iterator[tuple[int, int]]:
    """The index of each deadline once it has come, and how late that is, ns; nothing is left out.

    Simulated time moves by ticks: by it a deadline is late by what the clock has gone on since the tick was seen.

    Args:
        clock: is followed. offsets: ns after the first reading of it, ascending. is_stopped: whether to end early.

    Raises:
        ClockJumpedError: the clock jumped or was exchanged.
    """
    last, start, index = None, 0, 0
    while index < len(offsets):
        reading = clock.read()
        if is_stopped():
            return
        if reading is None:
            clock.sleep_until(0)
            continue
        if last is None:
            start = reading.nanoseconds
        elif reason := why_restart(last, reading):
            raise ClockJumpedError(reason)
        last = reading
        while index < len(offsets) and start + offsets[index] <= reading.nanoseconds and not is_stopped():
            now = clock.read() or reading
            since = reading.nanoseconds if reading.is_simulated else start + offsets[index]
            yield index, now.nanoseconds - since
            index += 1
        if index < len(offsets):
            clock.sleep_until(start + offsets[index])


class Decimator:
    """Which steps are also samples of a slower topic: the first in each of its periods."""

    def __init__(self, rate: float) -> None:
        self._period = round(NANOSECONDS / rate)
        self._last: int | None = None

    def is_due(self, clock: int) -> bool:
        """Whether the step at clock time `clock`, ns, is one; to be asked once for each step."""
        before, self._last = self._last, clock // self._period
        return self._last != before


class TimedQueue:
    """Requests between threads: any thread posts actions, the stepping thread calls those whose time has come.

    Of one time it holds one request of each kind, the last. So it does not grow while the clock stands still.
    """

    def __init__(self) -> None:
        self._requests: dict[tuple[int, str], Callable[[int], None]] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        """How many requests wait."""
        return len(self._requests)

    def post(self, time: int, kind: str, action: Callable[[int], None]) -> None:
        """Store an action for clock time `time`, ns, with which it will be called; behind those of the same time."""
        with self._lock:
            self._requests.pop((time, kind), None)
            self._requests[time, kind] = action

    def deliver(self, since: int, until: int) -> None:
        """Call every action whose time is not after `until`, ns, in the order of time, none as of before `since`."""
        if not self._requests:
            return
        with self._lock:
            due = sorted((key for key in self._requests if key[0] <= until), key=itemgetter(0))
            actions = [(time, self._requests.pop((time, kind))) for time, kind in due]
        for time, action in actions:
            action(max(time, since))

    def clear(self) -> None:
        """Drop all actions."""
        with self._lock:
            self._requests.clear()
