"""What `python -m benchmarks` lists can be run, and nothing that can be run is left out."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.__main__ import GROUPS, HERE, Benchmark

LISTED = [own for members in GROUPS.values() for own in members]
OF_A_FIGURE = {"posterior_figure"}
"""Draws a figure of the documentation; measures nothing."""


def modules_that_run() -> set[str]:
    """Modules that start something when Python runs them."""
    found = set()
    for path in HERE.rglob("*.py"):
        if '__name__ == "__main__"' in path.read_text(encoding="utf-8"):
            found.add(path.relative_to(HERE).with_suffix("").as_posix().replace("/", "."))
    packages = {path.parent.name for path in HERE.glob("*/__main__.py")}
    return {name for name in found if not name.endswith("__main__")} | packages


def test_every_benchmark_is_listed_once() -> None:
    names = [own.module for own in LISTED]
    assert sorted(names) == sorted(modules_that_run() - OF_A_FIGURE)


@pytest.mark.parametrize("own", LISTED, ids=lambda own: own.module)
def test_each_says_what_it_answers(own: Benchmark) -> None:
    assert 15 < len(own.question) < 140
    assert "python" not in own.question


def test_what_documents_print_is_listed() -> None:
    text = (Path(__file__).parents[1] / "docs" / "results" / "measured.md").read_text(encoding="utf-8")
    printed = {own.module for own in LISTED if f"benchmarks.{own.module}" in text}
    assert len(printed) > 25
