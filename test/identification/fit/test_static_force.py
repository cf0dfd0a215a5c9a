"""The attraction polynomial from a static table: values, honest intervals, and what a missing constant term does."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve, load_valve, save_valve
from valve_sim.files.tables import TableError
from valve_sim.identification.fit.static_force import BeginsLate, StartOfMotion, fit_static_force
from valve_sim.identification.reporting.finding_sentences import remarks
from valve_sim.identification.reporting.identification_document import static_force_document
from valve_sim.model import Tolerances, ValveError

TRUTH = np.array([3.0336, 17.096e3, -30.931e6, 24.026e9])
NOISE = 0.05  # N


def table(
    folder: Path, seed: int = 0, *, scale: float = 1.0, points: int = 60, begin: float = 0.0, end: float = 1.23e-3
) -> Path:
    """A table of the default valve's attraction, as a load cell with noise would show it."""
    displacement = np.linspace(begin, end, points)
    force = scale * np.polynomial.polynomial.polyval(displacement, TRUTH)
    force += NOISE * np.random.default_rng(seed).standard_normal(points)
    path = folder / f"force_{seed}.csv"
    rows = np.column_stack([displacement, force])
    np.savetxt(path, rows, delimiter=",", header="displacement,force", comments="")
    return path


def test_95_percent_intervals_hold_the_truth_in_95_percent_of_tables(tmp_path: Path):
    inside = np.zeros(4)
    for seed in range(200):
        # Few points, so that Student's t and the normal distribution differ (2.23 against 1.96).
        found = fit_static_force(table(tmp_path, seed, points=14), default_valve()).intervals
        inside += [found[f"a{power}"].low <= TRUTH[power] <= found[f"a{power}"].high for power in range(4)]
    # 95 % of 200 with three standard errors of a proportion.
    assert np.all(np.abs(inside / 200 - 0.95) < 3 * np.sqrt(0.95 * 0.05 / 200))


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_covariance_is_that_of_numpys_polyfit(tmp_path: Path, degree: int):
    path = table(tmp_path)
    displacement, force = np.loadtxt(path, delimiter=",", skiprows=1).T
    coefficients, covariance = np.polyfit(displacement * 1e3, force, degree, cov=True)  # in mm: polyfit's rcond
    units = 1e3 ** np.arange(degree + 1)
    found = fit_static_force(path, default_valve(), degree=degree).valve
    matrix = np.array(found.tolerances.attraction_covariance)
    np.testing.assert_allclose(
        matrix[: degree + 1, : degree + 1], covariance[::-1, ::-1] * np.outer(units, units), rtol=1e-6
    )
    assert not np.any(matrix[degree + 1 :]), "terms that are not fitted are exact"
    assert not np.any(matrix[:, degree + 1 :])
    np.testing.assert_allclose(found.parameters.attraction_polynomial[: degree + 1], coefficients[::-1] * units)


def test_the_covariance_is_how_tables_scatter(tmp_path: Path):
    """Measured at 4.5 V, a quarter of the force with the same noise: four times the scatter at the reference."""
    count = 400
    fits = [
        fit_static_force(table(tmp_path, seed, scale=0.25), default_valve(), voltage=4.5).valve for seed in range(count)
    ]
    errors = np.array([valve.parameters.attraction_polynomial for valve in fits]) - TRUTH
    said = np.mean([np.array(valve.tolerances.attraction_covariance) for valve in fits], axis=0)
    # In coordinates in which what is said is the unit matrix, what is seen is Wishart: 1 ± sqrt(2 / count).
    coordinates = np.linalg.solve(np.linalg.cholesky(said), errors.T)
    seen = coordinates @ coordinates.T / count
    assert np.diag(seen) == pytest.approx(1.0, abs=3.5 * np.sqrt(2.0 / count))
    assert seen - np.diag(np.diag(seen)) == pytest.approx(np.zeros((4, 4)), abs=3.5 * np.sqrt(1.0 / count))


def test_the_file_keeps_the_covariance_and_the_other_tolerances(tmp_path: Path):
    known = replace(default_valve(), tolerances=Tolerances({"stroke": 4e-6}))
    found = fit_static_force(table(tmp_path), known, constant=False)
    save_valve(tmp_path / "attraction.yaml", found.valve, "fitted")
    again = load_valve(tmp_path / "attraction.yaml")
    assert again == found.valve
    assert again.tolerances.declared == {"stroke": 4e-6}
    matrix = again.tolerances.attraction_covariance
    assert matrix is not None
    assert matrix[0] == (0.0, 0.0, 0.0, 0.0)
    assert np.sqrt(matrix[1][1]) == pytest.approx(found.intervals["a1"].stderr)
    assert static_force_document(found).to_json()["attraction_covariance"] == [value for row in matrix for value in row]


def test_constant_term_is_said_to_start_the_motion(tmp_path: Path):
    result = fit_static_force(table(tmp_path), default_valve())
    (start,) = result.findings
    assert isinstance(start, StartOfMotion)
    assert start.constant == result.intervals["a0"]
    assert start.opening.meets_main == pytest.approx(5.3e-3, rel=0.1)
    assert start.opening.reaches_stop == pytest.approx(9.9e-3, rel=0.1)
    assert start.without is not None
    assert math.isnan(start.without.meets_main)
    (sentence,) = remarks(result.findings)
    assert "starts the motion" in sentence
    assert "without it the valve never opens at 9 V" in sentence


def test_without_a_constant_term_the_valve_is_said_never_to_open(tmp_path: Path):
    found = fit_static_force(table(tmp_path), default_valve(), constant=False)
    assert found.valve.parameters.attraction_polynomial[0] == 0.0
    assert set(found.intervals) == {"a1", "a2", "a3"}
    assert "never opens at 9 V" in remarks(found.findings)[0]
    assert not found.valve.can_open()


def test_a_table_that_begins_away_from_the_seat_is_said_to_extrapolate(tmp_path: Path):
    result = fit_static_force(table(tmp_path, begin=2e-4), default_valve())
    assert BeginsLate(2e-4) in result.findings
    assert any("begins at 200 µm" in sentence for sentence in remarks(result.findings))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("displacement,force\n", "no table of numbers"),
        ("displacement,weight\n0,1\n", "expected one named force.*, or other names and units with --map"),
        ("displacement,force\n0,1\n0.001,abc\n", "line 3: column force: found 'abc'"),
        ("displacement,force\n0,1\n0.001,nan\n", "line 3: column force: found no finite number"),
        ("displacement,force\n0,1\n0.001\n", "line 3 behind the numbers left out: '0.001'"),
        ("displacement,force\n0,3\n0.26,6\n0.6,7\n1.0,11\n1.23,20\n", r"in mm, say so with --map \(unit: mm\)"),
        ("displacement,force\n0,3\n0.001,6\n0.0012,7\n", "has 3 points at 3 displacements"),
    ],
)
def test_unusable_tables_are_refused_by_name(tmp_path: Path, text: str, words: str):
    path = tmp_path / "force.csv"
    path.write_text(text)
    with pytest.raises(TableError, match=words) as refusal:
        fit_static_force(path, default_valve())
    assert str(path) in str(refusal.value)


@pytest.mark.parametrize(
    "settings", [{"degree": 4}, {"degree": -1}, {"degree": 0, "constant": False}, {"voltage": 0.0}]
)
def test_settings_without_sense_are_refused(tmp_path: Path, settings: dict[str, float]):
    with pytest.raises(ValveError, match="expected"):
        fit_static_force(table(tmp_path), default_valve(), **settings)  # type: ignore[arg-type]
