"""The work of identification_node, without ROS: a fit or a diagnosis in a thread, its files and its report."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim.files.parameter_files import save_valve
from valve_sim.files.recording_map import load_map
from valve_sim.identification.diagnosis.identify import Identification, identify
from valve_sim.identification.estimation.declared_values import out_of_tolerance
from valve_sim.identification.estimation.findings import leaves_more_than_noise
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.identification.plants.valve import DAMPINGS, dampings_of
from valve_sim.identification.reporting.identification import identification_json
from valve_sim.identification.reporting.units import measured
from valve_sim.model import Valve
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.nodes.settings import IdentificationSettings
from valve_sim.nodes.threads import StoppableThread
from valve_sim.traces import Trace, another_valve, left_out_finding, read_trace, refuse_doubtful_units

IDENTIFIED_FILE: Final = "identified.yaml"
CORRECTED_FILE: Final = "corrected.yaml"
BEFORE_FILE: Final = "before.yaml"
_NAMED: Final = ("none", "effects")

Progress = Callable[[str, float], None]


class Outcome(NamedTuple):
    """The result of a fit or a diagnosis.

    Attributes:
        valve: the identified or corrected one. clock_offset: s by which the samples are stamped late.
        report: content of identify.json or report.json. file: where the valve was written.
        summary: one sentence for a person. intervals: by name of each fitted parameter.
        objection: why the valve should not be handed on; empty where nothing speaks against it.
        advice: the profile to record next; None where nothing is to be told apart.
    """

    valve: Valve
    clock_offset: float
    report: dict[str, Any]
    file: Path
    summary: str
    intervals: Mapping[str, Interval]
    objection: str
    advice: Path | None = None

    @property
    def files(self) -> str:
        """The files that were written, in words."""
        return str(self.file) if self.advice is None else f"{self.file}, and {self.advice} for what to record next"


class Applied(NamedTuple):
    """Whether the result was set on the valve of `apply_to`.

    Attributes:
        node: the valve's name. is_set: whether it took the result over. reason: why not.
        changes: one line for each parameter that has another value now.
    """

    node: str
    is_set: bool
    reason: str = ""
    changes: tuple[str, ...] = ()


class Cancelled(Exception):  # noqa: N818 -- not an error: the node ends
    """The thread is to stop."""


def read_recording(settings: IdentificationSettings, declared: Valve) -> Trace:
    """The recording that is replayed and fitted.

    Raises:
        ValveError: it or its map cannot be used, or its numbers are of another unit.
    """
    recording_map = load_map(Path(settings.map).expanduser()) if settings.map else None
    trace = read_trace(Path(settings.bag).expanduser(), settings.valve_name or None, recording_map)
    refuse_doubtful_units(trace, declared.parameters)
    further = (*left_out_finding(trace), *another_valve(trace, declared.parameters))
    return replace(trace, findings=(*trace.findings, *further))


def freed(settings: IdentificationSettings, declared: Valve) -> tuple[str, ...]:
    """What is refitted: of what is so by default, what the valve uses."""
    return dampings_of(declared) if settings.free == DAMPINGS else settings.free


def fit_or_diagnose(
    trace: Trace, declared: Valve, settings: IdentificationSettings, folder: Path, progress: Progress
) -> Outcome:
    """Refit or diagnose, and write the valve that was found, and what to record next, into `folder`.

    Raises:
        ValveError: the declared valve cannot be simulated, or the file cannot be written.
    """
    if settings.mode == "identify":
        return _identified(identify([trace], declared, freed(settings, declared), progress), settings, folder)
    return _diagnosed(trace, declared, settings, folder, progress)


def _identified(result: Identification, settings: IdentificationSettings, folder: Path) -> Outcome:
    plant = result.fit.problem.plant
    values = [f"{name} {measured(found, plant.parameter(name).unit)}" for name, found in result.intervals.items()]
    summary = f"identified: {', '.join(values)}"
    file = folder / IDENTIFIED_FILE
    save_valve(file, result.valve, _provenance(settings, summary))
    offset = result.fit.values["clock_offset[0]"]
    report, objection = identification_json(result), _objection_to(result)
    return Outcome(result.valve, offset, report, file, summary, result.intervals, objection)


def _objection_to(result: Identification) -> str:
    if not result.fit.converged:
        return "the fit did not converge"
    if leaves_more_than_noise(result.fit):
        return "the residual is not white, so the model lacks something (mode:=diagnose may name it)"
    if off := out_of_tolerance(result.declared):
        return (
            f"{', '.join(off)} would be more than three tolerances off, so the model lacks something "
            "(mode:=diagnose may name it)"
        )
    bound = next((name for name in result.fit.free if result.fit.on_bound(name) is not None), "")
    return f"{bound} sits on the bound of its range" if bound else ""


def _diagnosed(
    trace: Trace, declared: Valve, settings: IdentificationSettings, folder: Path, progress: Progress
) -> Outcome:
    # Imported where it is needed: it takes half a second.
    from valve_sim.identification.diagnosis.outcome import objection_to, what_is_left
    from valve_sim.identification.diagnosis.run import diagnose
    from valve_sim.identification.estimation.budget import Budget
    from valve_sim.identification.reporting.diagnosis_json import to_json
    from valve_sim.identification.reporting.recording_profile import write_record_next
    from valve_sim.identification.reporting.summary import summarise

    result = diagnose([trace], [], declared, progress, Budget.of_seconds(settings.budget))
    file = folder / CORRECTED_FILE
    summary, report = summarise(result), to_json(result)
    if result.verdict.kind == "effects" and (left := what_is_left(result)):
        summary += f" Beside it {left}."
    provenance = _provenance(settings, summary)
    save_valve(file, result.valve, provenance)
    advice = write_record_next(folder, result, provenance)
    offset = result.after.fit.values.get("clock_offset[0]", 0.0)
    kind = result.verdict.kind
    objection = objection_to(result) if kind in _NAMED else f"the verdict is {kind!r}"
    return Outcome(result.valve, offset, report, file, summary, result.after.intervals, objection, advice)


def _provenance(settings: IdentificationSettings, summary: str) -> str:
    declared = settings.params or "the shipped valve"
    return f"by identification_node from {settings.bag}, starting from {declared}\n{summary}"


def report_text(outcome: Outcome, applied: Applied | None) -> str:
    """The report as JSON, with the outcome of `apply_to`."""
    handed_on = None if applied is None else applied._asdict()
    return json.dumps({**outcome.report, "file": str(outcome.file), "applied": handed_on}, ensure_ascii=False)


class Task(StoppableThread):
    """A thread that does the work; its progress can be read at any time. It ends at its next report of progress.

    Args:
        work: the work; reports its progress and returns one sentence for a person.
        end: called with that sentence, or with why there is none; is_good says which.

    Attributes:
        is_done: whether there is a result, or a reason why there is none. status: its progress.
    """

    def __init__(self, work: Callable[[Progress], str], end: Callable[[str, bool], None]) -> None:
        super().__init__(
            "identification",
            lambda: self._finish(work(self._say), Level.OK),
            lambda error: self._finish(str(error) if isinstance(error, ValveError) else repr(error), Level.ERROR),
        )
        self._end = end
        self.is_done = False
        self.status = Status("identification", Level.OK, "about to begin", _values("", 0.0))

    def _say(self, what: str, fraction: float) -> None:
        if self.is_stopping:
            raise Cancelled
        self.status = Status("identification", Level.OK, what, _values(what, fraction))

    def _finish(self, words: str, level: Level) -> None:
        self.status = Status("identification", level, words, _values("done", 1.0))
        self.is_done = True
        self._end(words, level is Level.OK)


def _values(what: str, fraction: float) -> dict[str, str]:
    return {"doing": what, "progress (%)": f"{100.0 * fraction:.0f}"}
