"""`ros2 run valve_sim archive_node`: keeps what monitors say of valves for years.

See `valve_sim.station.archive_shell.ArchiveShell` for topics and parameters.
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
    return run_node("archive_node", _make_shell, args)


def _make_shell(given: GivenFiles) -> Shell:
    require("pyarrow", "parquet", "an archive")
    # Imported only after `run_node` has found ROS; without ROS it prints one line.
    from valve_sim.station.archive_shell import ArchiveShell

    return ArchiveShell(given)


if __name__ == "__main__":
    raise SystemExit(main())
