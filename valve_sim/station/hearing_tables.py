"""Topics that several nodes of a station hear, and what holds between their parameters. Needs no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from valve_sim.model import ParameterError
from valve_sim.nodes.topics import LATCHED, RELIABLE, Qos, Topic

LATEST: Final = Qos(1, is_reliable=False)
"""Of what comes often, the last one is enough."""

SAID: Final = (
    Topic("{monitor}/stroke_report", "std_msgs/msg/String", "in", "each stroke, in JSON", qos=RELIABLE),
    Topic("{monitor}/finding", "diagnostic_msgs/msg/DiagnosticArray", "in", "what has changed", qos=LATCHED),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "in", "of valves and monitors", qos=Qos(100)),
)
"""Topics of monitors and valves that are subscribed to."""
LIVE: Final = (
    Topic("{valve}/phase", "std_msgs/msg/UInt8", "in", "of the stroke", qos=LATCHED),
    Topic("{valve}/is_open", "std_msgs/msg/Bool", "in", "whether the flow path is fully open", qos=LATCHED),
    Topic("{valve}/coil_current", "std_msgs/msg/Float64", "in", "by which it is known to live", "A", LATEST),
    Topic("{valve}/outlet_pressure", "sensor_msgs/msg/FluidPressure", "in", "behind a valve with gas", "Pa", LATEST),
)
"""Topics of a valve that are published often; only the latest message counts."""


def check_one_each(valves: Sequence[str], **lists: Sequence[str]) -> None:
    """Check that there is one entry for each valve, and each name once.

    Raises:
        ParameterError: another number, or a name twice.
    """
    for name, entries in lists.items():
        if len(entries) != len(valves):
            raise ParameterError(f"{name}: found {len(entries)}, expected {len(valves)}, one for each of valves")
    for name, entries in {"valves": valves, "monitors": lists.get("monitors", ())}.items():
        if len(set(entries)) != len(entries):
            raise ParameterError(f"{name}: found {', '.join(entries)}, expected each once")


def check_filled(**texts: str) -> None:
    """Check that no text is empty.

    Raises:
        ParameterError: one is.
    """
    for name, text in texts.items():
        if not text.strip():
            raise ParameterError(f"{name}: found {text!r}, expected a text; leave it out for the default")
