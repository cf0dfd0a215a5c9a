"""When did the valve get its command? How uncertain that is, measured all the time beside a working valve.

A command on a topic has no stamp: it is timed by when it came in here, and the valve obeys when it came in there. On a
busy machine the two differ by milliseconds, from stroke to stroke. Two things show by how much: how unevenly samples,
which are stamped, come in; and how the start of a stroke scatters about its command. A fault that delays every stroke
alike shows in the mean of the latter, not in its scatter, so that this hides no such fault.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

REMEMBERED: Final = 10
"""s for which the unevenness of arrivals is remembered."""
FAR: Final = 3.0
"""Standard deviations within which nearly all of some twenty normal numbers are."""
RECENT: Final = 20
"""Strokes over which the scatter is taken."""
SAME_VOLTAGE: Final = 0.01
"""Share by which voltages differ at most whose strokes take the same time: a fault delays low ones by more."""
PLAINLY_WIDER: Final = 2.0
"""Times the commissioned scatter beyond which its mean is in doubt too: a busy machine makes commands late."""
MEDIAN_OF_LARGER: Final = 1.052
"""Median of the larger size of two standard normal numbers."""
UNTIMED: Final = 0.05
"""s: so wide a prior that it says nothing of when a command was obeyed."""
LONGEST: Final = 0.1
"""Share of the time that the valve takes to open: with a larger scatter, nothing is said of delays."""


class ArrivalSpread:
    """How unevenly stamped samples come in: arrival less stamp, of which a clock's offset is no part.

    The soonest of the last `REMEMBERED` seconds is what the way itself takes; what is later waited for a processor or
    a network, as a command without a stamp may have done.
    """

    def __init__(self) -> None:
        self._seconds: deque[tuple[float, float, float]] = deque(maxlen=REMEMBERED)

    def add(self, time: float, late: float) -> None:
        """A sample of this stamp, s, that came in so late, s; nan is left out."""
        if not math.isfinite(late):
            return
        if not self._seconds or not 0.0 <= time - self._seconds[-1][0] < 1.0:
            self._seconds.append((time, late, late))
            return
        start, low, high = self._seconds[-1]
        if not low <= late <= high:
            self._seconds[-1] = start, min(low, late), max(high, late)

    @property
    def soonest(self) -> float:
        """s; inf before the first."""
        return min((low for _, low, _ in self._seconds), default=math.inf)

    @property
    def spread(self) -> float:
        """Seconds between the soonest and the latest; 0 before the first."""
        return max(high for _, _, high in self._seconds) - self.soonest if self._seconds else 0.0


class TimedStroke(NamedTuple):
    """What one stroke shows of its commands' times.

    Attributes:
        volts: of the stroke. shifts: s by which its opening and its closing were later than their commands, the
            commissioned mean taken off; nan where not seen. arrival_spread: as `StrokeRecord` has it, s.
    """

    volts: float
    shifts: Sequence[float]
    arrival_spread: float


class CommandScatter:
    """The standard deviation that a command's time must be allowed, stroke by stroke.

    Args:
        jitter: s, as found at commissioning; it is never less.
        healthy: the commissioning strokes.
    """

    def __init__(self, jitter: float, healthy: Iterable[TimedStroke]) -> None:
        self._jitter = jitter
        self._strokes: deque[TimedStroke] = deque(maxlen=2 * RECENT)
        self._steps: deque[tuple[float, float]] = deque(maxlen=2 * RECENT)
        self._arrivals: deque[float] = deque(maxlen=RECENT)
        self.arrivals = math.nan
        """s, the widest spread of arrivals at commissioning; nan where they are not known."""
        for stroke in healthy:
            self.add(stroke)
        self.arrivals = self._widest_arrival()
        self.sigma = self.lasting = jitter
        """s: what the last stroke is allowed, and what the strokes before it show already."""

    def add(self, stroke: TimedStroke) -> float:
        """One more stroke, that itself included; the standard deviation of its commands' times, s.

        What is new with this stroke alone may be a change of the valve, or chance: nobody knows before the next one.
        """
        last, step = self._step(stroke)
        if math.isfinite(step):
            self._steps.append((last, step))
        self._strokes.append(stroke)
        if math.isfinite(stroke.arrival_spread):
            self._arrivals.append(stroke.arrival_spread)
        self.lasting = self._with_mean(max(self._jitter * self._arrival_ratio(), self._of_steps()))
        self.sigma = max(self.lasting, self._with_mean(step / FAR if math.isfinite(step) else 0.0))
        return self.sigma

    def _with_mean(self, spread: float) -> float:
        """The root mean square about the commissioned time, where the scatter is plainly wider than it was."""
        if spread <= PLAINLY_WIDER * self._jitter:
            return max(self._jitter, spread)
        last = list(self._strokes)[-RECENT:]
        shifts = [shift for stroke in last for shift in stroke.shifts if math.isfinite(shift)]
        return max(spread, math.sqrt(sum(shift**2 for shift in shifts) / max(1, len(shifts))))

    def _step(self, stroke: TimedStroke) -> tuple[float, float]:
        """The last voltage that was its own, and how much later it was than then, s: the larger of two, over √2."""
        for last in reversed(self._strokes):
            if abs(last.volts - stroke.volts) <= SAME_VOLTAGE * abs(stroke.volts):
                apart = [abs(now - then) for now, then in zip(stroke.shifts, last.shifts, strict=True)]
                step = max((step for step in apart if math.isfinite(step)), default=math.nan)
                return round(stroke.volts, 1), step / math.sqrt(2.0)
        return stroke.volts, math.nan

    def _of_steps(self) -> float:
        """The scatter that steps show. One step for each voltage is a change of the valve: the largest is left out."""
        by_voltage: dict[float, list[float]] = {}
        for volts, step in self._steps:
            by_voltage.setdefault(volts, []).append(step)
        steps = sorted(step for group in by_voltage.values() for step in sorted(group)[:-1])
        return max(steps[-1] / FAR, steps[len(steps) // 2] / MEDIAN_OF_LARGER) if steps else 0.0

    def _widest_arrival(self) -> float:
        return max(self._arrivals, default=math.nan)

    def _arrival_ratio(self) -> float:
        """How much less evenly samples come in than at commissioning: so much less evenly, then, do commands."""
        ratio = self._widest_arrival() / self.arrivals if self.arrivals > 0.0 else math.nan
        return ratio if math.isfinite(ratio) else 1.0


def allowed_scatters(jitter: float, opening_seconds: float) -> tuple[float, ...]:
    """The standard deviations of a command's time, s, with which strokes are scored: doubled, and then `UNTIMED`."""
    levels = []
    while jitter <= LONGEST * opening_seconds:
        levels.append(jitter)
        jitter *= 2.0
    return (*levels, UNTIMED)


def allowed_for(sigma: float, levels: Sequence[float]) -> float:
    """The least of the levels that allows for this standard deviation, s; the last where none does."""
    return next((level for level in levels if level >= sigma * (1.0 - 1e-9)), levels[-1])
