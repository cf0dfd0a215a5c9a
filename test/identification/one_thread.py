"""A monitor whose segmenter and stroke monitor run in one thread, for tests and benchmarks."""

from __future__ import annotations

import math

from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Valve


class Monitor:
    """Each way to hand something over is the segmenter's, and returns reports of the strokes that ended with it."""

    def __init__(self, valve: Valve, settings: MonitorSettings | None = None, *, refit: bool = True) -> None:
        settings = settings or MonitorSettings()
        self.segmenter = StrokeSegmenter(valve, settings)
        self.stroke_monitor = StrokeMonitor(valve, settings)
        self._refit = refit
        self._is_handed_over = False

    def command(self, time: float, volts: float) -> list[StrokeReport]:
        self.segmenter.command(time, volts)
        return self._reports()

    def measure(self, time: float, position: float, arrival: float = math.nan) -> list[StrokeReport]:
        self.segmenter.measure(time, position, arrival)
        return self._reports()

    def measure_many(self, times: Array, positions: Array) -> list[StrokeReport]:
        """Take samples of the positions, like `StrokeSegmenter.measure_many`."""
        self.segmenter.measure_many(times, positions)
        return self._reports()

    def measure_current(
        self, time: float, current: float, voltage: float = math.nan, arrival: float = math.nan
    ) -> list[StrokeReport]:
        self.segmenter.measure_current(time, current, voltage, arrival)
        return self._reports()

    def measure_currents(self, times: Array, currents: Array, voltages: Array) -> list[StrokeReport]:
        """Take samples of the current, like `StrokeSegmenter.measure_currents`."""
        self.segmenter.measure_currents(times, currents, voltages)
        return self._reports()

    def _reports(self) -> list[StrokeReport]:
        reports = [self.stroke_monitor.assess(record, refit=self._refit) for record in self.segmenter.take_finished()]
        if reports and math.isfinite(self.stroke_monitor.command_scatter):
            self.segmenter.scatter = self.stroke_monitor.command_scatter
        baseline = self.stroke_monitor.baseline
        if baseline is not None and not self._is_handed_over:
            self.segmenter.use(baseline.valve, baseline.lateness)
            self._is_handed_over = True
        return reports
