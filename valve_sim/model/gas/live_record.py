"""A valve that is stepped now and then, in one record: what the core needs of it, and what it shows at its last time.

A step a millisecond finds the processor's caches filled by others. To unpack ten arguments of Python then takes as
long as the step; one argument takes a fifth of that.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numba.extending import register_jitable

from valve_sim.model.compiling import compiled
from valve_sim.model.core_types import EVENT_RECORD, STATE_RECORD
from valve_sim.model.effects.record import VALVE_RECORD
from valve_sim.model.gas.driver import NONE, run_on
from valve_sim.model.gas.record import GAS_COLUMNS, GAS_STATE_RECORD, GAS_VALVE_RECORD, is_of_gas
from valve_sim.model.gas.sampling import ROW
from valve_sim.model.gas.step_memory import WORK_RECORD
from valve_sim.model.response import EVENT_ROOM

MOST_STEPS_PER_SECOND: Final = 1_000_000
"""Steps for each second of a run, and for one second more, after which it ends with an error."""


def _live_record(valve: Any, state: Any, columns: int) -> Any:
    return np.dtype(
        [
            ("valve", valve),
            ("state", state),
            ("tolerance", "f8"),  # relative error of a step
            ("times", "f8", (1,)),  # s, of the last step's end
            ("current", "f8", (1,)),  # normalised current u there
            ("row", "f8", (1, columns)),  # all else that there is to show, see `sampling.ROW`
            ("events", EVENT_RECORD, (EVENT_ROOM,)),  # of the last step
        ],
        align=True,
    )


LIVE_RECORD: Final = _live_record(VALVE_RECORD, STATE_RECORD, ROW)
"""A valve that is stepped."""
LIVE_GAS_RECORD: Final = _live_record(GAS_VALVE_RECORD, GAS_STATE_RECORD, ROW + GAS_COLUMNS)
"""The same of a valve with gas."""


def new_live(record: Any, state: Any, tolerance: float) -> Any:
    """A valve to be stepped from a state on: a (1,) LIVE_RECORD, of a valve with gas a (1,) LIVE_GAS_RECORD.

    Args:
        record: (1,) record of the valve. state: (1,) record of its state. Both are copied.
        tolerance: relative error of one step.
    """
    live = np.zeros(1, LIVE_GAS_RECORD if is_of_gas(record) else LIVE_RECORD)
    live["valve"], live["state"], live["tolerance"] = record, state, tolerance
    return live


@register_jitable
def most_steps(duration: float) -> int:
    """The steps after which a run of some seconds ends with an error."""
    return int(MOST_STEPS_PER_SECOND * (1.0 + max(0.0, duration)))


@compiled
def step_live(live, time, commit):
    """Step a live valve to a time, s, and show it there; one that goes no further back than its state.

    Args:
        live: (1,) record, see `new_live`. time: s.
        commit: whether to stop exactly there (before a command), or at the last whole step.

    Returns:
        events counted, of which those that there is room for are noted; Outcome; Phase.
    """
    times = live.times[0]
    times[0] = time
    limits = (time, commit, live[0].tolerance, most_steps(time - live[0].state.time))
    samples = (times, live.row[0], times, live.current[0])
    log = (live.events[0], NONE)
    _, count, outcome = run_on(live.valve, live.state, np.zeros(1, WORK_RECORD), limits, samples, log, None)
    return count, outcome, int(live.row[0][0][4])
