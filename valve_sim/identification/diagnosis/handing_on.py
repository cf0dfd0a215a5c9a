"""Which values of a fit may be set on a valve that runs: those that the data determine, if they predict no worse."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.identification.diagnosis.identify import signal_errors
from valve_sim.identification.fit.declared_values import estimate_of
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.fit.result import Fit
from valve_sim.model import Valve

WIDEST: Final = 1.0
"""Width of a 95 % interval over the value, or the declared value, beyond which the data do not determine it."""
NARROWED: Final = 0.5
"""Standard error over the tolerance of a declared value, below which the data say more of it than its tolerance."""
NO_WORSE: Final = 1.0 + 1e-6
"""Misfit over that of the declared values."""


class HandedOn(NamedTuple):
    """What may be set on a valve.

    Attributes:
        valve: the declared one with the values that the data determine. held: names of those that stay as declared.
        objection: why nothing should be set; empty where nothing speaks against it.
    """

    valve: Valve
    held: tuple[str, ...]
    objection: str


def handed_on(result: Fit, intervals: Mapping[str, Interval]) -> HandedOn:
    """What of a fit may be set on a valve that runs.

    Raises:
        SimulationError: the valve cannot be simulated with these values.
    """
    plant = result.problem.plant
    known = determined(result, intervals)
    held = tuple(name for name in (*result.free, *_of_machine(result)) if name not in known)
    if not set(known) & set(result.free):
        return HandedOn(plant.with_values({}), held, f"the recording does not determine {', '.join(result.free)}")
    refitted = tuple(name for name in held if name in result.free)
    if not refitted:
        return HandedOn(plant.estimated(estimate_of(result)), (), "")
    values = {name: result.values[name] for name in known}
    rest = {own.name: own.mean for own in result.nuisances if own.is_of_machine and own.name not in known}
    recording = {own.name: result.values[own.name] for own in result.nuisances if not own.is_of_machine}
    before, after = (_misfit(result, {**recording, **own}) for own in ({}, {**rest, **values}))
    worse = "the values that the recording determines do not predict it better by themselves"
    return HandedOn(plant.with_values(values), held, "" if after <= NO_WORSE * before else worse)


def determined(result: Fit, intervals: Mapping[str, Interval]) -> tuple[str, ...]:
    """The refitted values, and declared values within tolerances, that the data determine.

    Of an effect all values are determined, or none: those that switch it decide, and shapes go with them.
    """
    plant, known = result.problem.plant, []
    switches = {
        name: [free for free, own in zip(effect.free_names(), effect.parameters, strict=True) if own.off is not None]
        for effect in plant.effects.values()
        for name in effect.free_names()
    }
    for name in result.free:
        decisive = [own for own in switches.get(name, []) if own in intervals] or [name]
        if all(_is_determined(result, own, intervals[own]) for own in decisive):
            known.append(name)
    return (*known, *_of_machine(result))


def _is_determined(result: Fit, name: str, found: Interval) -> bool:
    """Whether an interval is bounded by the data, narrow beside the value, and away from where nothing is changed."""
    plant = result.problem.plant
    off = plant.parameter(name).off
    if found.unbounded is not None or result.on_bound(name) is not None:
        return False
    if off is not None and math.isfinite(off) and found.low <= off <= found.high:
        return False
    size = max(abs(found.value), abs(plant.declared(name)) if math.isfinite(plant.declared(name)) else 0.0)
    return found.high - found.low <= WIDEST * size


def _of_machine(result: Fit) -> tuple[str, ...]:
    """Declared values within tolerances of which the data say more than these."""
    variances = {name: float(result.covariance[at, at]) for at, name in enumerate(result.names)}
    return tuple(
        own.name
        for own in result.nuisances
        if own.is_of_machine and math.sqrt(max(0.0, variances[own.name])) <= NARROWED * own.sigma
    )


def _misfit(result: Fit, values: Mapping[str, float]) -> float:
    """Sum of squared errors of all signals with these values, each in its noise."""
    errors = signal_errors(result, values={**{own.name: own.mean for own in result.nuisances}, **values})
    return math.fsum(own.count * (own.after / own.noise) ** 2 for own in errors if own.count)
