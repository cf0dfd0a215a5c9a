"""Shared by the nodes: QoS profiles, and parameters that are read once at the start."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Protocol, TypeVar

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.expand_topic_name import expand_topic_name
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from valve_sim.files.parameter_sections import Section
from valve_sim.model import ParameterError
from valve_sim.model.compiling import COMPILING, announce_compiling
from valve_sim.nodes.parameters import ROS_OWN, ROS_OWN_PREFIX, files_for_others, sources_of

RELIABLE: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
LATCHED: Final = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Late subscribers get the last message."""


def make_node(name: str) -> Node:
    """A node that has declared all parameters that it was given, known or not, with the type that they have.

    It says when its model has to be compiled, for until then it does nothing of what it is asked.

    Raises:
        ParameterError: something was given without a value.
    """
    try:
        node = Node(name, automatically_declare_parameters_from_overrides=True)
    except ValueError as error:
        raise ParameterError(
            "a parameter file or the command line gives a name without a value, such as effects: {} or free:=[] "
            f"({error}); take it out"
        ) from error
    logger = node.get_logger()
    announce_compiling(lambda: logger.info(f"{COMPILING}; what comes meanwhile waits"))
    return node


def declare(node: Node, name: str, value: Any, descriptor: ParameterDescriptor) -> None:
    """Declare a parameter with this value, in place of its declaration by `make_node`."""
    if node.has_parameter(name):
        node.undeclare_parameter(name)
    node.declare_parameter(name, value, descriptor, ignore_override=True)


def given_parameters(
    node: Node, sections: Sequence[tuple[str, Section]], former_names: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Flat name to value of the parameters given on the command line and in its files, without those of ROS itself.

    rclpy passes over a misspelt name without a word; `make_node` has declared it. A file that holds nothing for this
    node is warned about, and so is a name of an earlier release, which still counts (`former_names`: to present ones).
    """
    name = node.get_fully_qualified_name()
    for path, found in files_for_others(sections, name).items():
        node.get_logger().warning(f"{path} has parameters for {', '.join(found)}, and none for {name}")
    for former, present in (former_names or {}).items():
        if node.has_parameter(former):
            node.get_logger().warning(f"parameter {former} is called {present} now; please use that name")
            value = node.get_parameter(former).value
            node.undeclare_parameter(former)
            if not node.has_parameter(present):
                node.declare_parameter(present, value, ignore_override=True)
    declared: Mapping[str, Any] = node.get_parameters_by_prefix("")
    return {
        key: parameter.value
        for key, parameter in declared.items()
        if key not in ROS_OWN and not key.startswith(ROS_OWN_PREFIX)
    }


def declare_read_only(node: Node, values: Mapping[str, Any], descriptions: Mapping[str, str]) -> None:
    """Declare parameters that do not change while the node runs."""
    for key, value in values.items():
        descriptor = ParameterDescriptor(name=key, description=descriptions[key], read_only=True)
        declare(node, key, list(value) if isinstance(value, tuple) else value, descriptor)


class _Settings(Protocol):
    """A named tuple of parameters."""

    def _asdict(self) -> dict[str, Any]: ...


S = TypeVar("S", bound=_Settings)


def declare_settings(
    node: Node,
    sections: Sequence[tuple[str, Section]],
    check: Callable[[Mapping[str, object], Mapping[str, str]], S],
    descriptions: Mapping[str, str],
) -> S:
    """The settings of a node that reads its parameters once; they are declared, and cannot be changed.

    Args:
        node: the one that starts.
        sections: (file, section) of the parameter files on the command line.
        check: makes settings of what was given, by name, and of the file where each was given.
        descriptions: of each setting.

    Raises:
        ParameterError: a parameter is unknown, of the wrong type or out of range.
    """
    settings = check(given_parameters(node, sections), sources_of(sections, node.get_fully_qualified_name()))
    declare_read_only(node, settings._asdict(), descriptions)
    return settings


def full_name(node: Node, given: str, key: str) -> str:
    """The full name of another node or topic, relative to this node's namespace unless it begins with a slash.

    Raises:
        ParameterError: it is no name; the message says that parameter `key` holds it.
    """
    try:
        return str(expand_topic_name(given, node.get_name(), node.get_namespace()))
    except ValueError as error:
        raise ParameterError(f"{key}: found {given!r}, expected a ROS name, such as valve or /tank_1/valve") from error
