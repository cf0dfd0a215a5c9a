"""What make does before it runs the package: environments and compiled code that are out of date are made anew."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OLD, NEW = 1_000_000_000, 2_000_000_000
NEEDED = ("Makefile", "setup.py", "setup.cfg", "package.xml", "pyproject.toml", "tools/environment", ".ci/run")

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="there is no make here")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout whose environment has been made and whose model has been compiled."""
    for name in NEEDED:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    shutil.copytree(ROOT / "valve_sim" / "model", tmp_path / "valve_sim" / "model")
    shutil.copy(ROOT / "valve_sim" / "warm.py", tmp_path / "valve_sim" / "warm.py")
    for path in tmp_path.rglob("*"):
        os.utime(path, (OLD, OLD))
    (tmp_path / ".venv").mkdir()
    for name in (".ready-to-run", ".warm"):
        (tmp_path / ".venv" / name).touch()
    return tmp_path


def planned(folder: Path, target: str) -> str:
    """What make would run."""
    environment = {name: value for name, value in os.environ.items() if name not in ("ROS_DISTRO", "MAKEFLAGS")}
    return subprocess.run(
        ["make", "--dry-run", target], cwd=folder, env=environment, capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.parametrize("target", ["run", "shell"])
def test_the_model_is_compiled_before_first_use_where_its_sources_are_others(checkout: Path, target: str) -> None:
    assert "valve_sim.warm" not in planned(checkout, target)
    os.utime(checkout / "valve_sim" / "model" / "effects" / "stiction.py", (NEW, NEW))
    assert "python -m valve_sim.warm" in planned(checkout, target)
    assert "tools/environment make" not in planned(checkout, target), "the environment is as it should be"


def test_an_environment_is_made_anew_where_what_it_needs_is_declared_otherwise(checkout: Path) -> None:
    os.utime(checkout / "setup.py", (NEW, NEW))
    assert "tools/environment make .venv" in planned(checkout, "run")


STAND_IN = """#!/bin/sh
echo "$(basename "$0") $*" >> done.txt
case "$(basename "$0") $*" in *"$FAILS"*) exit 3;; esac
"""
PARTS = {
    "lint": "-m ruff check", "types": "-m mypy", "layers": "lint-imports", "docs": "-m sphinx",
    "tests": "not ros and not long", "nodes": "-m ros and not long",
}  # fmt: skip
"""Of make test: its name, and words of its command."""
LONG = {"long-tests": "not ros and long", "long-nodes": "-m ros and long", "campaign": "-m benchmarks.campaign"}
KILTED = {"kilted": "test/nodes/test_messages.py"}


def outcome(folder: Path, command: str, fails: str) -> tuple[subprocess.CompletedProcess[str], str, str]:
    """How a command ends where a program that is given these words fails, and what ran on Jazzy and on Kilted."""
    for environment in (".venv", ".venv-kilted"):
        (folder / environment / "bin").mkdir(parents=True, exist_ok=True)
        for mark in (".ready-to-test", ".warm"):
            (folder / environment / mark).touch()
        for program in ("python", "lint-imports"):
            stand_in = folder / environment / "bin" / program
            stand_in.write_text(STAND_IN.replace("done.txt", f"{environment}.txt"))
            stand_in.chmod(0o755)
    browser = folder / "bin" / "chromium"  # or .ci/run would install one
    browser.parent.mkdir()
    browser.touch(mode=0o755)
    given = {name: value for name, value in os.environ.items() if name not in ("ROS_DISTRO", "MAKEFLAGS")}
    given["PATH"] = f"{browser.parent}{os.pathsep}{given['PATH']}"
    ran = subprocess.run(
        command.split(), cwd=folder, env={**given, "FAILS": fails}, capture_output=True, text=True, check=False
    )
    jazzy, kilted = (folder / ".venv.txt", folder / ".venv-kilted.txt")
    return ran, *(log.read_text() if log.exists() else "" for log in (jazzy, kilted))


def test_what_is_long_has_a_command_of_its_own(checkout: Path) -> None:
    ran, jazzy, kilted = outcome(checkout, "make test", "nothing")
    assert ran.returncode == 0
    assert all(words in jazzy for words in PARTS.values())
    assert not any(words in jazzy for words in LONG.values())
    assert kilted == ""


def test_ci_runs_both(checkout: Path) -> None:
    ran, jazzy, kilted = outcome(checkout, "bash .ci/run", "nothing")
    assert ran.returncode == 0
    assert all(words in jazzy for words in (*PARTS.values(), *LONG.values()))
    assert KILTED["kilted"] in kilted


@pytest.mark.parametrize("part", [*PARTS, *LONG, *KILTED])
def test_a_part_that_fails_is_named_and_hides_no_other(checkout: Path, part: str) -> None:
    command = "make test" if part in PARTS else "make test-long"
    parts = PARTS if part in PARTS else LONG | KILTED
    ran, *logs = outcome(checkout, command, parts[part])
    assert ran.returncode != 0
    assert all(words in "".join(logs) for words in parts.values())
    named = {name for name in parts if f"Target '{name}' not remade" in ran.stderr or f": {name}]" in ran.stderr}
    assert named == {part}


def test_ci_fails_where_either_fails(checkout: Path) -> None:
    ran, jazzy, _ = outcome(checkout, "bash .ci/run", PARTS["types"])
    assert ran.returncode != 0
    assert LONG["campaign"] in jazzy
