"""The pressure behind a valve with gas before a stroke, from which the model of the stroke starts."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.traces import Trace

MOST: Final = 5_000
"""Samples of each kind in memory."""
LONGEST: Final = 2.0
"""s before a stroke for which pressures are kept."""


class LinePressure:
    """Pressures of the last seconds: as heard, where any is heard, else as the model has them."""

    def __init__(self) -> None:
        self._noted: deque[tuple[float, float]] = deque(maxlen=MOST)
        self._heard: deque[tuple[float, float]] = deque(maxlen=MOST)
        self._kept: list[tuple[float, float]] = []

    def note(self, time: float, pressure: float) -> None:
        """What the model has at a sample, s and Pa."""
        self._add(self._noted, time, pressure)

    def hear(self, time: float, pressure: float) -> None:
        """What a sensor shows; what is not later than the last is left out."""
        self._add(self._heard, time, pressure)

    def keep(self) -> None:
        """A stroke begins: keep what there is for it."""
        latest = self._noted[-1][0] if self._noted else -math.inf
        is_heard = bool(self._heard) and self._heard[-1][0] > latest - LONGEST
        self._kept = list(self._heard if is_heard else self._noted)

    def before(self, trace: Trace, opening: float) -> Trace:
        """That stroke's trace with the pressure at its beginning, given when its first command was, s."""
        if not self._kept:
            return trace
        times, pressures = np.array(self._kept).T
        began = opening - float(trace.drive.times[0])
        return replace(trace, outlet_start=float(np.interp(began, times, pressures)))

    @staticmethod
    def _add(samples: deque[tuple[float, float]], time: float, pressure: float) -> None:
        if not (math.isfinite(time) and math.isfinite(pressure)) or (samples and time <= samples[-1][0]):
            return
        samples.append((time, pressure))
        while samples[0][0] < time - LONGEST:
            samples.popleft()
