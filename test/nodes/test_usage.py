"""`--help` of each node: what it does, a command that can be copied, and a page that exists. Needs no ROS."""

import re
from pathlib import Path

import pytest

from valve_sim.nodes import __main__ as nodes
from valve_sim.nodes.starting import Program
from valve_sim.station import __main__ as station

PROGRAMS = [found for module in (nodes, station) for found in vars(module).values() if isinstance(found, Program)]


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_help_teaches_and_starts_nothing(program: Program, capsys: pytest.CaptureFixture[str]) -> None:
    assert program([program.name, "--help"]) == 0
    output = capsys.readouterr().out
    assert output.startswith(f"{program.name} ")
    assert re.search(rf"^    {program.name} ?", output, re.MULTILINE)
    pages = re.findall(r"docs/\S+\.md", output)
    assert pages
    assert all((Path(__file__).parents[2] / page).is_file() for page in pages)
