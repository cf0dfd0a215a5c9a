"""Every command of README.md and of the tutorials works as printed, from top to bottom, in one terminal."""

from __future__ import annotations

import importlib.util
import itertools
import json
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from own_domain import own_domain

from valve_sim.cli import main

pytestmark = [pytest.mark.ros, pytest.mark.long]

ROOT = Path(__file__).parents[1]
STAND_IN = Path(__file__).with_name("ros2_stand_in.py")
PATIENCE = 900.0
FOREGROUND = """
foreground() {
    : > foreground.txt
    "$@" 2> foreground.txt &
    local node=$! code=0
    until grep --quiet 'ready: ' foreground.txt || ! kill -0 $node 2> /dev/null; do sleep 0.1; done
    kill -INT $node 2> /dev/null || true
    wait $node || code=$?
    cat foreground.txt >&2
    return $code
}
"""
"""A node that is started in the foreground runs until Ctrl-C; here that comes when it is ready."""

WITH_ROS = ("README.md", "docs/tutorials/first_correction.md")
WITHOUT_ROS = ("docs/tutorials/first_diagnosis.md", "docs/tutorials/own_oscilloscope.md", "docs/sensorless.md")

NOT_HERE = {
    "make run": "test_demo.py runs what it runs",
    "make shell": "opens a shell for people",
    "make test": "is what runs this test",
    "make docs": "make test-long builds them, too",
    "rosdep install": "CI has neither rosdep nor colcon; test_packaging.py compares what would be installed",
    "python3 -m venv": "belongs to it",
    "venv/bin/": "belongs to it",
    "ros2 launch": "CI has no launch; nodes/test_station.py starts what the launch file says",
}
"""Commands that are not run, and what is in their place."""

needs_ros = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None, reason="there is no ROS 2 here: rclpy cannot be imported"
)


def console_blocks(document: str) -> Iterator[list[str]]:
    """The lines of each block of commands and what they print."""
    for found in re.finditer(r"```console\n(.*?)```", document, re.DOTALL):
        yield found.group(1).splitlines()


def commands(lines: list[str]) -> Iterator[str]:
    """What is typed at "$ ", with the lines that belong to it: after a backslash, and of a here-document."""
    rest = iter(lines)
    for line in rest:
        if not line.startswith("$ "):
            continue  # what a command prints
        typed = [line[2:]]
        while typed[-1].endswith("\\"):
            typed.append(next(rest))
        ending = re.search(r"<<(\w+)$", typed[-1])
        while ending and typed[-1] != ending[1]:
            typed.append(next(rest))
        yield "\n".join(typed)


def script(document: str) -> str:
    """The commands as a script that ends at the first one that fails."""
    lines = ["set -euo pipefail", "set -m", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT", FOREGROUND]
    for block in console_blocks(document):
        for command in commands(block):
            if any(command.startswith(words) for words in NOT_HERE):
                continue
            lines += [f"echo {_quoted('$ ' + command)}", _ending(command)]
    return "\n".join(lines) + "\n"


def _ending(command: str) -> str:
    """A node in the foreground gets its Ctrl-C, but for the one that ends when it is done."""
    ends_alone = any(f" {name} " in command for name in ("valve-sim", "identification_node"))
    if command.startswith("ros2 run") and not ends_alone and not command.endswith("&"):
        return f"foreground {command}"
    return command


def _quoted(words: str) -> str:
    return "'" + words.replace("'", "'\\''") + "'"


@pytest.fixture
def terminal(tmp_path: Path) -> tuple[Path, dict[str, str]]:
    """A folder to work in, with what a checkout has, and an environment in which the commands are found."""
    tools = tmp_path / "bin"
    tools.mkdir()
    for name, words in {"valve-sim": "-m valve_sim", "ros2": str(STAND_IN), "python3": ""}.items():
        tool = tools / name
        tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
        tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    folder = tmp_path / "work"
    folder.mkdir()
    for name in ("bags", "config"):
        shutil.copytree(ROOT / name, folder / name)
    environment = {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", "")))),
        "ROS_DOMAIN_ID": str(own_domain()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }
    return folder, environment


def run_page(name: str, terminal: tuple[Path, dict[str, str]]) -> tuple[Path, str]:
    """Types the commands of a page; returns the folder that they were typed in, and what was printed."""
    folder, environment = terminal
    text = script((ROOT / name).read_text(encoding="utf-8"))
    ran = subprocess.run(
        ["bash", "-c", text], cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    told = f"{ran.stdout}\n{ran.stderr}"
    assert ran.returncode == 0, told
    assert "Traceback" not in told, told
    return folder, told


def assert_named(report: dict[str, Any], effect: str, **values: float) -> None:
    """A report names an effect, and the values are those that were simulated, within four standard errors."""
    assert report["verdict"]["kind"] == "effects"
    assert report["verdict"]["effects"] == [effect]
    for name, value in values.items():
        found = report["after"]["effects"][effect][name]
        assert abs(found["value"] - value) < 4.0 * found["stderr"]


def report_in(folder: Path) -> dict[str, Any]:
    """The report that `diagnose --output` left in a folder."""
    report: dict[str, Any] = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return report


@needs_ros
@pytest.mark.parametrize("name", WITH_ROS)
def test_the_commands_work_as_printed(name: str, terminal: tuple[Path, dict[str, str]]) -> None:
    folder, told = run_page(name, terminal)
    assert_named(report_in(folder / "results"), "coulomb_friction", force=0.15)
    if name == "README.md":
        results = sorted(path.name for path in (folder / "results").glob("*.yaml"))
        assert results == ["corrected.yaml", "identified.yaml", "record_next.yaml"], told
    if name == "docs/tutorials/first_correction.md":
        page = (ROOT / "docs" / "reference" / "report_json.md").read_text(encoding="utf-8")
        assert_described(report_in(folder / "results"), page)
        assert "pressure_force" in (folder / "worn" / "corrected.yaml").read_text(encoding="utf-8")


def test_the_first_tutorial_says_what_happens(terminal: tuple[Path, dict[str, str]]) -> None:
    folder, told = run_page("docs/tutorials/first_diagnosis.md", terminal)
    assert_named(report_in(folder / "results"), "coulomb_friction", force=0.15)
    assert_named(report_in(folder / "bouncing"), "stop_bounce", restitution_stop=0.3, restitution_seat=0.2)
    fitted = json.loads((folder / "results" / "identify.json").read_text(encoding="utf-8"))
    assert fitted["parameters"]["pilot_damping"]["value"] == pytest.approx(8.0, abs=0.1)
    assert fitted["rmse_um"]["after"] == pytest.approx(1.18, abs=0.01)
    assert "noise 1.03 µm" in told
    assert told.index("\npassed\n") < told.index("\nFAILED\n") < told.index("exit code 1")


def test_the_tutorial_of_an_own_valve_says_what_happens(terminal: tuple[Path, dict[str, str]]) -> None:
    folder, told = run_page("docs/tutorials/own_oscilloscope.md", terminal)
    assert_named(report_in(folder / "results"), "coulomb_friction", force=0.3)
    fitted = json.loads((folder / "results" / "identify.json").read_text(encoding="utf-8"))
    assert fitted["parameters"]["pilot_damping"]["value"] == pytest.approx(6.9, abs=0.1)
    assert fitted["rmse_um"]["after"] == pytest.approx(1.8, abs=0.05)
    for words in ("voltage: {column: CH1, unit: V}", "scale: 10, say", "8 steps of the measured voltage", "\npassed\n"):
        assert words in told
    page = (ROOT / "docs" / "tutorials" / "own_oscilloscope.md").read_text(encoding="utf-8")
    (said,), (found,) = re.findall(r"tolerance is\s+([\d.]+) µm", page), re.findall(r": within ([\d.]+) µm", told)
    assert float(said) == round(float(found), 1)


def test_the_page_of_the_current_alone_works_as_printed(terminal: tuple[Path, dict[str, str]]) -> None:
    folder, told = run_page("docs/sensorless.md", terminal)
    assert report_in(folder / "results")["verdict"]["kind"] in ("none", "insufficient")
    assert "\npassed\n" in told


EXTRAS = {"fleet": "distributed", "export-fmu": "pythonfmu"}
"""What the examples of some commands need beyond the package: a module to look for."""


# An archive, which history prints, is written by archive_node alone.
@pytest.mark.parametrize("command", sorted(main.commands.keys() - {"history"}))
def test_the_first_example_of_each_help_works_as_printed(command: str, terminal: tuple[Path, dict[str, str]]) -> None:
    if command in EXTRAS:
        pytest.importorskip(EXTRAS[command])
    output = CliRunner().invoke(main, [command, "--help"]).output
    example = next(part for part in output.split("\n\n") if part.startswith("    "))
    folder, environment = terminal
    ran = subprocess.run(
        ["bash", "-euc", example],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, f"{example}\n{ran.stdout}\n{ran.stderr}"


def assert_described(report: dict[str, Any], page: str) -> None:
    """The page of report.json names the keys that a report has, in their order."""
    parts = [part for part in page.split("\n## ") if not part.startswith("The report of identify")]
    top, state, verdict, _, recording = (re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE) for part in parts)
    assert sorted(top) == sorted(report)
    assert sorted(state) == sorted(report["after"])
    assert sorted(verdict) == sorted(report["verdict"])
    for entry in itertools.chain.from_iterable(report["recording"].values()):
        assert {key for key in entry if f"`{key}`" not in page.rsplit("\n## ", maxsplit=1)[-1]} == set()
    assert recording[0] == "error"
    for candidate in report["candidates"]:
        assert "| `candidates` | " + ", ".join(f"`{key}`" for key in candidate) + " |" in page


def test_nothing_is_left_out_that_the_documents_do_not_have() -> None:
    every = [
        command
        for name in (*WITH_ROS, *WITHOUT_ROS)
        for block in console_blocks((ROOT / name).read_text(encoding="utf-8"))
        for command in commands(block)
    ]
    assert len(every) > 20
    for words in NOT_HERE:
        assert any(command.startswith(words) for command in every), f"{words} is in no document"
