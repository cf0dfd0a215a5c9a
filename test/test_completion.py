"""Shell completion: what the wheel installs for bash, zsh and fish completes the commands there are."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.shell_completion import get_completion_class

from valve_sim.cli import COMPLETE_VAR, main

ROOT = Path(__file__).parents[1]
SCRIPTS = {"bash": "valve-sim", "zsh": "_valve-sim", "fish": "valve-sim.fish"}


@pytest.fixture
def path(tmp_path: Path) -> str:
    """A PATH on which valve-sim is found."""
    tool = tmp_path / "valve-sim"
    tool.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m valve_sim "$@"\n')
    tool.chmod(tool.stat().st_mode | stat.S_IXUSR)
    return os.pathsep.join([str(tmp_path), os.environ["PATH"]])


def completed(path: str, line: str) -> list[str]:
    """What bash offers at the end of a line, with the script that ships."""
    words = line.split(" ")
    script = f"""
source '{ROOT / "completions" / "valve-sim"}'
COMP_WORDS=({" ".join(f"'{word}'" for word in words)}); COMP_CWORD={len(words) - 1}
compopt() {{ :; }}
_valve_sim_completion valve-sim
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "--norc", "-c", script], env=environment, capture_output=True, text=True, timeout=300, check=True
    )
    return done.stdout.split()


def test_bash_completes_every_command_and_option(path: str) -> None:
    assert isinstance(main, click.Group)
    assert completed(path, "valve-sim ") == sorted(main.commands)
    assert completed(path, "valve-sim inf") == ["info"]
    assert {"--valve", "--params", "--json"} <= set(completed(path, "valve-sim info --"))


@pytest.mark.parametrize("shell", SCRIPTS)
def test_the_script_asks_as_the_program_answers(shell: str, path: str) -> None:
    kind = get_completion_class(shell)
    assert kind is not None
    script = (ROOT / "completions" / SCRIPTS[shell]).read_text(encoding="utf-8")
    assert f"{COMPLETE_VAR}={shell}_complete" in script
    assert (script.splitlines()[0] == "#compdef valve-sim") == (shell == "zsh")
    program = shutil.which("valve-sim", path=path)
    assert program is not None
    asked = {
        COMPLETE_VAR: f"{shell}_complete",
        "COMP_WORDS": "valve-sim ",
        "COMP_CWORD": "1" if shell != "fish" else "",
    }
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **asked}
    answer = subprocess.run([program], env=environment, capture_output=True, text=True, timeout=300, check=True)
    assert isinstance(main, click.Group)
    assert all(command in answer.stdout for command in main.commands)
