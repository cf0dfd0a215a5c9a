"""Bags of small fleets, recorded from the independent plant, and what the command line makes of them."""

from __future__ import annotations

from collections.abc import Set
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, record, train_bags, write_bag

from valve_sim.fleet import run as fleet_run
from valve_sim.fleet.units import EXAMINED, Unit
from valve_sim.fleet.work import Examined

DAY_NS = 86_400_000_000_000
FINE = Recorder(quantisation=0.1e-6, sample_rate=10e3)


def make_bag(folder: Path, day: float = 0.0, valve: str = "/valve", seed: int = 1, **friction: float) -> Path:
    """A new bag of two strokes; `force` adds Coulomb friction, N."""
    plant = DeclaredPlant({"coulomb_friction": friction} if friction else {}, dict(CAMPAIGN_VALVE))
    made = record(plant, train_bags(4)[seed % 4], FINE, seed)
    return write_bag(made, folder, valve, BAG_START_NS + round(day * DAY_NS))


def counted(monkeypatch: pytest.MonkeyPatch, fails: bool = False) -> list[str]:
    """Names of the bags whose valves are examined from now on, which finds nothing, or fails by no fault of theirs."""
    asked: list[str] = []

    def instead(unit: Unit, output: Path) -> Examined:
        asked.append(Path(unit.bag.source).name)
        if fails:
            raise OSError("gone")
        values = {"verdict": "none", "effects": [], "out_of_tolerance": [], "start_time": 1, "summary": ""}
        return Examined(unit.row(EXAMINED, **values), {})

    monkeypatch.setattr(fleet_run, "examine", instead)
    return asked


def assert_rows_agree(here: Path, there: Path, passing: Set[str]) -> None:
    """The tables of two runs are the same but for some columns; of sums, the last bits depend on where arrays lie."""
    tables = [pq.read_table(folder / "fleet.parquet").drop_columns(sorted(passing)) for folder in (here, there)]
    assert tables[0].schema.equals(tables[1].schema)
    for one, other in zip(*(table.to_pylist() for table in tables), strict=True):
        assert {name: _to_nine_digits(value) for name, value in one.items()} == other


def _to_nine_digits(value: Any) -> Any:
    return pytest.approx(value, rel=1e-9, nan_ok=True) if isinstance(value, float) else value
