"""Refit declared parameters to measured strokes, and say which of them the data determine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Final

import numpy as np

from valve_sim.identification.fit.declared_values import DeclaredValue, declared_values, estimate_of
from valve_sim.identification.fit.findings import Finding, findings, leaves_more_than_noise
from valve_sim.identification.fit.fitter import Fitter
from valve_sim.identification.fit.gram import sum_squares
from valve_sim.identification.fit.intervals import Interval, profile_interval
from valve_sim.identification.fit.posterior import EVEN, rivals_of
from valve_sim.identification.fit.problem import Problem, is_long
from valve_sim.identification.fit.recorded_errors import RecordedError, by_recording
from valve_sim.identification.fit.result import Fit, fit
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.protocol import (
    Array,
    Channel,
    Piece,
    Plant,
    finite_prediction,
    primary_channels,
)
from valve_sim.identification.plants.stroke_choice import choose_strokes
from valve_sim.identification.plants.tolerances import GAS_NAMES, parameters_of_effects
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.valve_model import dampings_of
from valve_sim.model import CATALOGUE, DECLARED, ParameterError, Valve
from valve_sim.model.parameters import UNUSED_BY_ONE_PLUNGER, closest, unused_words
from valve_sim.model.valve import OF_TWO_PLUNGERS
from valve_sim.recordings import Trace
from valve_sim.recordings.checking import check_traces

STARTS: Final = (1.0, 4.0, 0.25)
"""Factors on the declared values from which fits start."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class SignalError:
    """How far off one signal of one recording is, SI.

    Attributes:
        signal: name of its channel. kind: of its sensor. unit: of all that follows.
        count: of its measurements. before, after: rms of measured less shown, as declared and refitted.
        noise: of the sensor, standard deviation.
    """

    signal: str
    kind: str
    unit: str
    count: int
    before: float
    after: float
    noise: float


@dataclass(frozen=True, repr=False)
class Identification:
    """The outcome of `identify`.

    Attributes:
        fit: the best fit. intervals: by freed parameter, 95 % by profile likelihood.
        profiles: by freed parameter, (value, rise of χ²) pairs.
        findings: what the data do not determine, and what else is off.
        errors: of each signal of each recording.
        sources: what was read.
        declared: values that are known within a tolerance, as declared and as the data see them.
        recording: the errors of each recording, by its source; none where the model lacks something, which they would
            imitate.
    """

    fit: Fit
    intervals: Mapping[str, Interval]
    profiles: Mapping[str, list[tuple[float, float]]]
    findings: tuple[Finding, ...]
    errors: tuple[SignalError, ...]
    sources: tuple[str, ...] = ()
    declared: tuple[DeclaredValue, ...] = ()
    recording: Mapping[str, tuple[RecordedError, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Identification(pilot_damping = 1.4 ± 0.02, main_damping = 3.2 ± 0.03)."""
        found = (f"{name} = {own.value:.6g} ± {own.stderr:.2g}" for name, own in self.intervals.items())
        return f"Identification({', '.join(found)})"

    @property
    def plant(self) -> Plant:
        """The machine with its recordings."""
        return self.fit.problem.plant

    @property
    def valve(self) -> Valve:
        """The identified valve.

        Raises:
            TypeError: the machine is no valve.
        """
        return self.plant.estimated(estimate_of(self.fit))

    @property
    def primary_channel(self) -> Channel:
        """One of the channels by which the errors are meant."""
        return self.plant.channels[primary_channels(self.plant)[0]]

    @property
    def rmse_before(self) -> float:
        """Of the signals by which a model is judged, as declared: m of a position; else A or Pa."""
        return self.error_of(self.primary_channel.kind).before

    @property
    def rmse_after(self) -> float:
        """Of the signals by which a model is judged, refitted."""
        return self.error_of(self.primary_channel.kind).after

    def error_of(self, kind: str) -> SignalError:
        """All signals of a kind of sensor together.

        Raises:
            KeyError: nothing of the kind was recorded.
        """
        own = [error for error in self.errors if error.kind == kind]
        if not own:
            raise KeyError(kind)
        count = sum(error.count for error in own)

        def together(rms: Callable[[SignalError], float]) -> float:
            squares = math.fsum(error.count * rms(error) ** 2 for error in own if error.count)
            return math.sqrt(squares / count) if count else math.nan

        before, after = together(attrgetter("before")), together(attrgetter("after"))
        return SignalError(kind, kind, own[0].unit, count, before, after, own[0].noise)


def identify(
    traces: Sequence[Trace],
    valve: Valve,
    free: Sequence[str] | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Refit parameters of the declared valve to one or more traces.

    Args:
        traces: measured strokes.
        valve: the declared valve; effects that it has on stay on.
        free: declared parameters, `gas.<name>` or `<effect>.<parameter>`, to refit; default: the dampings.
        progress: told what is being done, and the fraction done.

    Raises:
        ParameterError: a name that cannot be freed.
        SimulationError: the declared valve cannot be simulated.
        TraceError: a recording has columns that cannot be used, say with NaN in them.
    """
    check_traces(traces)
    free = dampings_of(valve) if free is None else free
    check_free(free, valve)
    say = progress or (lambda what, fraction: None)
    say("start", 0.0)
    # Before the data are prepared: what this takes of memory is free again then.
    starts = starts_of(traces, valve, free)
    return _identified(ValvePlant(traces, valve), free, starts, [trace.source for trace in traces], say)


def identify_plant(
    plant: OwnPlant, free: Sequence[str] | None = None, progress: Progress | None = None
) -> Identification:
    """Refit parameters of a machine of a plant file to its recordings.

    Args:
        plant: with its recordings. free: parameters, or `<effect>.<parameter>`; default: those declared `free`.
        progress: told what is being done, and the fraction done.

    Raises:
        ParameterError: a name that cannot be freed, or none.
        SimulationError: the declared machine cannot be simulated.
    """
    free = tuple(plant.base if free is None else free)
    plant.model.check_free(free)
    finite_prediction(plant, {})
    starts, sources = starts_about_declared(plant, free), [recording.source for recording in plant.recordings]
    return _identified(plant, free, starts, sources, progress or (lambda what, fraction: None))


def _identified(
    plant: Plant, free: Sequence[str], starts: Sequence[Mapping[str, float]], sources: Sequence[str], say: Progress
) -> Identification:
    """Fit, intervals, errors and findings, of any machine."""
    best, lacking = fit_beside_errors(plant, free, starts, say)
    best = best.widened()
    recording = {} if lacking else by_recording([best])
    intervals: dict[str, Interval] = {}
    profiles: dict[str, list[tuple[float, float]]] = {}
    for index, name in enumerate(free):
        say(f"interval of {name}", 0.5 + 0.5 * index / len(free))
        intervals[name], profiles[name] = profile_interval(best, name)
    say("done", 1.0)
    return Identification(
        best, intervals, profiles, findings(best, intervals, itertools.chain(*recording.values()), lacking),
        signal_errors(best), tuple(sources), declared_values(best), recording,
    )  # fmt: skip


def signal_errors(result: Fit, values: Mapping[str, float] | None = None) -> tuple[SignalError, ...]:
    """How far off each channel is, as declared and with the values of a fit.

    Errors of the recordings that were estimated along are the same in both.
    """
    problem, plant = result.problem, result.problem.plant
    values = result.values if values is None else values
    own = {nuisance.name: values[nuisance.name] for nuisance in result.nuisances if not nuisance.is_of_machine}
    added = result.added if problem.columns.unknowns else ()
    before, after = (_rms_of_channels(problem, there, added) for there in (own, values))
    return tuple(
        SignalError(one.name, one.kind, one.unit, one.count, before[index], after[index], problem.noise_of(index).sigma)
        for index, one in enumerate(plant.channels)
    )


def _rms_of_channels(problem: Problem, values: Mapping[str, float], added: Sequence[Array]) -> list[float]:
    """Root mean square of measured less shown of each channel.

    Args:
        problem: the machine and its data. values: by which it is simulated.
        added: (n,) by channel what the errors of its sensors add to what they show; empty: nothing.
    """
    channels = problem.plant.channels
    squares, counts = [list[float]() for _ in channels], [0 for _ in channels]
    for piece in _pieces(problem.plant, values):
        index, own = piece.channel, piece.samples
        left = channels[index].data[own] - (piece.shown + added[index][own] if added else piece.shown)
        left_out = problem.left_out(index)
        left = left if left_out is None else left[~left_out[own]]
        squares[index].append(sum_squares(left))
        counts[index] += len(left)
    return [
        math.sqrt(math.fsum(own) / count) if count else math.nan for own, count in zip(squares, counts, strict=True)
    ]


def _pieces(plant: Plant, values: Mapping[str, float]) -> Iterator[Piece]:
    """What each channel would show; of a long recording never all of it at once."""
    pieces = plant.pieces(values, ()) if is_long(plant) else None
    if pieces is not None:
        yield from pieces
        return
    for index, shown in enumerate(plant.predict(values)):
        yield Piece(index, 0, shown, np.empty((len(shown), 0)))


def fit_beside_errors(
    plant: Plant, free: Sequence[str], starts: Sequence[Mapping[str, float]], say: Progress
) -> tuple[Fit, float]:
    """The best fit, with the errors of the recordings as large as they are beside it.

    Args:
        plant: the machine with its recordings. free: parameters to refit. starts: of fits.
        say: told the progress, to 0.3.

    Returns:
        The fit, and the probability that something unnamed acts beside it, where that is likely; else 0. Errors are
        then as large as they are before the data are asked.

    Raises:
        SimulationError: the declared machine cannot be simulated.
    """
    say("noise", 0.0)
    problem, rivals = Problem(plant).condensed(), rivals_of(plant)
    if any(noise.samples == 0 for noise in problem.noises.values()):
        # Of a machine that is never still the noise is what the fit leaves.
        first = Fitter(problem, rivals, free=free, starts=starts).fitted_plainly()
        problem = problem.with_noise_left_by(first.values)
        starts = [first.values]
    say("fit", 0.1)
    fitter = Fitter(problem, rivals, free=free, starts=starts)
    if problem.is_long:
        best = _without_influence(fitter.fitted_plainly(), free)
        return best, 1.0 if leaves_more_than_noise(best) else 0.0
    tried = fitter.fitted_declared()
    if restless := problem.moves_at_rest(tried.values):
        problem = problem.without_rest(restless).with_noise_left_by(tried.values)
        fitter = Fitter(problem, rivals, free=free, starts=[tried.values])
        tried = fitter.fitted_declared()
    unnamed = rivals.unnamed_beside((), tried.evidence)
    best = _without_influence(fitter.settled(tried), free)
    say("fit", 0.3)
    if unnamed > EVEN:
        return best.allowing(fitter.process, tried.spread.cell), unnamed
    return best, 0.0


def _without_influence(best: Fit, free: Sequence[str]) -> Fit:
    """A fit in which what has no influence on the data stays as declared: where it started is not what was found."""
    plant = best.problem.plant
    idle = {name: plant.declared(name) for name in free if math.isinf(best.stderr(name))}
    if not idle:
        return best
    return fit(best.problem, best.model.unknowns, {**best.values, **idle}, sizes=best.gaussian.sizes)


def check_free(free: Sequence[str], valve: Valve | None = None) -> None:
    """Check that all names can be freed, of a given valve or of any.

    Raises:
        ParameterError: one cannot; the message has the closest that can, or says why the valve has no use for it.
    """
    has_gas = valve is None or valve.gas is not None
    effects = {name: effect for name, (effect, _) in parameters_of_effects().items()}
    known = [*DECLARED, *(name for name, effect in effects.items() if CATALOGUE[effect].named)]
    for name in free:
        if not has_gas and (name in GAS_NAMES or (name in effects and CATALOGUE[effects[name]].with_gas)):
            raise ParameterError(f"{name}: cannot be freed, the valve declares no gas; add gas: to its file")
        if name not in [*known, *GAS_NAMES]:
            alike = closest(name, [*known, *GAS_NAMES])
            raise ParameterError(f"{name}: cannot be freed, there is no such parameter; did you mean {alike}?")
        if valve is not None and valve.parameters.has_one_plunger:
            if name in UNUSED_BY_ONE_PLUNGER:
                raise ParameterError(f"{name}: cannot be freed, {unused_words(name)}")
            if effects.get(name) in OF_TWO_PLUNGERS:
                raise ParameterError(f"{name}: cannot be freed, a valve with one plunger picks nothing up")


def starts_of(traces: Sequence[Trace], valve: Valve, free: Sequence[str]) -> list[dict[str, float]]:
    """Where fits start: at the declared values times each of `STARTS`, to avoid local minima.

    A long recording is fitted once, from the best fit to some of its strokes.
    """
    few, choice = choose_strokes(traces)
    plant = ValvePlant(few, valve)
    starts = starts_about_declared(plant, free)
    if choice is None:
        return starts
    found = Fitter(Problem(plant).condensed(), rivals_of(plant), free=free, starts=starts).fitted_plainly()
    return [{name: found.values[name] for name in free}]


def starts_about_declared(plant: Plant, free: Sequence[str]) -> list[dict[str, float]]:
    """The declared values of what is freed times each of `STARTS`; of effects, and of 0, such shares of a scale."""
    return [{name: _started(plant, name, factor) for name in free} for factor in STARTS]


def _started(plant: Plant, name: str, factor: float) -> float:
    declared, parameter = plant.declared(name), plant.parameter(name)
    if parameter.off is None:
        return declared * factor if declared else parameter.prior_scale * factor
    if math.isinf(parameter.off):
        return parameter.prior_scale * factor
    return parameter.off + 0.1 * factor * parameter.prior_scale
