"""What the launch files have in common. Needs launch_ros; no node imports this.

An argument that is a parameter has no value of its own: without one it is not set here, so that the parameter file
counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from valve_sim.files.resources import config_path

CONFIG: Final = config_path("valve.yaml").parent
"""The folder of the parameter files that ship."""
USE_SIM_TIME: Final = {"use_sim_time": "follow /clock"}

Arguments = Mapping[str, tuple[str, str]]
"""Default value and meaning of each argument by name."""


def description(
    arguments: Arguments, parameters: Mapping[str, str], nodes_of: Callable[[Mapping[str, str]], list[Node]]
) -> LaunchDescription:
    """A launch file's arguments, and the nodes that their values ask for.

    Args:
        parameters: the meaning of each argument that is a parameter, by name.
        nodes_of: the nodes, by the values of all arguments.
    """
    unset = "; empty: as the parameter file or the node has it"
    told = {**arguments, **{name: ("", words + unset) for name, words in parameters.items()}}
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=words) for name, (value, words) in told.items()
    ]

    def made(context: LaunchContext) -> list[Node]:
        return nodes_of(context.launch_configurations)

    return LaunchDescription([*declared, OpaqueFunction(function=made)])


def one_node(name: str, file: str, parameters: Mapping[str, str]) -> LaunchDescription:
    """A launch file of one node with one parameter file, of which `file` says what is in it."""
    arguments = {
        "params_file": (str(CONFIG / "valve.yaml"), f"ROS 2 parameter file of {file}"),
        "namespace": ("", "before the node's name, such as tank_1"),
    }

    def nodes_of(given: Mapping[str, str]) -> list[Node]:
        return [node(name, given["namespace"], given["params_file"], {key: key for key in parameters if given[key]})]

    return description(arguments, parameters, nodes_of)


def node(
    name: str, namespace: str, file: str | Path | None, parameters: Mapping[str, str],
    words: Sequence[str] = (), fixed: Mapping[str, object] | None = None, **options: Any,
) -> Node:  # fmt: skip
    """The node of this name, which the program `<name>_node` runs.

    Args:
        file: with its parameters. As one of launch's `parameters`, a file that is not there is only warned of.
        parameters: the argument that gives each. fixed: what others are. Both count before the file.
        words: further ROS arguments, before the file, which counts before them.
    """
    return Node(
        package="valve_sim",
        executable=f"{name}_node",
        name=name,
        namespace=namespace,
        parameters=[{**(fixed or {}), **{key: LaunchConfiguration(given) for key, given in parameters.items()}}],
        ros_arguments=[*words, *(() if file is None else ("--params-file", str(file)))],
        output="screen",
        **options,
    )
