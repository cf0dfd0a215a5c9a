"""What a segmenter keeps: the stroke in progress, and its samples or those of the last moments before one.

Signals of several strokes are joined here, too.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.monitoring.findings import Fault
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Drive
from valve_sim.recordings import Signal, Trace
from valve_sim.recordings.command_times import MISSING

MOST_SAMPLES: Final = 100_000
"""Samples of a stroke; one that has more is ended."""
WAITING: Final = 0.1
"""s."""
UNSEEN: Final = 0.1
"""Share of the range by which what is measured may change where samples are missing."""
FEWEST_VOLTAGES: Final = 2
"""Samples of a voltage, between which it may step."""


class KeptSamples:
    """Samples in the order of their times, s: positions, m, and currents beside them, or the coil's current alone.

    Args:
        by_current: whether the samples are currents, A, with the voltage where it is measured.
    """

    def __init__(self, *, by_current: bool = False) -> None:
        self.by_current = by_current
        self.times: list[float] = []
        self.values: list[float] = []
        self._voltages: list[float] = []
        self._current_times: list[float] = []
        self._currents: list[float] = []
        self._voltages_beside: list[float] = []
        self._waiting: deque[tuple[float, float, float]] = deque(maxlen=MOST_SAMPLES)

    @property
    def latest_current(self) -> float:
        """Time of the last current beside positions, s; −inf without any."""
        if self._waiting:
            return self._waiting[-1][0]
        return self._current_times[-1] if self._current_times else -math.inf

    def add(self, times: list[float], values: list[float], voltages: list[float]) -> None:
        """Add samples; with currents, the voltages at the coil's terminals, V, nan where not measured."""
        self.times.extend(times)
        self.values.extend(values)
        self._voltages.extend(voltages)

    def add_current(self, time: float, current: float, voltage: float, *, is_kept: bool) -> None:
        """Add a current beside positions, with the voltage at the coil's terminals, V, nan where not measured.

        What need not be kept is, after all, if samples `WAITING` s later are: a command may be heard after it acted.
        """
        self._waiting.append((time, current, voltage))
        while self._waiting[0][0] < time - WAITING:
            self._waiting.popleft()
        if not is_kept:
            return
        while self._waiting and len(self._current_times) < MOST_SAMPLES:
            time, current, voltage = self._waiting.popleft()
            self._current_times.append(time)
            self._currents.append(current)
            self._voltages_beside.append(voltage)

    def last_within(self, limit: float, earliest: float) -> float:
        """Time of the last sample of at most `limit`, s; nan if that is the very last, or is before `earliest`."""
        index = len(self.values) - 1
        while index >= 0 and self._size(index) > limit and self.times[index] >= earliest:
            index -= 1
        if index < 0 or self._size(index) > limit or index == len(self.values) - 1:
            return math.nan
        return self.times[index]

    def _size(self, index: int) -> float:
        """Size of a position, which may lie below its zero at rest, or of a current of either sign."""
        return abs(self.values[index]) if self.by_current else self.values[index]

    def highest_since(self, time: float) -> float:
        """The largest value from a time on; 0 without samples."""
        return max(self.values[bisect.bisect_left(self.times, time) :], default=0.0)

    def drop_before(self, time: float) -> None:
        """Drop what is earlier, and the earliest of too many."""
        for times, *columns in (
            (self.times, self.values, self._voltages),
            (self._current_times, self._currents, self._voltages_beside),
        ):
            first = max(bisect.bisect_left(times, time), len(times) - MOST_SAMPLES // 2)
            for column in (times, *columns):
                del column[:first]

    def trace(self, source: str, drive: list[tuple[float, float]], until: float, last: float) -> Trace:
        """What is kept as a trace that begins with its first sample.

        Args:
            source: for messages. drive: commands, s and V.
            until: s, of the last sample that it has. last: s, of the last current beside positions.
        """
        start = self.times[0] if self.times else drive[0][0]
        times, volts = np.array(drive, dtype=np.float64).T
        stop = bisect.bisect_right(self.times, until)
        at, values = np.array(self.times[:stop]) - start, np.array(self.values[:stop])
        commands, epoch = Drive(times - start, volts.copy()), round(start * 1e9)
        if not self.by_current:
            return Trace(source, commands, at, values, coil_current=self._currents_until(last, start), epoch_ns=epoch)
        nothing = np.empty(0)
        alone = Trace(source, commands, nothing, nothing, coil_current=Signal(at, values), epoch_ns=epoch)
        return replace(alone, coil_voltage=_known(at, self._voltages[:stop]))

    def voltage(self, trace: Trace, last: float) -> Signal | None:
        """The voltage at the coil's terminals during a stroke, by its times; None where it was not measured."""
        if not trace.has_positions:
            return trace.coil_voltage
        stop = bisect.bisect_right(self._current_times, last)
        return _known(np.array(self._current_times[:stop]) - trace.epoch_ns / 1e9, self._voltages_beside[:stop])

    def _currents_until(self, last: float, start: float) -> Signal | None:
        stop = bisect.bisect_right(self._current_times, last)
        if stop == 0:
            return None
        return Signal(np.array(self._current_times[:stop]) - start, np.array(self._currents[:stop]))


def _known(times: Array, voltages: list[float]) -> Signal | None:
    """A voltage where it is known; None where it hardly is."""
    values = np.array(voltages)
    is_known = np.isfinite(values)
    return Signal(times[is_known], values[is_known]) if np.count_nonzero(is_known) >= FEWEST_VOLTAGES else None


class MeasuredMotion:
    """When the valve last moved by its positions: with gas its model may meanwhile rest, and wait for the pressure.

    Args:
        within: m, up to which it counts as resting.
    """

    def __init__(self, within: float) -> None:
        self._within = within
        self._resting = 0.0
        self.last = -math.inf
        """s."""

    def see(self, time: float, positions: list[float]) -> None:
        """Take some positions, m, the last of them at this time."""
        if max(max(positions) - self._resting, self._resting - min(positions)) > self._within:
            self._resting, self.last = positions[-1], time


@dataclass
class StrokeInProgress:
    """A stroke in progress."""

    is_at_rest: bool
    drive: list[tuple[float, float]] = field(default_factory=list)
    highest: float = 0.0
    model_opened: bool = False
    model_opened_at: float = math.nan
    latest: float = -math.inf
    opened: bool | None = None
    closed: bool | None = None
    fault: Fault | None = None


def hides_motion(times: Array, values: Array, range_: float) -> bool:
    """Whether samples, (n,) s and m or A, are missing while the valve moved, or its current changed, by this range."""
    steps = np.diff(times)
    if not len(steps):
        return False
    return bool(np.any((steps > MISSING * np.median(steps)) & (np.abs(np.diff(values)) > UNSEEN * range_)))


def joined(signals: Sequence[Signal | None], starts: Sequence[float]) -> Signal | None:
    """Signals of one stroke each in a row; None where one is missing. What two strokes have is there once.

    Args:
        signals: of the strokes. starts: s, by which each is later than its own times say.
    """
    known = [signal for signal in signals if signal is not None]
    if len(known) < len(signals):
        return None
    times = np.concatenate([signal.times + start for signal, start in zip(known, starts, strict=True)])
    is_later = _rises(times)
    return Signal(times[is_later], np.concatenate([signal.values for signal in known])[is_later])


def with_joined_ends(trace: Trace, strokes: Sequence[Trace], starts: Sequence[float]) -> Trace:
    """A trace with the pressures at both ends of the valve as these strokes have them; arguments: see `joined`."""
    return replace(
        trace,
        inlet_pressure=joined([stroke.inlet_pressure for stroke in strokes], starts),
        demand_pressure=joined([stroke.demand_pressure for stroke in strokes], starts),
    )


def _rises(times: Array) -> NDArray[np.bool_]:
    """Mask of the times that are later than all before them."""
    return np.asarray(times > np.concatenate([[-math.inf], np.maximum.accumulate(times)[:-1]]))
