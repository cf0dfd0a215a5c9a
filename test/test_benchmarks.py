"""What `python -m benchmarks` lists can be run, what can be run is listed, and pages print no other program."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from benchmarks.__main__ import COMMANDS, HERE, question
from benchmarks.campaign.cases import FAMILIES

LISTED = [command for commands in COMMANDS.values() for command in commands]
MODULES = {command.partition(" ")[0] for command in LISTED}
OURS = {"valve_sim", "benchmarks", "plants", "model", "identification", "nodes"}
"""Packages of this repository, which benchmarks import; others may be missing."""
DOCS = Path(__file__).parents[1] / "docs"


def modules_that_run() -> set[str]:
    """Modules that start something when Python runs them."""
    found = {
        path.relative_to(HERE).with_suffix("").as_posix().replace("/", ".")
        for path in HERE.rglob("*.py")
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8") and path.name != "__main__.py"
    }
    return found | {path.parent.name for path in HERE.glob("*/__main__.py")}


def test_every_program_is_listed_and_no_command_twice() -> None:
    assert modules_that_run() == MODULES
    assert len(set(LISTED)) == len(LISTED)
    assert [command for command in LISTED if not 15 < len(question(command)) < 140] == []


@pytest.mark.long
@pytest.mark.parametrize("module", sorted(MODULES))
def test_each_can_be_imported(module: str) -> None:
    program = f"benchmarks.{module}.__main__" if (HERE / module).is_dir() else f"benchmarks.{module}"
    try:
        importlib.import_module(program)
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] in OURS:
            raise
        pytest.skip(f"needs {missing.name}")


def test_what_pages_print_can_be_run() -> None:
    text = "\n".join(path.read_text(encoding="utf-8") for path in DOCS.rglob("*.md")).replace("\\\n", "")
    printed = set(re.findall(r"-m benchmarks\.([a-z_.]+[a-z])", text))
    assert len(printed) > 3 and printed <= modules_that_run()
    families = re.findall(r"benchmarks\.campaign --only ([a-z_,]+)", text)
    assert {family for names in families for family in names.split(",")} <= FAMILIES.keys()
