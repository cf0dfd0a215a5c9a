"""`--help` of each node: what it does, a command that can be copied, and a page that exists. Needs no ROS."""

import re
from pathlib import Path

import pytest

from valve_sim.nodes import __main__ as nodes
from valve_sim.nodes.starting import Program
from valve_sim.station import __main__ as station

PROGRAMS = (
    nodes.valve_node,
    nodes.identification_node,
    nodes.monitor_node,
    nodes.command_profile,
    station.opcua_node,
    station.plc_node,
    station.archive_node,
)


@pytest.fixture(params=PROGRAMS, ids=lambda program: program.name)
def program(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Program:
    """A node's program, called as where its name is found."""
    monkeypatch.setattr("valve_sim.nodes.starting.invocation", lambda name: name)
    found: Program = request.param
    return found


@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_teaches_and_starts_nothing(program: Program, flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    name = program.name
    assert program([name, flag]) == 0
    output = capsys.readouterr().out
    assert output.startswith(f"{name} ")
    assert re.search(rf"^    {name} ?", output, re.MULTILINE)
    assert [line for line in output.splitlines() if len(line) > 80] == []
    pages = re.findall(r"docs/\S+\.md", output)
    assert pages
    assert all((Path(__file__).parents[2] / page).is_file() for page in pages)


def test_help_names_the_program_as_it_is_called_here(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("valve_sim.nodes.starting.invocation", lambda name: f"ros2 run valve_sim {name}")
    nodes.valve_node(["valve_node", "--help"])
    output = capsys.readouterr().out
    assert "\n    ros2 run valve_sim valve_node\n" in output
    assert "\n    ros2 run valve_sim valve_node --ros-args " in output
