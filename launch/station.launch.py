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
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

NOISE_UM = 1.0
"""Of a laser; simulated valves have none at all, and a monitor that knew it would warn of what no sensor shows."""
ARGUMENTS = {
    "tanks": ("tank_1,tank_2,tank_3", "namespaces of the tanks, with commas"),
    "config": (
        str(Path(__file__).resolve().parents[1] / "config"),
        "folder of the parameter files, each called as the last part of its tank's namespace: tank_1.yaml",
    ),
    "gas": ("false", "whether there is hydrogen before the valves: files gas_tank_1.yaml and so on"),
    "use_sim_time": ("false", "follow /clock"),
    "monitors": ("true", "whether each valve has a monitor_node beside it"),
    "publish_rate": ("500.0", "Hz, of each valve"),
    "command_timeout": ("0.0", "s without a command, after which a valve closes by itself; 0: never"),
    "commissioning_strokes": ("20", "so many first strokes of a valve are taken for healthy by its monitor"),
    "state": ("", "folder in which monitors keep what commissioning found; empty: none"),
    "opcua": ("false", "whether an opcua_node serves all valves"),
    "opcua_port": ("4840", "TCP port of OPC UA"),
    "opcua_folder": ("", "folder of its certificates and history; empty: that of the node"),
    "plc": ("false", "whether a plc_node lets a PLC command all valves"),
    "plc_port": ("1502", "TCP port of Modbus"),
    "archive": ("false", "whether an archive_node keeps what the monitors say"),
    "archive_folder": ("", "folder of the archive; empty: that of the node"),
    "respawn": ("false", "whether a node that ends is started again, after 2 s"),
    "log_level": ("info", "of all nodes: debug, info, warn, error or fatal"),
}
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

    def node(name: str, tank: str, parameters: dict[str, object], file: Path | None = None) -> Node:
        # As one of `parameters`, a file that is not there is only warned of, and the shipped valve started.
        words = ["--log-level", given["log_level"], *([] if file is None else ["--params-file", str(file)])]
        return Node(
            package="valve_sim",
            executable=f"{name}_node",
            name=name,
            namespace=tank,
            parameters=[{"use_sim_time": is_on("use_sim_time"), **parameters}],
            ros_arguments=words,
            respawn=is_on("respawn"),
            respawn_delay=RESPAWN_SECONDS,
            output="screen",
        )

    def folder(name: str) -> dict[str, object]:
        return {"folder": given[name]} if given[name] else {}

    nodes = []
    for tank in tanks:
        name = tank.rpartition("/")[2]
        file = Path(given["config"]) / f"{'gas_' if is_on('gas') else ''}{name}.yaml"
        rates: dict[str, object] = {key: float(given[key]) for key in ("publish_rate", "command_timeout")}
        nodes.append(node("valve", tank, rates, file))
        if is_on("monitors"):
            strokes = int(given["commissioning_strokes"])
            watching = {"measured": "joint_states", "noise_um": NOISE_UM, "commissioning_strokes": strokes}
            kept = {"state": str(Path(given["state"]) / f"{tank.replace('/', '_')}.json")} if given["state"] else {}
            nodes.append(node("monitor", tank, {**watching, **kept}, file))
    if is_on("opcua"):
        served = {"valves": valves, "monitors": monitors, "port": int(given["opcua_port"])}
        nodes.append(node("opcua", "", {**served, **folder("opcua_folder")}))
    if is_on("plc"):
        nodes.append(node("plc", "", {"valves": valves, "port": int(given["plc_port"])}))
    if is_on("archive"):
        nodes.append(node("archive", "", {"valves": valves, "monitors": monitors, **folder("archive_folder")}))
    return nodes


def generate_launch_description() -> LaunchDescription:
    """A valve and a monitor for each tank, and what serves all of them."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=words)
        for name, (value, words) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes_of)])
