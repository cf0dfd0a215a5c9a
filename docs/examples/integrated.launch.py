"""A valve, a commander, a sensor's driver and a monitor: `ros2 launch docs/examples/integrated.launch.py`.

valve_sim's own launch file starts the valve. The monitor hears the driver's topic in place of the default one.
"""

import sys
from pathlib import Path

from launch.actions import DeclareLaunchArgument, ExecuteProcess, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

HERE = Path(__file__).parent


def generate_launch_description() -> LaunchDescription:
    """All four in the namespace tank_1."""
    share = FindPackageShare("valve_sim")
    file, use_sim_time = LaunchConfiguration("params_file"), LaunchConfiguration("use_sim_time")
    valve = PathJoinSubstitution([share, "launch", "valve.launch.py"])
    arguments = {"namespace": "tank_1", "params_file": file, "use_sim_time": use_sim_time}

    def script(name: str, remap: str) -> ExecuteProcess:
        given = ["-p", ["use_sim_time:=", use_sim_time], "-r", remap]
        return ExecuteProcess(cmd=[sys.executable, str(HERE / name), "--ros-args", *given], output="screen")

    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=PathJoinSubstitution([share, "config", "tank_1.yaml"])),
            DeclareLaunchArgument("use_sim_time", default_value="false"),
            IncludeLaunchDescription(PythonLaunchDescriptionSource(valve), launch_arguments=arguments.items()),
            Node(
                package="valve_sim",
                executable="monitor_node",
                name="monitor",
                namespace="tank_1",
                # A missing file in `parameters` is only a warning; given this way it ends the node.
                ros_arguments=["--params-file", file],
                parameters=[{"use_sim_time": use_sim_time}],
                remappings=[("valve/measured/joint_states", "/lab/stroke")],
                output="screen",
            ),
            script("sensor_driver.py", "measured:=/lab/stroke"),
            script("commander.py", "coil_voltage:=/tank_1/valve/coil_voltage"),
        ]
    )
