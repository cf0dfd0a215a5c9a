"""The catalogue's entries: what is neutral changes nothing, look-alikes are mutual, tags and words are there."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from valve_sim.model import CATALOGUE, Drive, Effect, Parameter, ParameterError, Stepper, Tag, Valve, simulate
from valve_sim.model.effects.catalogue import Catalogue

from .random_valves import RANGES

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
PULSE = Drive.of([1e-3, 21e-3], [9.0, 0.0])
TIMES = np.arange(1, 400) * 1e-4
NAMED = [name for name, effect in CATALOGUE.items() if effect.named]


def shaped(effect: Effect, share: float) -> dict[str, float]:
    """What switches it at its neutral value; what only shapes it anywhere in its range."""
    values = effect.neutral_values()
    for parameter in effect.parameters:
        if parameter.off is None and effect.name in RANGES:
            low, high = RANGES[effect.name][parameter.name]
            values[parameter.name] = low + share * (high - low)
    return values


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("name", CATALOGUE)
def test_an_effect_at_its_neutral_values_is_no_effect(name: str, share: float) -> None:
    neutral = Valve(CALIBRATED.parameters, {name: shaped(CATALOGUE[name], share)})
    with_it, without = (simulate(valve, PULSE, TIMES) for valve in (neutral, CALIBRATED))
    # Compiled of other equations, numbers are rounded elsewhere.
    for field in ("pilot_position", "main_position", "pilot_velocity", "coil_current", "attraction", "phase"):
        np.testing.assert_allclose(getattr(with_it, field), getattr(without, field), rtol=0.0, atol=1e-10)
    assert [event.kind for event in with_it.events] == [event.kind for event in without.events]


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_parameter_that_is_not_given_is_neutral(name: str) -> None:
    for parameter in CATALOGUE[name].parameters:
        alone = Valve(CALIBRATED.parameters, {name: {parameter.name: parameter.prior_scale}})
        whole = Valve(
            CALIBRATED.parameters, {name: {**CATALOGUE[name].neutral_values(), parameter.name: parameter.prior_scale}}
        )
        assert alone.numbers().tobytes() == whole.numbers().tobytes()
        assert alone.plan() is whole.plan()


@pytest.mark.parametrize(
    "sensor",
    [
        {"sensor_gain": {"gain": 1.02}},
        {"sensor_bandwidth": {"cutoff_frequency": 20.0}},
        {"sensor_delay": {"delay": 5e-3}},
    ],
    ids=lambda sensor: next(iter(sensor)),
)
def test_what_a_sensor_shows_does_not_change_the_spring(sensor: dict[str, dict[str, float]]) -> None:
    efforts = []
    for effects in ({}, sensor):
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


def test_ranges_follow_from_what_a_parameter_is() -> None:
    either_sign = (
        "constant_force",
        "pressure_force",
        "rest_attraction",
        "spring_hardening",
        "gap_offset",
        "stroke_offset",
    )
    for name in either_sign:
        parameter = CATALOGUE[name].parameters[0]
        assert parameter.lower == -parameter.upper < 0.0, name
    for name in ("drive_gain", "sensor_gain"):
        gain = CATALOGUE[name].parameters[0]
        assert gain.lower * gain.upper == pytest.approx(1.0), name
    for effect in CATALOGUE.values():
        for parameter in effect.parameters:
            # What may be infinite is divided by, or a rate: 0 and less have no meaning.
            assert parameter.lower > 0.0 or not parameter.infinite_at_upper, (effect.name, parameter.name)
    for effect in CATALOGUE.tagged(Tag.DISSIPATIVE):
        assert all(parameter.lower >= 0.0 for parameter in effect.parameters), effect.name


def test_tags_find_what_others_ask_for() -> None:
    assert {effect.name for effect in CATALOGUE.tagged(Tag.SENSOR)} == {
        "sensor_delay", "sensor_bandwidth", "sensor_gain",
    }  # fmt: skip
    assert {effect.name for effect in CATALOGUE.tagged(Tag.LIKE_DAMPING)} == {
        "coulomb_friction", "quadratic_drag", "squeeze_film",
    }  # fmt: skip
    assert {effect.name for effect in CATALOGUE.tagged(Tag.BUILT_IN)} == {"motional_emf"}
    assert "force_map" not in {effect.name for tag in Tag for effect in CATALOGUE.tagged(tag)}


@pytest.mark.parametrize("name", NAMED)
def test_an_entry_speaks_to_people(name: str) -> None:
    effect = CATALOGUE[name]
    assert effect.tags
    assert effect.title and "_" not in effect.title
    assert effect.summary and effect.source
    assert all(parameter.unit and parameter.description for parameter in effect.parameters)
    for sentence in (effect.on_a_real_valve, effect.what_to_do):
        assert re.fullmatch(r"[A-Z][^_\n]{20,240}\.", sentence), sentence
    values = {parameter.name: parameter.prior_scale for parameter in effect.parameters}
    severity = effect.severity_of(values, CALIBRATED.declared())
    assert severity is None or 0.0 <= severity.share < 10.0
    off = effect.severity_of(effect.neutral_values(), CALIBRATED.declared())
    assert off is None or off.share == 0.0


def test_severity_is_a_share_that_a_person_knows() -> None:
    friction = CATALOGUE["coulomb_friction"].severity_of({"force": 0.15}, CALIBRATED.declared())
    assert str(friction) == "5.9 % of the spring preload"
    nothing = CATALOGUE["coil_lag"].severity_of({"time_constant": 1e-4}, Valve().declared())
    assert nothing is None


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


@pytest.mark.parametrize("name", NAMED)
def test_how_severe_an_effect_is(name: str) -> None:
    declared = {
        **CALIBRATED.declared(), "spring_preload": 2.55, "spring_rate": 250.0, "pilot_gap": 0.26e-3, "stroke": 0.9e-3,
        "main_damping": 4.0,
    }  # fmt: skip
    values = {**CATALOGUE[name].neutral_values(), **SEVERITIES.get(name, ({}, 0.0))[0]}
    found = CATALOGUE[name].severity_of(values, declared)
    if name in SEVERITIES:
        assert found is not None
        assert found.share == pytest.approx(SEVERITIES[name][1])
        assert found.of
    else:
        assert found is None


def test_a_users_effect_needs_no_words_for_people() -> None:
    force = Parameter("force", "N", "largest drag")
    effect = Effect("eddy_drag", "drag of a conducting guide", (force,), "a book", term=math.hypot)
    assert effect.title == "Eddy drag"
    assert effect.on_a_real_valve == "Drag of a conducting guide."


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (Effect("coil_lag", "s", (), "t", term=math.hypot), ("coil_lag", "registered already")),
        (Effect("idle", "s", (), "t"), ("idle", "has no expression")),
    ],
)
def test_an_effect_that_cannot_take_part_is_refused(effect: Effect, words: tuple[str, ...]) -> None:
    with pytest.raises(ParameterError) as caught:
        CATALOGUE.register(effect)
    assert all(word in str(caught.value) for word in words)
