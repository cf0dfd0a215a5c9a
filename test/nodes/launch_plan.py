"""What a launch file starts, without the launch system: the file runs on stand-ins that write down what it says."""

from __future__ import annotations

import contextlib
import runpy
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple
from unittest import mock

from .ros_process import running


class LaunchConfiguration(NamedTuple):
    """Stands for the value of a launch argument."""

    name: str


class DeclareLaunchArgument(NamedTuple):
    name: str
    default_value: str
    description: str


class IfElseSubstitution(NamedTuple):
    """Stands for one of two texts, as an argument is true or not."""

    condition: LaunchConfiguration
    if_value: str
    else_value: str

    def perform(self, values: Mapping[str, str]) -> str:
        return self.if_value if values[self.condition.name] == "true" else self.else_value


class IfCondition(NamedTuple):
    configuration: LaunchConfiguration

    @property
    def names(self) -> set[str]:
        """The arguments that must be true."""
        return {self.configuration.name}


class Node(NamedTuple):
    """A node of a launch file, and the command line that launch_ros makes of it."""

    package: str
    executable: str
    name: str
    namespace: str
    parameters: list[list[str | IfElseSubstitution] | dict[str, Any]]
    condition: IfCondition | None = None
    output: str = ""
    remappings: Sequence[tuple[str, Sequence[str | LaunchConfiguration]]] = ()
    arguments: Sequence[str] = ()
    ros_arguments: Sequence[str | LaunchConfiguration] = ()

    @property
    def full_name(self) -> str:
        return f"/{self.namespace}/{self.name}".replace("//", "/")

    def is_started(self, values: Mapping[str, str]) -> bool:
        return self.condition is None or all(values[name] == "true" for name in self.condition.names)

    def file(self, values: Mapping[str, str]) -> Path:
        """Its one parameter file."""
        (parts,) = (given for given in self.parameters if isinstance(given, list))
        return Path("".join(part if isinstance(part, str) else part.perform(values) for part in parts))

    def command_line(self, values: Mapping[str, str]) -> list[str]:
        """The words after the executable's name."""
        words = ["--ros-args", *(word if isinstance(word, str) else values[word.name] for word in self.ros_arguments)]
        words += ["-r", f"__node:={self.name}", "-r", f"__ns:=/{self.namespace}"]
        for given in self.parameters:
            if isinstance(given, list):
                words += ["--params-file", str(self.file(values))]
                continue
            for name, value in given.items():
                words += ["-p", f"{name}:={values[value.name] if isinstance(value, LaunchConfiguration) else value}"]
        return words


class LaunchPlan(NamedTuple):
    """Default values of the arguments by name, and all nodes."""

    arguments: dict[str, str]
    nodes: list[Node]

    def started(self, values: Mapping[str, str]) -> list[Node]:
        """The nodes that are started with these values of arguments, the others as they are by default."""
        return [node for node in self.nodes if node.is_started({**self.arguments, **values})]

    @contextlib.contextmanager
    def running(self, folder: Path, namespaces: Collection[str], values: Mapping[str, str]) -> Iterator[None]:
        """The nodes of these namespaces while inside."""
        with contextlib.ExitStack() as stack:
            for node in self.started(values):
                if node.namespace in namespaces:
                    words = node.command_line({**self.arguments, **values})
                    stack.enter_context(running(folder, words, node.executable))
            yield


def read_launch_file(path: Path) -> LaunchPlan:
    """The plan of a launch file that has `generate_launch_description`."""
    stands_for = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {"DeclareLaunchArgument": DeclareLaunchArgument},
        "launch.conditions": {"IfCondition": IfCondition},
        "launch.substitutions": {
            "IfElseSubstitution": IfElseSubstitution,
            "LaunchConfiguration": LaunchConfiguration,
        },
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
    }
    modules = {name: ModuleType(name) for name in stands_for}
    for name, content in stands_for.items():
        vars(modules[name]).update(content)
    with mock.patch.dict(sys.modules, modules):
        entries = runpy.run_path(str(path))["generate_launch_description"]()
    arguments = {entry.name: entry.default_value for entry in entries if isinstance(entry, DeclareLaunchArgument)}
    return LaunchPlan(arguments, [entry for entry in entries if isinstance(entry, Node)])
