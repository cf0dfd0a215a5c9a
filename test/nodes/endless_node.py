"""A node with an endless calculation in place of its own, for tests of how it ends.

    python endless_node.py NODE --ros-args -p ...

It says "calculating" when that has begun.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any, NoReturn

PLACES = {
    "valve_node": "valve_shell:load_stepper",
    "monitor_node": "monitor_tasks:isolate_fault",
    "identification_node": "identification_shell:fit_or_diagnose",
    "dispenser_node": "dispensing:Dispenser.prepare",
    "command_profile": "command_profile_shell:checked_profile",
}
"""Module and name of what each node calculates."""


def calculate(*arguments: object) -> NoReturn:
    print("calculating", flush=True)
    while True:
        sum(range(1000))


def search_at_once() -> None:
    """Have the monitor look for a fault from its start on."""
    from valve_sim.identification.monitoring.findings import Occasion
    from valve_sim.nodes.monitor_shell import MonitorShell

    def prepare(self: Any) -> None:
        self._isolation.begin([], None, Occasion("/valve", 0, 0))

    MonitorShell._prepare = prepare  # type: ignore[method-assign]


if __name__ == "__main__":
    node = sys.argv.pop(1)
    module, _, names = PLACES[node].partition(":")
    owner: Any = importlib.import_module(f"valve_sim.nodes.{module}")
    *owners, name = names.split(".")
    for part in owners:
        owner = getattr(owner, part)
    setattr(owner, name, calculate)
    if node == "monitor_node":
        search_at_once()
    raise SystemExit(importlib.import_module(f"valve_sim.nodes.{node}").main())
