"""Refit declared parameters to measured strokes, and say which of them the data determine."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from valve_sim.identification.estimation.declared_values import DeclaredValue, declared_values, estimated_valve
from valve_sim.identification.estimation.findings import Finding, findings, leaves_more_than_noise
from valve_sim.identification.estimation.intervals import Interval, profile_interval
from valve_sim.identification.estimation.linearised import Linearised
from valve_sim.identification.estimation.problem import LONG, Problem
from valve_sim.identification.estimation.recorded_errors import RecordedError, by_recording, with_uncertain_sizes
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.estimation.state_of_recording import with_forgotten_errors, with_learned_errors
from valve_sim.identification.plants.protocol import Array, Channel, InPieces, Nuisance, Plant, primary_channels
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.identification.plants.stroke_choice import choose_strokes
from valve_sim.identification.plants.valve import ValvePlant, dampings_of
from valve_sim.identification.plants.valve_model import GAS_NAMES
from valve_sim.identification.selection.discrepancy import Discrepancy, lengths_of
from valve_sim.identification.selection.posterior import EVEN, Evidence, rivals_of
from valve_sim.model import CATALOGUE, DECLARED, ParameterError, SimulationError, Valve
from valve_sim.model.parameters import UNUSED_BY_ONE_PLUNGER, closest, unused_words
from valve_sim.model.valve import OF_TWO_PLUNGERS
from valve_sim.traces import Trace
from valve_sim.traces.checking import check_traces

STARTS: Final = (1.0, 4.0, 0.25)
"""Factors on the declared values from which fits start."""

DECIDED: Final = 100.0
"""Difference of ln p that no prior outweighs."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, repr=False)
class Identification:
    """The outcome of `identify`.

    Attributes:
        fit: the best fit. intervals: by freed parameter, 95 % by profile likelihood.
        profiles: by freed parameter, (value, rise of χ²) pairs.
        findings: what the data do not determine, and what else is off.
        rmse_before, rmse_after: of what is judged, as declared and refitted: m, of the pilot plunger's position; A, of
            the current where no position was recorded; Pa, of the outlet's pressure where that is all there is.
        current_before, current_after: A, of the current; NaN where none was recorded.
        pressure_before, pressure_after: Pa, of the outlet's pressure; likewise.
        valve: the identified valve.
        declared: values that are known within a tolerance, as declared and as the data see them.
        recording: the errors of each recording, by its source; none where the model lacks something, which they would
            imitate.
    """

    fit: Fit
    intervals: Mapping[str, Interval]
    profiles: Mapping[str, list[tuple[float, float]]]
    findings: tuple[Finding, ...]
    rmse_before: float
    rmse_after: float
    valve: Valve
    sources: tuple[str, ...] = field(default=())
    declared: tuple[DeclaredValue, ...] = ()
    current_before: float = math.nan
    current_after: float = math.nan
    pressure_before: float = math.nan
    pressure_after: float = math.nan
    recording: Mapping[str, tuple[RecordedError, ...]] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Identification(pilot_damping = 1.4 ± 0.02, main_damping = 3.2 ± 0.03)."""
        found = (f"{name} = {own.value:.6g} ± {own.stderr:.2g}" for name, own in self.intervals.items())
        return f"Identification({', '.join(found)})"

    @property
    def primary_channel(self) -> Channel:
        """One of the channels by which the errors are meant."""
        plant = self.fit.problem.plant
        return plant.channels[primary_channels(plant)[0]]


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
    say = progress or (lambda what, fraction: None)
    free = dampings_of(valve) if free is None else free
    check_free(free, valve)
    say("start", 0.0)
    best, evidence = fit_beside_errors(traces, valve, free, say)
    lacking = lacking_by(best.problem.plant, evidence)
    best, plant = with_uncertain_sizes(best), best.problem.plant
    assert isinstance(plant, ValvePlant)
    recording = {} if lacking else by_recording([best])
    intervals: dict[str, Interval] = {}
    profiles: dict[str, list[tuple[float, float]]] = {}
    for index, name in enumerate(free):
        say(f"interval of {name}", 0.5 + 0.5 * index / len(free))
        intervals[name], profiles[name] = profile_interval(best, name)
    say("done", 1.0)
    offsets = {nuisance.name: best.values[nuisance.name] for nuisance in best.nuisances if not nuisance.is_of_machine}
    # What the sensors' errors add is the same as declared and refitted.
    added = () if best.problem.errors is None else best.errors_of(best.left.condensed())
    found = findings(best, intervals, itertools.chain(*recording.values()), lacking)
    return Identification(
        best, intervals, profiles, found, primary_rmse(plant, offsets, added), primary_rmse(plant, best.values, added),
        estimated_valve(best, plant), tuple(trace.source for trace in traces), declared_values(best),
        rmse_of_kind(plant, offsets, "current"), rmse_of_kind(plant, best.values, "current"),
        rmse_of_kind(plant, offsets, "pressure"), rmse_of_kind(plant, best.values, "pressure"), recording,
    )  # fmt: skip


def fit_beside_errors(
    traces: Sequence[Trace], valve: Valve, free: Sequence[str], say: Progress
) -> tuple[Fit, Evidence]:
    """The best fit, with the errors of the recordings as large as they are beside it.

    Args:
        traces: measured strokes. valve: the declared valve. free: parameters to refit. say: told the progress, to 0.3.

    Returns:
        The fit, and the evidence of it and of something unnamed beside it. Where that is likely, errors are as large as
        they are before the data are asked.

    Raises:
        SimulationError: the declared valve cannot be simulated.
    """
    # Before the data are prepared: what this takes of memory is free again then.
    starts = starts_of(traces, valve, free)
    say("noise", 0.0)

    def fitted(problem: Problem, begun: Fit | None) -> Fit:
        if begun is not None:
            return best_fit(problem, free, [begun.values], lambda fraction: None)
        return best_fit(problem, free, starts, lambda fraction: say("fit", 0.3 * fraction))

    problem, best = with_learned_errors(Problem(ValvePlant(traces, valve)).condensed(), fitted)
    evidence = evidence_beside(best)
    if lacking_by(problem.plant, evidence) and problem.errors is not None:
        # Beside what it lacks, learned errors would imitate that.
        best = fitted(with_forgotten_errors(problem, best.values), None)
    return best, evidence


def check_free(free: Sequence[str], valve: Valve | None = None) -> None:
    """Check that all names can be freed, of a given valve or of any.

    Raises:
        ParameterError: one cannot; the message has the closest that can, or says why the valve has no use for it.
    """
    has_gas = valve is None or valve.gas is not None
    known = [*DECLARED, *(f"{e.name}.{p.name}" for e in CATALOGUE.values() if e.named for p in e.parameters)]
    of_gas = {f"{e.name}.{p.name}" for e in CATALOGUE.values() if e.with_gas for p in e.parameters}
    for name in free:
        if not has_gas and name in {*GAS_NAMES, *of_gas}:
            raise ParameterError(f"{name}: cannot be freed, the valve declares no gas; add gas: to its file")
        if name not in [*known, *GAS_NAMES]:
            alike = closest(name, [*known, *GAS_NAMES])
            raise ParameterError(f"{name}: cannot be freed, there is no such parameter; did you mean {alike}?")
        if valve is not None and valve.parameters.has_one_plunger:
            if name in UNUSED_BY_ONE_PLUNGER:
                raise ParameterError(f"{name}: cannot be freed, {unused_words(name)}")
            if name.partition(".")[0] in OF_TWO_PLUNGERS:
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
    found = best_of_starts(Problem(plant).condensed(), free, plant.nuisances, starts)
    return [{name: found.values[name] for name in free}]


def best_fit(
    problem: Problem, free: Sequence[str], starts: Sequence[Mapping[str, float]], progress: Callable[[float], None]
) -> Fit:
    """The best of fits from several starts.

    Where its residual is larger than the noise, errors of the commands' stamps are estimated too, and kept where the
    evidence is for them: some recorders stamp a command when they happen to receive it, up to a millisecond late.
    """
    plant = problem.plant
    plain = best_of_starts(problem, free, problem.nuisances, starts, progress)
    if not plant.timing_errors or not leaves_more_than_noise(plain):
        return plain
    nuisances = (*problem.nuisances, *plant.timing_errors)
    timed = best_of_starts(problem, free, nuisances, starts, lambda fraction: progress(1.0))
    return max(plain, timed, key=lambda found: found.log_evidence)


def evidence_beside(result: Fit) -> Evidence:
    """Evidence of a fit, and of something unnamed beside it, as a diagnosis has it of its empty set.

    Of a long recording, whose rows are not at hand, it is decided by whether more than noise is left.
    """
    problem = result.problem
    if problem.is_long:
        return Evidence(0.0, DECIDED if leaves_more_than_noise(result) else -DECIDED)
    model, places = Linearised(result), problem.rows.places
    spread = Discrepancy(places, lengths_of(problem.plant, places)).spread(model)
    return Evidence(model.integrated, spread.log_evidence)


def lacking_by(plant: Plant, evidence: Evidence) -> float:
    """Probability that the model lacks something, where that is likely; else 0."""
    unnamed = rivals_of(plant).unnamed_beside((), evidence)
    return unnamed if unnamed > EVEN else 0.0


def starts_about_declared(plant: Plant, free: Sequence[str]) -> list[dict[str, float]]:
    """The declared values of what is freed times each of `STARTS`; of effects, and of 0, such shares of a scale."""
    return [{name: _started(plant, name, factor) for name in free} for factor in STARTS]


def best_of_starts(
    problem: Problem,
    free: Sequence[str],
    nuisances: Sequence[Nuisance],
    starts: Sequence[Mapping[str, float]],
    progress: Callable[[float], None] = lambda fraction: None,
) -> Fit:
    """The best of fits from several starts; what has no influence on the data stays as declared.

    Raises:
        SimulationError: the machine cannot be simulated from any of them.
    """
    best: Fit | None = None
    for index, start in enumerate(starts):
        try:
            found = fit(problem, free, start, nuisances=nuisances)
        except SimulationError:
            if best is None and index + 1 == len(starts):
                raise
            continue
        # A fit keeps a row of derivatives for each sample: the others' would be most of the memory of a long recording.
        best = found if best is None or found.chi2 < best.chi2 else best
        progress((index + 1) / len(starts))
    assert best is not None
    without_influence = {name: problem.plant.declared(name) for name in free if math.isinf(best.stderr(name))}
    if not without_influence:
        return best
    # Where it started is not what was found: it stays as declared.
    return fit(problem, free, {**best.values, **without_influence}, nuisances=nuisances)


def primary_rmse(plant: Plant, values: Mapping[str, float], added: Sequence[Array] = ()) -> float:
    """Root mean square of measured less predicted over the measurements of the channels by which a model is judged.

    Args:
        plant: the machine and its data. values: by which it is simulated.
        added: (n,) by channel what the errors of its sensors add to what they show; empty: nothing.
    """
    return _rmse(plant, values, primary_channels(plant), added)


def rmse_of_kind(plant: Plant, values: Mapping[str, float], kind: str) -> float:
    """Root mean square of measured less predicted of all channels of a kind, in their unit; NaN without one."""
    channels = [index for index, channel in enumerate(plant.channels) if channel.kind == kind]
    return _rmse(plant, values, channels) if channels else math.nan


def _rmse(plant: Plant, values: Mapping[str, float], channels: Sequence[int], added: Sequence[Array] = ()) -> float:
    samples = sum(len(plant.channels[index].data) for index in channels)
    pieces = plant.pieces(values, ()) if isinstance(plant, InPieces) and samples > LONG else None
    if pieces is None:
        shown = plant.predict(values)
        if added:
            shown = [own + error for own, error in zip(shown, added, strict=True)]
        return root_mean_square(np.concatenate([_left(plant.channels[index], shown[index]) for index in channels]))
    left = (
        _left(plant.channels[piece.channel], piece.shown, piece.samples)
        for piece in pieces
        if piece.channel in channels
    )
    squares = math.fsum(float(np.sum(np.square(of_piece))) for of_piece in left)
    return math.sqrt(squares / max(1, sum(plant.channels[index].count for index in channels)))


def _left(channel: Channel, shown: Array, samples: slice = slice(None)) -> Array:
    """Measured less shown of some of a channel's samples, but for those that are left out."""
    return channel.kept(channel.data[samples] - shown, samples)


def _started(plant: Plant, name: str, factor: float) -> float:
    declared, parameter = plant.declared(name), plant.parameter(name)
    if parameter.off is None:
        return declared * factor if declared else parameter.prior_scale * factor
    if math.isinf(parameter.off):
        return parameter.prior_scale * factor
    return parameter.off + 0.1 * factor * parameter.prior_scale
