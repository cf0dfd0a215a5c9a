"""The reference pages of the station are what its tables say."""

from __future__ import annotations

from pathlib import Path

from valve_sim.station.pages import pages

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"


def test_the_pages_are_up_to_date() -> None:
    committed = {name: (REFERENCE / name).read_text(encoding="utf-8") for name in pages()}
    assert committed == pages(), "run: python -m valve_sim.station.pages docs/reference"
