"""The monitor's work beside the live path, without ROS: a thread that scores strokes, and one that isolates faults."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Final

from valve_sim.identification.estimation.parallel import threads_limited_to
from valve_sim.identification.monitoring.fault_isolation import FaultFinding, isolate_fault
from valve_sim.identification.monitoring.findings import StrokeRecord
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.model.errors import ValveError
from valve_sim.nodes.stoppable import StoppableThread
from valve_sim.traces import Trace

MOST_WAITING: Final = 100
"""Queued strokes; further ones are dropped and counted."""


class MonitorThread(StoppableThread):
    """A thread that compares strokes with the baseline, in order.

    Args:
        monitor: does it; belongs to this thread.
        prepare: called first, in the thread.
        report: called with each report.
        isolate: called with the strokes of an alarm, when it is time to isolate its fault.
        forget: called when the baseline has been discarded, because `recommission` was called.
        fail: called with the exception, if there is one; the thread then ends.
    """

    def __init__(
        self,
        monitor: StrokeMonitor,
        *,
        prepare: Callable[[], None],
        report: Callable[[StrokeReport], None],
        isolate: Callable[[list[Trace], Baseline], None],
        forget: Callable[[], None],
        fail: Callable[[Exception], None],
    ) -> None:
        super().__init__("monitor")
        self.lost = 0
        self._stroke_monitor = monitor
        self._prepare = prepare
        self._report = report
        self._isolate = isolate
        self._forget = forget
        self._fail = fail
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

    def run(self) -> None:
        """The thread."""
        try:
            self._prepare()
            while not self.is_stopping:
                record = self._waiting.get()
                if self._anew.is_set():
                    self._anew.clear()
                    self._stroke_monitor.recommission()
                    self._forget()
                if record is not None and not self.is_stopping:
                    self._work(record)
        except Exception as error:
            if not self.is_stopping:
                self._fail(error)

    def _work(self, record: StrokeRecord) -> None:
        self._report(self._stroke_monitor.assess(record))
        if evidence := self._stroke_monitor.take_evidence():
            self._isolate(evidence, self._stroke_monitor.with_present_scatter())


class FaultIsolation:
    """Isolates one fault at a time, each in a thread of its own; of requests meanwhile only the latest is kept.

    Args:
        tell: called with each finding, in the thread.
    """

    def __init__(self, tell: Callable[[FaultFinding], None]) -> None:
        self.finding: FaultFinding | None = None
        self.doing = ""
        self.failure = ""
        self._tell = tell
        self._next: tuple[list[Trace], Baseline] | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._stopping = threading.Event()

    def begin(self, strokes: list[Trace], baseline: Baseline) -> None:
        """Isolate the fault in these strokes, now or after the run in progress."""
        with self._lock:
            self._next = strokes, baseline
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="fault isolation", daemon=True)
                self._thread.start()

    def forget(self) -> None:
        """Discard what was found."""
        with self._lock:
            self._next, self.finding, self.failure = None, None, ""

    def stop(self, timeout: float | None) -> bool:
        """Cancel at the next report of progress; whether it has ended within `timeout`, s."""
        self._stopping.set()
        thread = self._thread
        if thread is not None:
            thread.join(timeout)
        return thread is None or not thread.is_alive()

    def _run(self) -> None:
        while (work := self._take()) is not None:
            try:
                # The other processors are for the live path, and for the nodes of other valves.
                with threads_limited_to(1):
                    found = isolate_fault(*work, self._say)
            except _Cancelled:
                return
            except (ValveError, ArithmeticError, ValueError) as error:
                self.failure = f"the fault could not be isolated: {error}"
            else:
                self.finding, self.failure = found, ""
                if not self._stopping.is_set():
                    self._tell(found)

    def _take(self) -> tuple[list[Trace], Baseline] | None:
        with self._lock:
            work, self._next = self._next, None
            if work is None or self._stopping.is_set():
                self._thread, self.doing = None, ""
                return None
            return work

    def _say(self, what: str, fraction: float) -> None:
        if self._stopping.is_set():
            raise _Cancelled
        self.doing = f"{what} ({100.0 * fraction:.0f} %)"


class _Cancelled(Exception):  # noqa: N818 -- not an error: the node ends
    """Fault isolation is to stop."""
