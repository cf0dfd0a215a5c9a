"""Findings on a fit beside its values, as data: what the data do not determine, and what else is wrong."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from valve_sim.identification.fit.errors.clocks import INPUT_EDGES
from valve_sim.identification.fit.intervals import Interval, Unbounded
from valve_sim.identification.fit.recorded_errors import OF_CLOCKS, RecordedError
from valve_sim.identification.fit.result import Fit

CORRELATED: Final = 0.95
"""Correlation above which two parameters can hardly be told apart: either is known three times worse than it would be
with the other one known."""
WEAK: Final = 0.25
"""A parameter is loosely determined if its 95 % interval is wider than this share of its value and declared value."""
TOO_MUCH: Final = 5.0
"""Standard deviations of χ² beyond which the residual is larger than the noise."""


@dataclass(frozen=True)
class NotIdentifiable:
    """The data do not bound a freed parameter, and why."""

    name: str
    reason: Unbounded


@dataclass(frozen=True)
class OnBound:
    """A freed parameter ended on the "lower" or "upper" bound of its range."""

    name: str
    bound: str


@dataclass(frozen=True)
class LooselyDetermined:
    """The 95 % interval of a freed parameter, low to high in its unit, is wide beside its value."""

    name: str
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Correlated:
    """A freed parameter whose estimate is correlated with that of another parameter by more than `CORRELATED`."""

    name: str
    other: str
    correlation: float


@dataclass(frozen=True)
class StampErrors:
    """The commands' stamps were estimated, each by itself; largest: s, beside the clock offset."""

    largest: float


@dataclass(frozen=True)
class LacksSomething:
    """Something that the model lacks acts, with this probability."""

    probability: float


@dataclass(frozen=True)
class ExplainedByErrors:
    """The model leaves no more than noise beside errors of the recordings, which may be what the model lacks."""


@dataclass(frozen=True)
class NotConverged:
    """The solver ended at its limit of iterations."""


Finding: TypeAlias = (
    NotIdentifiable
    | OnBound
    | LooselyDetermined
    | Correlated
    | StampErrors
    | LacksSomething
    | ExplainedByErrors
    | NotConverged
)


def findings(
    result: Fit, intervals: Mapping[str, Interval], errors: Iterable[RecordedError] = (), lacking: float = 0.0
) -> tuple[Finding, ...]:
    """All findings on a fit: by freed parameter first, then on the whole of it.

    Args:
        result: the fit.
        intervals: of its freed parameters, by name.
        errors: of the recordings, as the fit has them.
        lacking: probability that the model lacks something, where that is said; else 0.
    """
    return (*_on_parameters(result, intervals), *_on_the_whole(result, errors, lacking))


def leaves_more_than_noise(result: Fit) -> bool:
    """Whether χ² exceeds what noise gives it by 5 %, and by more than `TOO_MUCH` of its standard deviations.

    These include that the noise itself is known from a limited number of quiet samples only.
    """
    samples, quiet = result.problem.effective_samples, [noise.samples for noise in result.problem.noises.values()]
    left = result.chi2 / samples - 1.0
    return left > max(0.05, TOO_MUCH * math.sqrt(2.0 / samples + 2.0 / max(1, min(quiet))))


def _on_parameters(result: Fit, intervals: Mapping[str, Interval]) -> Iterator[Finding]:
    plant, correlation = result.problem.plant, result.correlation()
    reported = set()
    for index, name in enumerate(result.free):
        interval, bound = intervals[name], result.on_bound(name)
        if interval.unbounded is not None:
            yield NotIdentifiable(name, interval.unbounded)
        elif bound is not None:
            yield OnBound(name, bound)
        elif interval.high - interval.low > WEAK * max(abs(interval.value), abs(plant.declared(name))):
            yield LooselyDetermined(name, interval.low, interval.high, plant.parameter(name).unit)
        others = [(abs(float(correlation[index, j])), other) for j, other in enumerate(result.free) if j != index]
        strongest, other = max(others, default=(0.0, ""))
        if strongest > CORRELATED and (pair := frozenset((name, other))) not in reported:
            reported.add(pair)
            yield Correlated(name, other, strongest)


def _on_the_whole(result: Fit, errors: Iterable[RecordedError], lacking: float) -> Iterator[Finding]:
    stamps = {own.name for own in result.problem.plant.timing_errors if own.error != INPUT_EDGES.name}
    timing = [abs(result.values[nuisance.name]) for nuisance in result.nuisances if nuisance.name in stamps]
    if timing:
        yield StampErrors(max(timing))
    if lacking:
        yield LacksSomething(lacking)
    elif any(own.is_likely and own.error not in OF_CLOCKS for own in errors):
        yield ExplainedByErrors()
    if not result.converged:
        yield NotConverged()
