"""While a program of this package loads, SIGINT and SIGTERM end it at once, without a traceback.

Imported first by what runs a program, for its effect. So it loads no more than it must.
"""

from __future__ import annotations

import os
import signal
import sys

NODES = {
    "archive_node": 0,
    "command_profile": 1,
    "identification_node": 0,
    "monitor_node": 0,
    "opcua_node": 0,
    "plc_node": 0,
    "valve_node": 0,
}
"""Exit code of each program of a node while it starts; that of command_profile says that not all was sent."""
_STOPPED = 130
_OTHERS = ("demo/__main__.py", "valve_sim/warm.py")


def _end_with(code: int) -> None:
    """Have both signals end the process with an exit code from now on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, frame: os._exit(code))


if sys.argv[0].endswith(_OTHERS):
    _end_with(_STOPPED)
# `python -m valve_sim.nodes valve_node` has the name behind. Others that import this keep their signals.
_name = (sys.argv[1:] or [""])[0] if sys.argv[0].endswith("/__main__.py") else sys.argv[0].rpartition("/")[2]
if _name in NODES:
    _end_with(NODES[_name])
