"""Commands that the program prints work as printed, however it was started."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from valve_sim import invocation as under_test
from valve_sim.invocation import invocation

SCRIPT = Path(sys.executable).with_name("valve-sim")
PLAIN_PATH = os.pathsep.join(folder for folder in os.environ["PATH"].split(os.pathsep) if Path(folder) != SCRIPT.parent)
needs_script = pytest.mark.skipif(not SCRIPT.is_file(), reason=f"{SCRIPT} is not here: install the package")


def typed(command: str, folder: Path, path: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PATH": path, "AMENT_PREFIX_PATH": ""}
    return subprocess.run(
        ["bash", "-c", command], cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False
    )


SITUATIONS = {
    "on PATH": ("valve-sim", Path("/usr"), f"{SCRIPT.parent}{os.pathsep}{PLAIN_PATH}", "valve-sim"),
    "by its path": ("bin/valve-sim", SCRIPT.parents[1], PLAIN_PATH, "bin/valve-sim"),
    "from elsewhere": (str(SCRIPT), Path("/usr"), PLAIN_PATH, str(SCRIPT)),
    "as a module": (f"{sys.executable} -m valve_sim", Path("/usr"), PLAIN_PATH, str(SCRIPT)),
}


@needs_script
@pytest.mark.parametrize(("command", "here", "path", "expected"), SITUATIONS.values(), ids=SITUATIONS.keys())
def test_every_printed_command_works_where_it_is_printed(command: str, here: Path, path: str, expected: str) -> None:
    refused = typed(f"{command} frobnicate", here, path)
    hint = re.search(r"\(see (.*)\)$", refused.stderr.strip())
    assert refused.returncode == 2
    assert hint is not None
    assert hint[1] == f"{expected} --help"
    helped = typed(hint[1], here, path)
    assert (helped.returncode, helped.stderr) == (0, "")
    examples = [line.strip() for line in helped.stdout.splitlines() if line.startswith("  ") and "simulate --" in line]
    assert len(examples) == 1
    assert examples[0].startswith(f"{expected} simulate ")
    assert helped.stdout.startswith(f"Usage: {expected} ")


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """No script of ours anywhere, and a PATH of one empty folder."""
    tools = tmp_path / "tools"
    tools.mkdir()
    monkeypatch.setenv("PATH", str(tools))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    monkeypatch.setattr(under_test, "_scripts", lambda program: iter(()))
    return tmp_path


def executable(file: Path) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("#!/bin/sh\n")
    file.chmod(file.stat().st_mode | stat.S_IXUSR)
    return file


def test_where_colcon_put_it_ros2_runs_it(nothing_installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    executable(nothing_installed / "tools" / "ros2")
    executable(nothing_installed / "install" / "lib" / "valve_sim" / "valve-sim")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/opt/ros/jazzy{os.pathsep}{nothing_installed / 'install'}")
    assert invocation() == "ros2 run valve_sim valve-sim"
    assert invocation("valve_node") != "ros2 run valve_sim valve_node"  # this one is not there


def test_a_program_of_the_same_name_is_not_taken_for_ours(nothing_installed: Path) -> None:
    executable(nothing_installed / "tools" / "valve-sim")
    assert invocation() != "valve-sim"


def test_without_any_script_the_module_is_run(nothing_installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(executable(nothing_installed / "with space" / "python")))
    monkeypatch.chdir(nothing_installed)
    assert invocation() == "'with space/python' -m valve_sim"
    assert invocation("valve_node") == "'with space/python' -m valve_sim.nodes valve_node"
    shutil.copy("with space/python", "tools/python")
    monkeypatch.setattr(sys, "executable", str(nothing_installed / "tools" / "python"))
    assert invocation() == "python -m valve_sim"


@needs_script
def test_make_shell_finds_every_program_of_its_environment() -> None:
    tool = Path(__file__).parents[1] / "tools" / "environment"
    programs = ("valve-sim", "valve_node", "identification_node", "monitor_node", "command_profile")
    asked = subprocess.run(
        [str(tool), "shell", str(SCRIPT.parents[1])],
        input=f"command -v {' '.join(programs)}; echo makelevel=$MAKELEVEL",
        env={**os.environ, "PATH": PLAIN_PATH, "SHELL": "/bin/bash", "MAKELEVEL": "1"},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert asked.stdout.splitlines() == [*(str(SCRIPT.with_name(name)) for name in programs), "makelevel="]


@pytest.mark.parametrize("chosen", [None, "2"])
def test_the_package_asks_for_one_thread_of_linear_algebra_unless_somebody_chose(chosen: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    if chosen is not None:
        environment["OPENBLAS_NUM_THREADS"] = chosen
    program = "import os, valve_sim; print(os.environ['OPENBLAS_NUM_THREADS'])"
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout == f"{chosen or 1}\n"
