"""A station of tanks: in the namespace of each a `valve` with a parameter file of its own and its `monitor`.

    ros2 launch valve_sim station.launch.py monitors:=false command_timeout:=0.5
    ros2 launch valve_sim station.launch.py gas:=true
    ros2 launch valve_sim station.launch.py opcua:=true plc:=true archive:=true
    ros2 launch valve_sim station.launch.py tanks:=north/tank_1,north/tank_2 config:=/etc/station respawn:=true

A monitor declares the valve that its parameter file describes, and hears the simulated valve's own joint_states in
place of a sensor's. What a parameter sets while the station runs is a fault to it.
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    "tanks": ("tank_1,tank_2,tank_3", "namespaces of the tanks, with commas"),
    "config": (
        str(Path(__file__).resolve().parents[1] / "config"),
        "folder of the parameter files, each called as the last part of its tank's namespace: tank_1.yaml",
    ),
    "gas": ("false", "whether there is hydrogen before the valves: files gas_tank_1.yaml and so on"),
    "monitors": ("true", "whether each valve has a monitor_node beside it"),
    "state": ("", "folder in which monitors keep what commissioning found; empty: none"),
    "opcua": ("false", "whether an opcua_node serves all valves"),
    "plc": ("false", "whether a plc_node lets a PLC command all valves"),
    "archive": ("false", "whether an archive_node keeps what the monitors say"),
    "respawn": ("false", "whether a node that ends is started again, after 2 s"),
    "log_level": ("info", "of all nodes: debug, info, warn, error or fatal"),
}
PARAMETERS = {
    "use_sim_time": ("valve monitor opcua plc archive", "use_sim_time", "follow /clock"),
    "publish_rate": ("valve", "publish_rate", "Hz, of each valve"),
    "command_timeout": ("valve", "command_timeout", "s without a command, after which a valve closes by itself"),
    "commissioning_strokes": ("monitor", "commissioning_strokes", "so many first strokes are taken for healthy"),
    "opcua_port": ("opcua", "port", "TCP port of OPC UA"),
    "opcua_folder": ("opcua", "folder", "folder of its certificates and history"),
    "plc_port": ("plc", "port", "TCP port of Modbus"),
    "archive_folder": ("archive", "folder", "folder of the archive"),
}
"""Of arguments that are parameters: the nodes, the parameter, and what it says.

Without a value they are not set here, so that the parameter file counts."""
UNLESS_IN_FILE = {
    "valve": {"publish_rate": 500.0},
    # The noise is a laser's; simulated valves have none at all, and a monitor that knew it would warn of what no
    # sensor shows.
    "monitor": {"measured": "joint_states", "noise_um": 1.0},
}
"""What nodes of a station have where their parameter file says nothing."""
RESPAWN_SECONDS = 2.0


def nodes_of(context: LaunchContext) -> list[Node]:
    """The nodes that these values of the arguments ask for."""
    given = context.launch_configurations
    tanks = [tank.strip("/ ") for tank in given["tanks"].split(",") if tank.strip("/ ")]
    if not tanks:
        raise RuntimeError(f"tanks: found {given['tanks']!r}, expected namespaces such as tank_1,tank_2")
    valves, monitors = [f"{tank}/valve" for tank in tanks], [f"{tank}/monitor" for tank in tanks]

    def is_on(name: str) -> bool:
        return given[name].lower() in ("true", "1")

    def node(name: str, tank: str = "", file: Path | None = None, **parameters: object) -> Node:
        words = ["--log-level", given["log_level"]]
        for key, value in UNLESS_IN_FILE.get(name, {}).items():
            words += ["-p", f"{key}:={value}"]  # before the file, which therefore counts
        # As one of `parameters`, a file that is not there is only warned of, and the shipped valve started.
        words += [] if file is None else ["--params-file", str(file)]
        for argument, (names, key, _) in PARAMETERS.items():
            if name in names.split() and given[argument]:
                parameters[key] = LaunchConfiguration(argument)
        return Node(
            package="valve_sim",
            executable=f"{name}_node",
            name=name,
            namespace=tank,
            parameters=[parameters],
            ros_arguments=words,
            respawn=is_on("respawn"),
            respawn_delay=RESPAWN_SECONDS,
            output="screen",
        )

    nodes = []
    for tank in tanks:
        file = Path(given["config"]) / f"{'gas_' if is_on('gas') else ''}{tank.rpartition('/')[2]}.yaml"
        nodes.append(node("valve", tank, file))
        if is_on("monitors"):
            kept = {"state": str(Path(given["state"]) / f"{tank.replace('/', '_')}.json")} if given["state"] else {}
            nodes.append(node("monitor", tank, file, **kept))
    if is_on("opcua"):
        nodes.append(node("opcua", valves=valves, monitors=monitors))
    if is_on("plc"):
        nodes.append(node("plc", valves=valves))
    if is_on("archive"):
        nodes.append(node("archive", valves=valves, monitors=monitors))
    return nodes


def generate_launch_description() -> LaunchDescription:
    """A valve and a monitor for each tank, and what serves all of them."""
    unset = "; empty: as the parameter file or the node has it"
    told = {**ARGUMENTS, **{name: ("", words + unset) for name, (_, _, words) in PARAMETERS.items()}}
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words) for name, (value, words) in told.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes_of)])
