"""The motion of a declared valve at the samples of a recording, of which only what a replay judges is kept.

It is simulated in pieces: a whole row of what the model has at each sample would be most of the memory of a long one.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve_pieces import Cut, cuts
from valve_sim.identification.plants.valve_sensors import response_to
from valve_sim.model import Drive, Event, Response, Valve
from valve_sim.model.gas.record import is_of_gas
from valve_sim.model.response import event_log, event_tuple
from valve_sim.model.simulation import Control, Samples, columns_of, new_states, rated_current, run_course
from valve_sim.traces import Trace

STILL_SPEED: Final = 1e-5
"""m/s: below it the model rests; a pilot plunger that nothing holds down creeps at nanometres a second."""
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

    record = valve.record()
    if is_of_gas(record) or record[0]["sensor_delay"]:
        return _whole(response_to(valve, trace, drive, taken(slice(None)), start, offset), trace.primary_signal)
    state, shown, is_moving = new_states(record, start), np.empty(len(times)), np.empty(len(times), dtype=bool)
    events: list[Event] = []
    for cut in cuts(times, times, drive, (offset, 0.0)):
        own = taken(cut.positions)
        samples = Samples(own, np.empty((len(own), columns_of(record))), own, np.empty(len(own)))
        events += _run(record, state, drive, cut, samples)
        is_moving[cut.positions] = np.abs(samples.rows[:, 2]) > STILL_SPEED
        is_position = trace.primary_signal == "position"
        shown[cut.positions] = samples.rows[:, 0] if is_position else samples.currents * rated_current(record)
    return Motion(shown, is_moving, tuple(events))


def _run(record: Any, state: Any, drive: Drive, cut: Cut, samples: Samples) -> tuple[Event, ...]:
    """Run a piece; its events."""
    course, before, room = (drive.times[cut.commands], drive.volts[cut.commands], cut.end), state.copy(), EVENTS
    while True:
        events = event_log(room)
        count = run_course(record, state, course, samples, events, Control(in_series=True))
        if count <= room:
            return event_tuple(events, count)
        state[:], room = before, count


def _whole(response: Response, judged: str) -> Motion:
    shown = {
        "position": response.pilot_position, "current": response.coil_current,
        "outlet_pressure": response.outlet_pressure,
    }[judged]  # fmt: skip
    assert shown is not None
    return Motion(shown, np.abs(response.pilot_velocity) > STILL_SPEED, response.events)
