"""`ros2 run valve_sim opcua_node`: serves what monitors and valves say to OPC UA clients.

See `valve_sim.station.opcua_shell.OpcUaShell` for topics and parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.starting import GivenFiles, Shell, run_node
from valve_sim.station.extras import require


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal ends it.

    Args:
        args: the command line with the program's own name first; default sys.argv.

    Returns:
        the exit code: 0 after SIGINT or SIGTERM, 1 if the node failed, 2 after unusable input.
    """
    return run_node("opcua_node", _make_shell, args)


def _make_shell(given: GivenFiles) -> Shell:
    require("asyncua", "opcua", "the OPC UA server")
    # Imported only after `run_node` has found ROS; without ROS it prints one line.
    from valve_sim.station.opcua_shell import OpcUaShell

    return OpcUaShell(given)


if __name__ == "__main__":
    raise SystemExit(main())
