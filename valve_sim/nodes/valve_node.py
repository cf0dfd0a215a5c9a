"""`ros2 run valve_sim valve_node`: a valve that runs in real time on ROS 2 topics.

See `valve_sim.nodes.valve_shell.ValveShell` for topics, services and parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.starting import GivenFiles, Shell, run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Args:
        args: the command line with the program's own name first; default sys.argv.

    Returns:
        the exit code: 0 after a signal, 1 if the node failed, 2 after unusable input.
    """
    return run_node("valve_node", _make_shell, args)


def _make_shell(given: GivenFiles) -> Shell:
    # Imported only after `run_node` has found ROS; without ROS it prints one line.
    from valve_sim.nodes.valve_shell import ValveShell

    return ValveShell(given)


if __name__ == "__main__":
    raise SystemExit(main())
