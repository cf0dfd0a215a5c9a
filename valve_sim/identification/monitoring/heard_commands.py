"""When the commands of a stroke took effect, by the voltage at the coil, and how much later they were heard.

Samples of the coil carry stamps, a command on a topic does not: where the voltage is heard beside the positions, it
says when the valve received each command, and nothing is left of the scatter with which messages come in on a busy
machine.
"""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import replace

from valve_sim.identification.monitoring.command_timing import RECENT, ArrivalSpread
from valve_sim.model import Drive
from valve_sim.traces import Signal, Trace
from valve_sim.traces.command_times import dates_by_voltage, within_steps


class HeardCommands:
    """Dates the commands of each stroke, and remembers by how much they came in later than they took effect."""

    def __init__(self) -> None:
        self._late: deque[float] = deque(maxlen=2 * RECENT)
        self._spread = ArrivalSpread()

    @property
    def lateness(self) -> float:
        """s, the median of the last commands; 0 where no voltage was heard."""
        return statistics.median(self._late) if self._late else 0.0

    @property
    def spread(self) -> float:
        """Seconds between the smallest and the largest of late."""
        return self._spread.spread

    def dated(self, trace: Trace, voltage: Signal | None) -> Trace:
        """A stroke with its commands when they took effect; itself where the voltage does not show them.

        Args:
            trace: of a stroke. voltage: at the coil's terminals, V, by the stroke's times, s.
        """
        if voltage is None:
            return trace
        heard = trace.drive
        if not trace.has_positions:
            dates = dates_by_voltage(heard.times, heard.volts, voltage, has_stamps=False)
            return trace if dates is None else replace(trace, drive=Drive(dates.times, dates.volts))
        times = within_steps(heard.times, heard.volts, voltage)
        if times is None:
            return trace
        start = trace.epoch_ns / 1e9
        for date, late in zip(times.tolist(), (heard.times - times).tolist(), strict=True):
            self._late.append(late)
            self._spread.add(start + date, late)
        return replace(trace, drive=Drive(times, heard.volts))
