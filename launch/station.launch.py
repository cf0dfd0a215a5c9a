"""A station of three tanks: valves /tank_1/valve … /tank_3/valve, each with a parameter file of its own."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

CONFIG = Path(__file__).resolve().parents[1] / "config"
TANKS = ("tank_1", "tank_2", "tank_3")


def generate_launch_description() -> LaunchDescription:
    """Three times valve_node, in namespaces."""
    valves = [
        Node(
            package="valve_sim",
            executable="valve_node",
            name="valve",
            namespace=tank,
            parameters=[str(CONFIG / f"{tank}.yaml"), {"use_sim_time": LaunchConfiguration("use_sim_time")}],
            output="screen",
        )
        for tank in TANKS
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("use_sim_time", default_value="false", description="follow /clock"),
            *valves,
        ]
    )
