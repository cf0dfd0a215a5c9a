"""Every program is ready for a signal before it loads anything that takes long, and ends then with its exit code."""

from __future__ import annotations

import subprocess
import sys

import pytest

import valve_sim.nodes.__main__
import valve_sim.station.__main__
from valve_sim import early_signals
from valve_sim.nodes.starting import Program

INTERRUPTED = """
import importlib, os, signal, sys

looked_for = []

class Interrupts:
    def find_spec(self, name, path=None, target=None):
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler or name == "valve_sim.cli":
            sys.meta_path.remove(self)
            print(*looked_for, flush=True)
            os.kill(os.getpid(), signal.SIGINT)
        looked_for.append(name)

module, main, *sys.argv = sys.argv[1:]
sys.meta_path.insert(0, Interrupts())
getattr(importlib.import_module(module), main)()
"""
"""A program that gets Ctrl-C as soon as it handles signals, or is inside the `try` of `valve-sim`.

It prints what it has looked for until then.
"""


@pytest.mark.parametrize(
    ("words", "modules", "main", "code"),
    [
        ("/usr/bin/valve-sim", ["valve_sim.__main__"], "main", 130),
        ("/usr/bin/monitor_node", ["valve_sim.nodes", "valve_sim.nodes.__main__"], "monitor_node", 0),
        ("/usr/bin/archive_node", ["valve_sim.station", "valve_sim.station.__main__"], "archive_node", 0),
        ("/lib/nodes/__main__.py valve_node", ["valve_sim.nodes", "valve_sim.nodes.__main__"], "valve_node", 0),
        ("/lib/nodes/__main__.py command_profile", ["valve_sim.nodes", "valve_sim.nodes.__main__"], "valve_node", 1),
        ("/lib/demo/__main__.py", ["valve_sim.demo", "valve_sim.demo.__main__"], "main", 130),
        ("/lib/valve_sim/warm.py", ["valve_sim.warm"], "main", 130),
    ],
)
def test_ctrl_c_ends_a_program_that_has_loaded_nothing_yet(
    words: str, modules: list[str], main: str, code: int
) -> None:
    command = [sys.executable, "-c", INTERRUPTED, modules[-1], main, *words.split()]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    is_command_line = modules == ["valve_sim.__main__"]
    handling = [] if is_command_line else ["valve_sim.early_signals"]
    assert ran.stdout.split() == ["valve_sim", *modules, *handling]
    assert (ran.returncode, ran.stderr) == (code, "valve-sim: stopped\n" if is_command_line else "")


def test_each_program_of_a_node_is_known() -> None:
    modules = (valve_sim.nodes.__main__, valve_sim.station.__main__)
    programs = [found for module in modules for found in vars(module).values() if isinstance(found, Program)]
    assert {program.name for program in programs} == early_signals.NODES.keys()
