"""The monitor's work beside the live path, without ROS, and what it says of that on /diagnostics.

One thread scores strokes, one isolates faults; the statuses tell of the valve, its model, the input, fault isolation,
and each stroke.
"""

from __future__ import annotations

import gc
import math
import queue
import threading
from collections.abc import Callable
from typing import Final, NamedTuple

from valve_sim.identification.monitoring.agreement import Agreement
from valve_sim.identification.monitoring.fault_isolation import FaultFinding, isolate_fault
from valve_sim.identification.monitoring.findings import Fault, Occasion, StrokeRecord, StrokeState
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.identification.reporting.monitor_messages import (
    TIMING_UNCERTAIN,
    fault_words,
    finding_json,
    keys_and_values,
    remark_words,
    shared_delay_words,
    state_words,
    stroke_json,
    told_finding,
)
from valve_sim.model.errors import ValveError
from valve_sim.nodes.diagnostics import Level, Status, number_words, unheard_words
from valve_sim.nodes.realtime import NANOSECONDS
from valve_sim.nodes.threads import Cancelled, Fail, StoppableThread
from valve_sim.recordings import Trace

MOST_WAITING: Final = 100
"""Queued strokes; further ones are dropped and counted."""
FARTHEST_STAMP: Final = 0.2
"""s by which the nearest stamp of a second may differ from the node's clock; transport takes milliseconds."""
LONGEST_WAIT: Final = 60.0
"""s that a sample may have waited on its way; what is older is of another clock."""
SAME_WAIT: Final = 0.05
"""s by which the waits of samples differ at most, within a second, on a machine that is not busy."""
BETWEEN_LOOKS: Final = 1.5
"""s from one look at the stamps to the next, at most."""
SILENT_SECONDS: Final = 2.0
"""Time without samples after which the input is a warning."""


class MonitorThread(StoppableThread):
    """A thread that compares strokes with the baseline, in order; the monitor belongs to it.

    `prepare` is called first, in the thread. `isolate` is called with the strokes of an alarm, the baseline, and the
    last of the strokes as it was cut out; `forget` when `recommission` has discarded the baseline.
    """

    def __init__(
        self,
        monitor: StrokeMonitor,
        *,
        prepare: Callable[[], None],
        report: Callable[[StrokeReport], None],
        isolate: Callable[[list[Trace], Baseline, StrokeRecord], None],
        forget: Callable[[], None],
        fail: Fail,
    ) -> None:
        super().__init__("monitor", self._compare, fail)
        self.lost = 0
        self._stroke_monitor = monitor
        self._prepare = prepare
        self._report = report
        self._isolate = isolate
        self._forget = forget
        self._anew = threading.Event()
        self._waiting: queue.Queue[StrokeRecord | None] = queue.Queue(MOST_WAITING)

    def post(self, record: StrokeRecord) -> None:
        """Queue a stroke; never waits."""
        try:
            self._waiting.put_nowait(record)
        except queue.Full:
            self.lost += 1

    def recommission(self) -> None:
        """Take the strokes that follow as the new baseline; never waits."""
        self._anew.set()
        self.wake()

    def wake(self) -> None:
        """Wake the thread."""
        try:
            self._waiting.put_nowait(None)
        except queue.Full:
            return

    def _compare(self) -> None:
        self._prepare()
        gc.freeze()  # as a `Worker` does
        while not self.is_stopping:
            record = self._waiting.get()
            if self._anew.is_set():
                self._anew.clear()
                self._stroke_monitor.recommission()
                self._forget()
            if record is not None and not self.is_stopping:
                self._take(record)

    def _take(self, record: StrokeRecord) -> None:
        self._report(self._stroke_monitor.assess(record))
        if evidence := self._stroke_monitor.take_evidence():
            self._isolate(evidence, self._stroke_monitor.with_present_scatter(), record)


class Found(NamedTuple):
    """A finding, and the last of the strokes that it rests on."""

    finding: FaultFinding
    occasion: Occasion

    @property
    def claim(self) -> tuple[str, frozenset[str]]:
        """The claim: the kind of the verdict, and its names."""
        return self.finding.verdict.kind, frozenset(self.finding.verdict.effects)


class _Work(NamedTuple):
    """A fault that is to be isolated."""

    strokes: list[Trace]
    baseline: Baseline
    occasion: Occasion


class FaultIsolation:
    """Isolates one fault at a time, each in a thread of its own; of requests meanwhile only the latest is kept.

    The search looks at each report of its progress whether it is still wanted. It may be long until the next one: a
    node that is to end does not wait for it.

    Args:
        tell: called in the thread with each finding, and with whether it names something else than the one before.

    Attributes:
        found: the last finding. doing: what is being tried; empty while nothing is. failure: why there was no result.
    """

    def __init__(self, tell: Callable[[Found, bool], None]) -> None:
        self.found: Found | None = None
        self.doing = ""
        self.failure = ""
        self._tell = tell
        self._next: _Work | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._is_wanted = threading.Event()
        self._is_stopping = False
        self._agreement = Agreement()

    def begin(self, strokes: list[Trace], baseline: Baseline, occasion: Occasion) -> None:
        """Isolate the fault in these strokes, now or after the run in progress; `occasion` is that of the last."""
        with self._lock:
            self._next = _Work(strokes, baseline, occasion)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="fault isolation", daemon=True)
                self._thread.start()

    def forget(self) -> None:
        """Discard what was found, and what a search that is going on will find."""
        with self._lock:
            self._is_wanted.clear()
            self._next, self.found, self.failure = None, None, ""
            self._agreement.forget()

    def stop(self, timeout: float) -> bool:
        """Cancel at the next report of progress; whether it has ended within `timeout`, s."""
        self._is_stopping = True
        self._is_wanted.clear()
        thread = self._thread
        if thread is not None:
            thread.join(timeout)
        return thread is None or not thread.is_alive()

    def _run(self) -> None:
        while (work := self._take()) is not None:
            try:
                finding = isolate_fault(work.strokes, work.baseline, self._say)
            except Cancelled:
                continue
            except Exception as error:  # whatever it is, the next stroke's search is to begin
                kind = "" if isinstance(error, ValveError) else f"{type(error).__name__}: "
                self._conclude(None, f"the fault could not be isolated: {kind}{error}")
            else:
                self._conclude(Found(finding, work.occasion), "")

    def _conclude(self, found: Found | None, failure: str) -> None:
        with self._lock:
            if not self._is_wanted.is_set():
                return
            if found is not None and self._agreement.add(found.finding) is None:
                self.failure = ""
                return  # one window of strokes alone may be wrong
            before = self.found
            self.found, self.failure = found or before, failure
        if found is not None:
            self._tell(found, before is None or found.claim != before.claim)

    def _take(self) -> _Work | None:
        with self._lock:
            work, self._next = self._next, None
            if work is None or self._is_stopping:
                self._thread, self.doing = None, ""
                return None
            self._is_wanted.set()
            return work

    def _say(self, what: str, fraction: float) -> None:
        if not self._is_wanted.is_set():
            raise Cancelled
        self.doing = f"{what} ({100.0 * fraction:.0f} %)"


class Health(NamedTuple):
    """Whether a valve is as commissioned: the level, a name that stays as long as nothing changes, and words."""

    level: Level
    state: str
    words: str


def health_of(monitor: StrokeMonitor, fault: Fault | None, found: Found | None, wanted: int) -> Health:
    """ERROR where the valve does not open or close, WARN where it has changed.

    Args:
        fault: of the stroke that is going on, or of the last one. found: the last finding.
        wanted: strokes that commissioning takes.
    """
    if fault is not None:
        return Health(Level.ERROR, "fault", fault_words(fault))
    alarm, scatter = monitor.alarm, monitor.command_scatter
    if alarm is not None:
        changed = f"the strokes since number {alarm.began} are not those of the commissioned valve"
        is_traced = found is not None and found.occasion.stroke >= alarm.began
        cause = told_finding(*found) if found is not None and is_traced else f"most in the direction of {alarm.cause}"
        return Health(Level.WARN, "alarm", f"{changed}: {cause}")
    if monitor.baseline is None:
        words = f"commissioning, {monitor.commissioned} of {wanted} strokes"
        return Health(Level.OK, state_words(StrokeState.COMMISSIONING), words)
    if monitor.is_timing_uncertain:
        words = f"commands are obeyed {1e3 * scatter:.1f} ms sooner or later than they come in; the shape of strokes is"
        return Health(Level.OK, TIMING_UNCERTAIN, f"{TIMING_UNCERTAIN}: {words} as commissioned")
    shared = f"{shared_delay_words(monitor.shared_delay)}; else " if monitor.shared_delay else ""
    return Health(Level.OK, state_words(StrokeState.WATCHING), f"{shared}as commissioned")


def health_status(
    fault: Fault | None, monitor: StrokeMonitor, last: StrokeReport | None, wanted: int, found: Found | None
) -> Status:
    """`health_of` a valve, and the figures of its `last` stroke; `fault` of the stroke that is going on."""
    values = {
        "strokes": "0" if last is None else str(last.record.number + 1),
        "alarms": str(monitor.alarms),
        "state": state_words(monitor.state),
        "scatter of commands (ms)": number_words(1e3 * monitor.command_scatter, ".3f"),
        "highest sum": "none" if last is None or math.isnan(last.sum) else f"{last.sum:.2f} ({last.cause})",
        "threshold": "none" if last is None else number_words(last.threshold, ".2f"),
        **(
            {"residual (µm)": "none"}
            if last is None
            else _figure("residual", last.rms, has_positions=last.has_positions)
        ),
        "cause": "" if found is None else told_finding(*found),
    }
    if fault is None and last is not None and not last.has_positions:
        fault = last.record.fault
    health = health_of(monitor, fault, found, wanted)
    return Status("valve", health.level, health.words, values)


def model_status(monitor: StrokeMonitor) -> Status:
    """Whether the declared model explains the healthy valve."""
    baseline = monitor.baseline
    if baseline is None:
        return Status("model", Level.OK, "not commissioned yet", {})
    parameters = baseline.valve.parameters
    values = {
        "pilot_damping (N·s·m⁻¹)": f"{parameters.pilot_damping:.5g}",
        "main_damping (N·s·m⁻¹)": f"{parameters.main_damping:.5g}",
        **_figure("noise", baseline.noise.sigma, has_positions=baseline.has_positions),
        "lateness (µs)": f"{1e6 * baseline.lateness:.1f}",
        "scatter of commands (µs)": f"{1e6 * baseline.scatter:.1f}",
    }
    against = monitor.contradictions
    if against:
        words = f"the declared valve is not this one, even when healthy (see {', '.join(against[:3])}); `diagnose` it"
        return Status("model", Level.WARN, words, values)
    return Status("model", Level.OK, "explains the healthy valve", values)


def isolation_status(isolation: FaultIsolation) -> Status:
    """Progress of fault isolation."""
    if isolation.failure:
        return Status("fault isolation", Level.WARN, isolation.failure, {})
    if isolation.doing:
        return Status("fault isolation", Level.OK, "running", {"doing": isolation.doing})
    return Status("fault isolation", Level.OK, "idle", {})


def stroke_status(report: StrokeReport, valve: str) -> Status:
    """A stroke as keys and values, each figure a number in SI units; what is not known is left out."""
    level, words = _verdict_on(report)
    return Status("stroke", level, words, dict(keys_and_values(stroke_json(report, valve))))


def finding_status(found: Found) -> Status:
    """A finding as keys and values: the kind of its verdict, the effects and their sizes, and how sure all that is."""
    told = finding_json(*found)
    values = {name: value for name, value in told.items() if name not in ("schema", "summary")}
    return Status("finding", Level.WARN, told["summary"], dict(keys_and_values(values)))


def _verdict_on(report: StrokeReport) -> tuple[Level, str]:
    """Level and message of one stroke."""
    if report.record.fault is not None:
        return Level.ERROR, fault_words(report.record.fault)
    if report.alarm is not None:
        return Level.WARN, "an alarm"
    return Level.OK, state_words(report.state) if report.remark is None else remark_words(report.remark)


def _figure(name: str, value: float, *, has_positions: bool) -> dict[str, str]:
    """What is measured, m in µm or, by the current alone, A in mA."""
    unit, scale = ("µm", 1e6) if has_positions else ("mA", 1e3)
    return {f"{name} ({unit})": number_words(scale * value, ".3f")}


class StampCheck:
    """Compares the stamps of samples with the node's own clock, by which commands are timed: they must be one clock.

    A clock that is wrong is so by the same time for each sample. Samples that wait, in a driver or on a busy machine,
    differ in how long, by more than the least of it; and where clocks were seen to agree, the least grows no faster
    than time goes on.
    """

    def __init__(self) -> None:
        self._begin()
        self._waited = math.nan
        """s that samples had waited at the last look; nan where clocks were not seen to agree."""

    def _begin(self) -> None:
        self._topic, self._least, self._most = "", math.inf, -math.inf

    def note(self, topic: str, stamp: int, now: int) -> None:
        """A sample came with this stamp at this ROS time, ns, which is 0 before the first /clock."""
        if not now:
            return
        late = now - stamp
        self._most = max(self._most, late)
        if abs(late) < abs(self._least):
            self._topic, self._least = topic, late

    def look(self, *, is_simulated: bool) -> str:
        """What is wrong with the stamps since the last look, and the mend; empty where nothing is, or none came."""
        topic, least, most = self._topic, self._least / NANOSECONDS, self._most / NANOSECONDS
        self._begin()
        if not topic:
            return ""
        is_one_clock = abs(least) <= FARTHEST_STAMP
        has_grown = least - self._waited <= BETWEEN_LOOKS and most - least > SAME_WAIT
        has_waited = 0.0 < least < LONGEST_WAIT and (has_grown or most - least > least)
        self._waited = least if is_one_clock or has_waited else math.nan
        if is_one_clock:
            return ""
        if has_waited:
            return (
                f"{topic} comes {_duration(least)} to {_duration(most)} after its stamps, held back by its driver or a "
                "busy machine; send each sample at once, or fewer of them"
            )
        mend = (
            "all must be stamped by /clock, or use_sim_time be false"
            if is_simulated
            else "of a recording: use_sim_time:=true, ros2 bag play --clock-topics-all; of another computer: set its "
            "clock (NTP)"
        )
        where = "behind" if least > 0.0 else "ahead of"
        return f"{topic} is stamped {_duration(abs(least))} {where} this node's clock, which times commands; {mend}"


def _duration(seconds: float) -> str:
    if seconds < 7200.0:
        return f"{seconds:.1f} s"
    return f"{seconds / 3600.0:.1f} h" if seconds < 172_800.0 else f"{seconds / 86_400.0:.0f} days"


class InputCount:
    """Counts samples, commands and what cannot be used, for /diagnostics."""

    def __init__(self) -> None:
        self.samples = 0
        self.commands = 0
        self.rejected = 0
        self.incomplete = 0
        """Strokes that were not judged because messages are missing or late."""
        self._why = ""
        self._lost_before = 0
        self._looked_at = math.nan
        self._samples_before = 0
        self._rejected_before = 0
        self._last_sample = math.nan

    def reject(self, why: str) -> None:
        """Count one that cannot be used."""
        self.rejected += 1
        self._why = why

    def status(
        self, now: float, lost: int, waiting_for: str, unheard: int = 0, stamps: str = "", not_judged: str = ""
    ) -> Status:
        """Whether samples and commands arrive and can be used; counts since the last call.

        Args:
            now: s of a monotonic clock. lost: strokes, in all, that were not judged for lack of time.
            waiting_for: what is still missing, or empty. unheard: publishers of commands of incompatible QoS.
            stamps: what `StampCheck` says. not_judged: that the last stroke was not, for lack of messages; or empty.
        """
        fresh, rejected_now = self.samples - self._samples_before, self.rejected - self._rejected_before
        if fresh or math.isnan(self._last_sample):
            self._last_sample = now if fresh else math.nan
        rate = fresh / (now - self._looked_at) if now > self._looked_at else math.nan
        self._looked_at, self._samples_before, self._rejected_before = now, self.samples, self.rejected
        silence, lost_now, self._lost_before = now - self._last_sample, lost - self._lost_before, lost
        values = {
            "samples": str(self.samples),
            "commands": str(self.commands),
            "rate (Hz)": number_words(rate, ".1f"),
            "rejected": str(self.rejected),
            "strokes not judged": str(lost + self.incomplete),
        }
        rejections = f"rejected, the last: {self._why}"
        waits = [
            f"waiting for {waiting_for}",
            *([f"{self.rejected} {rejections}"] if self.rejected else ()),
            *([unheard_words(unheard)] if unheard else ()),
        ]
        doubts = (
            stamps,
            "; ".join(waits) if waiting_for else "",
            f"{rejected_now} {rejections}" if rejected_now else "",
            f"no sample for {silence:.1f} s" if silence > SILENT_SECONDS else "",
            unheard_words(unheard),
            f"{lost_now} strokes are not judged, for lack of time" if lost_now else "",
            not_judged,
        )
        doubt = next(filter(None, doubts), "")
        return Status("input", Level.WARN if doubt else Level.OK, doubt or "arrives", values)
