"""Every program is ready for a signal before it loads anything that takes long."""

from __future__ import annotations

import subprocess
import sys

import pytest

NOTES = """
import importlib, signal, sys

looked_for = []

class Notes:
    def find_spec(self, name, path=None, target=None):
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler or name == "valve_sim.cli":
            sys.meta_path.remove(self)
            print(*looked_for)
        looked_for.append(name)

module, main, *sys.argv = sys.argv[1:]
sys.meta_path.insert(0, Notes())
sys.exit(getattr(importlib.import_module(module), main)())
"""
"""A program that prints what is loaded before it handles signals, or is inside the `try` of `valve-sim`."""


@pytest.mark.parametrize(
    ("program", "function", "loaded"),
    [
        ("valve-sim", "main", ["valve_sim", "valve_sim.__main__"]),
        (
            "monitor_node",
            "monitor_node",
            ["valve_sim", "valve_sim.nodes", "valve_sim.nodes.__main__", "valve_sim.nodes.ending"],
        ),
        (
            "archive_node",
            "archive_node",
            [
                "valve_sim",
                "valve_sim.station",
                "valve_sim.station.__main__",
                "valve_sim.nodes",
                "valve_sim.nodes.ending",
            ],
        ),
    ],
)
def test_a_program_is_ready_for_a_signal_before_it_loads_anything_else(
    program: str, function: str, loaded: list[str]
) -> None:
    module = next(name for name in loaded if name.endswith("__main__"))
    command = [sys.executable, "-c", NOTES, module, function, f"/usr/bin/{program}", "--help"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    assert ran.stdout.splitlines()[0].split() == loaded
