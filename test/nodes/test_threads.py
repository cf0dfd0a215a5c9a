"""The threads of a node, without ROS: what goes wrong in one is told, and a signal at any moment ends the work."""

from __future__ import annotations

import subprocess
import sys
import threading

import pytest

from valve_sim.nodes.threads import StoppableThread, StopRequest

from .ros_process import ENDS_WITHIN

INTERRUPTED = """
import signal
from valve_sim.nodes.threads import StopRequest

came = 0
stop = StopRequest()

def handle(number, frame):
    global came
    came += 1
    stop.ask("a signal came")
    stop.why = ""  # so that the wait goes on, to be interrupted at another place
    signal.setitimer(signal.ITIMER_REAL, 20e-6 if came < 5000 else 0.0)

signal.signal(signal.SIGALRM, handle)
signal.setitimer(signal.ITIMER_REAL, 20e-6)
while came < 5000:
    stop.wait(1e-6)
"""
"""A main thread that waits again and again while signals come; with threading.Event it stands still soon."""


def test_a_signal_never_finds_the_main_thread_holding_what_its_handler_needs() -> None:
    subprocess.run([sys.executable, "-c", INTERRUPTED], check=True, timeout=ENDS_WITHIN)


def test_the_first_reason_to_stop_counts_and_whoever_waits_later_need_not_wait() -> None:
    stop = StopRequest()
    assert not stop.wait(0.0)
    stop.ask("first")
    stop.ask("second")
    assert stop.wait() and stop.wait() and stop.wait(0.0)
    assert stop.why == "first"


@pytest.mark.parametrize("is_ending", [False, True])
def test_what_goes_wrong_is_told_unless_the_thread_is_to_end_anyway(is_ending: bool) -> None:
    told: list[Exception] = []
    begun, may_fail = threading.Event(), threading.Event()

    def work() -> None:
        begun.set()
        may_fail.wait()
        raise ValueError("too stiff")

    thread = StoppableThread("work", work, told.append)
    thread.start()
    begun.wait()
    if is_ending:
        assert not thread.stop(0.0)
    may_fail.set()
    thread.join()
    assert [str(error) for error in told] == ([] if is_ending else ["too stiff"])
    assert thread.stop(0.0)
