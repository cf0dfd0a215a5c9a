"""The result of `identify`, as JSON and as text for the terminal."""

from __future__ import annotations

import math
from typing import Any

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.estimation.identify import Identification
from valve_sim.identification.reporting.declared_values import declared_json, declared_lines
from valve_sim.identification.reporting.findings import remarks
from valve_sim.identification.reporting.interval_json import intervals_json
from valve_sim.identification.reporting.units import limits, measured, quantity


def identification_json(result: Identification) -> dict[str, Any]:
    """The content of identify.json."""
    noise = result.fit.problem.noises["position"]
    report = {
        "schema": "valve_sim/identification/1",
        "sources": list(result.sources),
        "noise_um": 1e6 * noise.sigma,
        "noise": {
            "sigma_um": 1e6 * noise.sigma,
            "colour": list(noise.coefficients),
            "quantisation_um": 1e6 * noise.step,
        },
        "parameters": intervals_json(result.intervals),
        **declared_json(result.declared),
        "clock_offsets_us": [
            1e6 * result.fit.values[nuisance.name]
            for nuisance in result.fit.problem.plant.nuisances
            if nuisance.name.startswith("clock_offset")
        ],
        "rmse_um": {"before": 1e6 * result.rmse_before, "after": 1e6 * result.rmse_after},
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
    lines = [f"{'parameter':<28}{'value ± standard error':<30}{'95 % interval':<30}declared"]
    for name, interval in result.intervals.items():
        unit, declared = plant.parameter(name).unit, plant.declared(name)
        found = f"{measured(interval, unit):<30}{limits(interval, unit):<30}"
        lines.append(f"{name:<28}{found}{quantity(declared, unit)}")
    lines += declared_lines(result.declared)
    noise = result.fit.problem.noises["position"]
    lines.append(
        f"residual {1e6 * result.rmse_before:.3g} µm as declared, {1e6 * result.rmse_after:.3g} µm refitted; "
        f"sensor noise {1e6 * noise.sigma:.3g} µm"
    )
    return "\n".join([*lines, *remarks(result.findings)])
