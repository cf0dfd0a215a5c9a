"""The catalogue's entries: what is neutral changes nothing, look-alikes are mutual, and how severe an effect is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from valve_sim.model import CATALOGUE, Drive, Effect, ParameterError, Stepper, Valve, simulate
from valve_sim.model.effects.catalogue import Catalogue
from valve_sim.model.runs import Directions, Run
from valve_sim.model.simulation import commands_of

from .random_valves import RANGES

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
PULSE = Drive.of([1e-3, 21e-3], [9.0, 0.0])
TIMES = np.arange(1, 400) * 1e-4


def shaped(effect: Effect) -> dict[str, float]:
    """What switches it at its neutral value; what only shapes it at the end of its range."""
    values = effect.neutral_values()
    shapes = [parameter.name for parameter in effect.parameters if parameter.off is None]
    return {**values, **{name: RANGES[effect.name][name][1] for name in shapes if effect.name in RANGES}}


@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_at_its_neutral_values_is_no_effect(name: str) -> None:
    neutral = Valve(CALIBRATED.parameters, {name: shaped(CATALOGUE[name])})
    with_it, without = (simulate(valve, PULSE, TIMES) for valve in (neutral, CALIBRATED))
    # Compiled of other equations, numbers are rounded elsewhere.
    for field in ("pilot_position", "main_position", "pilot_velocity", "coil_current", "attraction", "phase"):
        np.testing.assert_allclose(getattr(with_it, field), getattr(without, field), rtol=0.0, atol=1e-10)
    assert [event.kind for event in with_it.events] == [event.kind for event in without.events]


@pytest.mark.long
@pytest.mark.parametrize("first", RANGES)
def test_any_two_effects_are_simulated_with_and_without_derivatives(first: str) -> None:
    for second in list(RANGES)[list(RANGES).index(first) + 1 :]:
        effects = {
            name: {key: 0.5 * (low + high) for key, (low, high) in RANGES[name].items()} for name in (first, second)
        }
        valve = Valve(CALIBRATED.parameters, effects)
        run = Run(valve, 0.0, directions=Directions.of(valve, PULSE, ["main_damping", "stroke", "a0"]))
        shown = run.piece(commands_of(PULSE), TIMES[-1], TIMES)
        assert np.isfinite(shown.of_positions).all(), second
        np.testing.assert_allclose(shown.positions, simulate(valve, PULSE, TIMES).pilot_position, 0.0, 1e-10)


ALONE = {
    "with_gas": {True: {"pilot_clogging", "seat_leak"}, False: {"pressure_force", "stop_compliance"}},
    "named": {False: {"force_map"}},
    "tried": {False: {"stop_compliance"}},
    "needs_inductance": {True: {"motional_emf"}},
    "phase_2_only": {True: {"spring_hardening"}},
}
"""Effects that differ from all others in something, by what that is there."""


def test_effects_are_of_the_kinds_that_they_are_and_their_parameters_may_be_neutral() -> None:
    for what, apart in ALONE.items():
        for value, names in apart.items():
            assert {name for name, effect in CATALOGUE.items() if getattr(effect, what) is value} == names, what
    for own in (own for effect in CATALOGUE.values() for own in effect.parameters):
        assert own.lower < own.upper and own.prior_scale >= 0.0, own
        assert own.lower <= own.neutral <= own.upper or own.neutral == math.inf, own
    assert CATALOGUE["coil_lag"].parameter("time_constant").unit == "s"
    with pytest.raises(KeyError):
        CATALOGUE["coil_lag"].parameter("force")


def test_a_parameter_that_is_not_given_is_neutral() -> None:
    neutral = CATALOGUE["stiction"].neutral_values()
    alone = Valve(CALIBRATED.parameters, {"stiction": {"force": 0.1}})
    whole = Valve(CALIBRATED.parameters, {"stiction": {**neutral, "force": 0.1}})
    assert alone.numbers().tobytes() == whole.numbers().tobytes()
    assert alone.plan() is whole.plan()


def test_what_a_sensor_shows_does_not_change_the_spring() -> None:
    sensors = {
        "sensor_gain": {"gain": 1.02},
        "sensor_bandwidth": {"cutoff_frequency": 20.0},
        "sensor_delay": {"delay": 5e-3},
    }
    efforts = []
    for effects in ({}, sensors):
        stepper = Stepper(Valve(CALIBRATED.parameters, effects))
        stepper.command(0.0, 9.0)
        efforts.append([stepper.advance(time).main_effort for time in np.arange(1, 40) * 0.5e-3])
    assert efforts[0] == pytest.approx(efforts[1], rel=0.0, abs=1e-12)
    d = CALIBRATED.parameters
    assert efforts[0][-1] == pytest.approx(-(d.spring_preload + d.spring_rate * d.stroke))


def test_look_alikes_are_declared_once_and_mutual() -> None:
    alike = {name: CATALOGUE[name].confused_with for name in CATALOGUE}
    assert all(name in alike[other] for name, others in alike.items() for other in others)
    assert alike["stiction"] == ("coulomb_friction", "asymmetric_friction", "squeeze_film")
    mine = Effect("mine", "mine", (), "test", term=math.hypot, confused_with=("yours", "not_installed"))
    yours = Effect("yours", "yours", (), "test", term=math.hypot)
    both = Catalogue((mine, yours))
    assert both["yours"].confused_with == ("mine",)
    assert both["mine"].confused_with == ("yours",)


SEVERITIES = {
    "asymmetric_friction": ({"force_opening": 0.1, "force_closing": 0.5}, 0.5 / 2.55),
    "coil_heating": ({"temperature_rate": 20.0, "cooling_time_constant": 2.0}, 0.00393 * 40.0 * (1.0 - math.exp(-0.5))),
    "coil_lag": ({"time_constant": 2e-4}, 2e-4 / 0.9934e-3),
    "constant_force": ({"force": -0.1}, 0.1 / 2.55),
    "coulomb_friction": ({"force": 0.1}, 0.1 / 2.55),
    "drive_gain": ({"gain": 0.9}, 0.19),
    "eddy_lag": ({"time_constant": 3e-4}, 3e-4 / 0.9934e-3),
    "gap_offset": ({"offset": -26e-6}, 0.1),
    "magnetic_saturation": ({"current": 2.0}, 0.25),
    "motional_emf": ({"share": 0.8}, 0.8),
    "pickup_impact": ({"velocity_ratio": 0.7}, 0.3),
    "pressure_force": ({"force": 0.2}, 0.2 / 2.55),
    "quadratic_drag": ({"coefficient": 5.0}, 5.0 * 0.2**2 / 2.55),
    "residual_magnetism": ({"current": 0.3}, 0.09),
    "rest_attraction": ({"force": 0.2}, 0.2 / 2.55),
    "sensor_gain": ({"gain": 0.95}, 0.05),
    "spring_hardening": ({"coefficient": -1e8}, 1e8 * 0.9e-3**3 / (2.55 + 250.0 * 0.9e-3)),
    "squeeze_film": ({"coefficient": 1.0, "film_thickness": 1e-4}, 1.0 / 4.0),
    "stiction": ({"force": 0.1, "breakaway": 0.2}, 0.3 / 2.55),
    "stop_bounce": ({"restitution_stop": 0.3, "restitution_seat": 0.2}, 0.09),
    "stroke_offset": ({"offset": 45e-6}, 0.05),
    "pilot_clogging": ({"ratio": 0.6}, 0.4),
}
"""Of a spring of 2.55 N and 250 N/m, 0.26 mm of gap and 0.9 mm of stroke, 0.9934 ms of coil and 4 N·s/m of damping."""


def test_how_severe_an_effect_is() -> None:
    declared = {
        **CALIBRATED.declared(), "spring_preload": 2.55, "spring_rate": 250.0, "pilot_gap": 0.26e-3, "stroke": 0.9e-3,
        "main_damping": 4.0,
    }  # fmt: skip
    for name, effect in CATALOGUE.items():
        given, share = SEVERITIES.get(name, ({}, None))
        found = effect.severity_of({**effect.neutral_values(), **given}, declared)
        assert (found and found.share) == (share and pytest.approx(share)), name
    assert str(CATALOGUE["coulomb_friction"].severity_of({"force": 0.15}, declared)) == "5.9 % of the spring preload"
    assert CATALOGUE["coil_lag"].severity_of({"time_constant": 1e-4}, Valve().declared()) is None


def test_an_effect_that_cannot_take_part_is_refused() -> None:
    with pytest.raises(ParameterError, match="an effect named coil_lag is registered already"):
        CATALOGUE.register(Effect("coil_lag", "s", (), "t", term=math.hypot))
    with pytest.raises(ParameterError, match=r"effects\.idle: has no expression"):
        CATALOGUE.register(Effect("idle", "s", (), "t"))
