"""A delay of an input, or of a sensor: found, measured, written into the corrected file, and simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from valve_sim.cli import main
from valve_sim.files.plant_entries import PlantFileError
from valve_sim.files.plant_files import load_plant, plant_from
from valve_sim.identification.diagnosis.identify import identify_plant
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.own_simulation import simulate_plant
from valve_sim.recordings.columns import Columns, read

PLANT = """
plant: equations
states: {speed: {unit: rad/s, start: 0}}
inputs: {voltage: {unit: V, between: held}}
parameters:
  gain: {value: 9, unit: rad/(s*V), free: true, range: [0, 100]}
  tau: {value: 50, unit: ms, free: true, range: [1, 1000]}
derivatives: {speed: (gain*voltage - speed)/tau}
outputs: {shown: {value: speed, unit: rad/s, noise: 0.2}}
effects:
  late_drive: {delay: {voltage: lag}, parameters: {lag: {unit: ms, neutral: 0, scale: 5, range: [0, 100]}}}
  offset: {add: {speed: by/tau}, parameters: {by: {unit: rad/s, neutral: 0, scale: 1}}}
  drag: {add: {speed: -c*speed*abs(speed)}, parameters: {c: {unit: 1/rad, neutral: 0, scale: 0.01}}}
"""
GAIN, TAU, LAG = 10.0, 0.04, 0.0073


def recorded(folder: Path) -> Path:
    """A motor that obeys 7.3 ms late, by the closed form of a first-order lag between steps of its voltage."""
    random = np.random.default_rng(4)
    times = np.arange(0.0, 3.0, 2e-3)
    edges = np.arange(0.0, 3.0, 0.12)
    levels = random.uniform(-12.0, 12.0, len(edges))
    levels[0] = 0.0
    voltage = levels[np.searchsorted(edges, times + 1e-9) - 1]
    speed, begins = np.zeros(len(times)), 0.0
    for start, stop, level in zip(edges + LAG, [*(edges[1:] + LAG), np.inf], levels, strict=True):
        own = (times >= start) & (times < stop)
        speed[own] = GAIN * level + (begins - GAIN * level) * np.exp(-(times[own] - start) / TAU)
        begins = GAIN * level + (begins - GAIN * level) * np.exp(-(stop - start) / TAU)
    table = np.column_stack([times, voltage, speed + random.normal(0.0, 0.2, len(times))])
    np.savetxt(folder / "log.csv", table, delimiter=",", header="time,voltage,shown", comments="")
    (folder / "plant.yaml").write_text(PLANT)
    return folder / "log.csv"


def columns(path: Path) -> Columns:
    return read(path, {"time": "time", "voltage": {"column": "voltage"}, "shown": {"column": "shown"}})


def test_a_late_drive_is_named_and_the_corrected_file_has_it(tmp_path: Path) -> None:
    log = str(recorded(tmp_path))
    given = ["--plant", str(tmp_path / "plant.yaml"), "--output", str(tmp_path / "out")]
    found = CliRunner().invoke(main, ["diagnose", log, *given], catch_exceptions=False)
    assert found.stdout.startswith("effects: The model lacks late drive"), found.output
    corrected = yaml.safe_load((tmp_path / "out" / "corrected.yaml").read_text())
    assert corrected["inputs"]["voltage"]["delay"] == pytest.approx(LAG, abs=2e-4)
    assert corrected["parameters"]["tau"]["value"] == pytest.approx(1e3 * TAU, rel=0.02)
    checked = CliRunner().invoke(main, ["validate", log, "--plant", str(tmp_path / "out" / "corrected.yaml")])
    assert checked.exit_code == 0, checked.output
    as_declared = CliRunner().invoke(main, ["validate", log, "--plant", str(tmp_path / "plant.yaml")])
    assert as_declared.exit_code == 1


def test_a_sensor_that_is_late_shows_the_same_as_a_drive_that_is(tmp_path: Path) -> None:
    recording = columns(recorded(tmp_path))
    text = PLANT.replace("delay: {voltage: lag}", "delay: {shown: lag}")
    (tmp_path / "sensor.yaml").write_text(text)
    by_drive, by_sensor = (
        identify_plant(OwnPlant(load_plant(tmp_path / name), [recording]), ("gain", "tau", "late_drive.lag")).intervals
        for name in ("plant.yaml", "sensor.yaml")
    )
    for name, own in by_drive.items():
        assert by_sensor[name].value == pytest.approx(own.value, abs=0.1 * own.stderr)
    assert abs(by_drive["late_drive.lag"].value - LAG) < 3.0 * by_drive["late_drive.lag"].stderr
    assert by_drive["late_drive.lag"].stderr < 2e-4


def test_a_declared_delay_is_simulated(tmp_path: Path) -> None:
    recording = columns(recorded(tmp_path))
    content = yaml.safe_load(PLANT)
    content["parameters"] = {"gain": {"value": GAIN, "unit": "rad/(s*V)"}, "tau": {"value": TAU, "unit": "s"}}
    content["inputs"]["voltage"]["delay"] = LAG
    shown = simulate_plant(plant_from(content, "own.yaml"), recording).columns
    left = shown["shown"] - recording["shown"].readings
    assert np.std(left) == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("{voltage: lag}", "{current: lag}", r"late_drive.delay.current: is no input and no output"),
        ("{voltage: lag}", "{voltage: late}", r"late_drive.delay.voltage: found 'late'; "),
        ("{voltage: lag}", "7", r"late_drive.delay: found 7, expected an input or output and a parameter"),
        ("unit: ms, neutral: 0, scale: 5", "unit: V, neutral: 0, scale: 5", r"delay.voltage: is in .*, expected s"),
        ("scale: 5, range: [0, 100]", "scale: 5", r"lag needs neutral: 0 and a range from 0 on"),
        ("between: held}", "between: held, delay: -1}", r"inputs.voltage.delay: found -1, expected seconds from 0 on"),
        ("unit: rad/s, noise: 0.2", "unit: degC", r"outputs.shown.unit: found degC; temperatures of a plant are in K"),
    ],
)
def test_a_slip_is_one_line(old: str, new: str, words: str) -> None:
    assert old in PLANT
    with pytest.raises(PlantFileError, match=words):
        plant_from(yaml.safe_load(PLANT.replace(old, new)), "own.yaml")
