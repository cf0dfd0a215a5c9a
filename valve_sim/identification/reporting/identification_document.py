"""The results of `identify` and of `fit-force` as documents."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from valve_sim.identification.diagnosis.identify import Identification, SignalError
from valve_sim.identification.fit.static_force import StaticForce
from valve_sim.identification.plants.effect_titles import capitalised
from valve_sim.identification.plants.protocol import READABLE_UNITS
from valve_sim.identification.reporting.document import (
    Chapter,
    Document,
    Items,
    Line,
    Panel,
    Plot,
    Plots,
    Table,
    TableRow,
)
from valve_sim.identification.reporting.finding_sentences import remarks
from valve_sim.identification.reporting.recording_document import recording_sections
from valve_sim.identification.reporting.units import error_words, in_unit, limits, measured, quantity
from valve_sim.identification.reporting.values import declared_section, intervals_json, remark_on
from valve_sim.model import DECLARED
from valve_sim.model.tolerances import COVARIANCE_NAME

_WORDS: Final = {"current": "the current", "pressure": "the outlet's pressure"}
"""Kinds of signals of a valve, as a sentence has them; outputs of a plant file have their own names."""


def identification_document(result: Identification) -> Document:
    """Values, errors, declared values, and what the data do not determine; errors in the unit of the response."""
    plant, channel, fit = result.plant, result.primary_channel, result.fit
    noise, (scale, unit), findings = fit.problem.noises[channel.kind], channel.readable, remarks(result.findings)
    units = {name: plant.parameter(name).unit for name in result.intervals}
    values = Table(
        ("parameter", "value ± standard error", "95 % interval", "declared"),
        [
            TableRow(
                (
                    name,
                    measured(one, units[name]),
                    limits(one, units[name]),
                    quantity(plant.declared(name), units[name]),
                ),
                note=f"{capitalised(remark)}." if (remark := remark_on(one)) else "",
            )
            for name, one in result.intervals.items()
        ],
    )
    judged, *others = _by_kind(result)
    errors = [
        f"{_change('residual', judged)}; sensor noise {error_words(judged.noise, judged.unit)}",
        *(_change(f"residual of {_WORDS.get(error.kind, error.kind)}", error) for error in others),
    ]
    head = {"schema": "valve_sim/identification/1", "sources": list(result.sources), "unit": unit}
    noise_fields = {
        **in_unit("noise", scale * noise.sigma, unit),
        "noise": {
            **in_unit("sigma", scale * noise.sigma, unit),
            "colour": list(noise.coefficients),
            **in_unit("quantisation", scale * noise.step, unit),
        },
    }
    rest = {
        "clock_offsets_us": [1e6 * fit.values[one.name] for one in plant.nuisances if one.error == "clock_offset"],
        "nuisances": {
            one.name: {"estimate": fit.values[one.name], "unit": one.unit}
            for one in fit.nuisances
            if not one.is_of_machine
        },
        **_errors_json(_by_kind(result)),
        "signals": [asdict(error) for error in result.errors],
        "chi2_per_sample": fit.chi2 / fit.problem.effective_samples,
        "converged": fit.converged,
        "profiles": {
            name: [{"value": value, "rise": rise} for value, rise in curve if math.isfinite(value)]
            for name, curve in result.profiles.items()
        },
        "remarks": findings,
    }
    recording = recording_sections(result.recording, noise.sigma, channel.unit)
    return Document(
        "Identification",
        [
            Chapter(
                "", [values], {**head, **noise_fields, "parameters": intervals_json(result.intervals), "units": units}
            ),
            declared_section(result.declared, is_whole=True),
            Chapter("", [Items(errors)], rest),
            *recording,
            Chapter("", [Items(findings)]),
        ],
    )


def _by_kind(result: Identification) -> list[SignalError]:
    """The errors of each kind of signal together, that by which the model is judged first."""
    kinds = dict.fromkeys([result.primary_channel.kind, *(error.kind for error in result.errors)])
    return [result.error_of(kind) for kind in kinds]


def _errors_json(errors: list[SignalError]) -> dict[str, Any]:
    """Errors of all kinds of signals in the units in which they are read; of those of one unit the first one's."""
    told: dict[str, Any] = {}
    for error in errors:
        scale, unit = READABLE_UNITS.get(error.unit, (1.0, error.unit))
        told = {**in_unit("rmse", {"before": scale * error.before, "after": scale * error.after}, unit), **told}
    return told


def _change(name: str, error: SignalError) -> str:
    before, after = (error_words(own, error.unit) for own in (error.before, error.after))
    return f"{name} {before} as declared, {after} refitted"


def static_force_document(result: StaticForce) -> Document:
    """What `fit-force` says: coefficients, residual, and what they mean for the start of motion."""
    parameters, findings = result.valve.parameters, remarks(result.findings)
    left = result.force - result.predicted
    values = Table(
        ("", "value ± standard error", "95 % interval"),
        [
            TableRow((name, measured(one, DECLARED[name].unit), limits(one, DECLARED[name].unit)))
            for name, one in result.intervals.items()
        ],
    )
    fields = {
        "schema": "valve_sim/static_force/1",
        "source": result.source,
        "samples": len(result.force),
        "voltage": result.voltage,
        "reference_voltage": parameters.reference_voltage,
        "parameters": intervals_json(result.intervals),
        "attraction_polynomial": list(parameters.attraction_polynomial),
        "attraction_covariance": result.valve.tolerances.to_mapping().get(COVARIANCE_NAME, [0.0] * 16),
        "rmse_n": result.rmse,
        "maximum_n": float(np.max(np.abs(left))),
        "r_squared": result.r_squared,
        "remarks": findings,
    }

    def plots() -> list[Plot]:
        order = np.argsort(result.displacement)
        attraction = Panel(
            f"attraction at {result.voltage:g} V, N",
            [Line("measured", result.force[order], has_dots=True), Line("polynomial", result.predicted[order])],
        )
        residual = Panel("measured − polynomial, N", [Line("residual", left[order], has_dots=True)], has_zero=True)
        title = f"{result.source}: residual {result.rmse:.3g} N rms"
        return [Plot(title, "", 1e6 * result.displacement[order], "displacement, µm", [attraction, residual])]

    title = f"{result.source}: {len(result.force)} points at {result.voltage:g} V"
    end = f"residual {result.rmse:.3g} N (rms), R² {result.r_squared:.6f}"
    return Document("fit-force", [Chapter(title, [values, Plots(plots), Items([end, *findings])], fields)])
