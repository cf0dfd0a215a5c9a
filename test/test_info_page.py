"""The page on the output of `valve-sim info` shows what the command prints, and explains every line of it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from valve_sim.cli import main

ROOT = Path(__file__).parents[1]


def test_the_page_shows_what_is_printed_and_explains_all_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    page = (ROOT / "docs" / "reference" / "info.md").read_text(encoding="utf-8")
    printed = CliRunner().invoke(main, ["info", "bags/friction"]).output
    assert printed.startswith(page.split("$ valve-sim info bags/friction\n")[1].split("```")[0])
    arrivals = set(re.findall(r"^ {4}(\w[\w ]+?) \(", printed, re.MULTILINE))
    kinds = set(re.findall(r"^ {2}(\w+) at \d", printed, re.MULTILINE))
    assert len(arrivals) == 4 and len(kinds) == 2
    assert [words for words in arrivals | kinds if f"| `{words}` |" not in page] == []
    (valve,) = json.loads(CliRunner().invoke(main, ["info", "bags/friction", "--json"]).output)["valves"]
    assert set(valve) - set(re.findall(r"`(\w+)`", page)) <= {"epoch_ns", "input", "primary_signal"}
