"""What a simulation returns: the motion at the samples, and the events."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core_types import EventKind

Array = NDArray[np.float64]
_KINDS: Final = tuple(EventKind)


class Event(NamedTuple):
    """Something that happened to the plungers: time in s, position in m, velocity before it in m/s."""

    time: float
    kind: EventKind
    position: float
    velocity: float


def events_of(logged: Array) -> tuple[Event, ...]:
    """The events of (e, 4) s, number of the kind, m, and m/s before it."""
    return tuple([Event(t, _KINDS[int(kind)], x, v) for t, kind, x, v in logged.tolist()])


@dataclass(frozen=True)
class Response:
    """The motion of a valve at the sample times. Positions are as a position sensor shows them (effects sensor_*).

    Attributes:
        time: (n,) s. pilot_position, main_position: (n,) m. pilot_velocity: (n,) m/s, of the plunger itself.
        coil_current: (n,) A. attraction: (n,) N. phase: (n,) Phase as uint8.
        events: what happened, in order. coil_voltage: (n,) V, at the terminals.
        has_one_plunger: whether that is all the valve has, so that both positions are its own.
        outlet_pressure: (n,) Pa. mass_flow: (n,) kg/s through the valve, inlet to outlet. None without gas.
    """

    time: Array
    pilot_position: Array
    main_position: Array
    pilot_velocity: Array
    coil_current: Array
    attraction: Array
    phase: NDArray[np.uint8]
    events: tuple[Event, ...]
    coil_voltage: Array = field(default_factory=lambda: np.empty(0))
    has_one_plunger: bool = False
    outlet_pressure: Array | None = None
    mass_flow: Array | None = None

    def first(self, *kinds: EventKind) -> float:
        """The time of the first event of any of these kinds, s; nan when there is none."""
        return next((event.time for event in self.events if event.kind in kinds), math.nan)


def published_times(response: Response) -> tuple[float, float]:
    """The paper's t1 (pilot reaches the main plunger) and t2 (all parts reach the core), s; nan when not reached.

    A valve with one plunger has nothing to pick up: its t1 is when it leaves its seat.
    """
    t1 = response.first(EventKind.UNSEATED if response.has_one_plunger else EventKind.PICKED_UP, EventKind.HELD_AT_GAP)
    t2 = response.first(EventKind.REACHED_STOP, EventKind.BOUNCED_AT_STOP)
    return t1, t2
