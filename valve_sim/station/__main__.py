"""The programs of a station: `ros2 run valve_sim dispenser_node`, or `python -m valve_sim.station dispenser_node`."""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.__main__ import chosen
from valve_sim.nodes.starting import run_node
from valve_sim.station import usage


def dispenser_node(args: Sequence[str] | None = None) -> int:
    """Fill vehicles from the tanks of a station, one valve after the other; arguments and exit codes of `run_node`."""
    return run_node("dispenser_node", "valve_sim.station.dispenser_node:DispenserNode", args, usage.DISPENSER_NODE)


def opcua_node(args: Sequence[str] | None = None) -> int:
    """Serve what monitors and valves say to OPC UA clients; arguments and exit codes of `run_node`."""
    return run_node("opcua_node", "valve_sim.station.extras:opcua_node", args, usage.OPCUA_NODE)


def plc_node(args: Sequence[str] | None = None) -> int:
    """Have a PLC command the coils of valves over Modbus TCP; arguments and exit codes of `run_node`."""
    return run_node("plc_node", "valve_sim.station.extras:plc_node", args, usage.PLC_NODE)


def archive_node(args: Sequence[str] | None = None) -> int:
    """Keep what monitors say of valves for years; arguments and exit codes of `run_node`."""
    return run_node("archive_node", "valve_sim.station.extras:archive_node", args, usage.ARCHIVE_NODE)


if __name__ == "__main__":
    raise SystemExit(
        chosen(
            {
                "archive_node": archive_node,
                "dispenser_node": dispenser_node,
                "opcua_node": opcua_node,
                "plc_node": plc_node,
            }
        )
    )
