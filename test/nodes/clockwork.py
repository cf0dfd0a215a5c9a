"""Several valves and their monitors on simulated time, which goes on when all of them have caught up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .ros_process import PATIENCE, Probe, report_of

STROKE = (0.1, 0.03, 0.12)
"""s of rest, of voltage, and without it again."""
TICK = 10e-3
"""s by which the clock goes on."""
PAUSE = 0.1
"""s by the wall between ticks, while nodes still start."""
SECOND = 1_000_000_000


class Clockwork:
    """A station's clock and the hand on its coils, one probe for each valve; a busy machine makes it slow."""

    def __init__(self, probes: Sequence[Probe]) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from rcl_interfaces.srv import GetParameters
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64

        self._probe = probes[0]
        self._clock_type, self._float = Clock, Float64
        self._clock = self._probe.talker("/clock", Clock)
        self._now = 10 * SECOND
        self._voltages = [probe.talker("coil_voltage", Float64) for probe in probes]
        monitors = [probe.target.replace("valve", "monitor") for probe in probes]
        # The predictions last: a monitor that has found who hears them has found all that was announced before.
        self._reports = [self._probe.hear(f"{name}/stroke_report", DiagnosticArray) for name in monitors]
        self._predicted = [self._probe.hear(f"{name}/predicted/joint_states", JointState) for name in monitors]
        # A node answers a question after it has taken what was sent before: its answer says that it has.
        self._question = GetParameters.Request()
        self._askable = [
            self._probe.node.create_client(GetParameters, f"{name}/get_parameters")
            for name in (*(probe.target for probe in probes), *monitors)
        ]

    def wait_for_all(self) -> None:
        """Until every node is there and has its model compiled."""
        talkers = {self._clock: len(self._askable), **dict.fromkeys(self._voltages, 2)}
        assert self._probe.until(
            lambda: all(talker.get_subscription_count() == count for talker, count in talkers.items())
        )
        assert self._probe.until(lambda: all(client.service_is_ready() for client in self._askable))
        assert any(self._are_predicting() for _ in range(round(PATIENCE / PAUSE))), "a monitor predicts nothing"
        self._run(2 * TICK)

    def stroke(self) -> None:
        """One stroke of every valve."""
        rest, on, off = STROKE
        self._run(rest)
        self._command(9.0)
        self._run(on)
        self._command(0.0)
        self._run(off)

    def commission(self, most: int) -> None:
        """Strokes, so many at most, until every monitor knows its healthy valve."""
        everyone = range(len(self._reports))
        assert self.strokes_until(most, lambda: all(self._is_watching(index) for index in everyone)), "not commissioned"

    def strokes_until(self, most: int, condition: Callable[[], Any]) -> bool:
        """So many strokes at most; whether the condition came to hold after one."""
        for _ in range(most):
            self.stroke()
            if condition():
                return True
        return False

    def told(self, index: int) -> list[Any]:
        """The stroke reports of one monitor."""
        return [report_of(report) for report in self._reports[index]]

    def is_alarmed(self, index: int) -> bool:
        """Whether one monitor has raised an alarm."""
        return any(report["alarm.raised"] for report in self.told(index))

    def _is_watching(self, index: int) -> bool:
        return any(report["state"] == "watching" for report in self.told(index))

    def _are_predicting(self) -> bool:
        """Whether all do, after one more tick; they are given time, so that no flood of ticks awaits who compiles."""
        self._now += round(TICK * SECOND)
        self._tell_time()
        return self._probe.until(lambda: all(self._predicted), PAUSE)

    def _tell_time(self) -> None:
        message = self._clock_type()
        message.clock.sec, message.clock.nanosec = divmod(self._now, SECOND)
        self._clock.publish(message)

    def _run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK)):
            self._now += round(TICK * SECOND)
            # Nodes hear /clock without a guarantee.
            assert self._probe.insist(self._tell_time, self._have_caught_up), "a node does not follow the clock"

    def _have_caught_up(self) -> bool:
        stamps = [heard[-1].header.stamp for heard in self._predicted]
        return all(stamp.sec * SECOND + stamp.nanosec > self._now - TICK * SECOND for stamp in stamps)

    def _command(self, volts: float) -> None:
        for voltage in self._voltages:
            voltage.publish(self._float(data=volts))
        self._probe.answers(self._askable, self._question)
