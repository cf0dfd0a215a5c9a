"""A valve with gas as fits see it: effects of gas, tolerances of its numbers, and a tank that was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model.gas.cases import gas_valve

from valve_sim.identification.diagnosis.identify import check_free, identify
from valve_sim.identification.fit.declared_values import out_of_tolerance
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.model import Drive, ParameterError, Tolerances, Valve, simulate
from valve_sim.recordings import Signal, Trace

SIGMAS = {"outlet_volume": 2e-7, "pilot_orifice_diameter": 2e-6, "inlet_pressure": 1e5}
TIMES = np.arange(300) * 1e-3
OPENING = Drive.of([0.02], [9.0])
NOISE = 5e3


def declared(**gas: float) -> Valve:
    return replace(gas_valve(inlet_pressure=5e6, **gas), tolerances=Tolerances(gas=SIGMAS))


def trace_of(valve: Valve, seed: int = 1) -> Trace:
    shown = simulate(valve, OPENING, TIMES, start_time=0.0).outlet_pressure
    assert shown is not None
    noisy = shown + NOISE * np.random.default_rng(seed).standard_normal(len(TIMES))
    return Trace("outlet", OPENING, TIMES[:0], TIMES[:0], outlet_pressure=Signal(TIMES, noisy))


def test_effects_of_gas_are_tried_with_gas_alone() -> None:
    with_gas, bench = ValveModel(gas_valve()).effects, ValveModel(replace(gas_valve(), gas=None)).effects
    assert {"seat_leak", "pilot_clogging"} <= with_gas.keys()
    assert "pressure_force" not in with_gas
    assert set(bench) - set(with_gas) == {"pressure_force"}
    assert {name for name in set(with_gas) - set(bench) if not name.startswith("gas.")} == {
        "seat_leak",
        "pilot_clogging",
    }
    with pytest.raises(ParameterError, match=r"seat_leak\.area: cannot be freed, the valve declares no gas"):
        check_free(["seat_leak.area"], replace(gas_valve(), gas=None))
    check_free(["seat_leak.area"])


def test_a_number_of_gas_with_a_tolerance_is_a_nuisance_and_may_be_wrong() -> None:
    model = ValveModel(declared())
    found = {own.name: (own.mean, own.sigma) for own in model.nuisances}
    assert found["gas.outlet_volume"] == (1e-5, 2e-7)
    assert set(found) == {f"gas.{name}" for name in SIGMAS}
    choice = model.effects["gas.outlet_volume"]
    assert choice.is_declared_value and choice.free_names() == ("gas.outlet_volume",)
    assert "pilot_clogging" in choice.confused_with
    assert "gas.outlet_volume" in model.effects["pilot_clogging"].confused_with
    # A smaller pilot orifice is a clogged one.
    (larger,) = model.effects["gas.pilot_orifice_diameter"].parameters
    assert (larger.off, larger.lower) == (0.2e-3, 0.2e-3)
    assert model.with_values({"gas.outlet_volume": 2e-5}).gas.outlet_volume == 2e-5  # type: ignore[union-attr]


def test_a_fit_estimates_along_what_has_a_tolerance() -> None:
    true = declared(outlet_volume=1.02e-5)
    result = identify([trace_of(true)], declared(), ("seat_leak.area",))
    row = next(one for one in result.declared if one.name == "gas.outlet_volume")
    assert row.deviation > 0.3
    assert not out_of_tolerance(result.declared)
    assert result.valve.gas is not None
    assert result.valve.gas.outlet_volume == row.estimate
    assert set(result.valve.tolerances.gas) == set(SIGMAS)
    assert all(sigma < SIGMAS[name] for name, sigma in result.valve.tolerances.gas.items())
    assert result.intervals["seat_leak.area"].value < 3e-11
    assert result.rmse_after == pytest.approx(NOISE, rel=0.15)


def test_a_measured_tank_is_the_input_of_a_fit() -> None:
    trace = trace_of(gas_valve(inlet_pressure=5e6))
    measured = replace(trace, inlet_pressure=Signal(np.array([0.0, 0.1]), np.full(2, 5e6)))
    wrong = gas_valve(inlet_pressure=6e6)
    (shown,), (expected,) = (
        ValvePlant([one], valve).predict({})
        for one, valve in ((measured, wrong), (trace, gas_valve(inlet_pressure=5e6)))
    )
    np.testing.assert_allclose(shown, expected, rtol=1e-5)
    (declared_shown,) = ValvePlant([trace], wrong).predict({})
    assert np.abs(declared_shown - expected).max() > 1e5
    # A valve without gas has no use for it.
    beside = replace(measured, times=TIMES, pilot_position=np.zeros(len(TIMES)))
    assert ValvePlant([beside], replace(wrong, gas=None)).traces[0].inlet_pressure is None
