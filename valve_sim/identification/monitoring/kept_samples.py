"""What a segmenter keeps: the stroke in progress, and its samples or those of the last moments before one."""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from valve_sim.identification.monitoring.findings import Fault
from valve_sim.model import Drive
from valve_sim.traces import Signal, Trace
from valve_sim.traces.command_dates import dates_by_voltage

MOST_SAMPLES: Final = 100_000
"""Samples of a stroke; one that has more is ended."""


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

    @property
    def latest_current(self) -> float:
        """Time of the last current beside positions, s; −inf without any."""
        return self._current_times[-1] if self._current_times else -math.inf

    def add(self, times: list[float], values: list[float], voltages: list[float]) -> None:
        """Add samples; with currents, the voltages at the coil's terminals, V, nan where not measured."""
        self.times.extend(times)
        self.values.extend(values)
        self._voltages.extend(voltages)

    def add_current(self, time: float, current: float) -> None:
        """Add a current beside positions."""
        if len(self._current_times) < MOST_SAMPLES:
            self._current_times.append(time)
            self._currents.append(current)

    def last_within(self, limit: float, earliest: float) -> float:
        """Time of the last sample of at most `limit`, s; nan if that is the very last, or is before `earliest`."""
        index = len(self.values) - 1
        while index >= 0 and self._size(index) > limit and self.times[index] >= earliest:
            index -= 1
        if index < 0 or self._size(index) > limit or index == len(self.values) - 1:
            return math.nan
        return self.times[index]

    def _size(self, index: int) -> float:
        """Of a position, which may lie below its zero at rest, or of a current of either sign."""
        return abs(self.values[index]) if self.by_current else self.values[index]

    def highest_since(self, time: float) -> float:
        """The largest value from a time on; 0 without samples."""
        return max(self.values[bisect.bisect_left(self.times, time) :], default=0.0)

    def drop_before(self, time: float) -> None:
        """Drop what is earlier, and the earliest of too many."""
        for times, *columns in (
            (self.times, self.values, self._voltages),
            (self._current_times, self._currents),
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
        voltages = np.array(self._voltages[:stop])
        is_known = np.isfinite(voltages)
        if np.count_nonzero(is_known) < 2:
            return alone
        measured = Signal(at[is_known], voltages[is_known])
        dates = dates_by_voltage(commands.times, commands.volts, measured, has_stamps=False)
        if dates is not None:
            alone = replace(alone, drive=Drive(dates.times, dates.volts))
        return replace(alone, coil_voltage=measured)

    def _currents_until(self, last: float, start: float) -> Signal | None:
        stop = bisect.bisect_right(self._current_times, last)
        if stop == 0:
            return None
        return Signal(np.array(self._current_times[:stop]) - start, np.array(self._currents[:stop]))


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
