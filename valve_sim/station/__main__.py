"""The programs of a station: `ros2 run valve_sim opcua_node`, or `python -m valve_sim.station opcua_node`."""

from __future__ import annotations

from valve_sim import early_signals  # noqa: F401 -- first, for its effect
from valve_sim.nodes.starting import Extra, Program, chosen

opcua_node = Program(
    "opcua_node",
    "valve_sim.station.opcua_node:OpcUaNode",
    """
    opcua_node shows valves and their monitors to OPC UA clients, such as a SCADA system.

    Clients read states, strokes, findings and alarms; none can command a coil. It needs the
    extra opcua: pip install '.[opcua]'. For one valve, in a checkout:

        opcua_node --ros-args -p valves:='[valve]' \\
            -p monitors:='[monitor]'
""",
    "docs/how_to/opcua.md",
    needs=Extra("asyncua", "opcua", "the OPC UA server"),
)
plc_node = Program(
    "plc_node",
    "valve_sim.station.plc_node:PlcNode",
    """
    plc_node lets a PLC command the coils of valves over Modbus TCP.

    It shows the PLC the state of each valve, and de-energises the coils when the PLC's
    heartbeat stands still. To poll a PLC that is the server (plc_host) it needs the extra
    modbus: pip install '.[modbus]'.

        plc_node --ros-args -p valves:='[valve]' -p map_file:=registers.csv
""",
    "docs/how_to/plc.md",
)
archive_node = Program(
    "archive_node",
    "valve_sim.station.archive_node:ArchiveNode",
    """
    archive_node keeps strokes, findings and alarms of valves for years, in SQLite.

    It subscribes to what monitors and valves publish; `valve-sim history` prints what it has
    kept.

        archive_node --ros-args -p folder:=archive -p valves:='[valve]' \\
            -p monitors:='[monitor]'
""",
    "docs/how_to/archive.md",
)

if __name__ == "__main__":
    raise SystemExit(chosen(opcua_node, plc_node, archive_node))
