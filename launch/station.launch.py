"""A station of three tanks: /tank_1 to /tank_3, in each a `valve` with a parameter file of its own and its `monitor`.

    ros2 launch valve_sim station.launch.py monitors:=false command_timeout:=0.5
    ros2 launch valve_sim station.launch.py gas:=true

    ros2 launch valve_sim station.launch.py opcua:=true plc:=true archive:=true

A monitor declares the valve that its parameter file describes, and hears the simulated valve's own joint_states in
place of a sensor's. What a parameter sets while the station runs is a fault to it.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import IfElseSubstitution, LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

CONFIG = Path(__file__).resolve().parents[1] / "config"
NOISE_UM = 1.0
"""Of a laser; simulated valves have none at all, and a monitor that knew it would warn of what no sensor shows."""
TANKS = ("tank_1", "tank_2", "tank_3")
ARGUMENTS = {
    "gas": ("false", "whether there is hydrogen before the valves, and a line behind them"),
    "use_sim_time": ("false", "follow /clock"),
    "monitors": ("true", "whether each valve has a monitor_node beside it"),
    "publish_rate": ("500.0", "Hz, of each valve"),
    "command_timeout": ("0.0", "s without a command, after which a valve closes by itself; 0: never"),
    "opcua": ("false", "whether an opcua_node serves all valves, at port 4840"),
    "plc": ("false", "whether a plc_node lets a PLC command all valves, at port 1502"),
    "archive": ("false", "whether an archive_node keeps what the monitors say"),
    "commissioning_strokes": ("20", "so many first strokes of a valve are taken for healthy by its monitor"),
}


def parameters_of(tank: str) -> list[str | IfElseSubstitution]:
    """Its parameter file, in parts."""
    return [f"{CONFIG}/", IfElseSubstitution(LaunchConfiguration("gas"), "gas_", ""), f"{tank}.yaml"]


def valve_of(tank: str) -> Node:
    """The simulated valve of a tank."""
    return Node(
        package="valve_sim",
        executable="valve_node",
        name="valve",
        namespace=tank,
        parameters=[
            parameters_of(tank),
            {name: LaunchConfiguration(name) for name in ("use_sim_time", "publish_rate", "command_timeout")},
        ],
        output="screen",
    )


def monitor_of(tank: str) -> Node:
    """The monitor beside it, with the same parameter file."""
    return Node(
        package="valve_sim",
        executable="monitor_node",
        name="monitor",
        namespace=tank,
        parameters=[
            parameters_of(tank),
            {"measured": "joint_states", "noise_um": NOISE_UM},
            {name: LaunchConfiguration(name) for name in ("use_sim_time", "commissioning_strokes")},
        ],
        condition=IfCondition(LaunchConfiguration("monitors")),
        output="screen",
    )


def node_of_all(name: str, **parameters: list[str]) -> Node:
    """A node of the station beside its tanks, where the argument of its name says so."""
    valves = [f"{tank}/valve" for tank in TANKS]
    return Node(
        package="valve_sim",
        executable=f"{name}_node",
        name=name,
        namespace="",
        parameters=[{"valves": valves, **parameters}, {"use_sim_time": LaunchConfiguration("use_sim_time")}],
        condition=IfCondition(LaunchConfiguration(name)),
        output="screen",
    )


def generate_launch_description() -> LaunchDescription:
    """A valve and a monitor for each tank, and what serves all of them."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words)
        for name, (value, words) in ARGUMENTS.items()
    ]
    monitors = [f"{tank}/monitor" for tank in TANKS]
    nodes = [*(valve_of(tank) for tank in TANKS), *(monitor_of(tank) for tank in TANKS)]
    nodes += [
        node_of_all("opcua", monitors=monitors),
        node_of_all("plc"),
        node_of_all("archive", monitors=monitors),
    ]
    return LaunchDescription([*arguments, *nodes])
