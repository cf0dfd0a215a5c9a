"""The work of identification_node, without ROS: a replay and a fit or a diagnosis, each in a thread.

A recording is played by a clock beside the model's prediction at each sample, while it is fitted or diagnosed; then
follow the files and the report.
"""

from __future__ import annotations

import contextlib
import json
import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.parameter_files import save_valve
from valve_sim.files.recording_map import load_map
from valve_sim.identification.diagnosis.handing_on import handed_on
from valve_sim.identification.diagnosis.identify import Identification, identify
from valve_sim.identification.fit.declared_values import out_of_tolerance
from valve_sim.identification.fit.findings import leaves_more_than_noise
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.plants.valve_model import DAMPINGS, dampings_of
from valve_sim.identification.plants.valve_sensors import response_to
from valve_sim.identification.reporting.identification_document import identification_document
from valve_sim.identification.reporting.units import measured
from valve_sim.model import Phase, Reading, Response, Valve
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status, number_words
from valve_sim.nodes.realtime import (
    LISTENERS_SECONDS,
    NANOSECONDS,
    ClockJumpedError,
    PaceClock,
    TimingRecord,
    when_due,
)
from valve_sim.nodes.settings import IdentificationSettings
from valve_sim.nodes.threads import Cancelled, Fail, StoppableThread
from valve_sim.recordings import Trace, another_valve, left_out_finding, read_trace, refuse_doubtful_units

LATE_SECONDS: Final = 0.01
"""s: lateness of published samples, 99th percentile, beyond which there is a warning."""
_UNKNOWN: Final = math.nan
IDENTIFIED_FILE: Final = "identified.yaml"
CORRECTED_FILE: Final = "corrected.yaml"
BEFORE_FILE: Final = "before.yaml"
_NAMED: Final = ("none", "effects", "partly")
Progress = Callable[[str, float], None]


class Prediction(NamedTuple):
    """The readings of a simulated valve at a trace's samples, and the name of the model, for people."""

    response: Response
    model: str

    def reading(self, index: int) -> Reading:
        """The reading at one sample; the main plunger's force is not given (NaN)."""
        own = self.response
        names = ("time", "pilot_position", "main_position", "pilot_velocity", "coil_current", "attraction")
        time, pilot, main, velocity, current, attraction = (float(getattr(own, name)[index]) for name in names)
        phase = Phase(int(own.phase[index]))
        moves = velocity if phase is Phase.MAIN else 0.0
        return Reading(time, pilot, main, velocity, moves, current, attraction, _UNKNOWN, phase, ())


def predict(trace: Trace, valve: Valve, clock_offset: float, model: str) -> Prediction:
    """Simulate a valve under the commands of a trace, whose samples are stamped `clock_offset`, s, late."""
    drive = trace.input(valve.parameters.release_voltage)
    times = trace.sample_times - clock_offset
    start = float(min(np.min(drive.times, initial=math.inf), np.min(times, initial=math.inf)))
    return Prediction(response_to(valve, trace, drive, times, start, clock_offset), model)


def measured_reading(trace: Trace, index: int) -> Reading:
    """A sample as a reading; what was not measured is NaN."""
    pilot = main = current = _UNKNOWN
    if trace.has_positions:
        pilot = float(trace.pilot_position[index])
        main = _UNKNOWN if trace.main_position is None else float(trace.main_position[index])
    elif trace.coil_current is not None:
        current = float(trace.coil_current.values[index])
    time = float(trace.sample_times[index])
    return Reading(time, pilot, main, _UNKNOWN, _UNKNOWN, current, _UNKNOWN, _UNKNOWN, Phase.CLOSED, ())


def measured_voltages(trace: Trace) -> NDArray[np.float64]:
    """(n,) V at the coil's terminals at each sample; NaN where no voltage has its stamp."""
    shown = np.full(len(trace.sample_times), _UNKNOWN)
    if trace.coil_voltage is not None:
        _, at, which = np.intersect1d(trace.sample_times, trace.coil_voltage.times, return_indices=True)
        shown[at] = trace.coil_voltage.values[which]
    return shown


def timeline(trace: Trace, rate: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """When each command and sample is due, in order; a command precedes a sample of equal time.

    Returns:
        (k + n,) ns after the start, all 0 at rate 0; and (k + n,) index of a sample, or −1 − that of a command.
    """
    times = np.concatenate([trace.drive.times, trace.sample_times])
    commands = len(trace.drive.times)
    places = np.concatenate([-1 - np.arange(commands), np.arange(len(trace.sample_times))])
    order = np.argsort(times, kind="stable")
    elapsed = times[order] - times[order[0]]
    offsets = np.rint(elapsed * (NANOSECONDS / rate)) if rate > 0.0 else np.zeros(len(elapsed))
    return offsets.astype(np.int64), places[order]


class Replay(StoppableThread):
    """A thread that replays a trace by absolute deadlines: nothing is left out, and lateness does not accumulate.

    After a jump of the clock it starts again. `rate` is in seconds of the trace a second of the clock, 0 for as fast as
    possible. `prepare` is called first, in the thread; `play` with each place of `timeline`; `end` when all is played.
    """

    def __init__(
        self, clock: PaceClock, trace: Trace, *, rate: float, loop: bool, prepare: Callable[[], None],
        play: Callable[[int], None], end: Callable[[], None], fail: Fail,
    ) -> None:  # fmt: skip
        super().__init__("replay", self._replay, fail)
        self.timing = TimingRecord()
        self.passes = 0
        self.played = 0
        self.is_done = False
        self._clock, self._loop, self._prepare, self._play, self._end = clock, loop, prepare, play, end
        self._offsets, self._places = (found.tolist() for found in timeline(trace, rate))
        span = float(trace.sample_times[-1] - trace.sample_times[0])
        self.samples_a_second = rate * (len(trace.sample_times) - 1) / span if span > 0.0 else 0.0
        self._period = NANOSECONDS / self.samples_a_second if self.samples_a_second > 0.0 else math.inf

    @property
    def samples(self) -> int:
        """Commands and samples of one pass."""
        return len(self._offsets)

    def wake(self) -> None:
        """Interrupt the wait for the next sample."""
        self._clock.wake()

    def _replay(self) -> None:
        self._prepare()
        self._stopping.wait(LISTENERS_SECONDS)
        while not self.is_stopping:
            is_whole = self._play_once()
            self.passes += is_whole
            if is_whole and not self._loop:
                break
        self.is_done = not self.is_stopping
        if self.is_done:
            self._end()

    def _play_once(self) -> bool:
        """Replay once; False if broken off because the clock jumped or the thread is to end."""
        self.played = 0
        with contextlib.suppress(ClockJumpedError):
            for index, late in when_due(self._clock, self._offsets, lambda: self.is_stopping):
                if self._places[index] >= 0:
                    self.timing.note(late, self._period)
                self._play(self._places[index])
                self.played = index + 1
        return self.played == self.samples


def replay_status(replay: Replay, now: int, model: str) -> Status:
    """Progress of the replay; `now` in ns of the clock that it follows."""
    timing = replay.timing.look(now)
    wanted = replay.samples_a_second
    values = {
        "model": model,
        "passes": str(replay.passes),
        "played": f"{replay.played} of {replay.samples}",
        "rate wanted (Hz)": f"{wanted:g}" if wanted > 0.0 else "as fast as possible",
        "rate reached (Hz)": number_words(timing.rate, ".1f"),
    }
    if replay.is_done:
        return Status("replay", Level.OK, "done", values)
    if wanted > 0.0:
        values["lateness p99 (ms)"] = number_words(1e3 * timing.lateness, ".3f")
        if timing.lateness > LATE_SECONDS:
            message = f"samples are published up to {timing.lateness:.3f} s late; ask for a lower rate"
            return Status("replay", Level.WARN, message, values)
    return Status("replay", Level.OK, "playing" if replay.played else "about to begin", values)


class Outcome(NamedTuple):
    """The result of a fit or a diagnosis.

    Attributes:
        valve: the identified or corrected one. clock_offset: s by which the samples are stamped late.
        report: content of identify.json or report.json. file: where the valve was written.
        summary: one sentence for a person. intervals: by name of each fitted parameter.
        to_set: the declared valve with what the recording determines, for `apply_to`.
        held: names of what was refitted or within a tolerance, and stays as declared in it.
        objection: why the valve should not be handed on; empty where nothing speaks against it.
        advice: the profile to record next; None where nothing is to be told apart.
    """

    valve: Valve
    clock_offset: float
    report: dict[str, Any]
    file: Path
    summary: str
    intervals: Mapping[str, Interval]
    to_set: Valve
    held: tuple[str, ...]
    objection: str
    advice: Path | None = None

    @property
    def files(self) -> str:
        """The files that were written, in words."""
        return str(self.file) if self.advice is None else f"{self.file}, and {self.advice} for what to record next"


class Applied(NamedTuple):
    """Whether the result was set on the valve `node` of `apply_to`, or why not; a line for each change."""

    node: str
    is_set: bool
    reason: str = ""
    changes: tuple[str, ...] = ()


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
    report, handed = identification_document(result).to_json(), handed_on(result.fit, result.intervals)
    objection = _objection_to(result) or handed.objection
    return Outcome(result.valve, offset, report, file, summary, result.intervals, handed.valve, handed.held, objection)


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
    from valve_sim.identification.fit.budget import Budget
    from valve_sim.identification.reporting.claims import summarise
    from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
    from valve_sim.identification.reporting.record_next import write_record_next

    result = diagnose([trace], [], declared, progress, Budget.of_seconds(settings.budget))
    file = folder / CORRECTED_FILE
    summary, report = summarise(result), diagnosis_document(result).to_json()
    if result.verdict.is_corrected and (left := what_is_left(result)):
        summary += f" Beside it {left}."
    provenance = _provenance(settings, summary)
    save_valve(file, result.valve, provenance)
    given = {"--params": settings.params, "--map": settings.map, "--valve": settings.valve_name}
    options = shlex.join([word for option, value in given.items() if value for word in (option, value)])
    advice = write_record_next(folder, result, provenance, options)
    offset = result.after.fit.values.get("clock_offset[0]", 0.0)
    kind = result.verdict.kind
    objection = objection_to(result) if kind in _NAMED else f"the verdict is {kind!r}"
    handed = handed_on(result.after.fit, result.after.intervals)
    return Outcome(
        result.valve, offset, report, file, summary, result.after.intervals, handed.valve, handed.held,
        objection or handed.objection, advice,
    )  # fmt: skip


def _provenance(settings: IdentificationSettings, summary: str) -> str:
    declared = settings.params or "the shipped valve"
    return f"by identification_node from {settings.bag}, starting from {declared}\n{summary}"


def report_text(outcome: Outcome, applied: Applied | None) -> str:
    """The report as JSON, with the outcome of `apply_to`."""
    handed_on = None if applied is None else applied._asdict()
    return json.dumps({**outcome.report, "file": str(outcome.file), "applied": handed_on}, ensure_ascii=False)


class Task(StoppableThread):
    """A thread that does the work, whose progress can be read at any time; it ends at its next report of progress.

    `end` is called with the sentence that the work returns, or with why there is none, and whether it is good.
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
