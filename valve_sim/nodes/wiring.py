"""What every node is made with: its parameters and its topics, each by its table.

Of each node the main thread works, or waits for the end; another answers ROS. So a signal never waits for a callback,
and ROS is there until the last command, 0 V, is heard.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError
from valve_sim.nodes.diagnostics import Status
from valve_sim.nodes.messages import diagnostic_array
from valve_sim.nodes.node_clock import NodeClock
from valve_sim.nodes.parameters import (
    Declares,
    NodeParameter,
    S,
    Value,
    files_for_others,
    is_of_ros,
    of_others,
    sources_of,
)
from valve_sim.nodes.receiving import Inbox, Source, Take
from valve_sim.nodes.spinning import every, guarded, spin
from valve_sim.nodes.threads import Fail, StoppableThread, StopRequest
from valve_sim.nodes.topics import Qos, Topic


def make_node(name: str) -> Node:
    """A node that has declared all parameters that it was given, known or not, with the type that they have.

    Raises:
        ParameterError: something was given without a value.
    """
    try:
        return Node(name, automatically_declare_parameters_from_overrides=True)
    except ValueError as error:
        raise ParameterError(
            "a parameter file or the command line gives a name without a value, such as effects: {} or free:=[] "
            f"({error}); take it out"
        ) from error


def declared(node: Node, sections: Sequence[tuple[str, Section]], settings: Declares[object]) -> Mapping[str, Value]:
    """The values of a node's parameters at the start; all of its table are declared with them.

    A file that holds nothing for this node is warned about. rclpy passes over a misspelt name without a word;
    `make_node` has declared it.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """
    name = node.get_fully_qualified_name()
    for path, found in files_for_others(sections, name).items():
        node.get_logger().warning(f"{path} has parameters for {', '.join(found)}, and none for {name}")
    all_declared: Mapping[str, Any] = node.get_parameters_by_prefix("")
    given = {key: parameter.value for key, parameter in all_declared.items() if not is_of_ros(key)}
    others = of_others(given, sections, name, settings)
    if others:
        node.get_logger().info(f"passed over, as they are of other nodes: {', '.join(others)}")
    own = {key: value for key, value in given.items() if key not in others}
    values = settings.values(own, sources_of(sections, name))
    for key in given:
        node.undeclare_parameter(key)
    for key, entry in settings.table().items():
        value = values[key]
        node.declare_parameter(
            key, list(value) if isinstance(value, tuple) else value, descriptor(entry), ignore_override=True
        )
    return values


def descriptor(entry: NodeParameter) -> ParameterDescriptor:
    """The descriptor of a parameter, and the range that ROS enforces."""
    message = ParameterDescriptor(name=entry.name, description=entry.description, read_only=entry.read_only)
    limits = entry.range
    if limits is None:
        message.additional_constraints = entry.choice_words if entry.choices else ""
    elif entry.type == "integer":
        message.integer_range = [IntegerRange(from_value=int(limits[0]), to_value=int(limits[1]), step=1)]
    else:
        message.floating_point_range = [FloatingPointRange(from_value=float(limits[0]), to_value=float(limits[1]))]
        if entry.rule is not None:
            message.additional_constraints = entry.rule.range_words()
    return message


def full_name(node: Node, given: str, key: str) -> str:
    """The full name of another node or topic, relative to this node's namespace unless it begins with a slash.

    Raises:
        ParameterError: it is no name; the message says that parameter `key` holds it.
    """
    try:
        return str(expand_topic_name(given, node.get_name(), node.get_namespace()))
    except ValueError as error:
        raise ParameterError(f"{key}: found {given!r}, expected a ROS name, such as valve or /tank_1/valve") from error


class Interface:
    """The topics and services of a node, made by its table: what is not in the table cannot be made.

    `places` stand for the words in braces of a name.
    """

    def __init__(self, node: Node, topics: Sequence[Topic], **places: str) -> None:
        self._node, self._places = node, places
        self._topics = {(topic.name, topic.direction): topic for topic in topics}

    def publisher(self, name: str, *, depth: int = 0, **places: str) -> Publisher:
        """A publisher of a topic of the table that keeps at least `depth` messages; `places`: see the class."""
        topic = self._topics[name, "out"]
        wanted = profile(topic.qos)
        wanted.depth = max(wanted.depth, depth)
        return self._node.create_publisher(kind_of(topic.type), self._filled(name, places), wanted)

    def receive(self, inbox: Inbox, name: str, take: Take, **places: str) -> Source:
        """Have a topic received; see `Inbox.subscribe`."""
        topic = self._topics[name, "in"]
        return inbox.subscribe(kind_of(topic.type), self._filled(name, places), take, profile(topic.qos))

    def serve(self, name: str, answer: Callable[[], tuple[bool, str]], **places: str) -> None:
        """Answer a Trigger: `answer` says whether it was done, and what to say."""
        ask = guarded(answer)

        def respond(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            response.success, response.message = ask()
            return response

        self._node.create_service(kind_of(self._topics[name, "service"].type), self._filled(name, places), respond)

    def _filled(self, name: str, places: Mapping[str, str]) -> str:
        return name.format(**self._places, **places)


def kind_of(name: str) -> Any:
    """The class of a message or service: "std_msgs/msg/Bool" and the like.

    Raises:
        ImportError, AttributeError: it is not installed.
    """
    package, folder, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.{folder}"), kind)


def profile(qos: Qos | None) -> QoSProfile:
    """The profile of a table's entry."""
    wanted = qos or Qos()
    return QoSProfile(
        depth=wanted.depth,
        reliability=ReliabilityPolicy.RELIABLE if wanted.is_reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if wanted.is_latched else DurabilityPolicy.VOLATILE,
    )


class Stops(Protocol):
    """What runs beside a node, such as a thread."""

    def stop(self, timeout: float) -> bool:
        """Ask it to end; whether it has ended within `timeout`, s."""


class RosNode(Generic[S]):
    """What the nodes of this package have in common: two tables, a clock, what runs beside the node, and its end.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """

    def __init__(
        self, node: str | Node, sections: Sequence[tuple[str, Section]], settings: Declares[S], topics: Sequence[Topic]
    ) -> None:
        self._node = make_node(node) if isinstance(node, str) else node
        self._clock = NodeClock(self._node)
        self._initial_values = declared(self._node, sections, settings)
        self._settings: S = settings.of(self._initial_values)
        self._interface = Interface(self._node, topics)
        self.exit_code = 0
        """1 if the node failed."""
        self._is_ready = False
        """Whether the model is compiled, of a node that has one."""
        self.stop = StopRequest()
        self._threads: list[Stops] = []
        """What is asked to end at the node's end, in this order."""
        self._answering = _Answering(self._node, self.stop.ask, self._fail)

    def run(self) -> None:
        """Answer ROS in a thread, and work in this one, until that is done or the node is asked to stop."""
        self._answering.start()
        try:
            self._work()
        finally:
            self._finish()

    def _work(self) -> None:
        """What the node does in its main thread."""
        self.stop.wait()

    def _finish(self) -> None:
        """What it does after its work, whatever ended that; ROS is still there."""

    def close(self, timeout: float) -> bool:
        """Ask all threads to end and release the node; whether each has ended within `timeout`, s.

        A thread that calculates for longer finds no node any more, and ends with the process.
        """
        have_ended = [thread.stop(timeout) for thread in (*self._threads, self._answering)]
        self._node.destroy_node()
        return all(have_ended)

    def _now(self) -> int:
        """Time of the node's clock, ns; 0 before the first /clock."""
        reading = self._clock.read()
        return 0 if reading is None else reading.nanoseconds

    def _waiting_for(self) -> str:
        """What its model cannot go on without; empty for nothing."""
        if not self._is_ready:
            return "the model to be compiled"
        return "/clock (use_sim_time is true)" if self._clock.read() is None else ""

    def _full_names(self, key: str) -> list[str]:
        """The full names of the nodes that a parameter, which is a list, names."""
        return [full_name(self._node, given, key) for given in getattr(self._settings, key)]

    def _publish_diagnostics(self, statuses: Callable[[], Iterable[Status]]) -> None:
        """Say what there is to say once a second of wall time, so that a silent /clock is reported too."""
        publisher = self._interface.publisher("/diagnostics")
        every(self._node, 1.0, lambda: publisher.publish(self._diagnostics(statuses(), self._clock.stamp())))

    def _diagnostics(self, statuses: Iterable[Status], stamp: int) -> DiagnosticArray:
        """A message of this node; `stamp` in ns."""
        return diagnostic_array(statuses, self._node.get_fully_qualified_name(), stamp)

    def _fail(self, error: Exception) -> None:
        """End the work, whichever thread cannot go on; ROS stays until the end."""
        if self._node.context.ok():
            self.exit_code = 1
            self._node.get_logger().fatal(f"the node cannot go on: {error!r}")
        self.stop.ask(f"the node cannot go on: {error!r}")


class _Answering(StoppableThread):
    """Answers ROS (parameters, topics, /clock) until it is stopped, and shuts ROS down then."""

    def __init__(self, node: Node, end_work: Callable[[str], None], fail: Fail) -> None:
        super().__init__("answering", self._answer, fail)
        self._node, self._end_work = node, end_work

    def wake(self) -> None:
        """Shut ROS down, whose end this thread waits for."""
        self._node.context.try_shutdown()

    def _answer(self) -> None:
        try:
            spin(self._node)
        except ExternalShutdownException:
            self._end_work("ROS was shut down")
