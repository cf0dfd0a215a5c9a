"""The plungers of a running valve in RViz: `ros2 launch valve_sim display.launch.py valve:=/tank_1/valve`.

Needs robot_state_publisher and rviz2 of the ROS 2 in use, which the package does without otherwise.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

CONFIG = Path(__file__).resolve().parents[1] / "config"
RATE = 50.0
"""Hz, of the frames that are shown."""


def generate_launch_description() -> LaunchDescription:
    """robot_state_publisher beside the valve's joint states, and RViz."""
    description = (CONFIG / "valve.urdf").read_text(encoding="utf-8")
    return LaunchDescription(
        [
            DeclareLaunchArgument("valve", default_value="/valve", description="full name of the node that is shown"),
            DeclareLaunchArgument("rviz", default_value="true", description="whether RViz is started, too"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="follow /clock"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                name="robot_state_publisher",
                namespace="",
                parameters=[
                    {"robot_description": description, "publish_frequency": RATE},
                    {"use_sim_time": LaunchConfiguration("use_sim_time")},
                ],
                remappings=[("joint_states", [LaunchConfiguration("valve"), "/joint_states"])],
                output="screen",
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                name="rviz",
                namespace="",
                parameters=[{"use_sim_time": LaunchConfiguration("use_sim_time")}],
                arguments=["-d", str(CONFIG / "display.rviz")],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
