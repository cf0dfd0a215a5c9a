"""What make does before it runs the package: environments and compiled code that are out of date are made anew."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OLD, NEW = 1_000_000_000, 2_000_000_000
NEEDED = ("Makefile", "setup.py", "setup.cfg", "package.xml", "tools/environment")

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
echo "$(nice) $(basename "$0") $*" >> done.txt
case "$(basename "$0") $*" in *"$FAILS"*) exit 3;; esac
"""
CHECKS = (
    "-m valve_sim.warm", "-m ruff check", "-m ruff format", "-m mypy", "lint-imports", "-m sphinx", "-m pytest",
    "tools/retest.py test/nodes/test_valve_node.py", "-m benchmarks.campaign",
)  # fmt: skip
KILTED_CHECKS = ("-m valve_sim.warm", "tools/retest.py test/nodes/test_messages.py")


def outcome(folder: Path, fails: str) -> tuple[int, dict[str, list[str]]]:
    """How `make test` ends where a program that is given these words fails, and what ran in each environment."""
    nodes = folder / "test" / "nodes"
    nodes.mkdir(parents=True)
    (nodes / "test_valve_node.py").touch()
    for environment in (".venv", ".venv-kilted"):
        (folder / environment / "bin").mkdir(parents=True, exist_ok=True)
        (folder / environment / ".ready-to-test").touch()
        for program in ("python", "lint-imports"):
            stand_in = folder / environment / "bin" / program
            stand_in.write_text(STAND_IN.replace("done.txt", f"{environment}.txt"))
            stand_in.chmod(0o755)
    given = {name: value for name, value in os.environ.items() if name not in ("ROS_DISTRO", "MAKEFLAGS")}
    ran = subprocess.run(
        ["make", "test"], cwd=folder, env={**given, "FAILS": fails}, capture_output=True, timeout=300, check=False
    )
    logs = (folder / f"{environment}.txt" for environment in (".venv", ".venv-kilted"))
    return ran.returncode, {log.stem: log.read_text().splitlines() if log.exists() else [] for log in logs}


def test_make_test_runs_all_checks_and_nodes_have_priority(checkout: Path) -> None:
    code, ran = outcome(checkout, "nothing")
    assert code == 0
    assert all(any(check in line for line in ran[".venv"]) for check in CHECKS)
    assert all(any(check in line for line in ran[".venv-kilted"]) for check in KILTED_CHECKS)
    for line in (*ran[".venv"], *ran[".venv-kilted"]):
        is_ahead = "valve_sim.warm" in line or "tools/retest.py" in line
        assert int(line.split()[0]) == (os.nice(0) if is_ahead else 19), line


@pytest.mark.parametrize("check", [*CHECKS, KILTED_CHECKS[-1]])
def test_whatever_fails_make_test_fails(checkout: Path, check: str) -> None:
    assert outcome(checkout, check)[0] != 0
