"""docs/examples/sequencer.py run again and again in one process, each time with a signal at a random moment.

    python interrupted_sequencer.py SEQUENCER RUNS SEED VALVES --ros-args -p ...

It runs at least so often, and until each of so many valves has been opened, which a busy machine may not come to before
the first signals. Prints how each run ended, a line each: the exit code, or the exception that came out of it, after
which none is run.
"""

from __future__ import annotations

import os
import random
import runpy
import signal
import sys
import threading
import time
from collections.abc import Callable
from typing import Any, Final

SIGNALS: Final = (signal.SIGINT, signal.SIGTERM)
LONGEST: Final = 0.8
"""s from the moment at which the sequencer takes its signals to the signal: long enough to open valves often."""


def interrupt(number: int, delay: float) -> None:
    """Send this process a signal, so many seconds after it does something else with it than to ignore it."""
    while signal.getsignal(number) is signal.SIG_IGN:
        time.sleep(1e-3)
    time.sleep(delay)
    os.kill(os.getpid(), number)


def interrupted(main: Callable[[], int], number: int, delay: float) -> int:
    """The exit code of a run that gets a signal."""
    for each in SIGNALS:
        signal.signal(each, signal.SIG_IGN)
    sender = threading.Thread(target=interrupt, args=(number, delay), daemon=True)
    sender.start()
    code = main()
    sender.join()
    return code


def note_opened(remote_valve: Any) -> set[str]:
    """A set that grows by the name of each valve that is given a voltage."""
    opened: set[str] = set()
    command = remote_valve.command

    def note(self: Any, volts: float) -> None:
        if volts:
            opened.add(self.name)
        command(self, volts)

    remote_valve.command = note
    return opened


def main(program: str, runs: int, seed: int, valves: int) -> None:
    """All runs."""
    moments = random.Random(seed)
    example = runpy.run_path(program)
    opened = note_opened(example["RemoteValve"])
    longest, done = LONGEST, 0
    while done < runs or len(opened) < valves:
        before = len(opened)
        number, delay = moments.choice(SIGNALS), moments.uniform(0.0, longest)
        try:
            print(interrupted(example["main"], number, delay), flush=True)
        except BaseException as error:
            print(repr(error), flush=True)
            raise
        done += 1
        if len(opened) == before < valves:
            # The signal came before the valves had been found, which may take long: most should find it at work.
            longest *= 1.5


if __name__ == "__main__":
    main(sys.argv[1], *(int(word) for word in sys.argv[2:5]))
