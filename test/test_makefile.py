"""What make does before it runs the package: environments and compiled code that are out of date are made anew."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPT = Path(sys.executable).with_name("valve-sim")
OLD, NEW = 1_000_000_000, 2_000_000_000
NEEDED = ("Makefile", "setup.py", "setup.cfg", "package.xml", "pyproject.toml", "tools/environment")

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


@pytest.mark.skipif(not SCRIPT.is_file(), reason=f"{SCRIPT} is not here: install the package")
def test_make_shell_finds_every_program_of_its_environment() -> None:
    programs = ("valve-sim", "valve_node", "identification_node", "monitor_node", "command_profile")
    path = [folder for folder in os.environ["PATH"].split(os.pathsep) if Path(folder) != SCRIPT.parent]
    asked = subprocess.run(
        [str(ROOT / "tools" / "environment"), "shell", str(SCRIPT.parents[1])],
        input=f"command -v {' '.join(programs)}; echo makelevel=$MAKELEVEL",
        env={**os.environ, "PATH": os.pathsep.join(path), "SHELL": "/bin/bash", "MAKELEVEL": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert asked.stdout.splitlines() == [*(str(SCRIPT.with_name(name)) for name in programs), "makelevel="]
