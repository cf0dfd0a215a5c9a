"""The independent plant as a station's real valve: clock, commands and samples on topics, in simulated time.

Nothing waits by the wall: the next samples are sent when the monitor has answered the last, so that strokes pass as
fast as it can take them, and a busy machine is slow and no worse.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from identification.live_strokes import LiveStroke, LiveValve

from .ros_process import ASK_AGAIN, PATIENCE, Probe, report_of

CHUNK = 100
"""Samples that are under way at most."""
SECOND = 1_000_000_000
PAUSE = 0.05
"""s by the wall between the samples that are sent before the monitor answers."""
BEFORE = -5.0
"""s: their stamps begin so long before the first stroke that nothing of them is kept with it."""


class PlantOnTopics:
    """A valve for monitor_node to watch, and ears for what it says."""

    def __init__(self, probe: Probe, valve: LiveValve, monitor: str = "/monitor") -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64

        self._probe = probe
        self._valve = valve
        self._float, self._joints, self._clock_message = Float64, JointState, Clock
        self._clock = probe.talker("/clock", Clock, 1000)
        self._voltage = probe.talker("coil_voltage", Float64)
        self._samples = probe.talker("measured/joint_states", JointState, 1000)
        # The predictions last: a monitor that has found who hears them has found all that was announced before.
        self._reports = probe.hear(f"{monitor}/stroke_report", DiagnosticArray)
        self.residuals = probe.hear(f"{monitor}/residual", Float64)
        self.predicted = probe.hear(f"{monitor}/predicted/joint_states", JointState)
        self._taken = self._sent = 0

    def wait_for_monitor(self) -> None:
        """Until each hears the other: samples of long before the first stroke are sent until one is answered."""
        talkers = (self._clock, self._voltage, self._samples)
        assert self._probe.until(lambda: all(talker.get_subscription_count() > 0 for talker in talkers))
        for index in range(round(PATIENCE / PAUSE)):
            message = self._joints(name=["pilot_plunger"], position=[0.0])
            _stamp(message.header.stamp, BEFORE + 1e-3 * index)
            self._samples.publish(message)
            if self._probe.until(lambda: bool(self.predicted), PAUSE):
                self._sent = self.told  # an earlier monitor took the end of its last stroke with it
                return
        raise AssertionError("the monitor predicts nothing")

    def stroke(self, effects: Mapping[str, Mapping[str, float]] | None = None) -> None:
        """One stroke of the valve with these effects, each sample answered."""
        made = self._valve.stroke(effects)
        self._sent += 1
        edges = np.searchsorted(made.times, made.command_times).tolist()
        for index, (first, stop) in enumerate(zip([0, *edges], [*edges, len(made.times)], strict=True)):
            if index:
                self._command(float(made.command_times[index - 1]), float(made.volts[index - 1]))
            for start in range(first, stop, CHUNK):
                self._send(made, start, min(start + CHUNK, stop))

    def strokes(self, count: int, effects: Mapping[str, Mapping[str, float]] | None = None) -> list[Any]:
        """So many strokes; the reports that were not taken yet of all but the last, which has not ended yet."""
        for _ in range(count):
            self.stroke(effects)
        assert self._probe.until(lambda: self.told >= self._sent - 1), "a stroke was not reported"
        return self.take_reports()

    def rest(self, count: int, seconds: float = 0.15) -> list[Any]:
        """Rest closed, each sample answered; the reports that came, once there have been `count` in all."""
        made = self._valve.rest(seconds)
        for start in range(0, len(made.times), CHUNK):
            self._send(made, start, min(start + CHUNK, len(made.times)))
        self._probe.until(lambda: self.told >= count)
        return self.take_reports()

    @property
    def told(self) -> int:
        """How many strokes have been reported."""
        return self._taken + len(self._reports)

    def take_reports(self) -> list[Any]:
        """The reports that have come since it was last asked."""
        taken = [report_of(report) for report in self._reports]
        self._taken += len(taken)
        self._reports.clear()
        return taken

    def forget(self) -> None:
        """All samples but the last: for runs that are long."""
        for heard in (self.predicted, self.residuals):
            del heard[:-1]

    def _command(self, time: float, volts: float) -> None:
        self._clock.publish(self._clock_message(clock=_stamp(self._joints().header.stamp, time)))
        self._voltage.publish(self._float(data=volts))

    def _send(self, made: LiveStroke, first: int, stop: int) -> None:
        for index in range(first, stop):
            message = self._joints(name=["pilot_plunger"], position=[float(made.position[index])])
            _stamp(message.header.stamp, float(made.times[index]))
            self._samples.publish(message)
        last = message
        # The monitor hears samples as sensors send them, at best effort: a busy machine may lose the last one as well.
        assert self._probe.until(lambda: self._is_predicted(last), ASK_AGAIN) or self._probe.insist(
            lambda: self._samples.publish(last), lambda: self._is_predicted(last)
        ), "no prediction"

    def _is_predicted(self, sample: Any) -> bool:
        return bool(self.predicted) and self.predicted[-1].header.stamp == sample.header.stamp


def _stamp(stamp: Any, time: float) -> Any:
    """From the tenth second on: ROS takes a time of zero for no clock."""
    stamp.sec, stamp.nanosec = divmod(10 * SECOND + round(time * SECOND), SECOND)
    return stamp
