"""A force of unknown origin: B-splines as they are defined, clamped, dissipative, and as files hold them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline

from valve_sim.files.parameter_files import load_valve, save_valve
from valve_sim.model import CATALOGUE, ParameterError, Valve
from valve_sim.model.effects import FORCE_MAP_VARIABLES, basis

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


def test_the_basis_is_that_of_scipys_b_splines() -> None:
    step = (HIGH - LOW) / (COUNT - 3)
    curve = BSpline(LOW + step * np.arange(-3, COUNT + 1), COEFFICIENTS, 3)
    places = np.linspace(LOW, HIGH, 97)[:-1]
    assert basis(places, LOW, HIGH, COUNT) @ COEFFICIENTS == pytest.approx(curve(places), abs=1e-13)


def test_what_a_file_holds_is_what_was_saved(tmp_path: Path) -> None:
    made = with_map("x", 0.3 * np.sin(np.arange(40.0)), 0.0, 1.23e-3)
    path = tmp_path / "corrected.yaml"
    save_valve(path, made, "test")
    assert "coefficients: [" in path.read_text(encoding="utf-8")
    assert load_valve(path) == made


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
