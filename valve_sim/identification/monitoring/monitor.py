"""Beside a real valve: each stroke held against the model, an alarm of a stated false-alarm rate. No clock, no ROS.

Two halves, for two threads. A `StrokeSegmenter` is fed commands and samples as they come; it steps the model beside
them, cuts the stream into strokes, and says at once when the valve does not open or does not close. A `StrokeMonitor`
takes the strokes, some milliseconds each, whenever there is time. A `Monitor` is both in a row.
"""

from __future__ import annotations

import math

from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Valve


class Monitor:
    """Watch and judge in a row, for callers that have the time.

    Args:
        valve: the declared valve.
        settings: how it is watched.
        refit: whether reports have refitted dampings.
    """

    def __init__(self, valve: Valve, settings: MonitorSettings | None = None, *, refit: bool = True) -> None:
        settings = settings or MonitorSettings()
        self.watch = StrokeSegmenter(valve, settings)
        self.judge = StrokeMonitor(valve, settings)
        self._refit = refit
        self._is_handed_over = False

    def command(self, time: float, volts: float) -> list[StrokeReport]:
        """As `StrokeSegmenter.command`; reports of the strokes that it ended."""
        self.watch.command(time, volts)
        return self._reports()

    def measure(self, time: float, position: float, arrival: float = math.nan) -> list[StrokeReport]:
        """As `StrokeSegmenter.measure`."""
        self.watch.measure(time, position, arrival)
        return self._reports()

    def measure_many(self, times: Array, positions: Array) -> list[StrokeReport]:
        """As `StrokeSegmenter.measure_many`."""
        self.watch.measure_many(times, positions)
        return self._reports()

    def _reports(self) -> list[StrokeReport]:
        reports = [self.judge.judge(record, refit=self._refit) for record in self.watch.take_finished()]
        if reports and math.isfinite(self.judge.command_scatter):
            self.watch.scatter = self.judge.command_scatter
        healthy = self.judge.healthy
        if healthy is not None and not self._is_handed_over:
            self.watch.use(healthy.valve, healthy.lateness)
            self._is_handed_over = True
        return reports
