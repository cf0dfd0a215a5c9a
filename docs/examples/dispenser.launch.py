"""The station with gas, and the dispenser of this folder: `ros2 launch docs/examples/dispenser.launch.py`."""

import sys
from pathlib import Path

from launch.actions import ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

DISPENSER = Path(__file__).with_name("dispenser.py")


def generate_launch_description() -> LaunchDescription:
    """Three valves with gas and their monitors, which the dispenser commands."""
    station = PathJoinSubstitution([FindPackageShare("valve_sim"), "launch", "station.launch.py"])
    return LaunchDescription(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(station), launch_arguments={"gas": "true", "plc": "false"}.items()
            ),
            ExecuteProcess(cmd=[sys.executable, str(DISPENSER)], output="screen"),
        ]
    )
