"""`ros2 run valve_sim dispenser_node`: a line and a vehicle behind the valves of a station, which it opens in turn.

See `valve_sim.nodes.dispenser_shell.DispenserShell` for topics and parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.starting import GivenFiles, Shell, run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal ends it.

    Args:
        args: the command line with the program's own name first; default sys.argv.

    Returns:
        the exit code: 0 after SIGINT or SIGTERM, 1 if the node failed, 2 after unusable input.
    """
    return run_node("dispenser_node", _make_shell, args)


def _make_shell(given: GivenFiles) -> Shell:
    # Imported only after `run_node` has found ROS; without ROS it prints one line.
    from valve_sim.nodes.dispenser_shell import DispenserShell

    return DispenserShell(given)


if __name__ == "__main__":
    raise SystemExit(main())
