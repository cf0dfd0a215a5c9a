"""The program `valve-sim`, and `python -m valve_sim`: from its first import on, Ctrl-C ends it with one line."""

from __future__ import annotations

import os
import signal
import sys

STOPPED = 130


def main() -> None:
    """Run the command line and exit."""
    usual = sys.unraisablehook
    # A Ctrl-C that comes while an object is deleted reaches nobody but this.
    sys.unraisablehook = lambda found: _stop() if found.exc_type is KeyboardInterrupt else usual(found)
    try:
        from valve_sim.cli import main as run

        run()
    except KeyboardInterrupt:
        _stop()
    except SystemExit as end:
        if end.code != STOPPED:
            raise
        _leave()


def _stop() -> None:
    os.write(sys.__stderr__.fileno() if sys.__stderr__ else 2, b"valve-sim: stopped\n")
    _leave()


def _leave() -> None:
    """End at once: a thread of a fit would be waited for, and a second Ctrl-C would interrupt that with a traceback."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from contextlib import suppress

    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(STOPPED)


if __name__ == "__main__":
    main()
