"""What the mode of the plungers, and of the coil's circuit, means for the equations that the kernels have.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.core import layout as at
from valve_sim.model.core.polynomials import Block, invoke
from valve_sim.model.core_types import Phase

CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = (int(phase) for phase in Phase)
RIGID: Final = 1e-11
"""m/N: a stop that gives way less is rigid: 0.2 nm at 20 N, below the 1 nm to which contacts are located. A softer one
swings in less than 10 µs, and its steps would be as short."""
SPACING: Final = 1.2e-16
"""Half of the relative distance between doubles, and a little more: rounding takes less than that to the next one."""
FAR: Final = 1e30
"""Intervals from the ends of a curve beyond which nothing changes."""
NO_CURRENT: Final = 1e-12
"""Of the reference current: less is none, where there is no voltage."""


def enter(b: Block, t: Block) -> None:
    """Derive from the mode, and from whether and which way the plungers move, what the equations ask for."""
    mode = b[at.MODE]
    one = b[at.ONE_PLUNGER]
    up = b[at.DIRECTION] > 0.0
    b[at.BEYOND] = 1.0 if mode == OPEN and b[at.COMPLIANCE] > RIGID else 0.0
    b[at.LIFTED] = 1.0 if mode >= MAIN else 0.0
    b[at.LIFTED_UP] = 1.0 if mode >= GAP_HOLD or one > 0.0 else 0.0
    b[at.LIFTED_DOWN] = 1.0 if mode >= MAIN else 0.0
    b[at.CLOSED_NOW] = 1.0 if mode == CLOSED else 0.0
    b[at.ON_SEAT] = one * b[at.CLOSED_NOW]
    b[at.MAY_RISE] = 1.0 if mode != OPEN or b[at.BEYOND] > 0.0 else 0.0
    b[at.MAY_FALL] = 1.0 - b[at.CLOSED_NOW]
    if mode == OPEN and up:
        b[at.AHEAD] = 1e300
    elif mode < MAIN and not up:
        b[at.AHEAD] = 0.0
    else:
        b[at.AHEAD] = b[contact_ahead(b)]
    if b[at.CURVE] > 0.0:
        invoke(b[at.PLACE], b, t)
        place_curve(b, t, whole_below(b[at.CURVE_PLACE]))
    if b[at.GUARDS] > 0.0:
        last = at.FLAG + int(b[at.FLIPPED])
        flag = b[last]
        invoke(b[at.DECIDE], b, t)
        if b[at.FLIPPED_AT] == b[at.TIME]:
            # It was crossed now; by rounding the state may be on either side.
            b[last] = flag
    if b[at.CURVE] > 0.0:
        b[at.FLAG + int(b[at.LOW_GUARD])] = 1.0
        b[at.FLAG + int(b[at.HIGH_GUARD])] = 1.0
    b[at.PENDING] = 0.0


def whole_below(a: float) -> float:
    """The largest whole number that is not above a number."""
    return float(math.floor(a))


def place_curve(b: Block, t: Block, index: float) -> None:
    """Put the cubic of an interval of the curve of splines into the equations; beyond its ends a constant."""
    last = b[at.CURVE_INTERVALS] - 1.0
    b[at.CURVE_INDEX] = index
    b[at.CURVE_LOW] = index
    b[at.CURVE_HIGH] = index + 1.0
    first = index
    place = 0.0
    varies = 1.0
    if not (index >= 0.0):
        b[at.CURVE_LOW] = -FAR
        b[at.CURVE_HIGH] = 0.0
        first = 0.0
        varies = 0.0
    elif index > last:
        b[at.CURVE_LOW] = last + 1.0
        b[at.CURVE_HIGH] = FAR
        first = last
        place = 1.0
        varies = 0.0
    if not (0.0 <= first <= last):
        first = 0.0  # of a place that is no number, with which the step fails
    width = int(b[at.WIDTH])
    set_cubic(b, 1, b, first, place, varies)
    for k in range(width):
        set_cubic(t[k:], width, b, first, place, varies)


def set_cubic(own: Block, stride: int, b: Block, first: float, place: float, varies: float) -> None:
    """The coefficients of the cubic of four B-splines, of values or of their tangents in one direction.

    Args:
        own: the values, or the tangents. stride: from one slot to the next. first: number of the first B-spline.
        place, varies: 0 and 1; beyond an end the place where the curve stays, and 0.
    """
    slot = int(b[at.CURVE]) + int(first)
    c0 = own[slot * stride]
    c1 = own[(slot + 1) * stride]
    c2 = own[(slot + 2) * stride]
    c3 = own[(slot + 3) * stride]
    d1 = 0.5 * (c2 - c0)
    d2 = 0.5 * (c0 - 2.0 * c1 + c2)
    d3 = (c3 - 3.0 * c2 + 3.0 * c1 - c0) / 6.0
    own[at.CURVE_C * stride] = (c0 + 4.0 * c1 + c2) / 6.0 + place * (d1 + d2 + d3)
    own[(at.CURVE_C + 1) * stride] = varies * d1
    own[(at.CURVE_C + 2) * stride] = varies * d2
    own[(at.CURVE_C + 3) * stride] = varies * d3


def contact_ahead(b: Block) -> int:
    """The slot of the position of the contact that the plungers move towards; that of the time for the seat."""
    if b[at.MODE] == OPEN:
        return at.STROKE
    if b[at.MODE] == MAIN:
        return at.STROKE if b[at.DIRECTION] > 0.0 else at.GAP
    return at.GAP if b[at.DIRECTION] > 0.0 else at.TIME


def settle_coil(b: Block, t: Block) -> None:
    """Set negligible currents of a coil without voltage to 0: while they fade, an hour takes a million steps."""
    states = int(b[at.STATES])
    warm = int(b[at.WARM])
    gas = int(b[at.DENSITY])
    for i in range(states):
        if i != warm and at.COIL + i != gas and abs(b[at.COIL + i]) > NO_CURRENT:
            return
    for i in range(states):
        if i != warm and at.COIL + i != gas:
            b[at.COIL + i] = 0.0
            set_tangents(b, t, at.COIL + i, at.COIL + i, 0.0)


def divided(a: float, c: float) -> float:
    """A quotient, or 0 where it has no value: an event that comes and goes at no rate has no derivative."""
    return a / c if c != 0.0 else 0.0


def set_tangents(b: Block, t: Block, slot: int, source: int, factor: float) -> None:
    """Make the tangents in a slot those of another one, times a factor."""
    width = int(b[at.WIDTH])
    for k in range(width):
        t[slot * width + k] = factor * t[source * width + k]


def push_now(b: Block, t: Block) -> float:
    """Which way the forces move plungers at rest: +1, −1, or 0 for not at all."""
    invoke(b[at.LOOK], b, t)
    if b[at.UP] > 0.0:
        return 1.0
    return -1.0 if b[at.DOWN] > 0.0 else 0.0


def before(time: float) -> float:
    """The last double before a time, s, or one close to it."""
    return time - SPACING * abs(time) - 1e-300


FUNCTIONS: Final = (
    enter, whole_below, place_curve, set_cubic, contact_ahead, settle_coil, divided, set_tangents, push_now, before,
)  # fmt: skip
"""What is compiled."""
