"""What `python -m benchmarks` lists can be run, and nothing that can be run is left out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.__main__ import GROUPS, HERE, Benchmark

LISTED = [own for members in GROUPS.values() for own in members]
OF_A_FIGURE = {"posterior_figure", "record_well_figure"}
"""Draws a figure of the documentation; measures nothing."""
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
    assert {own.module for own in LISTED} == modules_that_run() - OF_A_FIGURE
    assert len({own.command for own in LISTED}) == len(LISTED)


@pytest.mark.parametrize("own", LISTED, ids=lambda own: own.command.partition("benchmarks.")[2])
def test_each_says_what_it_answers(own: Benchmark) -> None:
    assert 15 < len(own.question) < 140
    assert "python" not in own.question


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: path.relative_to(DOCS).as_posix())
def test_what_a_document_prints_can_be_run(path: Path) -> None:
    printed = set(re.findall(r"-m benchmarks\.([a-z_.]+[a-z])", path.read_text(encoding="utf-8")))
    assert printed <= modules_that_run()
