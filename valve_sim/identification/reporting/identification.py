"""The results of `identify` and of `fit-force`, as JSON and as text for the terminal."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.diagnosis.identify import Identification
from valve_sim.identification.estimation.static_force import StaticForce
from valve_sim.identification.plants.protocol import KEY_OF_UNIT
from valve_sim.identification.reporting.declared_values import declared_json, declared_lines
from valve_sim.identification.reporting.findings import interval_lines, intervals_json, remarks
from valve_sim.identification.reporting.recording_state import recording_json, recording_lines
from valve_sim.identification.reporting.units import three_digits
from valve_sim.model import DECLARED
from valve_sim.model.tolerances import COVARIANCE_NAME


def identification_json(result: Identification) -> dict[str, Any]:
    """The content of identify.json."""
    noise = result.fit.problem.noises[result.primary_channel.kind]
    scale, unit = result.primary_channel.readable
    key = KEY_OF_UNIT[unit]
    errors = {f"rmse_{key}": {"before": scale * result.rmse_before, "after": scale * result.rmse_after}}
    if not math.isnan(result.current_after):
        errors["rmse_ma"] = {"before": 1e3 * result.current_before, "after": 1e3 * result.current_after}
    if not math.isnan(result.pressure_after):
        errors["rmse_kpa"] = {"before": 1e-3 * result.pressure_before, "after": 1e-3 * result.pressure_after}
    report = {
        "schema": "valve_sim/identification/1",
        "sources": list(result.sources),
        f"noise_{key}": scale * noise.sigma,
        "noise": {
            f"sigma_{key}": scale * noise.sigma,
            "colour": list(noise.coefficients),
            f"quantisation_{key}": scale * noise.step,
        },
        "parameters": intervals_json(result.intervals),
        **declared_json(result.declared),
        "recording": recording_json(result.recording),
        "clock_offsets_us": [
            1e6 * result.fit.values[nuisance.name]
            for nuisance in result.fit.problem.plant.nuisances
            if nuisance.name.startswith("clock_offset")
        ],
        **errors,
        "chi2_per_sample": result.fit.chi2 / result.fit.problem.effective_samples,
        "converged": result.fit.converged,
        "profiles": {
            name: [{"value": value, "rise": rise} for value, rise in curve if math.isfinite(value)]
            for name, curve in result.profiles.items()
        },
        "remarks": remarks(result.findings),
    }
    return plain_mapping(report)


def identification_text(result: Identification) -> str:
    """A report for the terminal: values, errors, declared values, and what the data do not determine."""
    plant = result.fit.problem.plant
    lines = interval_lines(plant, result.intervals, 30)
    lines += declared_lines(result.declared)
    noise = result.fit.problem.noises[result.primary_channel.kind]
    scale, unit = result.primary_channel.readable
    lines.append(
        f"{_change('residual', scale * result.rmse_before, scale * result.rmse_after, unit)}; "
        f"sensor noise {three_digits(scale * noise.sigma)} {unit}"
    )
    if result.primary_channel.kind != "current" and not math.isnan(result.current_after):
        lines.append(_change("residual of the current", 1e3 * result.current_before, 1e3 * result.current_after, "mA"))
    if result.primary_channel.kind != "pressure" and not math.isnan(result.pressure_after):
        before, after = 1e-3 * result.pressure_before, 1e-3 * result.pressure_after
        lines.append(_change("residual of the outlet's pressure", before, after, "kPa"))
    return "\n".join([*lines, *recording_lines(result.recording), *remarks(result.findings)])


def _change(name: str, before: float, after: float, unit: str) -> str:
    return f"{name} {three_digits(before)} {unit} as declared, {three_digits(after)} {unit} refitted"


def static_force_json(result: StaticForce) -> dict[str, Any]:
    """The content of fit-force.json."""
    report = {
        "schema": "valve_sim/static_force/1",
        "source": result.source,
        "samples": len(result.force),
        "voltage": result.voltage,
        "reference_voltage": result.valve.parameters.reference_voltage,
        "parameters": intervals_json(result.intervals),
        "attraction_polynomial": list(result.valve.parameters.attraction_polynomial),
        "attraction_covariance": result.valve.tolerances.to_mapping().get(COVARIANCE_NAME, [0.0] * 16),
        "rmse_n": result.rmse,
        "maximum_n": float(np.max(np.abs(result.force - result.predicted))),
        "r_squared": result.r_squared,
        "remarks": remarks(result.findings),
    }
    return plain_mapping(report)


def static_force_text(result: StaticForce) -> str:
    """The report of a static force for the terminal."""
    lines = [f"{result.source}: {len(result.force)} points at {result.voltage:g} V"]
    lines.append(f"{'':<5}{'value':>12} {'± std. error':>14}   95 % interval")
    for name, interval in result.intervals.items():
        lines.append(
            f"{name:<5}{interval.value:>12.5g} ± {interval.stderr:<12.2g}   "
            f"[{interval.low:.5g}, {interval.high:.5g}] {DECLARED[name].unit}"
        )
    lines.append(f"residual {result.rmse:.3g} N (rms), R² {result.r_squared:.6f}")
    return "\n".join([*lines, *remarks(result.findings)])
