"""What a supervisor builds on, since the nodes are plain; docs/how_to/station.md says why. Exit codes: other tests."""

from __future__ import annotations

import configparser
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nodes.ros import Bool, Float64, UInt8

from .ros_process import Diagnostics, Probe, running

pytestmark = pytest.mark.ros


ROOT = Path(__file__).parents[2]


@pytest.mark.long
def test_a_valve_that_was_killed_while_open_comes_back_closed_and_without_voltage(probe: Probe, tmp_path: Path) -> None:
    is_open = probe.hear("is_open", Bool, latched=True)
    voltage = probe.talker("coil_voltage", Float64)
    with running(tmp_path) as killed:
        assert probe.until(lambda: is_open and voltage.get_subscription_count() == 1)
        voltage.publish(Float64(data=9.0))
        assert probe.until(lambda: is_open[-1].data)
        killed.process.kill()
        assert killed.exit_code() == -signal.SIGKILL
    phases, heard = probe.hear("phase", UInt8, latched=True), Diagnostics(probe)
    with running(tmp_path):
        assert probe.until(lambda: not is_open[-1].data), (
            "the controller's publisher is still there, its command is not"
        )
        assert probe.until(lambda: heard.all("command") and phases)
        assert (heard.all("command")[-1].message, heard.values("command")["voltage (V)"]) == ("none yet", "0")
        assert {message.data for message in phases} == {0}


@pytest.fixture
def unit(tmp_path: Path) -> tuple[list[str], dict[str, str], configparser.SectionProxy]:
    """The unit of the page: its command with folders that are here, the environment that systemd gives, the service."""
    page = (ROOT / "docs" / "how_to" / "station.md").read_text(encoding="utf-8")
    (text,) = (block.partition("```")[0] for block in page.split("```ini\n")[1:])
    parser = configparser.ConfigParser(interpolation=None)
    parser.read_string(text)
    service = parser["Service"]
    program = tmp_path / "install" / "valve_sim" / "lib" / "valve_sim" / "valve_node"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m valve_sim.nodes valve_node "$@"\n')
    program.chmod(0o755)
    sourced = {"PYTHONPATH": ROOT, "ROS_DOMAIN_ID": os.environ["ROS_DOMAIN_ID"], "ROS_LOG_DIR": tmp_path}
    setup = tmp_path / "install" / "setup.bash"
    setup.write_text("".join(f"export {name}={shlex.quote(str(value))}\n" for name, value in sourced.items()))
    environment = {"PATH": os.defpath, **({"HOME": str(Path.home())} if "User" in service else {})}
    command = service["ExecStart"].replace("/opt/station", str(tmp_path)).replace("/etc/station", str(ROOT / "config"))
    return shlex.split(command), environment, service


def test_the_systemd_unit_starts_as_printed_and_stops_with_code_0(unit) -> None:
    command, environment, _ = unit
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = ""
        for line in process.stderr:
            said += line
            if "ready: " in line:
                process.send_signal(signal.SIGTERM)
        assert "/tank_1/valve" in said, said
    assert process.returncode == 0, said


def test_the_systemd_unit_does_not_start_anew_what_a_person_must_correct(unit) -> None:
    command, environment, service = unit
    command[-1] = command[-1].replace("tank_1.yaml", "no_such.yaml")
    code = subprocess.run(command, env=environment, check=False).returncode
    assert str(code) == service["RestartPreventExitStatus"]
