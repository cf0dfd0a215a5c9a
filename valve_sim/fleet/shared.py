"""`identify` over many recordings of one valve, each read where it is worked on: in this process, or on Dask."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from valve_sim.files.recording_map import RecordingMap
from valve_sim.fleet.cluster import run_batches
from valve_sim.identification.diagnosis.identify import Identification, check_free, judged_rmse, rmse_of_kind
from valve_sim.identification.estimation.declared_values import declared_values, estimated_valve
from valve_sim.identification.estimation.intervals import covariance_interval
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.shared_fit import Share, Shared, as_fit, fit_shared, share_of
from valve_sim.identification.plants.protocol import judged_channels
from valve_sim.identification.plants.valve import ValvePlant
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

    def problem(self, path: Path) -> Problem:
        """One recording, with the noise of its own sensors.

        Raises:
            ValveError: it cannot be used.
        """
        return Problem(ValvePlant([self.trace(path)], self.valve))


class Task(NamedTuple):
    """One recording at some values of the machine; its own nuisances start from `own`."""

    path: Path
    values: Mapping[str, float]
    own: Mapping[str, float]


class Errors(NamedTuple):
    """Of one recording: samples that are judged, and rms errors of them and of the current, as declared and now."""

    samples: int
    before: float
    after: float
    current_before: float
    current_after: float


class Answer(NamedTuple):
    """A recording's share and errors, or why there are none; and the processor's seconds."""

    share: Share | None
    errors: Errors | None
    failure: str
    is_of_simulation: bool
    seconds: float


def answers(tasks: Sequence[Task], recordings: Recordings) -> list[Answer]:
    """One for each task; what goes wrong is an answer, too."""
    return [_answer(task, recordings) for task in tasks]


def _answer(task: Task, recordings: Recordings) -> Answer:
    begun = time.process_time()
    share, errors, failure, is_of_simulation = None, None, "", False
    try:
        problem = recordings.problem(task.path)
        share = share_of(problem, recordings.free, task.values, task.own)
        errors = _errors(problem, task.values, share.own)
    except (ValveError, OSError) as error:
        failure, is_of_simulation = str(error) or type(error).__name__, isinstance(error, SimulationError)
    return Answer(share, errors, failure, is_of_simulation, time.process_time() - begun)


def _errors(problem: Problem, values: Mapping[str, float], own: Mapping[str, float]) -> Errors:
    plant, now = problem.plant, {**values, **own}
    samples = sum(plant.channels[index].count for index in judged_channels(plant))
    judged = judged_rmse(plant, own), judged_rmse(plant, now)
    return Errors(samples, *judged, *(rmse_of_kind(plant, found, "current") for found in (own, now)))


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
    say, first = progress or (lambda what, fraction: None), recordings.problem(paths[0])
    own: list[Mapping[str, float]] = [{} for _ in paths]
    latest: list[Errors] = []
    steps = 0

    def shares_at(values: Mapping[str, float]) -> list[Share]:
        nonlocal steps
        steps += 1
        tasks = [Task(path, dict(values), start) for path, start in zip(paths, own, strict=True)]
        found = _all(tasks, recordings, connect, lambda done: say(f"step {steps}", done))
        shares = [answer.share for answer in found if answer.share is not None]
        latest[:] = [answer.errors for answer in found if answer.errors is not None]
        own[:] = [share.own for share in shares]
        return shares

    shared = fit_shared(first, recordings.free, shares_at)
    return _identification(first, recordings.free, shared, latest, paths)


def _all(
    tasks: Sequence[Task], recordings: Recordings, connect: Callable[[], Any], say: Callable[[float], None]
) -> list[Answer]:
    """The answers, in the order of the tasks: sums over recordings are the same wherever they were worked on."""
    found: dict[Path, Answer] = {}
    for batch in run_batches(connect, partial(answers, recordings=recordings), tasks, lambda answer: answer.seconds):
        if batch.failure:
            raise ValveError(f"{batch.items[0].path}: {batch.failure}")
        found.update((task.path, answer) for task, answer in zip(batch.items, batch.answers, strict=True))
        say(len(found) / len(tasks))
    ordered = [found[task.path] for task in tasks]
    for answer in ordered:
        if answer.failure:
            raise (SimulationError if answer.is_of_simulation else ValveError)(answer.failure)
    return ordered


def _identification(
    first: Problem, free: tuple[str, ...], shared: Shared, errors: Sequence[Errors], paths: Sequence[Path]
) -> Identification:
    result = as_fit(first, free, shared)
    plant = first.plant
    assert isinstance(plant, ValvePlant)
    rms = [_together(errors, index) for index in range(1, 5)]
    return Identification(
        result, {name: covariance_interval(result, name) for name in free}, {}, (), rms[0], rms[1],
        estimated_valve(result, plant), tuple(str(path) for path in paths), declared_values(result), rms[2], rms[3],
    )  # fmt: skip


def _together(errors: Sequence[Errors], index: int) -> float:
    """Root mean square over all recordings; NaN where one has none."""
    samples = sum(one.samples for one in errors)
    return math.sqrt(sum(one.samples * one[index] ** 2 for one in errors) / samples)
