"""The group `gas` of a parameter file: read, written, refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from valve_sim.files.parameter_files import load_valve, save_valve, valve_from_flat
from valve_sim.files.resources import config_path
from valve_sim.model import ParameterError, Valve

from .cases import gas_valve

GIVEN = {
    "valve.seat_load": 0.3,
    "gas.inlet_pressure": 35e6,
    "gas.outlet_volume": 1e-5,
    "gas.pilot_orifice_diameter": 0.2e-3,
    "gas.main_orifice_diameter": 3e-3,
    "gas.seat_diameter": 4e-3,
}


def test_what_is_given_is_the_gas_and_the_rest_has_defaults() -> None:
    valve = valve_from_flat(GIVEN, "here")
    assert valve.gas == gas_valve().gas
    assert valve_from_flat({}, "here").gas is None
    assert valve_from_flat({**GIVEN, "gas.inlet_pressure": 0.0}, "here").gas is None


def test_tolerances_and_effects_of_gas_are_read_back(tmp_path: Path) -> None:
    given = {
        **GIVEN, "tolerances.gas.outlet_volume": 2e-7, "tolerances.gas.inlet_pressure": 0.0,
        "effects.seat_leak.area": 1e-9, "effects.pilot_clogging.ratio": 1.0, "tolerances.effects.seat_leak.area": 1e-10,
    }  # fmt: skip
    valve = valve_from_flat(given, "here")
    assert valve.tolerances.gas == {"outlet_volume": 2e-7}
    assert valve.effects == {"seat_leak": {"area": 1e-9}}
    save_valve(tmp_path / "valve.yaml", valve, "test")
    assert load_valve(tmp_path / "valve.yaml") == valve
    assert not valve.tolerances.is_exact


def test_shipped_files_are_the_default_valve_before_a_tank() -> None:
    for pressure in (35, 70):
        assert load_valve(config_path(f"hydrogen_{pressure}mpa.yaml")) == gas_valve(inlet_pressure=pressure * 1e6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"gas.inlet_presure": 1e6},
            "here: gas.inlet_presure: found 1000000.0 under an unknown name; did you mean inlet_",
        ),
        ({"gas.fluid": "steam"}, "here: gas.fluid: found 'steam', expected one of hydrogen, nitrogen, helium, air"),
        ({"gas.seat_diameter": -1.0}, "here: gas.seat_diameter: found -1.0, expected a number from 1e-06 to 0.5 m"),
        ({"gas.seat_diameter": "wide"}, "here: gas.seat_diameter: found 'wide', expected a number in m"),
        ({"valve.seat_load": 0.0}, "here: valve.seat_load: found 0 N beside gas, expected above 0 N"),
        (
            {"effects.pressure_force.force": 1.0},
            "here: effects.pressure_force: found beside gas, with which it cannot act",
        ),
        (
            {"tolerances.gas.outlet_volum": 1e-7},
            "here: tolerances.gas.outlet_volum: found 1e-07 under an unknown name; did you mean outlet_volume?",
        ),
        (
            {"tolerances.outlet_volume": 1e-7},
            "here: tolerances.outlet_volume: found 1e-07; expected it as tolerances.gas.",
        ),
        ({"tolerances.gas": 1e-7}, "here: tolerances.gas: found 1e-07, expected tolerances.gas.<name>"),
        (
            {"gas.inlet_pressure": 0.0, "effects.seat_leak.area": 1e-9},
            "here: effects.seat_leak: found without gas, of which it is an effect; declare the group gas",
        ),
        (
            {"gas.inlet_pressure": 0.0, "tolerances.gas.outlet_volume": 1e-7},
            "here: tolerances.gas.outlet_volume: found 1e-07, but no gas is declared",
        ),
        (
            {"inlet_pressure": 1e6},
            "here: inlet_pressure: found 1000000.0 beside gas:, expected it below, as gas.inlet_",
        ),
    ],
)
def test_refusals_name_the_key_and_the_mend(change: dict[str, object], words: str) -> None:
    with pytest.raises(ParameterError) as refusal:
        valve_from_flat({**GIVEN, **change}, "here")
    assert str(refusal.value).startswith(words)


def test_what_must_be_given_is_named() -> None:
    given = {name: value for name, value in GIVEN.items() if name != "gas.seat_diameter"}
    with pytest.raises(ParameterError, match=r"^here: gas\.seat_diameter is missing; gas needs inlet_pressure, "):
        valve_from_flat(given, "here", Valve())
