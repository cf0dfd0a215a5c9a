"""Every command of README.md and of the first tutorial works as printed, from top to bottom, in one terminal."""

from __future__ import annotations

import importlib.util
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
from own_domain import own_domain

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

NOT_HERE = {
    "make run": "test_demo.py runs what it runs",
    "make shell": "test_invocation.py types into one",
    "make test": "is what runs this test",
    "make docs": "make test builds them, too",
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
    """What is typed at "$ ", with what follows it at "> "."""
    typed: list[str] = []
    for line in [*lines, "$ "]:
        if line.startswith("$ ") and typed:
            yield "\n".join(typed)
            typed = []
        if line.startswith("$ "):
            typed = [line[2:]]
        elif line.startswith("> "):
            typed.append(line[2:])


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


@needs_ros
@pytest.mark.parametrize("name", ["README.md", "docs/tutorials/first_correction.md"])
def test_the_commands_work_as_printed(name: str, terminal: tuple[Path, dict[str, str]]) -> None:
    folder, environment = terminal
    text = script((ROOT / name).read_text(encoding="utf-8"))
    ran = subprocess.run(
        ["bash", "-c", text], cwd=folder, env=environment, capture_output=True, text=True, timeout=PATIENCE, check=False
    )
    told = f"{ran.stdout}\n{ran.stderr}"
    assert ran.returncode == 0, told
    assert "Traceback" not in told, told
    if name == "README.md":
        results = sorted(path.name for path in (folder / "results").glob("*.yaml"))
        assert results == ["corrected.yaml", "identified.yaml"], told
    if name == "docs/tutorials/first_correction.md":
        report = json.loads((folder / "results" / "report.json").read_text(encoding="utf-8"))
        assert report["verdict"]["effects"] == ["coulomb_friction"]
        assert_described(report, (ROOT / "docs" / "reference" / "report_json.md").read_text(encoding="utf-8"))
        assert "pressure_force" in (folder / "worn" / "corrected.yaml").read_text(encoding="utf-8")


def assert_described(report: dict[str, Any], page: str) -> None:
    """The page of report.json names the keys that a report has, in their order."""
    tables = [re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE) for part in page.split("\n## ")]
    top, state, verdict, _ = tables
    assert sorted(top) == sorted(report)
    assert sorted(state) == sorted(report["after"])
    assert sorted(verdict) == sorted(report["verdict"])
    for candidate in report["candidates"]:
        assert "| `candidates` | " + ", ".join(f"`{key}`" for key in candidate) + " |" in page


def test_nothing_is_left_out_that_the_documents_do_not_have() -> None:
    every = [
        command
        for name in ("README.md", "docs/tutorials/first_correction.md")
        for block in console_blocks((ROOT / name).read_text(encoding="utf-8"))
        for command in commands(block)
    ]
    assert len(every) > 20
    for words in NOT_HERE:
        assert any(command.startswith(words) for command in every), f"{words} is in no document"
