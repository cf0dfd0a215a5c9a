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

from valve_sim.fleet.columns import BEFORE, MOTION, declared_quantities, effect_column
from valve_sim.fleet.units import Row
from valve_sim.identification.diagnosis.followed_positions import a_standard_error_apart
from valve_sim.identification.fit.declared_values import declared_values, estimate_of
from valve_sim.identification.fit.result import Fit, fit
from valve_sim.identification.fit.unknown import known, unknowns_of
from valve_sim.identification.plants.protocol import Plant
from valve_sim.model import DECLARED, Drive, EventKind, Valve, ValveError, published_times, simulate

HELD: Final = 1.0
"""s for which the reference voltage is on, and then off."""


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
        *published_times(found),
        next(closing, math.nan) - HELD,
    )


_BACK: Final = (EventKind.SEATED, EventKind.BOUNCED_AT_SEAT)


def motion_columns(result: Fit, plant: Plant) -> Row:
    """The motion of the fitted valve, with standard errors by the delta method, by column.

    Raises:
        SimulationError: the fitted valve cannot be simulated.
    """
    at = motion(plant.with_values(result.values))
    variances = np.zeros(len(MOTION))
    for pair in a_standard_error_apart(result):
        try:
            ahead, behind = (np.array(motion(plant.with_values(values))) for values in pair)
        except ValveError:  # beyond what can be declared or simulated: nothing is known of the error
            variances += math.nan
            break
        variances += np.square(0.5 * (ahead - behind))
    found: Row = {}
    for own, value, error in zip(MOTION, at, np.sqrt(variances).tolist(), strict=True):
        if math.isfinite(value):
            found[own.name] = value
            found[own.stderr] = error if math.isfinite(error) else None
    return found


def estimates(result: Fit, plant: Plant) -> Row:
    """Every declared value and every effect of a fitted valve, with standard errors, by column."""
    valve, found = plant.estimated(estimate_of(result)), dict[str, float | None]()
    for name, value in valve.declared().items():
        found[name] = value
    for effect, values in valve.effects.items():
        found.update({effect_column(f"{effect}.{name}"): value for name, value in values.items()})
    found.update(_errors_of_polynomial(valve))
    for declared in declared_values(result):
        column = effect_column(declared.name)
        if column in found and declared.name in (*DECLARED, *_dotted(valve)):
            found[column], found[f"{column}_stderr"] = declared.estimate, declared.stderr
    for name in result.free:
        column = effect_column(name)
        if column in found:
            found[f"{column}_stderr"] = result.stderr(name)
    return {name: value if value is not None and math.isfinite(value) else None for name, value in found.items()}


def with_errors_of_stamps(declared: Fit) -> Fit:
    """A fit with an error of each command's stamp, needed or not, so that all bags are fitted alike.

    Stamps that are 20 µs off, which a recorder's often are, scatter what is estimated six times as much as noise does
    if they are taken as they stand.

    Raises:
        SimulationError: the valve cannot be simulated.
    """
    plant = declared.problem.plant
    unknowns = unknowns_of(plant)
    stamps = [known(own) for own in plant.timing_errors]
    return fit(declared.problem, [*unknowns.base, *unknowns.known, *stamps], declared.values)


def valve_columns(result: Fit, plant: Plant) -> Row:
    """Estimates and motion of a fitted valve, with standard errors, by column.

    Raises:
        SimulationError: that valve cannot be simulated at its reference voltage.
    """
    return {**estimates(result, plant), **motion_columns(result, plant)}


def followed_columns(columns: Row) -> Row:
    """Of the columns of the refitted declared valve, those that are followed, by the names that they then have."""
    names = [own.name for own in (*MOTION, *declared_quantities())]
    return {
        f"{name}{BEFORE}{end}": columns[f"{name}{end}"]
        for name in names
        for end in ("", "_stderr")
        if f"{name}{end}" in columns
    }


def _dotted(valve: Valve) -> list[str]:
    return [f"{effect}.{name}" for effect, values in valve.effects.items() for name in values]


def _errors_of_polynomial(valve: Valve) -> Mapping[str, float | None]:
    covariance = valve.tolerances.attraction_covariance
    if covariance is None:
        return {}
    return {f"a{order}_stderr": math.sqrt(max(0.0, covariance[order][order])) for order in range(len(covariance))}
