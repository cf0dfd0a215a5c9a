"""Work that does something to the process it is done in; workers import this module by its name."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path


def twice(items: Sequence[int]) -> list[float]:
    """Nothing to speak of."""
    return [2.0 * item for item in items]


def twice_but_for_seven(items: Sequence[int]) -> list[float]:
    """What fails whenever 7 is among the items."""
    if 7 in items:
        raise RuntimeError("seven")
    return twice(items)


def twice_after_a_death(items: Sequence[int], marker: Path) -> list[float]:
    """The first process that comes to 3 dies of it."""
    if 3 in items and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return twice(items)


def kill_it(items: Sequence[int], process: int) -> list[float]:
    """Kill another process, such as the scheduler."""
    os.kill(process, signal.SIGKILL)
    return twice(items)
