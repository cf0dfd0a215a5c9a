"""What publishing a sample costs valve_node: `python -m benchmarks.publishing`.

CPU time of this process, which other work on the machine changes little: both messages of a sample, with a listener in
another process, filled in anew as ROS messages each time and as bytes encoded before (`ReadingMessages`). Needs ROS 2.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Final

import rclpy
from builtin_interfaces.msg import Time
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from valve_sim.files.parameter_files import default_valve
from valve_sim.nodes.live_valve import LiveValve, Step
from valve_sim.nodes.messages import JOINT_NAMES, ReadingMessages
from valve_sim.nodes.topics import RELIABLE
from valve_sim.nodes.wiring import profile

SAMPLES: Final = 3000
PERIOD: Final = 5e-4
"""s between samples, so that each is delivered by itself, as at 1 kHz."""
ROUNDS: Final = 5
LISTENER: Final = """
import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node("publishing_listener")
node.create_subscription(JointState, "/publishing/joint_states", lambda message: None, 10)
node.create_subscription(Float64, "/publishing/coil_current", lambda message: None, 10)
rclpy.spin(node)
"""


class Publisher:
    """Publishes one sample in either way."""

    def __init__(self, node: Node, step: Step) -> None:
        self.joint_states = node.create_publisher(JointState, "/publishing/joint_states", profile(RELIABLE))
        self.coil_current = node.create_publisher(Float64, "/publishing/coil_current", profile(RELIABLE))
        self._step = step
        self._encoded = ReadingMessages("")

    def filled_in(self) -> None:
        """As messages that are filled in."""
        reading = self._step.reading
        message = JointState(name=list(JOINT_NAMES))
        seconds, nanoseconds = divmod(self._step.stamp, 1_000_000_000)
        message.header.stamp = Time(sec=seconds, nanosec=nanoseconds)
        message.position = [reading.pilot_position, reading.main_position]
        message.velocity = [reading.pilot_velocity, reading.main_velocity]
        message.effort = [reading.attraction, reading.main_effort]
        self.joint_states.publish(message)
        self.coil_current.publish(Float64(data=reading.coil_current))

    def encoded(self) -> None:
        """As bytes."""
        self.joint_states.publish(self._encoded.joint_states(self._step.stamp, self._step.reading))
        self.coil_current.publish(self._encoded.coil_current(self._step.reading))


def cost(publish: Callable[[], None]) -> float:
    """CPU time of one call by itself, µs."""
    begin = time.process_time()
    for _ in range(SAMPLES):
        publish()
        time.sleep(PERIOD)
    return 1e6 * (time.process_time() - begin) / SAMPLES


def main() -> int:
    """Measure in turns and print: least and most of the rounds."""
    live = LiveValve(default_valve(), scale=1.0, command_timeout=0.0, max_voltage=30.0)
    live.restart(0, 0)
    rclpy.init()
    with subprocess.Popen([sys.executable, "-c", LISTENER]) as listener:
        try:
            publisher = Publisher(rclpy.create_node("publishing"), live.step(1_000_000))
            while not publisher.coil_current.get_subscription_count():
                time.sleep(0.05)
            ways = {"filled in": publisher.filled_in, "encoded before": publisher.encoded, "only slept": lambda: None}
            rounds = [{name: cost(publish) for name, publish in ways.items()} for _ in range(ROUNDS)]
        finally:
            listener.kill()
            rclpy.try_shutdown()
    for name in ways:
        costs = sorted(entry[name] for entry in rounds)
        print(f"{name:20s}{costs[0]:8.1f} to {costs[-1]:.1f} µs of CPU a sample")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
