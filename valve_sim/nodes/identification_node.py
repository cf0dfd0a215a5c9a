"""`ros2 run valve_sim identification_node`: replays a recorded bag beside the model and refits the model to it.

See `valve_sim.nodes.identification_shell.IdentificationShell` for topics and parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.starting import GivenFiles, Shell, run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM.

    Args:
        args: the command line with the program's own name first; default sys.argv.

    Returns:
        the exit code: 0 after a signal, 2 after unusable input.
    """
    return run_node("identification_node", _make_shell, args)


def _make_shell(given: GivenFiles) -> Shell:
    # Imported only after `run_node` has found ROS; without ROS it prints one line.
    from valve_sim.nodes.identification_shell import IdentificationShell

    return IdentificationShell(given)


if __name__ == "__main__":
    raise SystemExit(main())
