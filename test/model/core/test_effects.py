"""The catalogue of the core: every effect can be off, what does not go together is refused, users add their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from model.core.cases import CALIBRATED, STROKE
from model.derivatives import ACCURACY, Case, errors_of
from valve_sim.model import Valve, simulate
from valve_sim.model.effects import FORCE_MAP_VARIABLES, basis
from valve_sim.model.errors import ParameterError


def valve_of(effects: dict[str, Any], **values: Any) -> Valve:
    return Valve.from_mapping({"valve": values, "effects": effects}, "valve.yaml")


@pytest.mark.parametrize(
    ("effects", "values", "why"),
    [
        ({"coulomb": {"force": 1.0}}, {}, "no such effect; did you mean coulomb_friction"),
        ({"coulomb_friction": {"force": -1.0}}, {}, "expected a number from 0"),
        ({"coulomb_friction": {}}, {}, "force is missing"),
        ({"coulomb_friction": {"force": 1.0, "level": 2.0}}, {}, "no such parameter"),
        (
            {"stop_bounce": {"restitution_stop": 0.1, "restitution_seat": 0.1},
             "stop_compliance": {"compliance": 1e-8, "damping_ratio": 0.3}}, {}, "whose place it takes",
        ),
        ({"gap_offset": {"offset": 5e-3}}, {}, "expected 0 < pilot_gap < stroke"),
        ({"stroke_offset": {"offset": -1.1e-3}}, {}, "expected 0 < pilot_gap < stroke"),
        ({"gap_offset": {"offset": 1e-5}}, {"pilot_gap": 0.0}, "a valve with one plunger"),
        ({"motional_emf": {"share": 1.0}}, {}, "without inductance has no flux"),
        (
            {"motional_emf": {"share": 1.0}, "magnetic_saturation": {"current": 0.5}}, {"coil_time_constant": 1e-4},
            "more current would make less flux",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_one_line(effects: dict[str, Any], values: dict[str, Any], why: str) -> None:
    with pytest.raises(ParameterError, match=why) as raised:
        valve_of(effects, **values)
    assert "\n" not in str(raised.value) and str(raised.value).startswith("valve.yaml")


MAP = {"low": 1e-4, "high": 1.1e-3, "coefficients": [0.3, -0.2, 0.4, 0.1, -0.3, 0.2, 0.35, -0.1]}


@pytest.mark.parametrize("variable", FORCE_MAP_VARIABLES)
def test_a_force_map_is_its_spline_times_its_factor_and_stops_at_its_knots(variable: str) -> None:
    """Beyond its range a curve is constant."""
    low, high = {"v": (-0.3, 0.3), "t": (2e-3, 2e-2)}.get(variable.partition("·")[0], (1e-4, 1.1e-3))
    mapping = {**MAP, "low": low, "high": high, "variable": FORCE_MAP_VARIABLES.index(variable)}
    if "v" in variable:
        mapping["coefficients"] = [abs(c) for c in MAP["coefficients"]]  # type: ignore[attr-defined]
    valve = Valve.from_mapping(
        {"valve": CALIBRATED.parameters._asdict(), "effects": {"force_map": mapping}}, "map.yaml"
    )
    c = np.array(mapping["coefficients"])
    times = np.arange(1, 3000) * 1e-5
    response = simulate(valve, STROKE, times)
    exact = simulate(valve, STROKE, times, tolerance=1e-13)
    assert response.pilot_position == pytest.approx(exact.pilot_position, abs=2e-12)
    x, v = exact.pilot_position, exact.pilot_velocity
    place = {"x": x, "v": v, "t": times}[variable[0]]
    curve = basis(place, low, high, len(c)) @ c
    factor = -v if "v" in variable else (exact.coil_current / 0.9) ** 2 if "u²" in variable else 1.0
    force = curve * factor
    p = valve.parameters
    away = np.abs(times[:, None] - np.array([event.time for event in exact.events])).min(axis=1) > 4e-5
    for phase, mass, rest in ((1, p.pilot_mass, 0.0 * x), (3, p.moving_mass, p.spring_preload + p.spring_rate * x)):
        inside = np.flatnonzero((exact.phase == phase) & away)
        runs = [run for run in np.split(inside, np.flatnonzero(np.diff(inside) != 1) + 1) if len(run) > 20]
        for run in runs:
            damping = p.pilot_damping if phase == 1 else p.main_damping
            net = (exact.attraction + force - rest - damping * v)[run]
            slope = (v[run[4:]] - 8 * v[run[3:-1]] + 8 * v[run[1:-3]] - v[run[:-4]]) / -12e-5
            assert mass * slope == pytest.approx(net[2:-2], abs=2e-4)


def test_a_force_map_has_derivatives() -> None:
    valve = Valve.from_mapping(
        {"valve": CALIBRATED.parameters._asdict(), "effects": {"force_map": {**MAP, "variable": 0}}}, "map.yaml"
    )
    for name, errors in errors_of(Case(valve, STROKE), [f"force_map.{own}" for own in ("c3", "low", "high")]).items():
        assert min(errors) < ACCURACY, name
