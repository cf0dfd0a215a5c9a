"""`ros2 run valve_sim command_profile`: commands a valve by a file of times and voltages, and logs each command.

See `valve_sim.nodes.command_profile_shell.CommandProfileShell` for topics and parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

from valve_sim.nodes.starting import GivenFiles, Shell, run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until the profile has ended.

    Args:
        args: the command line with the program's own name first; default sys.argv.

    Returns:
        the exit code: 0 when all was commanded, 1 when it was broken off, 2 after unusable input.
    """
    return run_node("command_profile", _make_shell, args)


def _make_shell(given: GivenFiles) -> Shell:
    # Imported only after `run_node` has found ROS; without ROS it prints one line.
    from valve_sim.nodes.command_profile_shell import CommandProfileShell

    return CommandProfileShell(given)


if __name__ == "__main__":
    raise SystemExit(main())
