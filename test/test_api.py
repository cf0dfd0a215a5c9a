"""The Python front door: what a script or a notebook gets from `import valve_sim as vs`."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shipped import ROOT, diagnosed, identified, recording

import valve_sim as vs
from valve_sim.model import ValveError
from valve_sim.recordings import Trace

DRIVE = vs.Drive.of([0.01, 0.04], [9.0, 0.0])


@pytest.fixture(scope="module")
def trace() -> Trace:
    return recording("one_opening")


def test_every_public_name_is_there_and_completed() -> None:
    assert set(vs.__all__) == set(dir(vs))
    assert all(getattr(vs, name) for name in vs.__all__)
    with pytest.raises(AttributeError, match="no attribute 'simulates'"):
        vs.simulates  # noqa: B018


@pytest.mark.parametrize("chosen", [None, "2"])
def test_the_import_alone_loads_nothing_heavy_and_asks_for_one_thread_unless_somebody_chose(chosen: str | None) -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    if chosen is not None:
        environment["OPENBLAS_NUM_THREADS"] = chosen
    program = (
        "import os, sys, valve_sim; print(sorted({'numba', 'scipy', 'numpy', 'matplotlib'} & set(sys.modules)), "
        "os.environ['OPENBLAS_NUM_THREADS'])"
    )
    ran = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout == f"[] {chosen or 1}\n"


def test_a_diagnosis_takes_one_thread_also_where_numpy_was_loaded_before() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    program = """
import numpy, sys, threadpoolctl, valve_sim as vs
def threads():
    return [own["num_threads"] for own in threadpoolctl.threadpool_info() if own["user_api"] == "blas"]
before, seen = threads(), set()
vs.diagnose(sys.argv[1], budget=vs.Budget(100.0), progress=lambda what, done: seen.update(threads()))
print(seen, max(threads()) == max(before))
"""
    command = [sys.executable, "-c", program, str(ROOT / "bags" / "one_opening.mcap")]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert ran.stdout == "{1} True\n", ran.stderr


def test_a_simulation_is_a_table_a_picture_and_a_line() -> None:
    times = np.arange(0.0, 0.06, 5e-5)
    run = vs.simulate(vs.default_valve(), DRIVE, times)
    table = run.table()
    column = (
        table["pilot_position"].to_numpy() if hasattr(table, "columns") else [row["pilot_position"] for row in table]
    )
    np.testing.assert_array_equal(column, run.pilot_position)
    assert run.plot()._repr_png_().startswith(b"\x89PNG")
    assert "t2 19.90 ms" in repr(run)
    assert run._repr_html_().count("<tr>") == 1 + len(run.events)
    closed = vs.simulate(vs.default_valve(), vs.Drive.of([0.0], [0.0]), np.arange(0.0, 0.01, 1e-4))
    assert "not reached" in repr(closed) and closed.table_of_events() == []


def test_the_residual_is_that_which_identify_reports() -> None:
    found = identified("friction")
    left = found.residual()
    assert left.unit == "m"
    assert left.rms == pytest.approx(found.rmse_after, rel=1e-9)
    assert left.sigma == pytest.approx(1e-6, rel=0.1)
    table = found.table()
    rows = table.to_dict("records") if hasattr(table, "columns") else table
    assert [row["parameter"] for row in rows] == ["pilot_damping", "main_damping"]
    assert all(row["low"] < row["value"] < row["high"] for row in rows)
    assert "pilot_damping" in str(found)
    assert "pilot_damping" in found._repr_html_()
    assert found.plot()._repr_png_().startswith(b"\x89PNG")


@pytest.mark.long
def test_a_diagnosis_is_what_the_command_line_says(tmp_path: Path) -> None:
    found = diagnosed("friction")
    assert found.verdict.effects == ("coulomb_friction",)
    assert found.residual().rms == pytest.approx(found.after.train_rmse, rel=0.01)
    assert found.residual().rms < found.residual(before=True).rms
    table = found.table()
    rows = table.to_dict("records") if hasattr(table, "columns") else table
    assert rows[0]["effects"] == "coulomb_friction"
    assert "Coulomb friction" in str(found)
    assert "Coulomb friction" in found._repr_html_()
    assert found.plot()._repr_png_().startswith(b"\x89PNG")
    written = {path.name for path in found.write(tmp_path)}
    assert {"report.json", "report.html", "corrected.yaml"} <= written
    assert vs.load_valve(tmp_path / "corrected.yaml").effects.keys() == {"coulomb_friction"}


def test_another_valve_is_a_warning_and_another_unit_an_error(trace: Trace) -> None:
    small = vs.default_valve().with_values(stroke=2.5e-3)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        vs.identify(trace, small)
    assert any("another valve" in str(words.message) for words in said)
    in_mm = replace(trace, pilot_position=1e3 * trace.pilot_position)
    with pytest.raises(ValveError, match="unit"):
        vs.identify(in_mm)


def test_a_path_is_read_as_read_reads_it(tmp_path: Path, trace: Trace) -> None:
    path = ROOT / "bags" / "one_opening.mcap"
    found = vs.identify(str(path))
    assert found.intervals == vs.identify([trace]).intervals
    assert vs.validate([path], found.valve).passed
    assert not vs.validate(path, found.valve, tolerance=1e-9).passed
    assert "one_opening" in str(vs.validate(path, found.valve))
    with pytest.raises(ValveError, match=r"nowhere\.mcap: does not exist; give a rosbag2 folder"):
        vs.diagnose(tmp_path / "nowhere.mcap")
    np.savetxt(
        tmp_path / "log.csv", np.tri(9, 3, -1).cumsum(axis=0), delimiter=",", header="time,power,reading", comments=""
    )
    for call in (vs.identify, vs.diagnose, vs.validate):
        with pytest.raises(ValveError, match=r"log\.csv: is not read as a valve's; read it with a map"):
            call(str(tmp_path / "log.csv"))
        with pytest.raises(ValveError, match=r"recordings: found int, expected one from vs\.read, or its path"):
            call([path, 3])  # type: ignore[list-item]
        with pytest.raises(ValveError, match=r"machine: found str, expected a valve from vs\.load_valve"):
            call(path, "valve.yaml")  # type: ignore[arg-type]


OVEN = """
plant: equations
states: {warmth: {unit: K, start: 0}}
inputs: {power: {unit: W, between: held}}
parameters:
  capacity: {value: 60.0, unit: J/K, free: true, range: [1, 1000]}
  loss: {value: 0.5, unit: W/K, free: true, range: [0, 10]}
derivatives: {warmth: (power - loss*warmth)/capacity}
outputs: {reading: {value: warmth, unit: K, noise: 0.05}}
effects:
  radiation:
    add: {warmth: -coefficient*warmth**2/capacity}
    parameters: {coefficient: {unit: W/K^2, neutral: 0, scale: 0.01}}
"""


def test_another_machine_is_read_refitted_and_diagnosed_by_the_same_calls(tmp_path: Path) -> None:
    (tmp_path / "oven.yaml").write_text(OVEN)
    times, rng = np.arange(0.0, 600.0, 2.0), np.random.default_rng(3)
    power, warmth, seen = np.where(times % 200.0 < 120.0, 40.0, 5.0), 0.0, []
    for watts in power:
        seen.append(warmth)
        for _ in range(200):
            warmth += 0.01 * (watts - 0.4 * warmth - 0.004 * warmth**2) / 55.0
    log = np.c_[times, power, np.array(seen) + rng.normal(0.0, 0.05, len(times))]
    np.savetxt(tmp_path / "log.csv", log, delimiter=",", header="time,power,reading", comments="")
    oven, recording = vs.load_plant(tmp_path / "oven.yaml"), vs.read(tmp_path / "log.csv")
    assert not isinstance(recording, Trace)
    refitted = vs.identify(recording, oven)
    assert set(refitted.intervals) == {"capacity", "loss"}
    assert "capacity" in str(refitted)
    assert refitted.residual().unit == "K"
    assert vs.identify(tmp_path / "log.csv", oven).intervals == refitted.intervals
    assert not vs.validate(str(tmp_path / "log.csv"), oven).passed
    found = vs.diagnose(recording, oven)
    assert found.verdict.effects == ("radiation",)
    assert abs(found.after.intervals["loss"].value - 0.4) < 4.0 * found.after.intervals["loss"].stderr
    assert found.residual().rms == pytest.approx(0.05, rel=0.15)
    written = {path.name for path in found.write(tmp_path / "results")}
    assert written == {"report.json", "report.html", "corrected.yaml"}


def test_a_recording_of_the_other_kind_of_machine_is_refused_in_one_line(tmp_path: Path, trace: Trace) -> None:
    (tmp_path / "oven.yaml").write_text(OVEN)
    np.savetxt(
        tmp_path / "log.csv", np.tri(9, 3, -1).cumsum(axis=0), delimiter=",", header="time,power,reading", comments=""
    )
    with pytest.raises(ValveError, match=r"was read as a valve's; read it with vs\.read"):
        vs.diagnose(trace, vs.load_plant(tmp_path / "oven.yaml"))
    with pytest.raises(ValveError, match="is not read as a valve's; read it with a map, or give its machine"):
        vs.identify(vs.read(tmp_path / "log.csv"))


def test_a_map_says_whose_recording_it_is(tmp_path: Path) -> None:
    np.savetxt(
        tmp_path / "log.csv", np.c_[np.arange(50.0), np.ones((50, 2))], delimiter=",", header="t,a,b", comments=""
    )
    of_machine = {"time": {"column": "t"}, "torque": {"column": "a"}, "angle": {"column": "b"}}
    assert set(vs.read(tmp_path / "log.csv", of_machine).columns) == {"torque", "angle"}
    of_valve = {"time": {"column": "t"}, "command": {"column": "a"}, "current": {"column": "b"}}
    assert isinstance(vs.read(tmp_path / "log.csv", of_valve), Trace)
