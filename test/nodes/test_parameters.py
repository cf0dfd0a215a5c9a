"""The table of the node's parameters, without ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.files.parameter_sections import Section
from valve_sim.model import CATALOGUE, EXACT, ParameterError, Tolerances, Valve, ValveParameters
from valve_sim.model.gas import GasParameters
from valve_sim.nodes.parameters import as_declared, files_for_others, sources_of
from valve_sim.nodes.valve_parameters import (
    VALVE_KEYS,
    ValveSettings,
    check_with_valve,
    valve_of,
    valve_table,
    without_orphans,
)

ENTRIES = ValveSettings.table()
DEFAULTS = {name: entry.default for name, entry in ENTRIES.items()}
KNOWN = ((0.01, 2.0, 0.0, 0.0), (2.0, 1e4, 0.0, 0.0), (0.0, 0.0, 1e9, 0.0), (0.0, 0.0, 0.0, 0.0))
EXACT_VALUES = {
    **DEFAULTS,
    **{name: entry.default for name, entry in valve_table(Valve()).items() if "tol" in name[:3]},
}
"""Of a valve of which nothing is known how well."""


def check_overrides(given: dict[str, object], entries: Any, sources: dict[str, str]) -> dict[str, Any]:
    return check_with_valve(given, entries, sources, "valve_node")


WITH_GAS = {
    "valve.seat_load": 0.3, "gas.inlet_pressure": 35e6, "gas.outlet_volume": 1e-5, "gas.pilot_orifice_diameter": 2e-4,
    "gas.main_orifice_diameter": 3e-3, "gas.seat_diameter": 4e-3,
}  # fmt: skip


def test_the_table_holds_the_valve_every_effect_and_the_settings() -> None:
    valve = {f"valve.{name}" for name in ValveParameters._fields}
    effects = {f"effects.{effect.name}.{name}" for effect in CATALOGUE.values() for name in effect.given_names}
    settings = {"publish_rate", "time_scale", "command_timeout", "max_voltage", "frame_id"}
    gas = {f"gas.{name}" for name in GasParameters._fields}
    others = {name for name in ENTRIES if not name.startswith("tolerances.")}
    assert others == valve | effects | settings | gas
    tolerances = {name.removeprefix("tolerances.") for name in ENTRIES.keys() - others}
    named = {"attraction_covariance", "stroke", "effects.stiction.breakaway", "gas.inlet_pressure", "sensor.gain"}
    assert named <= tolerances


@pytest.mark.parametrize(
    ("given", "keeps"),
    [
        ({}, True),
        ({"publish_rate": 100}, True),
        ({"valve.stroke": 1.2e-3}, False),
        ({"tolerances.stroke": 1e-3}, False),
    ],
)
def test_shipped_tolerances_are_those_of_the_shipped_valve_only(given: dict[str, object], keeps: bool) -> None:
    shipped = replace(default_valve(), tolerances=Tolerances({"pilot_gap": 4e-6}, KNOWN, {}))
    valve = valve_of(check_overrides(given, {**ENTRIES, **valve_table(shipped)}, {}), "here")
    stated = replace(EXACT, declared={"stroke": 1e-3}) if "tolerances.stroke" in given else EXACT
    assert valve.tolerances == (shipped.tolerances if keeps else stated)
    assert valve.parameters._replace(stroke=0.0) == default_valve().parameters._replace(stroke=0.0)


def test_tolerances_are_checked_as_those_of_a_file() -> None:
    on = {"effects.coulomb_friction.force": 0.3, "tolerances.effects.coulomb_friction.force": 0.05}
    values = check_overrides({**on, "tolerances.stroke": 4e-6}, ENTRIES, {})
    assert valve_of(values, "here").tolerances == Tolerances(
        {"stroke": 4e-6}, None, {"coulomb_friction": {"force": 0.05}}
    )
    assert (values["tolerances.stroke"], values["tolerances.effects.coulomb_friction.force"]) == (4e-6, 0.05)
    again = {name: value for name, value in values.items() if name.startswith(VALVE_KEYS)}
    assert check_overrides(again, ENTRIES, {}) == values, "as a dump has it"
    with pytest.raises(ParameterError, match=r"a\.yaml: tolerances\.a0: found 0\.1 under an unknown name"):
        check_overrides({"tolerances.a0": 0.1}, ENTRIES, {"tolerances.a0": "a.yaml"})
    with pytest.raises(ParameterError, match=r"tolerances\.effects\.stiction\.force: found 0\.1, .*not declared on"):
        check_overrides({"tolerances.effects.stiction.force": 0.1}, ENTRIES, {})


@pytest.mark.parametrize(
    ("changes", "zeroed"),
    [
        ({"effects.stiction.force": 0.0}, set()),
        (
            {"effects.stiction.force": 0.0, "effects.stiction.breakaway": 0.0},
            {"force", "breakaway", "stribeck_velocity"},
        ),
        (
            {"effects.stiction.force": 0.0, "effects.stiction.breakaway": 0.0, "tolerances.effects.stiction.force": 1},
            {"breakaway", "stribeck_velocity"},
        ),
        ({"tolerances.effects.stiction.force": 0.02}, set()),
        ({"valve.stroke": 2e-3, "effects.no_such_effect.force": 0.0}, set()),
    ],
)
def test_an_effect_that_is_switched_off_takes_its_tolerances_with_it(
    changes: dict[str, object], zeroed: set[str]
) -> None:
    values = {**DEFAULTS, "effects.stiction.force": 0.3, "effects.stiction.breakaway": 0.1}
    completed = without_orphans(changes, values)
    assert completed == {**changes, **{f"tolerances.effects.stiction.{name}": 0.0 for name in zeroed}}


def test_the_defaults_are_the_default_valve_and_pass_their_own_checks() -> None:
    assert {name: entry.check(entry.default, "here") for name, entry in ENTRIES.items()} == DEFAULTS
    assert valve_of(DEFAULTS, "here") == default_valve()
    settings = ValveSettings.of(DEFAULTS)
    assert (settings.publish_rate, settings.time_scale, settings.command_timeout) == (1000.0, 1.0, 0.0)


def test_every_default_lies_in_the_range_that_ros_enforces() -> None:
    for entry in ENTRIES.values():
        if entry.range is not None:
            assert isinstance(entry.default, float)
            assert entry.range[0] <= entry.default <= entry.range[1]


@pytest.mark.parametrize("effect", [effect for effect in CATALOGUE.values()], ids=lambda effect: effect.name)
def test_one_parameter_alone_switches_its_effect_on(effect: object) -> None:
    whole = CATALOGUE[effect.name].given_as_list  # type: ignore[attr-defined]
    for rule in CATALOGUE[effect.name].parameters:  # type: ignore[attr-defined]
        if rule.off is None or (whole is not None and rule.name in whole.members):
            continue
        value = rule.off + rule.prior_scale if math.isfinite(rule.off) else rule.prior_scale
        if not rule.lower <= value <= rule.upper:
            value = rule.off - rule.prior_scale
        needed = WITH_GAS if CATALOGUE[effect.name].with_gas else {}  # type: ignore[attr-defined]
        valve = valve_of({**DEFAULTS, **needed, f"effects.{effect.name}.{rule.name}": value}, "here")  # type: ignore[attr-defined]
        assert valve.effects[effect.name][rule.name] == value  # type: ignore[attr-defined]


def test_one_of_a_list_switches_its_effect_on() -> None:
    given = {"effects.force_map.coefficients": [0, 0, 0.5, 0, 0]}
    valve = valve_of(check_overrides(given, ENTRIES, {}), "here")
    assert valve.effects["force_map"]["c3"] == 0.5
    assert valve.effects["force_map"]["count"] == 5
    assert not valve_of(check_overrides({}, ENTRIES, {}), "here").effects


def test_a_knot_of_an_earlier_version_is_refused_unless_it_was_off() -> None:
    assert check_overrides({"effects.force_map.f3": 0.0}, ENTRIES, {}) == EXACT_VALUES
    with pytest.raises(ParameterError, match=r"old\.yaml: effects\.force_map\.f3: found 0\.1, one of the eight knots"):
        check_overrides({"effects.force_map.f3": 0.1}, ENTRIES, {"effects.force_map.f3": "old.yaml"})


def test_what_was_given_replaces_defaults_and_integers_become_doubles() -> None:
    given = {"valve.pilot_damping": 3, "publish_rate": 100, "use_sim_time": True, "qos_overrides./a.b": 1}
    values = check_overrides({**given, "valve.attraction_polynomial": [3, 0, 0, 0]}, ENTRIES, {})
    assert values == {
        **EXACT_VALUES,
        "valve.pilot_damping": 3.0,
        "publish_rate": 100.0,
        "valve.attraction_polynomial": [3.0, 0.0, 0.0, 0.0],
    }
    assert isinstance(values["publish_rate"], float)


@pytest.mark.parametrize(
    ("name", "value", "source", "says"),
    [
        ("publish_rat", 100, "command line", "publish_rat: found 100 .* did you mean publish_rate"),
        ("valve.pilot_mas", 1.0, "some.yaml", "valve.pilot_mas: found 1.0 .* did you mean valve.pilot_mass"),
        ("publish_rate", 0, "some.yaml", "publish_rate: found 0, expected a number from 0.1 to 10000 Hz"),
        ("publish_rate", "fast", "some.yaml", "publish_rate: found 'fast', expected a number in Hz"),
        ("frame_id", 3, "some.yaml", "frame_id: found 3, expected text"),
        ("valve.stroke", 1e-4, "some.yaml", "valve.pilot_gap: .* expected 0 < pilot_gap < stroke"),
        ("valve.attraction_polynomial", [1.0], "some.yaml", "attraction_polynomial: found 1 terms"),
        ("valve.attraction_polynomial", "1, 2", "some.yaml", "expected a list of numbers"),
        ("valve.attraction_polynomial", [1.0, "x"], "some.yaml", r"attraction_polynomial\[1\]: found 'x'"),
    ],
)
def test_what_cannot_be_is_refused_with_its_source(name: str, value: object, source: str, says: str) -> None:
    sources = {} if source == "command line" else {name: source}
    with pytest.raises(ParameterError, match=f"{source}: .*{says}"):
        check_overrides({name: value}, ENTRIES, sources)


@pytest.mark.parametrize(
    ("name", "value", "declared"),
    [
        ("valve.pilot_damping", 3, 3.0),
        ("valve.pilot_damping", True, True),
        ("valve.attraction_polynomial", [1, 2.0], [1.0, 2.0]),
        ("valve.attraction_polynomial", "[0.0, 1e-05, inf]", [0.0, 1e-5, math.inf]),
        ("valve.attraction_polynomial", "[0.0, few]", ["0.0", " few"]),
        ("tolerances.stroke", "1e-06", 1e-6),
        ("effects.magnetic_saturation.current", "inf", math.inf),
        ("valve.pilot_damping", "stiff", "stiff"),
        ("frame_id", 3, 3),
        ("use_sim_time", 1, 1),
    ],
)
def test_integers_and_what_ros2_param_load_makes_of_a_dump_become_doubles_where_doubles_belong(
    name: str, value: object, declared: object
) -> None:
    found = as_declared(name, value, ENTRIES)
    assert (found, type(found)) == (declared, type(declared))


def test_the_last_file_that_gives_a_name_to_this_node_is_its_source() -> None:
    sections = [
        ("a.yaml", Section("/**", {"publish_rate": 1, "frame_id": "a"})),
        ("b.yaml", Section("/other", {"frame_id": "b"})),
        ("c.yaml", Section("/valve", {"publish_rate": 2})),
    ]
    assert sources_of(sections, "/valve") == {"publish_rate": "c.yaml", "frame_id": "a.yaml"}
    assert files_for_others(sections, "/valve") == {"b.yaml": ["/other"]}
