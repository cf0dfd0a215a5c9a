"""What nodes that command coils have in common: a signal only ends their work, and 0 V is the last command of all."""

from __future__ import annotations

import threading

from rclpy.publisher import Publisher
from std_msgs.msg import Float64

from valve_sim.nodes.spinning import AnsweringThread, wait_until_heard
from valve_sim.nodes.wiring import RosNode


class CommandingNode(RosNode):
    """A node that commands coils from its own threads, and from whichever of them under `_commanding`.

    Args:
        name: of the node, unless ROS is told another.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._voltages: list[Publisher] = []
        self._commanding = threading.Lock()
        self._is_off = False
        """Whether 0 V has been commanded for good; whoever is still at work then commands nothing."""
        self._stop = threading.Event()
        self._answering = AnsweringThread(self._node, stop=lambda reason: self._stop.set(), fail=self._fail)

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
        if self._node.context.ok():
            self._exit_code = 1
            self._node.get_logger().fatal(f"the node cannot go on: {error!r}")
        self._stop.set()
