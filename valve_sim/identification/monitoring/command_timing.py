"""The standard deviation of the time at which the valve received a command, measured while it works.

A command on a topic has no stamp: it is timed when it arrives here, and the valve follows it when it arrives there. On
a busy machine the two differ by milliseconds, from stroke to stroke. Two things show by how much: the jitter with which
stamped samples arrive, and how the start of a stroke scatters about its command. A fault that delays every stroke alike
changes the mean of the latter and not its scatter, so this hides no such fault.

Samples of the coil carry stamps: where the voltage is heard beside the positions, it says when the valve received each
command, and nothing is left of the scatter with which messages come in on a busy machine.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from valve_sim.model import Drive
from valve_sim.recordings import Signal, Trace
from valve_sim.recordings.command_times import dates_by_voltage, within_steps

ARRIVAL_WINDOW: Final = 10
"""s over which the jitter of arrivals is taken."""
EXTREME_SIGMAS: Final = 3.0
"""Standard deviations within which nearly all of some twenty normal numbers lie."""
RECENT: Final = 20
"""Strokes over which the scatter is taken."""
SAME_VOLTAGE: Final = 0.01
"""Largest relative difference of voltages whose strokes are compared: a fault delays those at low voltage more."""
WIDER_SCATTER: Final = 2.0
"""Ratio to the commissioned scatter beyond which the mean is uncertain too: a busy machine delays commands."""
MEDIAN_OF_LARGER: Final = 1.052
"""Median of the larger absolute value of two standard normal numbers."""
UNINFORMATIVE: Final = 0.05
"""s: a prior so wide that it carries no information on when a command took effect."""
LATEST: Final = UNINFORMATIVE
"""s by which samples may come in later than the soonest one, and commands may be assumed to."""
LONGEST: Final = 0.1
"""Share of the opening time: where the scatter is larger, delays are not scored."""


class ArrivalSpread:
    """The jitter of stamped samples: the spread of arrival less stamp, which an offset of the clock does not change.

    The soonest of the last `ARRIVAL_WINDOW` seconds is the delay of the transport; what is later waited for a processor
    or a network, as a command without a stamp may have.

    Attributes:
        earliest: s; inf before the first.
        spread: seconds between the smallest and the largest delay; 0 before the first.
    """

    def __init__(self) -> None:
        self.earliest, self.spread = math.inf, 0.0
        self._seconds: deque[tuple[float, float, float]] = deque(maxlen=ARRIVAL_WINDOW)

    def add(self, time: float, late: float) -> None:
        """Add a sample: its stamp and its delay, s; a delay that is nan is left out."""
        if not math.isfinite(late):
            return
        if not self._seconds or not 0.0 <= time - self._seconds[-1][0] < 1.0:
            self._seconds.append((time, late, late))
        else:
            start, low, high = self._seconds[-1]
            if low <= late <= high:
                return
            self._seconds[-1] = start, min(low, late), max(high, late)
        self.earliest = min(low for _, low, _ in self._seconds)
        self.spread = max(high for _, _, high in self._seconds) - self.earliest

    def beyond_earliest(self, late: float) -> float:
        """A delay less the smallest one, s; nan for one that is not finite."""
        return max(0.0, late - self.earliest) if math.isfinite(late) else math.nan


class StrokeTiming(NamedTuple):
    """The delays of one stroke behind its commands.

    Attributes:
        volts: of the stroke. shifts: s by which its opening and its closing were later than their commands, the
            commissioned mean taken off; nan where not seen. arrival_spread: as `StrokeRecord` has it, s.
    """

    volts: float
    shifts: Sequence[float]
    arrival_spread: float


class CommandScatter:
    """The standard deviation of the commands' times, updated with each stroke.

    Args:
        jitter: s, as found at commissioning: the lower limit.
        healthy: the commissioning strokes.
    """

    def __init__(self, jitter: float, baseline: Iterable[StrokeTiming]) -> None:
        self._jitter = jitter
        self._strokes: deque[StrokeTiming] = deque(maxlen=2 * RECENT)
        self._steps: deque[tuple[float, float]] = deque(maxlen=2 * RECENT)
        self._arrivals: deque[float] = deque(maxlen=RECENT)
        self.arrivals = math.nan
        """s, the widest spread of arrivals at commissioning; nan where they are not known."""
        for stroke in baseline:
            self.add(stroke)
        self.arrivals = self._widest_arrival()
        self.sigma = self.established = jitter
        """s: the value for the last stroke, and what earlier strokes have established already."""

    def add(self, stroke: StrokeTiming) -> float:
        """Add a stroke; the standard deviation of its commands' times, s, that stroke included.

        What this stroke alone shows may be a change of the valve or chance: only the next one will tell. Where the last
        one was as late, whatever its voltage, it is a change.
        """
        last, step = self._step(stroke)
        if math.isfinite(step):
            self._steps.append((last, step))
        alone = min(step, _change(stroke, self._strokes[-1])) if self._strokes else step
        self._strokes.append(stroke)
        if math.isfinite(stroke.arrival_spread):
            self._arrivals.append(stroke.arrival_spread)
        self.established = self._with_mean(max(self._jitter * self._arrival_ratio(), self._of_steps()))
        self.sigma = max(self.established, self._with_mean(alone / EXTREME_SIGMAS if math.isfinite(alone) else 0.0))
        return self.sigma

    @property
    def latest(self) -> float:
        """Seconds by which samples may come in late, see `latest_of`."""
        return latest_of(self.arrivals)

    def _with_mean(self, spread: float) -> float:
        """The root mean square about the commissioned time, where the scatter is plainly wider than it was."""
        if spread <= WIDER_SCATTER * self._jitter:
            return max(self._jitter, spread)
        last = list(self._strokes)[-RECENT:]
        shifts = [shift for stroke in last for shift in stroke.shifts if math.isfinite(shift)]
        return max(spread, math.sqrt(sum(shift**2 for shift in shifts) / max(1, len(shifts))))

    def _step(self, stroke: StrokeTiming) -> tuple[float, float]:
        """Its voltage, and the change of its delays since the last stroke at that voltage."""
        for last in reversed(self._strokes):
            if abs(last.volts - stroke.volts) <= SAME_VOLTAGE * abs(stroke.volts):
                return round(stroke.volts, 1), _change(stroke, last)
        return stroke.volts, math.nan

    def _of_steps(self) -> float:
        """The scatter of steps; the largest at each voltage is left out, for it may be a change of the valve."""
        by_voltage: dict[float, list[float]] = {}
        for volts, step in self._steps:
            by_voltage.setdefault(volts, []).append(step)
        steps = sorted(step for group in by_voltage.values() for step in sorted(group)[:-1])
        return max(steps[-1] / EXTREME_SIGMAS, steps[len(steps) // 2] / MEDIAN_OF_LARGER) if steps else 0.0

    def _widest_arrival(self) -> float:
        return max(self._arrivals, default=math.nan)

    def _arrival_ratio(self) -> float:
        """The jitter of samples relative to commissioning; that of commands is assumed to change by the same ratio."""
        ratio = self._widest_arrival() / self.arrivals if self.arrivals > 0.0 else math.nan
        return ratio if math.isfinite(ratio) else 1.0


def latest_of(usual: float) -> float:
    """Seconds by which samples of a stroke may come in late.

    Args:
        usual: s by which they usually do, as where a driver sends them in batches; nan where that is not known.
    """
    return max(LATEST, WIDER_SCATTER * usual if usual > 0.0 else 0.0)


def _change(stroke: StrokeTiming, last: StrokeTiming) -> float:
    """The change of the delays from one stroke to another, s: the larger, over √2; nan where neither has both."""
    apart = [abs(now - then) for now, then in zip(stroke.shifts, last.shifts, strict=True)]
    return max((step for step in apart if math.isfinite(step)), default=math.nan) / math.sqrt(2.0)


def scatter_levels(jitter: float, opening_seconds: float) -> tuple[float, ...]:
    """The standard deviations of a command's time, s, that strokes are scored with: doubling, then `UNINFORMATIVE`."""
    levels = []
    while jitter <= LONGEST * opening_seconds:
        levels.append(jitter)
        jitter *= 2.0
    return (*levels, UNINFORMATIVE)


def level_for(sigma: float, levels: Sequence[float]) -> float:
    """The smallest level that is no less than this standard deviation, s; the last where none is."""
    return next((level for level in levels if level >= sigma * (1.0 - 1e-9)), levels[-1])


class HeardCommands:
    """Dates the commands of each stroke, and remembers by how much they came in later than they took effect."""

    def __init__(self) -> None:
        self._late: deque[float] = deque(maxlen=2 * RECENT)
        self._spread = ArrivalSpread()
        self._were_seen: deque[bool] = deque(maxlen=RECENT)

    @property
    def are_usually_seen(self) -> bool:
        """Whether the voltage has shown the commands of most of the last strokes."""
        return 2 * sum(self._were_seen) > len(self._were_seen)

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
        dated = self._dated(trace, voltage)
        self._were_seen.append(dated is not trace)
        return dated

    def _dated(self, trace: Trace, voltage: Signal | None) -> Trace:
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
