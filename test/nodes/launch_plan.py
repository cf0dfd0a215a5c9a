"""What a launch file starts, without the launch system: the file runs on stand-ins that write down what it says."""

from __future__ import annotations

import contextlib
import runpy
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, NamedTuple
from unittest import mock

import yaml

from .ros_process import running


class LaunchConfiguration(NamedTuple):
    """Stands for the value of a launch argument."""

    name: str


class DeclareLaunchArgument(NamedTuple):
    name: str
    default_value: str
    description: str = ""


class OpaqueFunction(NamedTuple):
    function: Callable[[Any], list[Any]]


class IncludeLaunchDescription(NamedTuple):
    """Another launch file, as the parts of its path, and the arguments that it is given."""

    source: Sequence[str]
    launch_arguments: Iterable[tuple[str, Any]] = ()


class ExecuteProcess(NamedTuple):
    cmd: Sequence[Any]
    output: str = ""


class Node(NamedTuple):
    """A node of a launch file, and the command line that launch_ros makes of it."""

    package: str
    executable: str
    name: str
    namespace: str | LaunchConfiguration
    parameters: list[dict[str, Any]]
    output: str = ""
    ros_arguments: Sequence[str | LaunchConfiguration] = ()
    respawn: bool = False
    respawn_delay: float = 0.0
    remappings: Sequence[tuple[str, str]] = ()

    @property
    def full_name(self) -> str:
        return f"/{self.namespace}/{self.name}".replace("//", "/")

    @property
    def given(self) -> dict[str, Any]:
        """All its parameters beside those of files."""
        return {name: value for part in self.parameters for name, value in part.items()}

    def with_values(self, values: Mapping[str, str]) -> Node:
        """The node with these arguments in place of their names, as launch_ros puts them in: as YAML."""

        def filled(value: Any) -> Any:
            return yaml.safe_load(values[value.name]) if isinstance(value, LaunchConfiguration) else value

        return self._replace(
            namespace=filled(self.namespace),
            parameters=[{name: filled(value) for name, value in part.items()} for part in self.parameters],
        )

    def command_line(self, folder: Path) -> list[str]:
        """The words after the executable's name; its parameters are in a file of this folder."""
        words = ["--ros-args", *map(str, self.ros_arguments)]
        words += ["-r", f"__node:={self.name}", "-r", f"__ns:=/{self.namespace}"]
        if not self.given:
            return words
        file = folder / f"launch_params{self.full_name.replace('/', '_')}"
        # As launch_ros: it makes tuples of lists and dumps them with the tag of Python's.
        given = {key: tuple(value) if isinstance(value, list) else value for key, value in self.given.items()}
        file.write_text(yaml.dump({self.full_name: {"ros__parameters": given}}, default_flow_style=False))
        return [*words, "--params-file", str(file)]


class LaunchPlan(NamedTuple):
    """Default values of the arguments by name, and what the file's entries become."""

    arguments: dict[str, str]
    entries: list[Any]

    def started(self, **values: str) -> list[Node]:
        """The nodes that are started with these values of arguments, the others as they are by default."""
        given = {**self.arguments, **values}
        context = SimpleNamespace(launch_configurations=given)
        made = [entry.function(context) if isinstance(entry, OpaqueFunction) else [entry] for entry in self.entries]
        return [node.with_values(given) for nodes in made for node in nodes if isinstance(node, Node)]

    @contextlib.contextmanager
    def running(self, folder: Path, namespaces: Collection[str], **values: str) -> Iterator[None]:
        """The nodes of these namespaces while inside."""
        with contextlib.ExitStack() as stack:
            for node in self.started(**values):
                if node.namespace in namespaces:
                    stack.enter_context(running(folder, node.command_line(folder), node.executable))
            yield


def read_launch_file(path: Path) -> LaunchPlan:
    """The plan of a launch file that has `generate_launch_description`."""
    stands_for = {
        "launch": {"LaunchDescription": list, "LaunchContext": object},
        "launch.actions": {
            "DeclareLaunchArgument": DeclareLaunchArgument, "ExecuteProcess": ExecuteProcess,
            "IncludeLaunchDescription": IncludeLaunchDescription, "OpaqueFunction": OpaqueFunction,
        },
        "launch.launch_description_sources": {"PythonLaunchDescriptionSource": list},
        "launch.substitutions": {"LaunchConfiguration": LaunchConfiguration, "PathJoinSubstitution": list},
        "launch_ros": {},
        "launch_ros.actions": {"Node": Node},
        "launch_ros.substitutions": {"FindPackageShare": str},
    }  # fmt: skip
    modules = {name: ModuleType(name) for name in stands_for}
    for name, content in stands_for.items():
        vars(modules[name]).update(content)
    with mock.patch.dict(sys.modules, modules):
        entries = runpy.run_path(str(path))["generate_launch_description"]()
    arguments = {entry.name: entry.default_value for entry in entries if isinstance(entry, DeclareLaunchArgument)}
    return LaunchPlan(arguments, [entry for entry in entries if not isinstance(entry, DeclareLaunchArgument)])
