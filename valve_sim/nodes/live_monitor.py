"""A monitor by the stamps of what it hears, without ROS: commands, samples and pressures in; strokes out."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

from valve_sim.identification.monitoring.findings import Prediction, StrokeRecord
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor
from valve_sim.model import Valve
from valve_sim.nodes.monitor_work import InputCount, StampCheck
from valve_sim.nodes.realtime import LONGEST_LEAP_SECONDS, NANOSECONDS
from valve_sim.recordings.trouble import MOST_STROKES

_JUMP_SECONDS: Final = 1.0
"""A stamp that goes back by more means a clock that was set or a bag that restarted, not a sample out of order."""


class LiveMonitor:
    """The model beside each sample, and strokes as they end. All is called by the thread that empties the inbox.

    Args:
        valve: as declared. settings: of the monitor. strokes: the monitor of strokes, whose baseline is used.
        by_current: whether no position can come.
        follow: is handed the stamp, ns, and the prediction of each sample. finished: is handed each stroke.
        warn: is told what has changed, and whether it may do so at each sample.

    Attributes:
        input, stamps: what came. segmenter: the model beside the samples.
    """

    def __init__(
        self, valve: Valve, settings: MonitorSettings, strokes: StrokeMonitor, *, by_current: bool,
        follow: Callable[[int, Prediction], None], finished: Callable[[StrokeRecord], None],
        warn: Callable[[str, bool], None],
    ) -> None:  # fmt: skip
        self.input, self.stamps = InputCount(), StampCheck()
        self.segmenter = StrokeSegmenter(valve, settings)
        if by_current:
            self.segmenter.go_by_current()
        self._strokes, self._follow, self._finished, self._warn = strokes, follow, finished, warn
        self._largest = MOST_STROKES * valve.parameters.stroke
        self._is_by_current = self.segmenter.by_current
        self._epoch: int | None = None
        self._last_stamp: int | None = None
        self._baseline: Baseline | None = None

    def outlet_pressure(self, stamp: int, pressure: float) -> None:
        """A pressure behind the valve, Pa."""
        self.segmenter.line.hear(self._seconds(stamp), pressure)

    def end_pressure(self, name: str, stamp: int, pressure: float) -> None:
        """A pressure of its tank, or of what its demand's orifice leads to, Pa."""
        self.segmenter.line.hear_end(name, self._seconds(stamp), pressure)

    def command(self, topic: str, stamp: int, volts: float) -> None:
        """A command."""
        rejected = self.segmenter.rejected
        self.segmenter.command(self._seconds(stamp), volts)
        if self.segmenter.rejected > rejected:
            self.input.reject(f"{topic}: {volts:g} V")
        else:
            self.input.commands += 1
        self._hand_over()

    def position(self, topic: str, stamp: int, position: float, received: int) -> None:
        """A sample, m, and the time of its reception, ns, 0 where that is not known."""
        if abs(position) > self._largest:
            self.input.reject(f"{topic}: {position:g} m, expected metres, at most {self._largest:g} m")
            return
        self._watch_for_jumps(stamp)
        prediction = self.segmenter.measure(self._seconds(stamp), position, self._arrival(received))
        self._take(stamp, prediction, f"{topic}: {position:g} m")

    def coil(self, topic: str, stamp: int, current: float, voltage: float, received: int) -> None:
        """A sample of the coil, A and V or nan."""
        if self.segmenter.by_current:
            self._watch_for_jumps(stamp)
        prediction = self.segmenter.measure_current(self._seconds(stamp), current, voltage, self._arrival(received))
        if self.segmenter.by_current:
            self._take(stamp, prediction, f"{topic}: {current:g} A")

    def _seconds(self, stamp: int) -> float:
        """Seconds since the first stamp, so that a double resolves nanoseconds."""
        if self._epoch is None:
            self._epoch = stamp
        return (stamp - self._epoch) / NANOSECONDS

    def _arrival(self, received: int) -> float:
        return self._seconds(received) if received else math.nan

    def _watch_for_jumps(self, stamp: int) -> None:
        """Start again where the clock was set, or a bag starts again."""
        moved = (stamp - self._last_stamp) / NANOSECONDS if self._last_stamp is not None else 0.0
        if moved < -_JUMP_SECONDS or moved > LONGEST_LEAP_SECONDS:
            self._warn(f"the stamps jumped by {moved:g} s: the valve is taken to be at rest", True)
            self.segmenter.reset()
            self._epoch, self._last_stamp = stamp, stamp - 1

    def _take(self, stamp: int, prediction: Prediction | None, sample: str) -> None:
        """After a sample: hand on what was predicted, and strokes that it has ended."""
        if self.segmenter.by_current is not self._is_by_current:
            self._is_by_current = self.segmenter.by_current
            alone = "goes by the coil's current alone: no position comes"
            self._warn(alone if self._is_by_current else "goes by positions", False)
        if prediction is None:
            self.input.reject(f"{sample} at {stamp} ns, the last at {self._last_stamp} ns")
            return
        self._last_stamp = stamp
        self.input.samples += 1
        self._follow(stamp, prediction)
        self._hand_over()

    def _hand_over(self) -> None:
        for record in self.segmenter.take_finished():
            self._finished(record._replace(stamp=(self._epoch or 0) + round(record.time * NANOSECONDS)))
        scatter = self._strokes.command_scatter
        self.segmenter.scatter = scatter if math.isfinite(scatter) else 0.0
        baseline = self._strokes.baseline
        if baseline is not self._baseline and baseline is not None:
            self.segmenter.use(baseline.valve, baseline.lateness)
            self._baseline = baseline
