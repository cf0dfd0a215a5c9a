"""What is followed over time: the motion of an identified valve at one voltage, and every value that was estimated.

Two bags seldom hold the same strokes, and the times of a stroke depend on its voltage. The identified valve has both
behind it: simulated at its reference voltage, from rest, it gives times that can be compared, each with the error that
follows from the covariance of what was estimated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.fleet.columns import MOTION, effect_column
from valve_sim.fleet.units import Row
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import from_internal
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import DECLARED, Drive, EventKind, SimulationError, Valve, ValveError, simulate

HELD: Final = 1.0
"""s for which the reference voltage is on, and then off."""
STEP: Final = 0.5
"""Standard errors by which an estimate is varied for its derivative."""
LEAST_INFORMATION: Final = 1e-12
"""Smallest eigenvalue of the scaled information that is not rounding."""

Array = NDArray[np.float64]


def motion(valve: Valve) -> tuple[float, ...]:
    """(4,) s, in the order of `columns.MOTION`; nan where the valve does not get there.

    Raises:
        SimulationError: the valve cannot be simulated.
    """
    drive = Drive.of([0.0, HELD], [valve.parameters.reference_voltage, 0.0])
    found = simulate(valve, drive, [0.0, 2.0 * HELD])
    closing = (event.time for event in found.events if event.kind in _BACK and event.time >= HELD)
    return (
        found.first(EventKind.UNSEATED),
        found.first(EventKind.PICKED_UP, EventKind.HELD_AT_GAP),
        found.first(EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP),
        next(closing, math.nan) - HELD,
    )


_BACK: Final = (EventKind.SEATED, EventKind.BOUNCED_AT_SEAT)


def motion_columns(result: Fit, plant: ValvePlant) -> Row:
    """The motion of the fitted valve, with standard errors, by column."""
    known = result.machine
    at = motion(plant.with_values(result.values))
    covariance = _covariance(known.information) * result.problem.variance_inflation
    slopes = np.zeros((len(MOTION), len(known.names)))
    for index, name in enumerate(known.names):
        error = math.sqrt(covariance[index, index])
        slopes[:, index] = _slope(result, plant, name, float(known.coordinates[index]), STEP * error)
    errors = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))
    found: Row = {}
    for own, value, error in zip(MOTION, at, errors.tolist(), strict=True):
        if math.isfinite(value):
            found[own.name] = value
            found[own.stderr] = error if math.isfinite(error) else None
    return found


def _slope(result: Fit, plant: ValvePlant, name: str, at: float, step: float) -> Array:
    """(4,) derivative of the motion by an internal coordinate; nan where the valve beside it cannot be simulated."""

    def shifted(by: float) -> Array:
        value = from_internal(plant.parameter(name), at + by) if name in result.free else at + by
        return np.array(motion(plant.with_values({**result.values, name: value})))

    try:
        return (shifted(step) - shifted(-step)) / (2.0 * step) if step > 0.0 else np.zeros(len(MOTION))
    except (SimulationError, ValveError):
        return np.full(len(MOTION), math.nan)


def _covariance(information: Array) -> Array:
    """(k, k); directions that nothing is known of are left out, as they move nothing that was measured."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    sizes, directions = np.linalg.eigh(information * np.outer(scale, scale))
    inverse = np.where(sizes > LEAST_INFORMATION, 1.0 / np.maximum(sizes, LEAST_INFORMATION), 0.0)
    return np.asarray((directions * inverse) @ directions.T * np.outer(scale, scale))


def estimates(diagnosis: Diagnosis) -> Row:
    """Every declared value and every effect of the corrected valve, with standard errors, by column."""
    fit, found = diagnosis.after.fit, dict[str, float | None]()
    valve = diagnosis.valve
    for name, value in valve.declared().items():
        found[name] = value
    for effect, values in valve.effects.items():
        found.update({effect_column(f"{effect}.{name}"): value for name, value in values.items()})
    found.update(_errors_of_polynomial(valve))
    for declared in diagnosis.declared:
        column = effect_column(declared.name)
        if column in found and declared.name in (*DECLARED, *_dotted(valve)):
            found[column], found[f"{column}_stderr"] = declared.estimate, declared.stderr
    for name in fit.free:
        column = effect_column(name)
        if column in found:
            found[f"{column}_stderr"] = fit.stderr(name)
    return {name: value if value is not None and math.isfinite(value) else None for name, value in found.items()}


def _dotted(valve: Valve) -> list[str]:
    return [f"{effect}.{name}" for effect, values in valve.effects.items() for name in values]


def _errors_of_polynomial(valve: Valve) -> Mapping[str, float | None]:
    covariance = valve.tolerances.attraction_covariance
    if covariance is None:
        return {}
    return {f"a{order}_stderr": math.sqrt(max(0.0, covariance[order][order])) for order in range(len(covariance))}
