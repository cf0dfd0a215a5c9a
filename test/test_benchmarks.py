"""What `python -m benchmarks` lists can be run, and nothing that can be run is left out."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from benchmarks.__main__ import GROUPS, HERE, Benchmark
from benchmarks.campaign.cases import FAMILIES

LISTED = [own for members in GROUPS.values() for own in members]
OURS = {"valve_sim", "benchmarks", "plants", "model", "identification", "nodes"}
"""Packages of this repository, which benchmarks import; others may be missing."""
DOCS = Path(__file__).parents[1] / "docs"


def modules_that_run() -> set[str]:
    """Modules that start something when Python runs them."""
    found = set()
    for path in HERE.rglob("*.py"):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            found.add(path.relative_to(HERE).with_suffix("").as_posix().replace("/", "."))
    packages = {path.parent.name for path in HERE.glob("*/__main__.py")}
    return {name for name in found if not name.endswith("__main__")} | packages


def test_every_program_is_listed_and_no_command_twice() -> None:
    assert {own.module for own in LISTED} == modules_that_run()
    assert len({own.command for own in LISTED}) == len(LISTED)


@pytest.mark.parametrize("module", sorted({own.module for own in LISTED}))
def test_each_can_be_imported(module: str) -> None:
    program = f"benchmarks.{module}.__main__" if (HERE / module).is_dir() else f"benchmarks.{module}"
    try:
        importlib.import_module(program)
    except ModuleNotFoundError as missing:
        if (missing.name or "").partition(".")[0] in OURS:
            raise
        pytest.skip(f"needs {missing.name}")


@pytest.mark.parametrize("own", LISTED, ids=lambda own: own.command.partition("benchmarks.")[2])
def test_each_says_what_it_answers(own: Benchmark) -> None:
    assert 15 < len(own.question) < 140
    assert "python" not in own.question


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: path.relative_to(DOCS).as_posix())
def test_what_a_document_prints_can_be_run(path: Path) -> None:
    printed = set(re.findall(r"-m benchmarks\.([a-z_.]+[a-z])", path.read_text(encoding="utf-8")))
    assert printed <= modules_that_run()


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: path.relative_to(DOCS).as_posix())
def test_a_document_names_families_that_the_campaign_has(path: Path) -> None:
    text = path.read_text(encoding="utf-8").replace("\\\n", "")
    printed = re.findall(r"benchmarks\.campaign --only ([a-z_,]+)", text)
    assert {family for names in printed for family in names.split(",")} <= FAMILIES.keys()
