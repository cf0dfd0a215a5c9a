"""A delay that both commands of the last strokes share: it is of a clock, of a load, or of the valve.

Commands without a stamp are timed when they come in, samples by their stamps. When the load of a machine changes, the
one shifts against the other, by the same time in every stroke and for opening and closing alike. A fault of the valve
delays its opening and its closing by different times, or changes the shape of the motion. So a shared delay is taken
off before a stroke is compared with the baseline, and is said by itself. Where the coil's voltage dates the commands,
nothing is taken off: then a delay is the valve's.
"""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from typing import Final

from valve_sim.identification.monitoring.command_timing import StrokeTiming
from valve_sim.model import Drive
from valve_sim.recordings import Trace

FEWEST: Final = 2
"""Strokes in a row that share a delay."""
ALIKE: Final = 3.0
"""Standard deviations of commands' times within which delays are the same."""
PLAIN: Final = 2.0
"""The same beyond which a shared delay is one."""


class SharedDelay:
    """The delay that the last strokes share.

    Args:
        jitter: s, standard deviation of a command's time, as commissioned. healthy: the commissioning strokes.

    Attributes:
        seconds: by which commands are obeyed later than when the valve was commissioned; 0 where nothing is shared.
    """

    def __init__(self, jitter: float, healthy: Iterable[StrokeTiming]) -> None:
        columns = zip(*(stroke.shifts for stroke in healthy), strict=True)
        usual = [[shift for shift in column if math.isfinite(shift)] for column in columns]
        self._usual = [statistics.median(column) if column else 0.0 for column in usual]
        self._jitter = jitter
        self._last: deque[list[float]] = deque(maxlen=FEWEST)
        self.seconds = 0.0

    def add(self, stroke: StrokeTiming, *, is_dated: bool) -> float:
        """Add a stroke; the shared delay, that stroke included, s.

        Args:
            stroke: its delays. is_dated: whether the coil's voltage says when its commands took effect.
        """
        late = [shift - usual for shift, usual in zip(stroke.shifts, self._usual, strict=True)]
        if is_dated or not all(map(math.isfinite, late)):
            self._last.clear()
            self.seconds = 0.0
            return 0.0
        self._last.append(late)
        delays = [shift for shifts in self._last for shift in shifts]
        middle = statistics.median(delays)
        is_shared = len(self._last) == FEWEST and self._are_alike(delays, middle)
        if is_shared:
            self.seconds = middle if abs(middle) > PLAIN * self._jitter else 0.0
        elif not self._are_alike(late, self.seconds):
            self.seconds = 0.0
        return self.seconds

    def _are_alike(self, delays: Iterable[float], middle: float) -> bool:
        return max(abs(delay - middle) for delay in delays) <= ALIKE * self._jitter


def without_delay(trace: Trace, seconds: float) -> Trace:
    """A stroke whose commands are moved to where they were obeyed."""
    return trace if seconds == 0.0 else replace(trace, drive=Drive(trace.drive.times + seconds, trace.drive.volts))
