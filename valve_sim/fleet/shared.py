"""`identify` over many recordings of one valve, each read where it is worked on: in this process, or on Dask.

Each recording is first identified by itself, and learns its errors. The valve is then fitted to all of them, from the
values of the recording that is fitted best. What a recording has learned travels without its columns.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

from valve_sim.files.recording_map import RecordingMap
from valve_sim.fleet.cluster import run_batches
from valve_sim.identification.diagnosis.identify import (
    Identification,
    SignalError,
    check_free,
    fit_beside_errors,
    lacking_by,
    signal_errors,
    starts_of,
)
from valve_sim.identification.estimation.declared_values import declared_values
from valve_sim.identification.estimation.findings import findings
from valve_sim.identification.estimation.intervals import covariance_interval
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.recorded_errors import RecordedError, by_recording
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.shared_fit import ReducedNormalEquations, as_fit, fit_shared, share_of
from valve_sim.identification.estimation.structured_noise import StructuredNoise, structured_noise
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.posterior import Evidence
from valve_sim.model import SimulationError, Valve, ValveError
from valve_sim.traces import Trace, read_trace, refuse_doubtful_units

Progress = Callable[[str, float], None]


class Recordings(NamedTuple):
    """How recordings are read, and what they are held against.

    Attributes:
        valve: the declared one. free: parameters to free. name: of the valve in the recordings; None: the only one.
        recording_map: where recordings are foreign.
    """

    valve: Valve
    free: tuple[str, ...]
    name: str | None = None
    recording_map: RecordingMap | None = None

    def trace(self, path: Path) -> Trace:
        """One recording.

        Raises:
            ValveError: it cannot be used.
        """
        trace = read_trace(path, self.name, self.recording_map)
        refuse_doubtful_units(trace, self.valve.parameters)
        return trace

    def problem(self, path: Path, learned: Learned) -> Problem:
        """One recording, with the noise of its own sensors, and with what it has learned of its errors.

        Raises:
            ValveError: it cannot be used.
        """
        problem = Problem(ValvePlant([self.trace(path)], self.valve))
        if learned.errors is None:
            return problem
        errors = structured_noise(problem.plant, learned.values, learned.errors.modes, learned.errors)
        return problem.with_errors(errors)


class Learned(NamedTuple):
    """What a recording says by itself.

    Attributes:
        values: of its own fit, at which columns of its errors are made.
        misfit: χ² of a sample there.
        errors: sizes of its errors and modes of its mounts, without columns; None where it has none.
        recording: the errors, by the recording's source; none beside something unnamed.
        evidence: of its own fit, and of something unnamed beside it.
    """

    values: Mapping[str, float]
    misfit: float
    errors: StructuredNoise | None
    recording: Mapping[str, tuple[RecordedError, ...]]
    evidence: Evidence


class Task(NamedTuple):
    """One recording at some values of the machine; its own nuisances start from `own`."""

    path: Path
    learned: Learned
    values: Mapping[str, float]
    own: Mapping[str, float]


class Told(NamedTuple):
    """What a recording says of the machine, and how far it is missed."""

    share: ReducedNormalEquations
    errors: tuple[SignalError, ...]


Found = TypeVar("Found", Told, Learned)
Item = TypeVar("Item", Task, Path)


class Answer(NamedTuple, Generic[Found]):
    """What was found, or why nothing was; and the processor's seconds."""

    found: Found | None
    failure: str
    is_of_simulation: bool
    seconds: float


def answers(
    items: Sequence[Item], work: Callable[[Item, Recordings], Found], recordings: Recordings
) -> list[Answer[Found]]:
    """One for each item; what goes wrong is an answer, too."""
    return [_answer(item, work, recordings) for item in items]


def _answer(item: Item, work: Callable[[Item, Recordings], Found], recordings: Recordings) -> Answer[Found]:
    begun = time.process_time()
    found, failure, is_of_simulation = None, "", False
    try:
        found = work(item, recordings)
    except (ValveError, OSError) as error:
        failure, is_of_simulation = str(error) or type(error).__name__, isinstance(error, SimulationError)
    return Answer(found, failure, is_of_simulation, time.process_time() - begun)


def told(task: Task, recordings: Recordings) -> Told:
    """A recording's share at the values of its task.

    Raises:
        ValveError: it cannot be used, or the machine cannot be simulated.
    """
    problem = recordings.problem(task.path, task.learned)
    share, left = share_of(problem, recordings.free, task.values, task.own)
    return Told(share, signal_errors(left, {**task.values, **share.own}))


def learned(path: Path, recordings: Recordings) -> Learned:
    """What a recording says by itself.

    Raises:
        ValveError: it cannot be used, or the machine cannot be simulated.
    """
    traces, valve, free = [recordings.trace(path)], recordings.valve, recordings.free
    starts = starts_of(traces, valve, free)
    best, evidence = fit_beside_errors(ValvePlant(traces, valve), free, starts, lambda what, fraction: None)
    problem = best.problem
    return Learned(
        best.values,
        best.chi2 / problem.effective_samples,
        None if problem.errors is None else replace(problem.errors, columns={}),
        {} if lacking_by(problem.plant, evidence) else by_recording([best]),
        evidence,
    )


def identify_shared(
    paths: Sequence[Path],
    recordings: Recordings,
    connect: Callable[[], Any] = lambda: None,
    progress: Progress | None = None,
) -> Identification:
    """Refit parameters of one valve to many recordings of it; errors of clocks and of stamps are each recording's own.

    Args:
        paths: of the recordings, for every worker the same.
        recordings: how they are read, and what is freed.
        connect: gives a client of Dask, or None for work in this process.
        progress: told what is being done, and the fraction done.

    Raises:
        ValveError: a recording or a name cannot be used, the declared valve cannot be simulated, or the cluster was
            lost.
    """
    check_free(recordings.free, recordings.valve)
    say = progress or (lambda what, fraction: None)
    alone: list[Learned] = _all(paths, learned, recordings, connect, lambda done: say("each by itself", done))
    own: list[Mapping[str, float]] = [one.values for one in alone]
    latest: list[SignalError] = []
    steps = 0

    def shares_at(values: Mapping[str, float]) -> list[ReducedNormalEquations]:
        nonlocal steps
        steps += 1
        tasks = [Task(path, one, dict(values), start) for path, one, start in zip(paths, alone, own, strict=True)]
        found: list[Told] = _all(tasks, told, recordings, connect, lambda done: say(f"step {steps}", done))
        latest[:] = [error for one in found for error in one.errors]
        own[:] = [one.share.own for one in found]
        return [one.share for one in found]

    first = recordings.problem(paths[0], alone[0])
    shared = fit_shared(first, recordings.free, shares_at, min(alone, key=lambda one: one.misfit).values)
    result = as_fit(first, recordings.free, shared)
    return _identification(result, latest, paths, alone)


def _all(
    items: Sequence[Item],
    work: Callable[[Item, Recordings], Found],
    recordings: Recordings,
    connect: Callable[[], Any],
    say: Callable[[float], None],
) -> list[Found]:
    """What was found, in the order of the items: sums over recordings are the same wherever they were worked on."""
    found: dict[Path, Answer[Found]] = {}
    do = partial(answers, work=work, recordings=recordings)
    for batch in run_batches(connect, do, items, lambda answer: answer.seconds):
        if batch.failure:
            raise ValveError(f"{_path(batch.items[0])}: {batch.failure}")
        found.update((_path(item), answer) for item, answer in zip(batch.items, batch.answers, strict=True))
        say(len(found) / len(items))
    ordered: list[Found] = []
    for item in items:
        answer = found[_path(item)]
        if answer.found is None:
            raise (SimulationError if answer.is_of_simulation else ValveError)(answer.failure)
        ordered.append(answer.found)
    return ordered


def _path(item: Task | Path) -> Path:
    return item.path if isinstance(item, Task) else item


def _identification(
    result: Fit, errors: Sequence[SignalError], paths: Sequence[Path], alone: Sequence[Learned]
) -> Identification:
    # Recordings of one machine: what it lacks acts in all of them, or in none.
    together = Evidence(
        math.fsum(one.evidence.plain for one in alone), math.fsum(one.evidence.unnamed for one in alone)
    )
    lacking = lacking_by(result.problem.plant, together)
    recording = {} if lacking else {source: own for one in alone for source, own in one.recording.items()}
    intervals = {name: covariance_interval(result, name) for name in result.free}
    remarks = findings(result, intervals, itertools.chain(*recording.values()), lacking)
    return Identification(
        result, intervals, {}, remarks, tuple(errors), tuple(map(str, paths)), declared_values(result), recording
    )  # fmt: skip
