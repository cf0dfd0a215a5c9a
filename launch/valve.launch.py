"""One valve: `ros2 launch valve_sim valve.launch.py params_file:=my.yaml namespace:=tank_1`."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "params_file": (
        str(Path(__file__).resolve().parents[1] / "config" / "valve.yaml"),
        "ROS 2 parameter file of the valve",
    ),
    "namespace": ("", "before the node's name, such as tank_1"),
    "use_sim_time": ("", "follow /clock; empty: as the parameter file has it"),
}


def valve(context: LaunchContext) -> list[Node]:
    """valve_node with one parameter file."""
    given = context.launch_configurations
    return [
        Node(
            package="valve_sim",
            executable="valve_node",
            name="valve",
            namespace=given["namespace"],
            # As one of `parameters`, a file that is not there is only warned of, and the shipped valve started.
            ros_arguments=["--params-file", given["params_file"]],
            # What is among `parameters` counts before the file, so that only what was given may be.
            parameters=[{name: LaunchConfiguration(name) for name in ("use_sim_time",) if given[name]}],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """The valve and its arguments."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words)
        for name, (value, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=valve)])
