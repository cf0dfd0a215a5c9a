"""A station of tanks: in the namespace of each a `valve` with a parameter file of its own and its `monitor`.

    ros2 launch valve_sim station.launch.py monitors:=false command_timeout:=0.5
    ros2 launch valve_sim station.launch.py gas:=true
    ros2 launch valve_sim station.launch.py opcua:=true plc:=true archive:=true
    ros2 launch valve_sim station.launch.py tanks:=north/tank_1,north/tank_2 config:=/etc/station respawn:=true

A monitor declares the valve that its parameter file describes, and hears the simulated valve's own joint_states in
place of a sensor's. What a parameter sets while the station runs is a fault to it.
"""

from collections.abc import Mapping
from pathlib import Path

from launch_ros.actions import Node

from launch import LaunchDescription
from valve_sim.nodes.launching import CONFIG, USE_SIM_TIME, description, node

ARGUMENTS = {
    "tanks": ("tank_1,tank_2,tank_3", "namespaces of the tanks, with commas"),
    "config": (
        str(CONFIG),
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
    "use_sim_time": ("valve monitor opcua plc archive", "use_sim_time", USE_SIM_TIME["use_sim_time"]),
    "publish_rate": ("valve", "publish_rate", "Hz, of each valve"),
    "command_timeout": ("valve", "command_timeout", "s without a command, after which a valve closes by itself"),
    "commissioning_strokes": ("monitor", "commissioning_strokes", "so many first strokes are taken for healthy"),
    "opcua_port": ("opcua", "port", "TCP port of OPC UA"),
    "opcua_folder": ("opcua", "folder", "folder of its certificates and history"),
    "plc_port": ("plc", "port", "TCP port of Modbus"),
    "archive_folder": ("archive", "folder", "folder of the archive"),
}
"""Of arguments that are parameters: the nodes, the parameter, and what it says."""
UNLESS_IN_FILE = {
    "valve": {"publish_rate": 500.0},
    # The noise is a laser's; simulated valves have none at all, and a monitor that knew it would warn of what no
    # sensor shows.
    "monitor": {"measured": "joint_states", "noise_um": 1.0},
}
"""What nodes of a station have where their parameter file says nothing."""
RESPAWN_SECONDS = 2.0


def nodes_of(given: Mapping[str, str]) -> list[Node]:
    """The nodes that these values of the arguments ask for."""
    tanks = [tank.strip("/ ") for tank in given["tanks"].split(",") if tank.strip("/ ")]
    if not tanks:
        raise RuntimeError(f"tanks: found {given['tanks']!r}, expected namespaces such as tank_1,tank_2")
    valves, monitors = [f"{tank}/valve" for tank in tanks], [f"{tank}/monitor" for tank in tanks]

    def is_on(name: str) -> bool:
        return given[name].lower() in ("true", "1")

    def made(name: str, tank: str = "", file: Path | None = None, **fixed: object) -> Node:
        words = ["--log-level", given["log_level"]]
        for key, value in UNLESS_IN_FILE.get(name, {}).items():
            words += ["-p", f"{key}:={value}"]
        parameters = {
            key: argument for argument, (of, key, _) in PARAMETERS.items() if name in of.split() and given[argument]
        }
        return node(name, tank, file, parameters, words, fixed, respawn=is_on("respawn"), respawn_delay=RESPAWN_SECONDS)

    nodes = []
    for tank in tanks:
        file = Path(given["config"]) / f"{'gas_' if is_on('gas') else ''}{tank.rpartition('/')[2]}.yaml"
        nodes.append(made("valve", tank, file))
        if is_on("monitors"):
            kept = {"state": str(Path(given["state"]) / f"{tank.replace('/', '_')}.json")} if given["state"] else {}
            nodes.append(made("monitor", tank, file, **kept))
    if is_on("opcua"):
        nodes.append(made("opcua", valves=valves, monitors=monitors))
    if is_on("plc"):
        nodes.append(made("plc", valves=valves))
    if is_on("archive"):
        nodes.append(made("archive", valves=valves, monitors=monitors))
    return nodes


def generate_launch_description() -> LaunchDescription:
    """A valve and a monitor for each tank, and what serves all of them."""
    return description(ARGUMENTS, {name: words for name, (_, _, words) in PARAMETERS.items()}, nodes_of)
