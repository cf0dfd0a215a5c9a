"""The programs of a station: `ros2 run valve_sim dispenser_node`, or `python -m valve_sim.station dispenser_node`."""

from __future__ import annotations

from typing import Final

from valve_sim.nodes.starting import Extra, Program, chosen

dispenser_node: Final = Program(
    "dispenser_node",
    "valve_sim.station.dispenser_node:DispenserNode",
    """
    dispenser_node fills simulated vehicles from the tanks of a station with gas.

    It commands the valves one after the other, as a hydrogen station does in a cascade, and
    simulates the line and the vehicle. With the valves of config/gas_tank_1.yaml to _3.yaml
    running (ros2 launch valve_sim station.launch.py gas:=true starts them all):

        dispenser_node --ros-args --params-file config/gas_dispenser.yaml
""",
    "docs/how_to/station.md",
)
opcua_node: Final = Program(
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
plc_node: Final = Program(
    "plc_node",
    "valve_sim.station.plc_node:PlcNode",
    """
    plc_node lets a PLC command the coils of valves over Modbus TCP.

    It shows the PLC the state of each valve, and de-energises the coils when the PLC's
    heartbeat stands still. It needs the extra modbus: pip install '.[modbus]'.

        plc_node --ros-args -p valves:='[valve]' -p map_file:=registers.csv
""",
    "docs/how_to/plc.md",
    needs=Extra("pymodbus.simulator", "modbus", "Modbus TCP"),
)
archive_node: Final = Program(
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
    raise SystemExit(chosen(dispenser_node, opcua_node, plc_node, archive_node))
