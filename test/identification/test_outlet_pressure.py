"""Valves with gas, identified and validated by the pressure at their outlet, of an independent plant."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from model.gas.cases import gas_valve, independent

from identification.freed import fit
from valve_sim.cli.program import main
from valve_sim.files.parameter_files import save_valve
from valve_sim.identification.diagnosis.identify import Identification, check_free, identify
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.monitoring.findings import OpenedPartly, WaitsForPressure
from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.validation_document import validation_document
from valve_sim.identification.validation.replay import validate
from valve_sim.model import Drive, ParameterError, Tolerances, Valve, simulate
from valve_sim.nodes.identification_work import predict
from valve_sim.recordings import Signal, Trace

TIMES = np.arange(700) * 1e-3
NOISE = 35e3
"""Pa: 0.1 % of the inlet's."""
SHARES = {"pilot_orifice_diameter": 0.01, "outlet_volume": 0.02, "seat_diameter": 0.005}
"""Tolerances of numbers of gas, as shares of them."""
CLOGGING = "pilot_clogging.ratio"
ORIFICE, VOLUME, DEMAND = "gas.pilot_orifice_diameter", "gas.outlet_volume", "gas.demand_orifice_diameter"


@functools.cache
def shown(demand: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions and outlet pressures of the independent plant, without noise."""
    plant = independent(gas_valve(demand_orifice_diameter=demand))
    plant.rtol = 1e-8
    positions, pressures, _ = plant.run([(0.02, 9.0)], TIMES)
    return positions, pressures


def recorded(seed: int, demand: float = 0.0) -> Trace:
    """One opening at 1 kHz: command and outlet pressure, and nothing else."""
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(TIMES))
    nothing = np.empty(0)
    return Trace(
        "outlet", Drive.of([0.02], [9.0]), nothing, nothing, outlet_pressure=Signal(TIMES, shown(demand)[1] + noise)
    )


def of_gas(valve: Valve, **gas: float) -> Valve:
    assert valve.gas is not None
    return replace(valve, gas=valve.gas._replace(**gas))  # type: ignore[arg-type]


def lifted(valve: Valve) -> float:
    """When the pressures are equal enough for the main plunger, s after the command."""
    response = simulate(valve, Drive.of([0.0], [9.0]), [0.0, 1.0])
    return next(event.time for event in response.events if event.kind.name == "LIFTED")


def error(result: Identification, name: str, truth: float) -> float:
    """Of an estimate, in its standard errors."""
    return (result.fit.values[name] - truth) / result.intervals[name].stderr


@pytest.mark.long
def test_the_pilot_orifice_follows_from_pressure_and_command_alone() -> None:
    declared = gas_valve(pilot_orifice_diameter=0.206e-3)
    result = identify([recorded(1)], declared, (ORIFICE,))
    assert abs(error(result, ORIFICE, 0.2e-3)) < 4.0
    assert result.intervals[ORIFICE].stderr < 0.001 * 0.2e-3
    assert result.intervals[ORIFICE].low < 0.2e-3 < result.intervals[ORIFICE].high
    assert lifted(result.valve) == pytest.approx(lifted(gas_valve()), rel=0.02)
    assert abs(lifted(declared) / lifted(gas_valve()) - 1.0) > 0.02
    assert result.rmse_after == pytest.approx(NOISE, rel=0.1)
    assert result.fit.problem.noises["pressure"].sigma == pytest.approx(NOISE, rel=0.15)


def test_a_dead_end_tells_area_over_volume_better_than_either() -> None:
    result = identify([recorded(2)], gas_valve(pilot_orifice_diameter=0.206e-3), (ORIFICE, VOLUME))
    values = result.fit.values
    assert values[ORIFICE] ** 2 / values[VOLUME] == pytest.approx(0.2e-3**2 / 1e-5, rel=2e-3)
    for name, truth in ((ORIFICE, 0.2e-3), (VOLUME, 1e-5)):
        interval = result.intervals[name]
        assert not interval.high - interval.low < 0.05 * truth


def test_a_known_demand_tells_orifice_and_volume_apart() -> None:
    declared = gas_valve(pilot_orifice_diameter=0.204e-3, outlet_volume=1.03e-5, demand_orifice_diameter=0.1e-3)
    result = identify([recorded(3, demand=0.1e-3)], declared, (ORIFICE, VOLUME))
    for name, truth in ((ORIFICE, 0.2e-3), (VOLUME, 1e-5)):
        assert abs(error(result, name, truth)) < 4.0
        assert result.fit.values[name] == pytest.approx(truth, rel=5e-3)


@functools.cache
def clogged(ratio: float, seed: int) -> Fit:
    """A fit with all within its tolerances, begun with a free orifice, of one opening with a clogged one."""
    plant = independent(gas_valve())
    plant.rtol, plant.clogging = 1e-8, ratio
    times = np.arange(1200) * 1e-3
    pressures = plant.run([(0.02, 9.0)], times)[1] + NOISE * np.random.default_rng(seed).standard_normal(len(times))
    nothing = np.empty(0)
    trace = Trace("outlet", Drive.of([0.02], [9.0]), nothing, nothing, outlet_pressure=Signal(times, pressures))
    declared = gas_valve()
    assert declared.gas is not None
    gas = {name: share * getattr(declared.gas, name) for name, share in SHARES.items()}
    known = {name: 0.03 * getattr(declared.parameters, name) for name in ("spring_rate", "spring_preload")}
    plant_of = ValvePlant([trace], replace(declared, tolerances=Tolerances(declared=known, gas=gas)))
    free = ("pilot_damping", "main_damping", CLOGGING)
    return fit(Problem(plant_of), free, {}, nuisances=plant_of.nuisances)


def test_a_clogged_orifice_is_found_although_the_fit_begins_far_away() -> None:
    """Begun with all values free the fit came to no end within its iterations."""
    result = clogged(0.6, seed=4)
    assert result.converged
    assert result.chi2 < 1.2 * len(result.residuals)
    assert max(abs(result.values[own.name] - own.mean) / own.sigma for own in result.nuisances) < 4.0
    assert abs(result.values[CLOGGING] - 0.6) < 4.0 * result.stderr(CLOGGING)


def test_a_clogged_orifice_is_no_better_known_than_what_fills_the_line() -> None:
    """Into a dead end the time to fill tells ratio · C_d · d_p²/V alone, and two of these have tolerances."""
    result = clogged(0.6, seed=4)
    least = 0.6 * math.hypot(2.0 * SHARES["pilot_orifice_diameter"], SHARES["outlet_volume"])
    assert 0.7 * least < result.stderr(CLOGGING) < 2.0 * least


def test_validate_judges_the_pressure() -> None:
    trace = recorded(4)
    right, wrong = (validate([trace], valve) for valve in (gas_valve(), gas_valve(pilot_orifice_diameter=0.206e-3)))
    assert right.passed
    assert not wrong.passed
    assert right.replays[0].noise == pytest.approx(NOISE, rel=0.15)
    report = validation_document(validate([trace], gas_valve(), pressure_tolerance=1e3)).to_json()
    assert not report["passed"]
    assert report["recordings"][0]["tolerance_kpa"] == pytest.approx(1.0)
    assert "kPa" in validation_document(right).to_text()


def test_pressure_beside_positions_is_judged_by_itself() -> None:
    positions, _ = shown()
    trace = replace(recorded(5), times=TIMES, pilot_position=positions)
    right = validate([trace], gas_valve())
    assert [replay.title for replay in right.replays] == ["pilot plunger", "outlet pressure"]
    # 20 % more volume: the plungers wait longer for another pressure.
    wrong = validate([trace], gas_valve(outlet_volume=1.2e-5))
    assert [replay.passed for replay in wrong.replays] == [False, False]


@pytest.mark.long
def test_measured_pressures_of_tank_and_demand_take_the_place_of_the_declared_ones() -> None:
    declared = gas_valve(demand_orifice_diameter=1e-4)
    plant = independent(of_gas(declared, inlet_pressure=33e6, demand_pressure=20e6))
    plant.rtol = 1e-8
    positions, pressures, _ = plant.run([(0.02, 9.0)], TIMES)
    trace = replace(
        recorded(8), times=TIMES, pilot_position=positions, outlet_pressure=Signal(TIMES, pressures),
        inlet_pressure=Signal(TIMES[[0, -1]], np.full(2, 33e6)), demand_pressure=Signal(TIMES[:1], np.full(1, 20e6)),
    )  # fmt: skip
    assert [replay.passed for replay in validate([trace], declared).replays] == [True, True]
    for unknown in ("inlet_pressure", "demand_pressure"):
        assert not validate([replace(trace, **{unknown: None})], declared).replays[1].passed
    # What identification_node publishes beside the measured samples.
    shown = predict(trace, declared, 0.0, "declared").response
    np.testing.assert_allclose(shown.outlet_pressure, pressures, rtol=1e-3)
    np.testing.assert_allclose(shown.pilot_position, positions, atol=3e-6)


def test_channels_are_predicted_at_their_own_times() -> None:
    valve = gas_valve()
    times, later = TIMES[::7] + 1e-4, TIMES[::3]
    trace = replace(
        recorded(6),
        times=times,
        pilot_position=np.zeros(len(times)),
        outlet_pressure=Signal(later, np.ones(len(later))),
    )
    response = [simulate(valve, trace.drive, at, start_time=0.0) for at in (times, later)]
    for delay in (0.0, 2e-3):
        late = {"sensor_delay.delay": delay} if delay else {}
        position, pressure = ValvePlant([trace], valve).predict(late)
        expected = simulate(valve, trace.drive, np.maximum(times - delay, 0.0), start_time=0.0).pilot_position
        np.testing.assert_allclose(position, expected, atol=1e-8)
        np.testing.assert_allclose(pressure, response[1].outlet_pressure, rtol=1e-4)


def test_what_has_no_gas_says_so() -> None:
    bench = replace(gas_valve(), gas=None)
    with pytest.raises(ParameterError, match="outlet's pressure alone"):
        ValvePlant([recorded(1)], bench)
    beside = replace(recorded(1), times=TIMES, pilot_position=np.zeros(len(TIMES)))
    assert [channel.kind for channel in ValvePlant([beside], bench).channels] == ["position"]
    with pytest.raises(ParameterError, match="declares no gas"):
        check_free([ORIFICE], bench)
    check_free([ORIFICE, VOLUME, DEMAND])


def test_the_command_line_records_and_refits_it(tmp_path: Path) -> None:
    def run(*arguments: Any) -> Any:
        return CliRunner().invoke(main, [str(argument) for argument in arguments], catch_exceptions=False)

    save_valve(tmp_path / "true.yaml", gas_valve(), "for a test")
    save_valve(tmp_path / "declared.yaml", gas_valve(pilot_orifice_diameter=0.206e-3), "for a test")
    for name in ("outlet.mcap", "outlet.csv"):
        made = run(
            "simulate", "--params", tmp_path / "true.yaml", "--voltage", 9, "--duration", 0.7, "--rate", 1000,
            "--pressure-noise-kpa", 35, "--noise-um", 1, "--output", tmp_path / name,
        )  # fmt: skip
        assert made.exit_code == 0, made.output
        assert run("info", tmp_path / name, "--json").exit_code == 0
    refitted = run(
        "identify", tmp_path / "outlet.csv", "--params", tmp_path / "declared.yaml", "--free", ORIFICE,
        "--output", tmp_path / "results", "--json",
    )  # fmt: skip
    assert refitted.exit_code == 0, refitted.output
    report = json.loads((tmp_path / "results" / "identify.json").read_text())
    assert report["parameters"][ORIFICE]["value"] == pytest.approx(0.2e-3, rel=2e-3)
    assert report["rmse_kpa"]["after"] == pytest.approx(35.0, rel=0.1)
    for params, code in (("results/identified.yaml", 0), ("declared.yaml", 1)):
        assert run("validate", tmp_path / "outlet.mcap", "--params", tmp_path / params).exit_code == code


@pytest.mark.parametrize("has_gas", [True, False])
def test_a_valve_that_waits_at_the_gap_waits_for_pressure_and_is_not_stuck(*, has_gas: bool) -> None:
    valve = gas_valve() if has_gas else replace(gas_valve(), gas=None)
    segmenter = StrokeSegmenter(valve, MonitorSettings(stroke_timeout=10.0))
    random = np.random.default_rng(0)
    gap = valve.parameters.pilot_gap
    for time in np.arange(0.0, 3.0, 1e-3).tolist():
        if time >= 0.02 > time - 1e-3:
            segmenter.command(0.02, 9.0)
        segmenter.measure(time, (gap if time > 0.03 else 0.0) + 1e-6 * random.standard_normal())
        if time < 0.5 and has_gas:
            assert segmenter.fault is None, "the model waits, too"
    expected = WaitsForPressure if has_gas else OpenedPartly
    assert isinstance(segmenter.fault, expected)
    assert segmenter.fault.travel == pytest.approx(gap, abs=1e-5)
