"""The motion of a declared valve at the samples of a recording, of which only what a replay judges is kept.

It is simulated in pieces: a whole row of what the model has at each sample would be most of the memory of a long one.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve_pieces import Cut, cuts
from valve_sim.identification.plants.valve_sensors import response_to
from valve_sim.model import TOLERANCE, Drive, EventKind, Response, Valve
from valve_sim.model.response import Event
from valve_sim.model.runs import Run
from valve_sim.model.simulation import commands_of
from valve_sim.traces import Trace

STILL_SPEED: Final = 1e-5
"""m/s: below it the model rests; a pilot plunger that nothing holds down creeps at nanometres a second."""
_KINDS: Final = tuple(EventKind)
EVENTS: Final = 256
"""Room for those of a piece, which is made larger where there are more."""


class Motion(NamedTuple):
    """What a replay needs of a response.

    Attributes:
        shown: (n,) what is judged: position, m, current, A, or outlet pressure, Pa. is_moving: (n,) whether it moves.
        events: what happened, in order.
    """

    shown: Array
    is_moving: NDArray[np.bool_]
    events: tuple[Event, ...]


def motion_of(valve: Valve, trace: Trace, drive: Drive, times: Array, start: float, offset: float) -> Motion:
    """The motion at (n,) stamps of samples, s, of a valve that rests until a start, s; arguments as of `response_to`.

    Raises:
        SimulationError: the valve cannot be simulated.
    """

    def taken(own: slice) -> Array:
        return np.maximum(times[own] - offset, start)

    if valve.gas is not None or valve.after_effects("sensor_delay")[0]:
        return _whole(response_to(valve, trace, drive, taken(slice(None)), start, offset), trace.primary_signal)
    shown, is_moving = np.empty(len(times)), np.empty(len(times), dtype=bool)
    events, commands = list[Event](), commands_of(drive)
    stepped = Run(valve, start, tolerance=TOLERANCE)  # as `simulate` has it
    is_position = trace.primary_signal == "position"
    for cut in cuts(times, times, drive, (offset, 0.0)):
        rows, new = _rows(stepped, commands[cut.commands], cut, taken(cut.positions))
        events += new
        is_moving[cut.positions] = np.abs(rows[:, 2]) > STILL_SPEED
        shown[cut.positions] = rows[:, 0 if is_position else 8]
    return Motion(shown, is_moving, tuple(events))


def _rows(stepped: Run, commands: Array, cut: Cut, times: Array) -> tuple[Array, list[Event]]:
    """Run a piece: its rows, and its events."""
    before, room = stepped.save(), EVENTS
    while True:
        rows, events, count = stepped.rows(commands, cut.end, times, room=room)
        if count <= room:
            return rows, [Event(t, _KINDS[int(kind)], x, v) for t, kind, x, v in events.tolist()]
        stepped.restore(before)
        room = count


def _whole(response: Response, judged: str) -> Motion:
    shown = {
        "position": response.pilot_position, "current": response.coil_current,
        "outlet_pressure": response.outlet_pressure,
    }[judged]  # fmt: skip
    assert shown is not None
    return Motion(shown, np.abs(response.pilot_velocity) > STILL_SPEED, response.events)
