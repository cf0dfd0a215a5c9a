"""A monitor of one valve: `ros2 launch valve_sim monitor.launch.py params_file:=tank_1.yaml namespace:=tank_1`.

Beside a valve that valve_node simulates: `measured:=joint_states noise_um:=1.0`.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "params_file": (
        str(Path(__file__).resolve().parents[1] / "config" / "valve.yaml"),
        "ROS 2 parameter file of the valve that is declared, and of the monitor",
    ),
    "namespace": ("", "before the node's name, such as tank_1"),
    "use_sim_time": ("false", "follow /clock"),
}
PARAMETERS = {
    "valve_node": (str, "name of the valve, below which its topics are, relative to the namespace"),
    "measured": (str, "topic of the measured positions below it, or of its coil"),
    "noise_um": (float, "µm, standard deviation of the position sensor"),
    "state": (str, "file that keeps what commissioning found, for the next start"),
}
"""Parameters of monitor_node that are arguments, too; without a value they are as the parameter file has them."""


def monitor(context: LaunchContext) -> list[Node]:
    """monitor_node with one parameter file, and with what the arguments say beside it."""
    given = context.launch_configurations
    named = {name: kind(given[name]) for name, (kind, _) in PARAMETERS.items() if given[name]}
    return [
        Node(
            package="valve_sim",
            executable="monitor_node",
            name="monitor",
            namespace=given["namespace"],
            # As one of `parameters`, a file that is not there is only warned of, and the shipped valve declared.
            ros_arguments=["--params-file", given["params_file"]],
            parameters=[{"use_sim_time": given["use_sim_time"].lower() in ("true", "1"), **named}],
            output="screen",
        )
    ]


def generate_launch_description() -> LaunchDescription:
    """The monitor and its arguments."""
    told = {**ARGUMENTS, **{name: ("", words) for name, (_, words) in PARAMETERS.items()}}
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words) for name, (value, words) in told.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=monitor)])
