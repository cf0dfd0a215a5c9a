"""Tolerances of declared values: what is taken, what is refused with one line, and that no motion depends on them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from valve_sim.model import CATALOGUE, DECLARED, EXACT, Drive, ParameterError, Tolerances, Valve, simulate
from valve_sim.model.tolerances import TOLERATED, SensorTolerances

DIAGONAL = (0.01, 1e4, 1e10, 1e16)
FRICTION = {"coulomb_friction": {"force": 0.3}, "stiction": {"force": 0.2, "breakaway": 0.1, "stribeck_velocity": 0.02}}
COVARIANCE = [value for row in np.diag(DIAGONAL).tolist() for value in row]


def checked(**tolerances: Any) -> Tolerances:
    return Valve.from_mapping({"effects": FRICTION, "tolerances": tolerances}, "a.yaml").tolerances


def changed(*entries: tuple[int, float]) -> list[float]:
    matrix = list(COVARIANCE)
    for index, value in entries:
        matrix[index] = value
    return matrix


@st.composite
def covariances(draw: st.DrawFn) -> list[float]:
    """R Rᵀ of a random (4, k) root, k from 0 to 4: of every rank."""
    number = st.integers(-1000, 1000)
    root = np.array(draw(st.lists(st.lists(number, min_size=4, max_size=4), max_size=4))).reshape(-1, 4).T / 1e3
    matrix = (np.sqrt(DIAGONAL)[:, None] * root) @ (np.sqrt(DIAGONAL)[:, None] * root).T
    return [float(value) for value in matrix.ravel()]


def positive(name: str) -> st.SearchStrategy[float]:
    width = DECLARED[name].upper - DECLARED[name].lower
    return st.floats(0.0, width, exclude_min=True, allow_subnormal=False)


@seed(16)
@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(
    declared=st.fixed_dictionaries({}, optional={name: positive(name) for name in TOLERATED}),
    covariance=st.none() | covariances(),
    force=st.none() | st.floats(1e-9, 10.0),
)
def test_every_valve_survives_its_own_mapping(
    declared: dict[str, float], covariance: list[float] | None, force: float | None
) -> None:
    given_values: dict[str, Any] = dict(declared)
    if covariance is not None:
        given_values["attraction_covariance"] = covariance
    if force is not None:
        given_values["effects"] = {"coulomb_friction": {"force": force}}
    valve = Valve.from_mapping({"effects": FRICTION, "tolerances": given_values}, "a.yaml")
    again = Valve.from_mapping(valve.to_mapping(), "a.yaml")
    assert again == valve
    assert dict(valve.tolerances.declared) == declared
    if covariance is not None and any(covariance):
        found = np.array(valve.tolerances.attraction_covariance).ravel()
        np.testing.assert_allclose(found, covariance, rtol=1e-12)
    assert valve.tolerances.is_exact == (not declared and not (covariance and any(covariance)) and force is None)


def test_a_sensor_is_as_true_as_usual_where_nothing_is_said_of_it() -> None:
    assert Valve().tolerances.sensor == SensorTolerances(gain=0.002, linearity=0.001)
    silent = Valve.from_mapping({"tolerances": {"stroke": 4e-6}}, "a.yaml")
    assert silent.tolerances.sensor == Valve().tolerances.sensor
    assert "sensor" not in silent.to_mapping()["tolerances"]


def test_what_is_said_of_the_sensor_is_kept() -> None:
    valve = Valve.from_mapping({"tolerances": {"sensor": {"gain": 0.0, "linearity": 0.0005}}}, "a.yaml")
    assert valve.tolerances.sensor == SensorTolerances(0.0, 0.0005)
    assert valve.tolerances.is_exact  # of the valve itself nothing is said
    assert Valve.from_mapping(valve.to_mapping(), "a.yaml") == valve
    assert valve.exact().tolerances.sensor == valve.tolerances.sensor


@pytest.mark.parametrize(
    ("said", "says"),
    [
        ({"gian": 0.1}, r"a\.yaml: tolerances\.sensor\.gian: found 0\.1 under an unknown name; did you mean gain"),
        ({"gain": -0.1}, r"a\.yaml: tolerances\.sensor\.gain: found -0\.1, expected a number from 0 to 0\.1"),
        (0.1, r"a\.yaml: tolerances\.sensor: found 0\.1, expected \{gain, linearity\}"),
    ],
)
def test_what_a_sensor_cannot_be_is_refused(said: object, says: str) -> None:
    with pytest.raises(ParameterError, match=says):
        Valve.from_mapping({"tolerances": {"sensor": said}}, "a.yaml")


def test_zero_means_exact_and_leaves_no_trace() -> None:
    zeros = {
        **dict.fromkeys(TOLERATED, 0.0),
        "attraction_covariance": [0] * 16,
        "effects": {name: dict.fromkeys((p.name for p in entry.parameters), 0.0) for name, entry in CATALOGUE.items()},
    }
    valve = Valve.from_mapping({"tolerances": zeros}, "a dump")
    assert valve == Valve()
    assert "tolerances" not in valve.to_mapping()


@pytest.mark.parametrize(
    ("tolerances", "named"),
    [
        ({"spring_rat": 12.8}, ["tolerances.spring_rat:", "12.8", "did you mean tolerances.spring_rate?"]),
        ({"valve.stroke": 1e-6}, ["tolerances.valve.stroke", "did you mean tolerances.stroke?"]),
        ({"spring_rate": -1.0}, ["tolerances.spring_rate", "-1.0", "from 0 to 1e+07 N/m"]),
        ({"spring_rate": float("nan")}, ["tolerances.spring_rate", "nan", "from 0"]),
        ({"spring_rate": "3 %"}, ["tolerances.spring_rate", "'3 %'", "expected a number in N/m"]),
        ({"a0": 0.1}, ["tolerances.a0", "0.1", "attraction_covariance", "16 numbers", "fit-force"]),
        ({"attraction_covariance": COVARIANCE[:9]}, ["attraction_covariance", "list of 9", "16 numbers"]),
        ({"attraction_covariance": ["x", *COVARIANCE[1:]]}, ["attraction_covariance[0]", "'x'", "number"]),
        ({"attraction_covariance": changed((5, float("nan")))}, ["attraction_covariance[5]", "nan"]),
        ({"attraction_covariance": changed((5, -1e4))}, ["-10000", "variance of a1", "at least 0"]),
        ({"attraction_covariance": changed((1, 3.0))}, ["found 3 above and 0 below", "a0 and a1", "symmetric"]),
        ({"attraction_covariance": changed((1, 11.0), (4, 11.0))}, ["found 11 for a0 and a1", "positive semidefinite"]),
        (
            {"attraction_covariance": changed((1, 9.0), (4, 9.0), (2, 9e3), (8, 9e3), (6, -9e6), (9, -9e6))},
            ["eigenvalue -0.8", "positive semidefinite"],
        ),
        ({"effects": {"stictoin": {"force": 0.1}}}, ["tolerances.effects.stictoin", "did you mean stiction?"]),
        ({"effects": {"stiction": {"forse": 0.1}}}, ["effects.stiction.forse", "0.1", "did you mean force?"]),
        ({"effects": {"stiction": {"force": -0.1}}}, ["effects.stiction.force", "-0.1", "from 0"]),
        ({"effects": {"drive_gain": {"gain": 0.1}}}, ["tolerances.effects.drive_gain.gain", "0.1", "not declared on"]),
        ({"effects": {"force_map": {"c3": 0.1}}}, ["tolerances.effects.force_map.c3", "has no tolerances"]),
        ({"stiction": {"force": 0.1}}, ["tolerances.stiction", "tolerances.effects.stiction"]),
    ],
)
def test_what_is_no_tolerance_is_said_in_one_line(tolerances: dict[str, Any], named: list[str]) -> None:
    with pytest.raises(ParameterError) as caught:
        checked(**tolerances)
    message = str(caught.value)
    assert message.startswith("a.yaml: tolerances.")
    assert "\n" not in message
    assert [part for part in named if part not in message] == [], message


def test_a_covariance_rounded_to_what_people_print_is_taken_and_made_symmetric() -> None:
    matrix = changed((1, 9.999999), (4, 10.000001), (5, 1e4))
    found = checked(attraction_covariance=matrix).attraction_covariance
    assert found is not None
    assert found[0][1] == found[1][0] == pytest.approx(10.0, rel=1e-9)


@pytest.mark.parametrize("name", ["pilot_mass", "moving_mass"])
def test_a_tolerance_of_a_mass_wants_two_bodies(name: str) -> None:
    one_body = {"pilot_mass": 0.134, "moving_mass": 0.134}
    assert Valve.from_mapping({"valve": one_body, "tolerances": {"stroke": 4e-6}}, "a.yaml").tolerances.declared
    with pytest.raises(ParameterError, match=rf"tolerances\.{name}: .* expected moving_mass, .* above pilot_mass"):
        Valve.from_mapping({"valve": one_body, "tolerances": {name: 1e-3}}, "a.yaml")


def test_tolerances_stay_when_values_change_and_move_nothing() -> None:
    valve = replace(Valve().with_values(a0=3.0, coil_time_constant=1e-3), effects=FRICTION)
    known = replace(valve, tolerances=checked(spring_rate=12.8, attraction_covariance=COVARIANCE))
    assert known.with_values(pilot_damping=2.0).tolerances is known.tolerances
    drive, times = Drive.of([0.0], [9.0]), np.linspace(0.0, 0.02, 50)
    assert np.array_equal(simulate(known, drive, times).pilot_position, simulate(valve, drive, times).pilot_position)
    assert Valve().tolerances is EXACT
