"""What identification_node finds out, without ROS: a fit or a diagnosis in a thread, its files and its report."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim.files.parameter_files import save_valve
from valve_sim.identification.identify import Identification, identify
from valve_sim.model import Valve
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status
from valve_sim.nodes.identification_parameters import Settings
from valve_sim.traces import Trace

IDENTIFIED_FILE: Final = "identified.yaml"
CORRECTED_FILE: Final = "corrected.yaml"
_APPLICABLE: Final = ("none", "effects")

Progress = Callable[[str, float], None]


class Outcome(NamedTuple):
    """What was found.

    Attributes:
        valve: the identified or corrected one. clock_offset: s by which the samples are stamped late.
        report: content of identify.json or report.json. file: where the valve was written.
        summary: one sentence for a person. is_applicable: whether the valve may be handed on.
    """

    valve: Valve
    clock_offset: float
    report: dict[str, Any]
    file: Path
    summary: str
    is_applicable: bool


class Applied(NamedTuple):
    """Whether a running node took the result over: its name, and why not."""

    node: str
    is_set: bool
    reason: str


class Cancelled(Exception):  # noqa: N818 -- not an error: the node ends
    """The thread was asked to stop."""


def find_out(trace: Trace, declared: Valve, settings: Settings, folder: Path, progress: Progress) -> Outcome:
    """Refit or diagnose, and write the valve that was found into `folder`.

    Raises:
        ValveError: the declared valve cannot be simulated, or the file cannot be written.
    """
    if settings.mode == "identify":
        return _identified(identify([trace], declared, settings.free, progress), settings, folder)
    return _diagnosed(trace, declared, settings, folder, progress)


def _identified(result: Identification, settings: Settings, folder: Path) -> Outcome:
    values = [f"{name} {interval.value:.6g} ± {interval.stderr:.2g}" for name, interval in result.intervals.items()]
    summary = f"identified: {', '.join(values)}"
    file = folder / IDENTIFIED_FILE
    save_valve(file, result.valve, _provenance(settings, summary))
    offset = result.fit.values["clock_offset[0]"]
    return Outcome(result.valve, offset, result.to_json(), file, summary, result.fit.converged)


def _diagnosed(trace: Trace, declared: Valve, settings: Settings, folder: Path, progress: Progress) -> Outcome:
    # Only where it is asked for: it brings half a second of imports.
    from valve_sim.identification.diagnosis import diagnose
    from valve_sim.identification.report_json import to_json

    result = diagnose([trace], [], declared, progress)
    file = folder / CORRECTED_FILE
    save_valve(file, result.valve, _provenance(settings, result.verdict.summary))
    offset = result.after.fit.values.get("clock_offset[0]", 0.0)
    is_applicable = result.verdict.kind in _APPLICABLE
    return Outcome(result.valve, offset, to_json(result), file, result.verdict.summary, is_applicable)


def _provenance(settings: Settings, summary: str) -> str:
    declared = settings.params or "the shipped valve"
    return f"by identification_node from {settings.bag}, starting from {declared}\n{summary}"


def report_text(outcome: Outcome, applied: Applied | None) -> str:
    """The report as JSON, with what became of `apply_to`."""
    handed_on = None if applied is None else applied._asdict()
    return json.dumps({**outcome.report, "file": str(outcome.file), "applied": handed_on}, ensure_ascii=False)


class Task(threading.Thread):
    """A thread that finds out and hands on; how far it is can be asked for at any time.

    Args:
        work: does it, telling its progress; returns one sentence for a person.
        end: called with that sentence, or with why there is none; is_good says which.
    """

    def __init__(self, work: Callable[[Progress], str], end: Callable[[str, bool], None]) -> None:
        super().__init__(name="identification", daemon=True)
        self._work = work
        self._end = end
        self._stopping = threading.Event()
        self._state = Status("identification", Level.OK, "about to begin", _values("", 0.0))

    @property
    def status(self) -> Status:
        """How far it is."""
        return self._state

    def stop(self, timeout: float) -> bool:
        """End the thread at its next word of progress; whether it has ended within `timeout`, s."""
        self._stopping.set()
        if self.is_alive():
            self.join(timeout)
        return not self.is_alive()

    def run(self) -> None:
        """The thread."""
        try:
            summary = self._work(self._say)
        except Cancelled:
            return
        except ValveError as error:
            self._finish(str(error), Level.ERROR)
        except Exception as error:
            if not self._stopping.is_set():
                self._finish(repr(error), Level.ERROR)
        else:
            self._finish(summary, Level.OK)

    def _say(self, what: str, fraction: float) -> None:
        if self._stopping.is_set():
            raise Cancelled
        self._state = Status("identification", Level.OK, what, _values(what, fraction))

    def _finish(self, words: str, level: Level) -> None:
        self._state = Status("identification", level, words, _values("done", 1.0))
        self._end(words, level is Level.OK)


def _values(what: str, fraction: float) -> dict[str, str]:
    return {"doing": what, "progress (%)": f"{100.0 * fraction:.0f}"}
