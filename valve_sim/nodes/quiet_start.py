"""Imported first by what runs programs: a signal that comes while modules load ends them without a traceback.

Nothing has begun by then, so the exit code is 0; that of command_profile, which says whether all was sent, is 1.
"""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType

_PROGRAMS = ("_node", "command_profile", "nodes/__main__.py", "station/__main__.py")
"""What the first word of a program's command line ends in; others that import this keep their signals."""


def _end(number: int, frame: FrameType | None) -> None:
    os._exit(int(any(word.endswith("command_profile") for word in sys.argv[:2])))


if sys.argv[0].endswith(_PROGRAMS):
    for _number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(_number, _end)
