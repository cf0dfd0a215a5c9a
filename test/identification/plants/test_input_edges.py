"""Jumps of a sampled input lie between two readings: truth is the closed form of a coil that is switched anywhere."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from valve_sim.files.plant_files import load_plant
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.plants.input_edges import Edge, edges_of, with_edges, without_noise
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.model.core.own.simulation import Inputs
from valve_sim.recordings.columns import read

Array = NDArray[np.float64]

RESISTANCE, INDUCTANCE, BEGINS = 8.05, 29.7e-3, 0.01
SWITCHED = BEGINS + np.arange(8) * 0.04 + np.array([0.3, 1.7, 0.9, 0.1, 1.2, 0.6, 1.9, 1.4]) * 1e-4
VOLTS = (12.0, 0.0, 14.0, 0.0, 18.0, 0.0, 24.0, 0.0)
COIL = """
plant: equations
states: {{i: {{unit: A, start: 0}}}}
inputs: {{voltage: {{unit: V, between: {between}}}}}
parameters:
  resistance: {{value: 8, unit: Ohm, free: true, range: [0, 100]}}
  inductance: {{value: 30, unit: mH, free: true, range: [1, 1000]}}
derivatives: {{i: (voltage - resistance*i)/inductance}}
outputs: {{current: {{value: i, unit: A}}}}
effects:
  shunt: {{add: {{current: g*voltage}}, parameters: {{g: {{unit: 1/Ohm, neutral: 0, scale: 1.0e-3}}}}}}
  offset: {{add: {{i: u/inductance}}, parameters: {{u: {{unit: V, neutral: 0, scale: 0.1}}}}}}
"""


def current(times: Array) -> Array:
    """(n,) A, through a coil that is switched at SWITCHED."""
    found, tau = np.zeros_like(times), INDUCTANCE / RESISTANCE
    here, since = 0.0, 0.0
    for volts, begin, end in zip((0.0, *VOLTS), (0.0, *SWITCHED), (*SWITCHED, math.inf), strict=True):
        level, own = volts / RESISTANCE, (times >= begin) & (times < end)
        found[own] = level + (here - level) * np.exp(-(times[own] - begin) / tau)
        here, since = level + (here - level) * math.exp(-(end - begin) / tau), begin
    assert since == SWITCHED[-1]
    return found


def recorded(folder: Path, between: str, noise: float) -> OwnPlant:
    """What a logger at 5 kHz has of it, in a table; noise: of the measured voltage, V."""
    times, random = np.arange(0.0, 0.34, 2e-4), np.random.default_rng(4)
    volts = np.concatenate([[0.0], VOLTS])[np.searchsorted(SWITCHED, times, side="right")]
    volts += noise * random.standard_normal(len(times))
    rows = np.column_stack([times, volts, current(times) + 1e-3 * random.standard_normal(len(times))])
    np.savetxt(folder / "log.csv", rows, delimiter=",", header="t,u,i", comments="", fmt="%.9g")
    (folder / "coil.yaml").write_text(COIL.format(between=between))
    columns: dict[str, Any] = {"time": {"column": "t", "unit": "s"}, "voltage": {"column": "u", "unit": "V"}}
    columns["current"] = {"column": "i", "unit": "A"}
    return OwnPlant(load_plant(folder / "coil.yaml"), [read(folder / "log.csv", columns)])


@pytest.mark.parametrize(("between", "noise"), [("held", 0.0), ("straight", 0.0), ("straight", 0.1)])
def test_a_coil_that_is_switched_between_two_samples_lacks_nothing(between: str, noise: float, tmp_path: Path) -> None:
    """Beside noise of the voltage the levels at which it rests are known to some millivolts only."""
    found = diagnose_plant(recorded(tmp_path, between, noise), None)
    assert found.verdict.kind == "none"
    result = found.before.fit
    for name, truth in (("resistance", RESISTANCE), ("inductance", INDUCTANCE)):
        error = math.sqrt(float(result.covariance[result.names.index(name), result.names.index(name)]))
        assert abs(result.values[name] - truth) < 4.0 * error < 0.05 * truth
    plant = recorded(tmp_path, between, noise)
    nominal = {own.name: own.during[0] + 1.5 * 2e-4 for own in plant.timing_errors}
    fitted = [result.names.index(name) for name in nominal if result.values.get(name)]
    for place in fitted:
        name, error = result.names[place], math.sqrt(float(result.covariance[place, place]))
        truth = SWITCHED[list(nominal).index(name)]
        assert abs(nominal[name] + result.values[name] - truth) < 4.0 * error
    assert len(fitted) >= 6  # those of a stroke that is held out are not among them


def test_inputs_step_where_the_edge_is() -> None:
    times, levels = np.array([0.0, 1.0, 2.0, 3.0, 4.0]), np.array([[0.0], [0.0], [5.0], [5.0], [5.0]])
    held, straight = (Inputs(times, levels, np.array([own])) for own in (True, False))
    at = np.array([0.5, 1.2, 1.6, 1.9, 2.3, 2.7, 3.5])
    for inputs, time in ((held, 2.0), (straight, 1.5)):
        for late in (-0.4, 0.3, 1.1):
            found = with_edges(inputs, [Edge("e", time, 1.0, (0,))], [late])
            shown = found.levels[np.searchsorted(found.times, at, side="right") - 1, 0]
            np.testing.assert_array_equal(shown, np.where(at >= time + late, 5.0, 0.0))
    assert with_edges(held, [Edge("e", 2.0, 1.0, (0,))], [0.0]) is held


def test_an_edge_is_a_jump_between_two_rests() -> None:
    times = np.arange(200) * 1e-3
    square = np.where((times * 20).astype(int) % 2 == 0, 0.0, 10.0)
    noise = 0.02 * np.random.default_rng(1).standard_normal(200)
    assert [round(own.time, 4) for own in edges_of(0, [(times, square + noise)], [True], 1e-3)] == [0.05, 0.1, 0.15]
    middles = [round(own.time, 4) for own in edges_of(0, [(times, square + noise)], [False], 1e-3)]
    assert middles == [0.0495, 0.0995, 0.1495]
    for other in (np.sin(40.0 * times), noise, np.where(np.arange(200) % 2 == 0, 0.0, 1.0), np.ones(200)):
        assert not edges_of(0, [(times, other)], [True], 1e-3)
    # What goes on changing between its jumps is no noise.
    still, levels = without_noise(square + noise)
    assert len(np.unique(still)) == 2
    assert [own.rests for own in levels] == [((0, 50), (100, 150)), ((50, 100), (150, 200))]
    assert [own.error for own in levels] == pytest.approx([2e-3, 2e-3], rel=0.2)
    assert np.max(np.abs(still - square)) < 0.02
    droops = square + noise + 0.1 * np.sin(30.0 * times)
    np.testing.assert_array_equal(without_noise(droops)[0], droops)
