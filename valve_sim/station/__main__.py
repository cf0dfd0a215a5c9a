"""The programs of a station: `ros2 run valve_sim dispenser_node`, or `python -m valve_sim.station dispenser_node`."""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.__main__ import chosen
from valve_sim.nodes.starting import run_node


def dispenser_node(args: Sequence[str] | None = None) -> int:
    """Fill vehicles from the tanks of a station, one valve after the other; arguments and exit codes of `run_node`."""
    return run_node("dispenser_node", "valve_sim.station.dispenser_node:DispenserNode", args)


if __name__ == "__main__":
    raise SystemExit(chosen({"dispenser_node": dispenser_node}))
