"""The sample bags are what bags/README.md says."""

from __future__ import annotations

import re

import pytest
from shipped import ROOT, identified

from valve_sim.identification.fit.declared_values import out_of_tolerance
from valve_sim.recordings import list_valves

BAGS = ROOT / "bags"
ROWS = re.findall(r"^\| `([^`]+)` .* ([\d.]+) / ([\d.]+) \|$", (BAGS / "README.md").read_text(), re.MULTILINE)


def test_every_bag_has_its_row_and_all_are_small() -> None:
    bags = {path.name for path in BAGS.iterdir() if path.is_dir() or path.suffix == ".mcap"} - {"__pycache__"}
    assert {name.rstrip("/") for name, _, _ in ROWS} == bags
    assert sum(path.stat().st_size for path in BAGS.rglob("*") if path.is_file()) < 2_000_000


@pytest.mark.parametrize(("name", "pilot", "main"), ROWS, ids=[row[0] for row in ROWS])
def test_a_bag_identifies_as_what_it_was_made_with(name: str, pilot: str, main: str) -> None:
    assert list_valves(BAGS / name) == ("/valve",)
    result = identified(name.rstrip("/").removesuffix(".mcap"))
    if name == "friction/":
        assert out_of_tolerance(result.declared), "what is missing is no tolerance"
        return
    assert not out_of_tolerance(result.declared)
    for parameter, truth in (("pilot_damping", pilot), ("main_damping", main)):
        interval = result.intervals[parameter]
        assert abs(interval.value - float(truth)) < 4.0 * interval.stderr
