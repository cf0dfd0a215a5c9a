"""The monitor's work beside the live path, without ROS: a thread that scores strokes, and one that isolates faults."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Final, NamedTuple

from valve_sim.identification.estimation.parallel import threads_limited_to
from valve_sim.identification.monitoring.fault_isolation import FaultFinding, isolate_fault
from valve_sim.identification.monitoring.findings import Occasion, StrokeRecord
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.model.errors import ValveError
from valve_sim.nodes.threads import Fail, StoppableThread
from valve_sim.traces import Trace

MOST_WAITING: Final = 100
"""Queued strokes; further ones are dropped and counted."""


class MonitorThread(StoppableThread):
    """A thread that compares strokes with the baseline, in order.

    Args:
        monitor: does it; belongs to this thread.
        prepare: called first, in the thread.
        report: called with each report.
        isolate: called with the strokes of an alarm, the baseline, and the last of the strokes as it was cut out, when
            it is time to isolate its fault.
        forget: called when the baseline has been discarded, because `recommission` was called.
        fail: told what went wrong.
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
                # The other processors are for the live path, and for the nodes of other valves.
                with threads_limited_to(1):
                    finding = isolate_fault(work.strokes, work.baseline, self._say)
            except _Cancelled:
                continue
            except (ValveError, ArithmeticError, ValueError) as error:
                self._conclude(None, f"the fault could not be isolated: {error}")
            else:
                self._conclude(Found(finding, work.occasion), "")

    def _conclude(self, found: Found | None, failure: str) -> None:
        with self._lock:
            if not self._is_wanted.is_set():
                return
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
            raise _Cancelled
        self.doing = f"{what} ({100.0 * fraction:.0f} %)"


class _Cancelled(Exception):  # noqa: N818 -- not an error: the node ends
    """What is being isolated is no longer wanted."""
