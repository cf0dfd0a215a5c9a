"""Strokes of the independent plant of which nothing but the coil is seen, as a monitor meets them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from plants.coil_alone import Build, Course, simulate

from identification.one_thread import Monitor
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport

RATE, NOISE, VOLTAGE_NOISE = 5e3, 1e-3, 5e-3
"""Hz, A, V."""
COMMANDS = np.array([0.020, 0.050])
LATEST = 3e-3
"""s, as are the commands: by how much one may come late."""


@lru_cache(maxsize=64)
def course(build: Build, volts: float, period: float) -> Course:
    """One stroke without noise."""
    return simulate(build, COMMANDS, np.array([volts, 0.0]), (np.arange(round(period * RATE)) + 0.37) / RATE)


class LiveCoil:
    """A valve that strokes beside its monitor; each command comes late, but where no voltage is measured, which dates
    commands.
    """

    def __init__(
        self,
        monitor: Monitor,
        random: np.random.Generator,
        levels: Sequence[float],
        period: float,
        *,
        has_voltage: bool,
    ) -> None:  # fmt: skip
        self.monitor, self._random, self._levels, self._period = monitor, random, levels, period
        self._has_voltage, self._strokes = has_voltage, 0

    def stroke(self, build: Build) -> list[StrokeReport]:
        """One stroke of a valve that is built so; reports of those that ended meanwhile."""
        volts, begin = self._levels[self._strokes % len(self._levels)], self._period * self._strokes
        shown, random = course(build, volts, self._period), self._random
        times = begin + shown.times
        current = shown.current + NOISE * random.standard_normal(len(times))
        voltage = shown.voltage + VOLTAGE_NOISE * random.standard_normal(len(times))
        received = begin + COMMANDS + self._has_voltage * LATEST * random.uniform(size=2)
        if not self._has_voltage:
            voltage[:] = math.nan
        edges = [0, *np.searchsorted(times, received), len(times)]
        reports = []
        for part, first in enumerate(edges[:-1]):
            if part:
                reports += self.monitor.command(float(received[part - 1]), (volts, 0.0)[part - 1])
            chosen = slice(first, edges[part + 1])
            reports += self.monitor.measure_currents(times[chosen], current[chosen], voltage[chosen])
        self._strokes += 1
        return reports

    def strokes(self, count: int, build: Build) -> list[StrokeReport]:
        """So many of them."""
        return [report for _ in range(count) for report in self.stroke(build)]
