"""tools/retest.py: what fails at first and passes alone is named; nothing else that fails passes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[1] / "tools" / "retest.py"
UNSTEADY = """
from pathlib import Path

def test_steady():
    with Path("runs").open("a") as runs:
        runs.write("steady ")

def test_unsteady():
    runs = Path("runs").read_text()
    Path("runs").write_text(runs + "unsteady ")
    assert "unsteady" in runs
"""
FAILS = "def test_fails():\n    assert False\n"
CRASHES_AFTER_A_FAILURE = """
import os
from pathlib import Path

def test_unsteady():
    is_second = Path("seen").exists()
    Path("seen").touch()
    assert is_second

def test_crashes():
    os.abort()
"""
SKIPPED_THE_SECOND_TIME = """
from pathlib import Path
import pytest

def test_unsteady():
    if Path("seen").exists():
        pytest.skip("not now")
    Path("seen").touch()
    assert False
"""


def retest(folder: Path, source: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The tool on one file of tests."""
    (folder / "test_it.py").write_text(source)
    (folder / "pytest.ini").write_text("[pytest]\n")
    environment = {**os.environ, "UNSTEADY_TESTS": str(folder / "unsteady.txt")}
    return subprocess.run(
        [sys.executable, str(TOOL), "test_it.py", *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


def test_what_fails_first_and_passes_alone_is_named_loudly(tmp_path: Path) -> None:
    ran = retest(tmp_path, UNSTEADY)
    assert ran.returncode == 0, ran.stdout
    assert (tmp_path / "runs").read_text().split() == ["steady", "unsteady", "unsteady"], "only what failed runs again"
    line = "unsteady: test_it.py::test_unsteady failed, and passed alone; mend it"
    assert ran.stdout.splitlines()[-2] == line
    assert line in (tmp_path / "unsteady.txt").read_text()


@pytest.mark.parametrize(
    ("source", "code", "runs"),
    [
        (FAILS, 1, 2),
        (UNSTEADY + FAILS, 1, 2),
        (SKIPPED_THE_SECOND_TIME, 1, 2),
        (CRASHES_AFTER_A_FAILURE, None, 1),
        ("import no_such_module\n", 2, 1),
        ("raise KeyboardInterrupt\n", 2, 1),
        ("", 5, 1),
    ],
    ids=["fails", "one of two fails", "skipped then", "crashes", "not collected", "interrupted", "no tests"],
)
def test_whatever_else_fails_is_a_failure(tmp_path: Path, source: str, code: int | None, runs: int) -> None:
    ran = retest(tmp_path, source)
    assert ran.returncode != 0
    assert code is None or ran.returncode == code
    assert ran.stdout.count("test session starts") == runs
    assert "mend it" not in ran.stdout
    assert not (tmp_path / "unsteady.txt").exists()


def test_what_passes_is_run_once_and_nothing_is_said(tmp_path: Path) -> None:
    ran = retest(tmp_path, "def test_passes():\n    pass\n")
    assert ran.returncode == 0
    assert ran.stdout.count("test session starts") == 1
    assert "unsteady" not in ran.stdout
