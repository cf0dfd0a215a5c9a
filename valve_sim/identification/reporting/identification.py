"""The results of `identify` and of `fit-force`, as JSON and as text for the terminal."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.diagnosis.identify import Identification, SignalError
from valve_sim.identification.fit.static_force import StaticForce
from valve_sim.identification.plants.protocol import READABLE_UNITS
from valve_sim.identification.reporting.declared_values import declared_json, declared_lines
from valve_sim.identification.reporting.findings import interval_lines, intervals_json, remarks
from valve_sim.identification.reporting.recording_state import recording_json, recording_lines
from valve_sim.identification.reporting.units import in_unit, three_digits
from valve_sim.model import DECLARED
from valve_sim.model.tolerances import COVARIANCE_NAME

_WORDS: Final = {"current": "the current", "pressure": "the outlet's pressure"}
"""Kinds of signals of a valve, as a sentence has them; outputs of a plant file have their own names."""


def identification_json(result: Identification) -> dict[str, Any]:
    """The content of identify.json; errors in `unit`, as of report.json, and of each signal in SI."""
    plant, channel = result.plant, result.primary_channel
    noise = result.fit.problem.noises[channel.kind]
    scale, unit = channel.readable
    report = {
        "schema": "valve_sim/identification/1",
        "sources": list(result.sources),
        "unit": unit,
        # noise_um, and in place of the plain number all that is known of the noise.
        **in_unit("noise", scale * noise.sigma, unit),
        "noise": {
            **in_unit("sigma", scale * noise.sigma, unit),
            "colour": list(noise.coefficients),
            **in_unit("quantisation", scale * noise.step, unit),
        },
        "parameters": intervals_json(result.intervals),
        "units": {name: plant.parameter(name).unit for name in result.intervals},
        **declared_json(result.declared),
        "recording": recording_json(result.recording),
        "clock_offsets_us": [
            1e6 * result.fit.values[nuisance.name]
            for nuisance in plant.nuisances
            if nuisance.name.startswith("clock_offset")
        ],
        "nuisances": {
            own.name: {"estimate": result.fit.values[own.name], "unit": own.unit}
            for own in result.fit.nuisances
            if not own.is_of_machine
        },
        **_errors_json(result),
        "signals": [asdict(own) for own in result.errors],
        "chi2_per_sample": result.fit.chi2 / result.fit.problem.effective_samples,
        "converged": result.fit.converged,
        "profiles": {
            name: [{"value": value, "rise": rise} for value, rise in curve if math.isfinite(value)]
            for name, curve in result.profiles.items()
        },
        "remarks": remarks(result.findings),
    }
    return plain_mapping(report)


def _errors_json(result: Identification) -> dict[str, Any]:
    """Errors of all kinds of signals in the units in which they are read; of those of one unit the first one's."""
    found: dict[str, Any] = {}
    for own in (result.error_of(result.primary_channel.kind), *_others(result)):
        scale, unit = READABLE_UNITS.get(own.unit, (1.0, own.unit))
        found = {**in_unit("rmse", {"before": scale * own.before, "after": scale * own.after}, unit), **found}
    return found


def _others(result: Identification) -> list[SignalError]:
    """What a model is not judged by, each kind of signal together."""
    kinds = dict.fromkeys(own.kind for own in result.errors if own.kind != result.primary_channel.kind)
    return [result.error_of(kind) for kind in kinds]


def identification_text(result: Identification) -> str:
    """A report for the terminal: values, errors, declared values, and what the data do not determine."""
    lines = interval_lines(result.plant, result.intervals, 30)
    lines += declared_lines(result.declared)
    judged = result.error_of(result.primary_channel.kind)
    lines.append(f"{_change('residual', judged)}; sensor noise {_readable(judged.noise, judged.unit)}")
    lines += [_change(f"residual of {_WORDS.get(own.kind, own.kind)}", own) for own in _others(result)]
    return "\n".join([*lines, *recording_lines(result.recording), *remarks(result.findings)])


def _change(name: str, own: SignalError) -> str:
    before, after = _readable(own.before, own.unit), _readable(own.after, own.unit)
    return f"{name} {before} as declared, {after} refitted"


def _readable(value: float, si: str) -> str:
    scale, unit = READABLE_UNITS.get(si, (1.0, si))
    return f"{three_digits(scale * value)} {unit}"


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
