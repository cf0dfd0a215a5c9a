"""What a printed event table determines of a valve, and what not: `valve-sim diagnose --events TABLE`.

With two numbers no test of residuals is possible: every pair of effects with two amplitudes may fit exactly. So this
page claims no effect. It lists which effects close the table, one by one and in pairs; shows the region of parameters
that fit equally well; and ranks measurements by how far members of that region disagree on them.
"""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.intervals import CHI2_RISE_95
from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.priors import Elsewhere, Prior
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.event_table import EventPlant, EventTable, reached
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.identification.selection.posterior import Set
from valve_sim.identification.selection.search import Search
from valve_sim.model import CATALOGUE, Drive, EventKind, ParameterError, Response, Tolerances, Valve, simulate

Progress = Callable[[str, float], None]

PULLS: Final = ("rest_attraction.force", "coil_lag.time_constant")
"""What is fitted at each pair of dampings, to draw the region in all four."""
DAMPING_AXIS: Final = np.concatenate([[0.0], np.logspace(-1.0, 3.0, 33)])
"""N·s/m: 0, and 0.1 to 1000 in steps of a third."""
SHARE: Final = 1e-3
"""Relative step of a difference quotient."""
COVARIANCE_DIGITS: Final = 6
"""Significant digits of a variance in the parameter file."""
ROUNDED: Final = 5
"""Significant digits that go into the parameter file: far finer than any table's standard error."""
CLOSE: Final = 1e-5
"""s: an event this near its measured time counts as met."""
MEMBERS: Final = 40
"""How many members of the region predict the further measurements."""
FORCE_ERROR, TIME_ERROR, POSITION_ERROR = 0.05, 0.05, 1.0
"""N (the paper's load cell, ±0.25 % of 19.1 N), ms (the table's own) and µm (a laser sensor's noise): assumed."""


def declared_counterparts() -> dict[str, tuple[str, str]]:
    """Effects that only change a declared value: file key and declared scalar that they are added to."""
    return {
        f"{effect.name}.{parameter}": ("attraction_polynomial" if declared == "a0" else declared, declared)
        for effect in CATALOGUE.values()
        for parameter, declared in effect.adds_to.items()
    }


class Candidate(NamedTuple):
    """Effects that were added to the declared valve and fitted.

    Attributes:
        effects: their names. values: of their parameters.
        times: s, when each event then happens; nan where it does not. chi2: Σ (error/uncertainty)².
        closes: whether every event is met within `CLOSE`.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    times: tuple[float, ...]
    chi2: float
    closes: bool


@dataclass(frozen=True)
class Region:
    """All that fits the table as well as the best does.

    Attributes:
        pilot_damping, main_damping: (m,), (n,) N·s/m, the grid.
        rest_attraction: (m, n) N, and coil_lag: (m, n) s: what the events then ask for.
        chi2: (m, n). allowed: (m, n) chi2 within the 95 % level, and no more pull at rest than was ever measured.
    """

    pilot_damping: Array
    main_damping: Array
    rest_attraction: Array
    coil_lag: Array
    chi2: Array
    allowed: np.typing.NDArray[np.bool_]

    def profile(self, name: str, *, capped: bool) -> Array:
        """The lowest χ² at each value of a damping, all else free; `capped`: infinite outside `allowed`."""
        chi2 = np.where(self.allowed, self.chi2, math.inf) if capped else self.chi2
        return np.asarray(chi2.min(axis=1 if name == DAMPINGS[0] else 0))

    def interval(self, name: str, *, capped: bool) -> tuple[float, float]:
        """The damping's 95 % interval, to the resolution of the grid, N·s/m; infinite where the grid ends first."""
        axis = getattr(self, name)
        inside = axis[self.profile(name, capped=capped) < CHI2_RISE_95]
        return float(inside[0]), math.inf if inside[-1] == axis[-1] else float(inside[-1])


class Quantity(enum.Enum):
    """What could be measured besides the events of the table."""

    STATIC_ATTRACTION = enum.auto()
    """At the largest gap."""
    CURRENT_TIME_CONSTANT = enum.auto()
    """Of the coil."""
    ARRIVAL = enum.auto()
    """When the last event of the table happens at `volts`."""
    CLOSING_TIME = enum.auto()
    """After release from `volts`."""
    DISPLACEMENT = enum.auto()
    """At `volts`, `time` after the command."""


class FurtherMeasurement(NamedTuple):
    """A measurement not made yet: what members of the region predict for it, and how well it could be measured.

    Attributes:
        quantity: what is measured, at `volts` (V), after `time` (s) and of the event of that name, where it has them.
        lowest, highest, uncertainty: in `unit`.
    """

    quantity: Quantity
    lowest: float
    highest: float
    uncertainty: float
    unit: str
    volts: float = math.nan
    time: float = math.nan
    event: str = ""

    @property
    def power(self) -> float:
        """Spread of the predictions, in standard errors of the measurement."""
        return (self.highest - self.lowest) / self.uncertainty


@dataclass(frozen=True)
class EventDiagnosis:
    """The outcome of `diagnose_events`.

    Attributes:
        declared: the declared valve as it stands. singles, pairs: best first, only those in which an event happens.
        shipped: the candidate whose values go into the parameter file, rounded. valve: the valve with them.
        standard_errors: of these values by those of the table's times, the dampings taken as declared; they are
            tolerances of the valve, where the declared one has any.
        largest_attraction: N, of that valve while it opens.
        region: what fits equally well. measurements: that would narrow it, the most informative first.
    """

    table: EventTable
    declared: Candidate
    singles: tuple[Candidate, ...]
    pairs: tuple[Candidate, ...]
    shipped: Candidate
    standard_errors: Mapping[str, float]
    valve: Valve
    largest_attraction: float
    region: Region
    measurements: tuple[FurtherMeasurement, ...]

    def errors(self, entry: Candidate) -> list[float]:
        """Predicted less measured time of each event, s; nan where it does not happen."""
        return [time - event.time for time, event in zip(entry.times, self.table.events, strict=True)]


def diagnose_events(table: EventTable, progress: Progress | None = None) -> EventDiagnosis:
    """Which effects close an event table, and what it leaves open.

    Args:
        table: the measurement and the declared valve.
        progress: told what is being tried, and the fraction done.

    Raises:
        ParameterError: `ship` names effects that do not close the table.
        SimulationError: the declared valve cannot be simulated.
    """
    say = progress or (lambda what, fraction: None)
    plant = EventPlant(table)
    search = Search(event_problem(plant))
    declared = _candidate(plant, search, ())
    names = tuple(plant.effects)
    singles = [_candidate(plant, search, (name,)) for name in names]
    pairs = []
    for index, pair in enumerate(itertools.combinations(names, 2)):
        say(" + ".join(pair), 0.3 * index / (len(names) * (len(names) - 1) / 2))
        pairs.append(_candidate(plant, search, pair))
    shipped, errors, valve = _shipped(plant, _candidate(plant, search, table.ship))
    say("what stays open", 0.3)
    region = _region(plant, lambda fraction: say("what stays open", 0.3 + 0.6 * fraction))
    say("what would decide", 0.95)
    response = simulate(valve, table.drive, np.arange(0.0, table.horizon, 1e-5))
    return EventDiagnosis(
        table, declared, _happening(singles), _happening(pairs), shipped, errors, valve,
        float(np.max(response.attraction)), region, _further_measurements(plant, region),
    )  # fmt: skip


def event_problem(plant: EventPlant) -> Problem:
    """The fit's problem, with the standard errors of the table for noise."""
    noises = {
        channel.kind: Noise(event.uncertainty, event.uncertainty, (), 0.0, 0)
        for channel, event in zip(plant.channels, plant.table.events, strict=True)
    }
    return _OfEvents(plant, noises=noises)


class _OfEvents(Problem):
    """Two events and as many values: it is asked what meets them, however large."""

    def prior(self, name: str) -> Prior:
        """None."""
        return Elsewhere()


def _candidate(plant: EventPlant, search: Search, effects: Sequence[str]) -> Candidate:
    """The best fit of some effects, tried again from scattered starts where it misses although the valve opens."""
    names: Set = tuple(sorted(effects))
    result = search.fit(names)
    times = plant.times(result.values)
    if effects and not _meets(plant, times) and not any(math.isnan(time) for time in times):
        result = search.fit(names, polish=True)
    return _as_candidate(plant, effects, result.values)


def _as_candidate(plant: EventPlant, effects: Sequence[str], values: Mapping[str, float]) -> Candidate:
    times = tuple(plant.times(values))
    residuals = event_problem(plant).residuals(values)
    return Candidate(tuple(effects), dict(values), times, float(residuals @ residuals), _meets(plant, times))


def _meets(plant: EventPlant, times: Sequence[float]) -> bool:
    return all(abs(time - event.time) < CLOSE for time, event in zip(times, plant.table.events, strict=True))


def _happening(candidates: Sequence[Candidate]) -> tuple[Candidate, ...]:
    """Those in which all events happen, best first."""
    return tuple(sorted((c for c in candidates if not any(map(math.isnan, c.times))), key=lambda c: c.chi2))


def _shipped(plant: EventPlant, candidate: Candidate) -> tuple[Candidate, dict[str, float], Valve]:
    """The candidate with rounded values, their standard errors, and the declared valve with both folded in.

    Raises:
        ParameterError: it does not close the table, or is more than another declared value.
    """
    source, words = plant.table.source, " + ".join(candidate.effects)
    if not candidate.closes:
        raise ParameterError(f"{source}: ship: {words} does not close the table; expected effects that do")
    folded = declared_counterparts()
    strange = [name for name in candidate.values if name not in folded]
    if strange:
        known = " or ".join(name.partition(".")[0] for name in folded)
        raise ParameterError(f"{source}: ship: {strange[0]} is no declared value; expected {known}")
    rounded = {name: float(f"{value:.{ROUNDED}g}") for name, value in _refined(plant, candidate.values).items()}
    declared = plant.table.valve.declared()
    values = {folded[name][1]: declared[folded[name][1]] + value for name, value in rounded.items()}
    errors = _standard_errors(plant, rounded)
    valve = plant.table.valve.with_values(**values)
    tolerances = _calibrated(valve.tolerances, {folded[name][1]: error for name, error in errors.items()})
    return _as_candidate(plant, candidate.effects, rounded), errors, replace(valve, tolerances=tolerances)


def _standard_errors(plant: EventPlant, values: Mapping[str, float]) -> dict[str, float]:
    """Standard errors of values that meet the events, by those of the events, to two digits."""
    problem = event_problem(plant)
    columns = []
    for name, value in values.items():
        above, below = (problem.residuals({**values, name: value * factor}) for factor in (1.0 + SHARE, 1.0 - SHARE))
        columns.append((above - below) / (2.0 * SHARE * value))
    sigmas = np.sqrt(np.diag(np.linalg.inv(np.transpose(columns).T @ np.transpose(columns))))
    return {name: float(f"{sigma:.2g}") for name, sigma in zip(values, sigmas, strict=True)}


def _calibrated(tolerances: Tolerances, errors: Mapping[str, float]) -> Tolerances:
    """With the standard errors of calibrated scalars; that of a0 adds to what is known of the attraction.

    A file without tolerances stays exact.
    """
    if tolerances.is_exact:
        return tolerances
    scalars = {name: error for name, error in errors.items() if name != "a0"}
    matrix = np.array(tolerances.attraction_covariance or np.zeros((4, 4)))
    matrix[0, 0] = float(f"{matrix[0, 0] + errors.get('a0', 0.0) ** 2:.{COVARIANCE_DIGITS}g}")
    covariance = tuple(tuple(row) for row in matrix.tolist()) if matrix.any() else None
    return replace(tolerances, declared={**tolerances.declared, **scalars}, attraction_covariance=covariance)


def _refined(plant: EventPlant, values: Mapping[str, float]) -> dict[str, float]:
    """The values of a fit to machine precision: the fit itself stops at a tenth of a standard error."""
    from scipy.optimize import least_squares

    sizes = np.array(list(values.values()))
    problem = event_problem(plant)

    def residuals(scales: Array) -> Array:
        return problem.residuals(dict(zip(values, scales * sizes, strict=True)))

    best = least_squares(
        residuals, np.ones(len(sizes)), xtol=1e-12, ftol=1e-12, gtol=1e-12, diff_step=np.full(len(sizes), 1e-5)
    )
    return dict(zip(values, (best.x * sizes).tolist(), strict=True))


def _region(plant: EventPlant, progress: Callable[[float], None]) -> Region:
    """The pull at rest and the lag that fit best at every pair of dampings; fits start from those of neighbours."""
    problem, axis = event_problem(plant), DAMPING_AXIS
    shape = (len(axis), len(axis))
    pull, lag, chi2 = np.empty(shape), np.empty(shape), np.empty(shape)
    for i, j in itertools.product(range(len(axis)), repeat=2):
        fixed = {DAMPINGS[0]: float(axis[i]), DAMPINGS[1]: float(axis[j])}
        starts = [(pull[k, m], lag[k, m]) for k, m in ((i - 1, j), (i, j - 1)) if k >= 0 and m >= 0] or [(3.0, 1e-3)]
        fits = [fit(problem, PULLS, dict(zip(PULLS, start, strict=True)), fixed=fixed) for start in starts]
        best = min(fits, key=lambda result: result.chi2)
        pull[i, j], lag[i, j], chi2[i, j] = best.values[PULLS[0]], best.values[PULLS[1]], best.chi2
        if j == 0:
            progress(i / len(axis))
    most = plant.table.largest_attraction or math.inf
    return Region(axis, axis, pull, lag, chi2, (chi2 - chi2.min() < CHI2_RISE_95) & (pull <= most))


def _further_measurements(plant: EventPlant, region: Region) -> tuple[FurtherMeasurement, ...]:
    """Measurements that were not printed, by how far members of the region disagree on them."""
    places = np.argwhere(region.allowed)
    members = places[np.linspace(0, len(places) - 1, min(MEMBERS, len(places))).astype(int)]
    voltage, last = plant.table.voltage, plant.table.events[-1]
    others = (0.85 * voltage, 1.5 * voltage)
    valves, forces, lags = [], [], []
    for i, j in members:
        forces.append(float(region.rest_attraction[i, j]))
        lags.append(float(region.coil_lag[i, j]))
        dampings = (float(region.pilot_damping[i]), float(region.main_damping[j]))
        valves.append(plant.with_values(dict(zip((*DAMPINGS, *PULLS), (*dampings, forces[-1], lags[-1]), strict=True))))
    curves = np.array([_step(valve, voltage, last.time).pilot_position for valve in valves])
    worst = int(np.argmax(np.ptp(curves, axis=0)))
    found = [
        _spread(Quantity.STATIC_ATTRACTION, forces, FORCE_ERROR, "N"),
        _spread(Quantity.CURRENT_TIME_CONSTANT, [1e3 * lag for lag in lags], TIME_ERROR, "ms"),
        _spread(Quantity.CLOSING_TIME, [_closing(plant, valve) for valve in valves], TIME_ERROR, "ms", volts=voltage),
        _spread(
            Quantity.DISPLACEMENT, (1e6 * curves[:, worst]).tolist(), POSITION_ERROR, "µm", volts=voltage,
            time=float(_sample_times(last.time)[worst]),
        ),
    ]  # fmt: skip
    for volts in others:
        steps = [_step(valve, volts, plant.table.horizon) for valve in valves]
        arrivals = [1e3 * reached(step, last.displacement) for step in steps]
        found.append(_spread(Quantity.ARRIVAL, arrivals, TIME_ERROR, "ms", volts=volts, event=last.name))
    known = [measurement for measurement in found if measurement is not None]
    return tuple(sorted(known, key=lambda measurement: -measurement.power))


def _spread(
    quantity: Quantity, predicted: Sequence[float], error: float, unit: str, **where: Any
) -> FurtherMeasurement | None:
    """None where no member predicts it."""
    finite = [value for value in predicted if math.isfinite(value)]
    return FurtherMeasurement(quantity, min(finite), max(finite), error, unit, **where) if finite else None


def _sample_times(stop: float) -> Array:
    return np.arange(0.0, stop, 5e-5)


def _step(valve: Valve, volts: float, stop: float) -> Response:
    return simulate(valve, Drive.of([0.0], [volts]), _sample_times(stop))


def _closing(plant: EventPlant, valve: Valve) -> float:
    """Milliseconds from switching off, long after opening, to the pilot plunger's first touch of its seat, or nan.

    Without seat load a pull at rest lifts it off again at once, by some picometres: the model calls that a bounce.
    """
    off = plant.table.horizon
    response = simulate(valve, Drive.of([0.0, off], [plant.table.voltage, 0.0]), np.array([0.0, 3.0 * off]))
    return 1e3 * (response.first(EventKind.SEATED, EventKind.BOUNCED_AT_SEAT) - off)
