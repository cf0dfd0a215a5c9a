"""The result of `identify`, as JSON and as text for the terminal."""

from __future__ import annotations

import math
from typing import Any

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.diagnosis.identify import Identification
from valve_sim.identification.plants.protocol import KEY_OF_UNIT
from valve_sim.identification.reporting.declared_values import declared_json, declared_lines
from valve_sim.identification.reporting.findings import remarks
from valve_sim.identification.reporting.intervals import interval_lines, intervals_json
from valve_sim.identification.reporting.recording_state import recording_json, recording_lines
from valve_sim.identification.reporting.units import three_digits


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
