"""This process's ROS node: subscribes to the valve's topics and commands its coil."""

from __future__ import annotations

import importlib
import queue
import threading
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from valve_sim.demo.process import STOP_LIMIT, DemoError

if TYPE_CHECKING:
    from rclpy.node import Node

TOPICS: Final[Mapping[str, str]] = {
    "/valve/joint_states": "sensor_msgs/msg/JointState",
    "/valve/coil": "sensor_msgs/msg/BatteryState",
    "/valve/phase": "std_msgs/msg/UInt8",
    "/valve/is_open": "std_msgs/msg/Bool",
}
"""The topics, by type."""
COMMAND: Final = "/valve/coil_voltage"


class Message(NamedTuple):
    """What came on a topic: serialized, and when it was published by the wall's clock, ns."""

    topic: str
    payload: bytes
    published: int


class Listener:
    """This process's ROS node: hears the valve's topics in a thread of its own, commands its coil."""

    def __init__(self) -> None:
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.qos import DurabilityPolicy, QoSProfile

        self.messages: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self.node: Node = Node("valve_demo")
        self._types = message_classes()
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for topic, kind in TOPICS.items():
            quality = latched if topic.endswith(("/phase", "/is_open")) else QoSProfile(depth=2000)
            self.node.create_subscription(self._types[kind], topic, self._hear(topic), quality, raw=True)
        self._commands = self.node.create_publisher(self._types["std_msgs/msg/Float64"], COMMAND, 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

        def spin() -> None:
            try:
                self._executor.spin()
            except Exception:
                # A signal or `close` shuts ROS down while it waits, which may then fail with any exception.
                if self.node.context.ok() and not self._is_closing:
                    raise

        self._is_closing = False
        self._thread = threading.Thread(target=spin, daemon=True)
        self._thread.start()

    def _hear(self, topic: str) -> Any:
        def hear(payload: bytes, information: Mapping[str, int]) -> None:
            # A middleware without the time of publication gives 0.
            published = information["source_timestamp"] or time.time_ns()
            self.messages.put(Message(topic, bytes(payload), published))

        return hear

    def decode(self, message: Message) -> Any:
        """The message itself."""
        from rclpy.serialization import deserialize_message

        return deserialize_message(message.payload, self._types[TOPICS[message.topic]])

    def command(self, volts: float) -> bytes:
        """Command the coil; returns the message as serialized."""
        from rclpy.serialization import serialize_message

        message = self._types["std_msgs/msg/Float64"](data=volts)
        self._commands.publish(message)
        return bytes(serialize_message(message))

    @property
    def is_heard(self) -> bool:
        """Whether there is a subscriber to the commands."""
        return bool(self._commands.get_subscription_count() > 0)

    def expect_valves(self, most: int) -> None:
        """Check that no more than so many nodes publish as this valve.

        Raises:
            DemoError: more do, so that their messages would be mixed up.
        """
        if self.node.count_publishers("/valve/joint_states") > most:
            raise DemoError(
                "another valve publishes on /valve/joint_states already; stop it, or choose another ROS_DOMAIN_ID"
            )

    def close(self) -> None:
        """Shut down the node."""
        from rclpy.utilities import try_shutdown

        self._is_closing = True
        self._executor.shutdown()
        self._thread.join(STOP_LIMIT)
        self.node.destroy_node()
        try_shutdown()


def message_classes() -> dict[str, Any]:
    """The message types of the topics by name."""
    names = {*TOPICS.values(), "std_msgs/msg/Float64"}
    places = {name: (name.partition("/")[0], name.rpartition("/")[2]) for name in names}
    return {name: getattr(importlib.import_module(f"{package}.msg"), kind) for name, (package, kind) in places.items()}
