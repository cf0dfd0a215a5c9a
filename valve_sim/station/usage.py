"""What `--help` of each node of a station prints: what it does, a command, and where to read on."""

from __future__ import annotations

from typing import Final

from valve_sim.nodes.usage import usage

DISPENSER_NODE: Final = usage(
    """
    dispenser_node fills simulated vehicles from the tanks of a station with gas.

    It commands the valves one after the other, as a hydrogen station does in a cascade, and
    simulates the line and the vehicle. With the valves of config/gas_tank_1.yaml to _3.yaml
    running (ros2 launch valve_sim station.launch.py gas:=true starts them all):

        dispenser_node --ros-args --params-file config/gas_dispenser.yaml
""",
    "docs/how_to/station.md",
)

OPCUA_NODE: Final = usage(
    """
    opcua_node shows valves and their monitors to OPC UA clients, such as a SCADA system.

    Clients read states, strokes, findings and alarms; none can command a coil. It needs the
    extra opcua: pip install '.[opcua]'. For one valve, in a checkout:

        opcua_node --ros-args -p valves:='[valve]' \\
            -p monitors:='[monitor]'
""",
    "docs/how_to/opcua.md",
)

PLC_NODE: Final = usage(
    """
    plc_node lets a PLC command the coils of valves over Modbus TCP.

    It shows the PLC the state of each valve, and de-energises the coils when the PLC's
    heartbeat stands still. It needs the extra modbus: pip install '.[modbus]'.

        plc_node --ros-args -p valves:='[valve]' -p map_file:=registers.csv
""",
    "docs/how_to/plc.md",
)

ARCHIVE_NODE: Final = usage(
    """
    archive_node keeps strokes, findings and alarms of valves for years, as Parquet files.

    It subscribes to what monitors and valves publish; `valve-sim history` prints what it has
    kept. It needs the extra parquet: pip install '.[parquet]'.

        archive_node --ros-args -p folder:=archive -p valves:='[valve]' \\
            -p monitors:='[monitor]'
""",
    "docs/how_to/archive.md",
)
