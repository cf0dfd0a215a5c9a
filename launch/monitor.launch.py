"""A monitor of one valve: `ros2 launch valve_sim monitor.launch.py params_file:=tank_1.yaml namespace:=tank_1`.

Beside a valve that valve_node simulates: `measured:=joint_states noise_um:=1.0`.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "params_file": (
        str(Path(__file__).resolve().parents[1] / "config" / "valve.yaml"),
        "ROS 2 parameter file of the valve that is declared, and of the monitor",
    ),
    "namespace": ("", "before the node's name, such as tank_1"),
}
PARAMETERS = {
    "use_sim_time": "follow /clock",
    "valve_node": "name of the valve, below which its topics are, relative to the namespace",
    "measured": "topic of the measured positions below it, or of its coil",
    "noise_um": "µm, standard deviation of the position sensor",
    "state": "file that keeps what commissioning found, for the next start",
}
"""Arguments that are parameters; without a value they are not set here, so that the parameter file counts."""


def monitor(context: LaunchContext) -> list[Node]:
    """monitor_node with one parameter file, and with what was given beside it."""
    given = context.launch_configurations
    return [
        Node(
            package="valve_sim",
            executable="monitor_node",
            name="monitor",
            namespace=given["namespace"],
            # As one of `parameters`, a file that is not there is only warned of, and the shipped valve declared.
            ros_arguments=["--params-file", given["params_file"]],
            parameters=[{name: LaunchConfiguration(name) for name in PARAMETERS if given[name]}],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """The monitor and its arguments."""
    told = {**ARGUMENTS, **{name: ("", f"{words}; empty: as in the file") for name, words in PARAMETERS.items()}}
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words) for name, (value, words) in told.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=monitor)])
