"""A node with an endless calculation in place of its own, for tests of how it ends.

    python endless_node.py NODE --ros-args -p ...

It says "calculating" when that has begun.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any, NoReturn

PLACES = {
    "valve_node": "live_valve:load_stepper",
    "monitor_node": "monitor_work:isolate_fault",
    "identification_node": "identification:fit_or_diagnose",
    "command_profile": "profile:checked_profile",
}
"""Module and name of what each node calculates."""


def calculate(*arguments: object) -> NoReturn:
    print("calculating", flush=True)
    while True:
        sum(range(1000))


def search_at_once() -> None:
    """Have the monitor look for a fault from its start on."""
    from valve_sim.identification.monitoring.findings import Occasion
    from valve_sim.nodes.monitor import MonitorNode

    def prepare(self: Any) -> None:
        self._isolation.begin([], None, Occasion("/valve", 0, 0))

    MonitorNode._prepare = prepare  # type: ignore[method-assign]


if __name__ == "__main__":
    node = sys.argv.pop(1)
    module, _, name = PLACES[node].partition(":")
    setattr(importlib.import_module(f"valve_sim.nodes.{module}"), name, calculate)
    if node == "monitor_node":
        search_at_once()
    raise SystemExit(getattr(importlib.import_module("valve_sim.nodes.__main__"), node)())
