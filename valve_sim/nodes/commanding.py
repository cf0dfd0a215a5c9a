"""What nodes that command coils have in common: a signal only ends their work, and 0 V is the last command of all."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType

from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import uninstall_signal_handlers
from std_msgs.msg import Float64

from valve_sim.nodes.spinning import spin, wait_until_heard
from valve_sim.nodes.threads import Fail, StoppableThread, StopRequest
from valve_sim.nodes.wiring import RosNode


class AnsweringThread(StoppableThread):
    """Answers ROS (parameters, topics, /clock) until it is stopped, and shuts ROS down then.

    SIGINT and SIGTERM only call `end_work`: a ROS context that they had shut down could not send 0 V any more.

    Args:
        node: is spun. end_work: called with the reason why the main thread shall end its work.
        fail: told what went wrong in the thread.
    """

    def __init__(self, node: Node, end_work: Callable[[str], None], fail: Fail) -> None:
        super().__init__("answering", self._answer, fail)
        self._node, self._end_work = node, end_work

    def start(self) -> None:
        """Take signals from now on, and answer; to be called in the main thread."""
        uninstall_signal_handlers()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._take_signal)
        super().start()

    def wake(self) -> None:
        """Shut ROS down, whose end this thread waits for."""
        self._node.context.try_shutdown()

    def _take_signal(self, number: int, frame: FrameType | None) -> None:
        self._end_work(f"a signal came ({signal.Signals(number).name})")

    def _answer(self) -> None:
        try:
            spin(self._node)
        except ExternalShutdownException:
            self._end_work("ROS was shut down")


class CommandingNode(RosNode):
    """A node whose main thread works until it is done or told to end, and which then commands 0 V.

    Whichever thread commands does so under `_commanding`, unless `_is_off`.

    Args:
        name: of the node, unless ROS is told another.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._voltages: list[Publisher] = []
        self._commanding = threading.Lock()
        self._is_off = False
        """Whether 0 V has been commanded for good; whoever is still at work then commands nothing."""
        self._stop = StopRequest()
        self._answering = AnsweringThread(self._node, self._stop.ask, self._fail)
        self._threads.append(self._answering)

    def spin(self) -> None:
        """Work until that is done or a signal comes; 0 V is the last command to every coil."""
        self._answering.start()
        try:
            self._work()
        finally:
            self._switch_off()

    def _work(self) -> None:
        """What the node does in its main thread, until it is asked to stop."""
        self._stop.wait()

    def _switch_off(self) -> None:
        """Command 0 V to every coil for good, and wait until that is heard."""
        with self._commanding:
            self._is_off = True
            if not self._node.context.ok():
                return
            for voltage in self._voltages:
                voltage.publish(Float64(data=0.0))
        wait_until_heard(self._voltages)

    def _fail(self, error: Exception) -> None:
        """End the work, whichever thread cannot go on; ROS stays, so that 0 V can still be sent."""
        self._log_failure(error)
        self._stop.ask(f"the node cannot go on: {error!r}")
