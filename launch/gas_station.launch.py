"""Three tanks of hydrogen: /tank_1 to /tank_3, in each a `valve` before a line of its own, and its `monitor`.

    ros2 launch valve_sim gas_station.launch.py demand:=0.04e-3

The valve of config/hydrogen_35mpa.yaml, before tanks of three pressures; a demand draws the gas out of each line. A
sequencer opens the tank of the lowest pressure first. A monitor hears the simulated valve's own joint_states and
outlet_pressure in place of sensors'. What a parameter sets while the station runs is a fault to it:

    ros2 param set /tank_2/valve effects.seat_leak.area 2.0e-9
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

PARAMETERS = Path(__file__).resolve().parents[1] / "config" / "hydrogen_35mpa.yaml"
NOISE_UM = 1.0
"""Of a laser; simulated valves have none at all, and a monitor that knew it would warn of what no sensor shows."""
PRESSURES = {"tank_1": 20e6, "tank_2": 28e6, "tank_3": 35e6}
"""Pa."""
ARGUMENTS = {
    "use_sim_time": ("false", "follow /clock"),
    "monitors": ("true", "whether each valve has a monitor_node beside it"),
    "publish_rate": ("500.0", "Hz, of each valve"),
    "command_timeout": ("0.0", "s without a command, after which a valve closes by itself; 0: never"),
    "commissioning_strokes": ("20", "so many first strokes of a valve are taken for healthy by its monitor"),
    "demand": ("0.04e-3", "m, diameter of the orifice through which gas is drawn out of each line; 0.0: dead ends"),
    "volume": ("10.0e-6", "m³, of each line"),
}


def gas_of(tank: str) -> dict[str, object]:
    """What differs from the parameter file."""
    return {
        "frame_id": tank,
        "gas.inlet_pressure": PRESSURES[tank],
        "gas.demand_orifice_diameter": LaunchConfiguration("demand"),
        "gas.outlet_volume": LaunchConfiguration("volume"),
    }


def valve_of(tank: str) -> Node:
    """The simulated valve of a tank."""
    return Node(
        package="valve_sim",
        executable="valve_node",
        name="valve",
        namespace=tank,
        parameters=[
            str(PARAMETERS),
            gas_of(tank),
            {name: LaunchConfiguration(name) for name in ("use_sim_time", "publish_rate", "command_timeout")},
        ],
        output="screen",
    )


def monitor_of(tank: str) -> Node:
    """The monitor beside it, with the same values."""
    return Node(
        package="valve_sim",
        executable="monitor_node",
        name="monitor",
        namespace=tank,
        parameters=[
            str(PARAMETERS),
            gas_of(tank),
            {"measured": "joint_states", "noise_um": NOISE_UM},
            {name: LaunchConfiguration(name) for name in ("use_sim_time", "commissioning_strokes")},
        ],
        condition=IfCondition(LaunchConfiguration("monitors")),
        output="screen",
    )


def generate_launch_description() -> LaunchDescription:
    """A valve and a monitor for each tank."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words)
        for name, (value, words) in ARGUMENTS.items()
    ]
    nodes = [make(tank) for make in (valve_of, monitor_of) for tank in PRESSURES]
    return LaunchDescription([*arguments, *nodes])
