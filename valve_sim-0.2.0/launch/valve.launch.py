"""One valve: `ros2 launch valve_sim valve.launch.py params_file:=my.yaml namespace:=tank_1`."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

CONFIG = Path(__file__).resolve().parents[1] / "config"


def generate_launch_description() -> LaunchDescription:
    """valve_node with one parameter file."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "params_file", default_value=str(CONFIG / "valve.yaml"), description="ROS 2 parameter file of the valve"
            ),
            DeclareLaunchArgument("namespace", default_value="", description="before the node's name, such as tank_1"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="follow /clock"),
            Node(
                package="valve_sim",
                executable="valve_node",
                name="valve",
                namespace=LaunchConfiguration("namespace"),
                # As one of `parameters`, a file that is not there is only warned of, and the shipped valve started.
                ros_arguments=["--params-file", LaunchConfiguration("params_file")],
                parameters=[{"use_sim_time": LaunchConfiguration("use_sim_time")}],
                output="screen",
            ),
        ]
    )
