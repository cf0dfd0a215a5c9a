"""`valve-sim simulate` of a valve with gas: the columns of the table, and the picture."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from valve_sim.cli import main
from valve_sim.files.resources import config_path


def simulate(folder: Path, params: Path, *options: str) -> tuple[int, str, Path]:
    table = folder / "opening.csv"
    arguments = ["simulate", "--params", str(params), "--duration", "0.6", "--rate", "1000", "--output", str(table)]
    result = CliRunner().invoke(main, [*arguments, "--voltage", "9", *options])
    return result.exit_code, result.output, table


def test_the_table_shows_pressure_and_flow(tmp_path: Path) -> None:
    picture = tmp_path / "opening.png"
    code, output, table = simulate(tmp_path, config_path("hydrogen_70mpa.yaml"), "--plot", str(picture))
    assert code == 0, output
    assert picture.stat().st_size > 10_000
    with table.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0])[-2:] == ["outlet_pressure", "mass_flow"]
    time, pressure, flow, phase = (
        np.array([float(row[name]) for row in rows]) for name in ("time", "outlet_pressure", "mass_flow", "phase")
    )
    assert time[phase == 4][0] == pytest.approx(0.491, abs=2e-3)
    assert pressure[0] == pytest.approx(1e5, rel=1e-12)
    assert flow[0] == 0.0
    assert pressure[-1] == pytest.approx(70e6, rel=1e-6)
    assert flow.max() > 5e-4 and abs(flow[-1]) < 1e-6
