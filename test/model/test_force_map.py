"""A force of unknown origin: B-splines as they are defined, clamped, dissipative, and as files hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from valve_sim.files.parameter_files import load_valve, save_valve
from valve_sim.model import CATALOGUE, Drive, ParameterError, Stepper, Valve, simulate
from valve_sim.model.effects import FORCE_MAP_COEFFICIENTS, FORCE_MAP_VARIABLES, basis

COUNT = 12
LOW, HIGH = -0.3, 0.9
COEFFICIENTS = np.random.default_rng(5).normal(size=COUNT)
OPENS = {"valve": {"attraction_polynomial": [3.0, 17.096e3, -30.931e6, 24.026e9]}}


def values(variable: str, coefficients: np.ndarray, low: float, high: float) -> dict[str, float]:
    entry = CATALOGUE["force_map"]
    given = {"variable": float(FORCE_MAP_VARIABLES.index(variable)), "low": low, "high": high}
    found = entry.unpacked({**given, "coefficients": coefficients.tolist()}, "test")
    return {name: float(value) for name, value in found.items()}  # type: ignore[arg-type]


def with_map(variable: str, coefficients: np.ndarray, low: float, high: float) -> Valve:
    found = {**values(variable, coefficients, low, high)}
    return Valve.from_mapping({**OPENS, "effects": {"force_map": found}}, "test")


def test_the_splines_add_up_to_one_and_none_is_negative() -> None:
    shapes = basis(np.linspace(LOW - 1.0, HIGH + 1.0, 501), LOW, HIGH, COUNT)
    assert np.sum(shapes, axis=1) == pytest.approx(1.0, abs=1e-14)
    assert shapes.min() >= 0.0
    assert np.count_nonzero(shapes, axis=1).max() == 4


def test_the_basis_is_that_of_scipys_b_splines() -> None:
    step = (HIGH - LOW) / (COUNT - 3)
    curve = BSpline(LOW + step * np.arange(-3, COUNT + 1), COEFFICIENTS, 3)
    places = np.linspace(LOW, HIGH, 97)[:-1]
    assert basis(places, LOW, HIGH, COUNT) @ COEFFICIENTS == pytest.approx(curve(places), abs=1e-13)


def test_where_velocity_takes_part_energy_is_only_taken_out() -> None:
    """On its way, at every instant the plungers are slower at the same place than without."""
    damping = np.abs(np.random.default_rng(3).normal(size=20)) * 8.0
    times = np.arange(0.0, 0.03, 2e-5)
    drive = Drive.of([0.0], [9.0])
    free = simulate(Valve.from_mapping(OPENS, "test"), drive, times)
    damped = simulate(with_map("x·v", damping, 0.0, 1.23e-3), drive, times)
    on_its_way = (damped.pilot_position > 0.02e-3) & (damped.pilot_position < 0.2e-3)
    same_place = np.interp(damped.pilot_position[on_its_way], free.pilot_position[:200], free.pilot_velocity[:200])
    assert np.count_nonzero(on_its_way) > 20
    assert np.all(damped.pilot_velocity[on_its_way] < same_place)


def test_a_live_valve_steps_what_a_file_holds_as_a_whole_run_simulates_it(tmp_path: Path) -> None:
    made = with_map("x", 0.3 * np.sin(np.arange(40.0)), 0.0, 1.23e-3)
    path = tmp_path / "corrected.yaml"
    save_valve(path, made, "test")
    assert "coefficients: [" in path.read_text(encoding="utf-8")
    read = load_valve(path)
    assert read == made
    times = np.linspace(0.0, 0.03, 301)
    whole = simulate(read, Drive.of([0.0], [9.0]), times)
    stepper = Stepper(read)
    stepper.command(0.0, 9.0)
    positions = []
    for time in times:
        positions.append(stepper.advance(float(time)).pilot_position)
    assert positions == pytest.approx(whole.pilot_position, abs=1e-9)
    without = simulate(Valve.from_mapping(OPENS, "test"), Drive.of([0.0], [9.0]), times)
    assert np.max(np.abs(without.pilot_position - whole.pilot_position)) > 10e-6


def file_with(folder: Path, force_map_lines: str) -> Path:
    path = folder / "valve.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    effects:\n      force_map: {force_map_lines}\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("{low: 0.0, high: 1.0e-3, f3: 0.1}", "force_map.f3: found 0.1, one of the eight knots of earlier versions"),
        ("{low: 0.0, high: 1.0e-3, coefficients: [1.0, 2.0]}", "found 2 numbers, expected a list of 4 to 40"),
        ("{low: 0.0, high: 1.0e-3, coefficients: 0.5}", "coefficients: found 0.5, expected a list of 4 to 40"),
        ("{low: 1.0, high: 0.0, coefficients: [1.0, 2.0, 1.0, 0.0]}", "expected low below high"),
        ("{variable: 1, low: -1.0, high: 1.0, coefficients: [1.0, -2.0, 1.0, 0.0]}", "expected none below 0"),
        ("{low: 0.0, high: 1.0e-3, c3: 0.1}", "under an unknown name"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path: Path, lines: str, words: str) -> None:
    with pytest.raises(ParameterError) as refused:
        load_valve(file_with(tmp_path, lines))
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def test_a_dump_of_an_earlier_version_without_a_force_map_is_read(tmp_path: Path) -> None:
    knots = ", ".join(f"f{knot}: 0.0" for knot in range(1, 9))
    found = load_valve(file_with(tmp_path, f"{{variable: 0.0, low: 0.0, high: 1.0, {knots}}}"))
    assert "force_map" not in found.effects


def test_fewer_coefficients_are_as_good_as_forty(tmp_path: Path) -> None:
    found = load_valve(file_with(tmp_path, "{low: 0.0, high: 1.0e-3, coefficients: [0.1, 0.2, 0.3, 0.4, 0.5]}"))
    assert found.to_mapping()["effects"]["force_map"]["coefficients"] == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert found.effects["force_map"][FORCE_MAP_COEFFICIENTS[5]] == 0.0
