"""The programs: `ros2 run valve_sim valve_node` and the like, or `python -m valve_sim.nodes valve_node`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence

from valve_sim.nodes import usage
from valve_sim.nodes.starting import UNUSABLE_INPUT, run_node

Program = Callable[[Sequence[str]], int]


def valve_node(args: Sequence[str] | None = None) -> int:
    """Run a valve in real time on ROS 2 topics; arguments and exit codes of `run_node`."""
    return run_node("valve_node", "valve_sim.nodes.valve:ValveNode", args, usage.VALVE_NODE)


def identification_node(args: Sequence[str] | None = None) -> int:
    """Replay a recording on topics and identify or diagnose its valve; arguments and exit codes of `run_node`."""
    return run_node(
        "identification_node", "valve_sim.nodes.identification:IdentificationNode", args, usage.IDENTIFICATION_NODE
    )


def monitor_node(args: Sequence[str] | None = None) -> int:
    """Watch a valve beside its model, stroke by stroke; arguments and exit codes of `run_node`."""
    return run_node("monitor_node", "valve_sim.nodes.monitor:MonitorNode", args, usage.MONITOR_NODE)


def command_profile(args: Sequence[str] | None = None) -> int:
    """Command a valve by a file of times and voltages; arguments and exit codes of `run_node`."""
    return run_node("command_profile", "valve_sim.nodes.profile:ProfileNode", args, usage.COMMAND_PROFILE)


def chosen(programs: Mapping[str, Program]) -> int:
    """Run the program that the command line names first, with the rest of it; its exit code."""
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in programs:
        print(f"expected one of {', '.join(programs)} first, found {name or 'nothing'}", file=sys.stderr)
        return UNUSABLE_INPUT
    return programs[name]([name, *sys.argv[2:]])


if __name__ == "__main__":
    raise SystemExit(
        chosen(
            {
                "valve_node": valve_node,
                "identification_node": identification_node,
                "monitor_node": monitor_node,
                "command_profile": command_profile,
            }
        )
    )
