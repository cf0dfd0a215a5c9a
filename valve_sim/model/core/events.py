"""What happens at an event: contacts, rest, the coil's circuit, the flow of gas, and what that does to derivatives.

Derivatives go through an event by its saltation: the states are moved to where the event is, by the rates before it
times the derivative δ of its time, changed there as the event changes them, and moved back by the rates after it.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

from typing import Final

from valve_sim.model.core import layout as at
from valve_sim.model.core.gas_steps import FIRST_STEP
from valve_sim.model.core.modes import (
    CLOSED,
    GAP_HOLD,
    MAIN,
    OPEN,
    PILOT,
    RIGID,
    contact_ahead,
    divided,
    enter,
    place_curve,
    push_now,
    set_tangents,
)  # fmt: skip
from valve_sim.model.core.polynomials import Block, invoke
from valve_sim.model.core_types import EventKind

UNSEATED, PICKED_UP, HELD_AT_GAP, LIFTED_OFF, DROPPED, REACHED_STOP, BOUNCED_AT_STOP = (
    int(k) for k in list(EventKind)[:7]
)
RELEASED, MAIN_SEATED, SEATED, BOUNCED_AT_SEAT, STUCK, BROKE_AWAY, GONE = (int(k) for k in list(EventKind)[7:14])
FLOW_CHOKED, FLOW_SUBSONIC, FLOW_REVERSED = (int(k) for k in list(EventKind)[14:])
DRIVEN, FREEWHEELING, CUT_OFF = 0, 1, 2
"""What closes the coil's circuit: its driver, the freewheeling path, or nothing."""
SLOW_AT_GAP: Final = 1e-3
"""m/s: a slower contact at the gap may be held there."""
SLOWEST_REBOUND: Final = 5e-3
"""m/s: a slower contact does not rebound."""
SHORTEST_LAG: Final = 2e-8
"""s: the current of a coil that is faster is gone at once when it freewheels."""
CONTINUOUS: Final = 1e-9
"""Of a rate: what it jumps by less where a comparison changes is rounding."""
JUMPED: Final = 1e-9
"""N: so much more than what holds them pushes plungers at rest only after a jump of the force."""


def leave(b: Block, t: Block, ends: int) -> None:
    """Find the derivative δ of the time of an event, and move the tangents of the states to where it is.

    That of a command, NO_EVENT, is known. What a jump of the force at the event before sets off at once has the δ of
    that event. Where a comparison changes, `flip` moves them. At a knot of a curve nothing jumps, and δ does not
    matter; nor does it where the flow of gas switches.
    """
    width = int(b[at.WIDTH])
    if width == 0:
        return
    invoke(b[at.LOOK], b, t)
    ahead = contact_ahead(b)
    for k in range(width):
        delta = 0.0
        if ends == at.NO_EVENT or (b[at.STEP] == 0.0 and max(b[at.UP], b[at.DOWN]) > JUMPED):
            delta = t[at.DELTA * width + k]
        elif ends == at.CONTACT:
            delta = divided(t[ahead * width + k] - t[at.X * width + k], b[at.V])
        elif ends == at.TURN:
            delta = divided(-t[at.V * width + k], b[at.ACCELERATION])
        elif ends == at.RISE:
            delta = divided(-t[at.UP * width + k], b[at.UP_RATE])
        elif ends == at.FALL:
            delta = divided(-t[at.DOWN * width + k], b[at.DOWN_RATE])
        elif ends == at.CURRENT_GONE:
            delta = divided(-t[at.CURRENT * width + k], b[at.CURRENT_RATE])
        elif at.FLAGGED <= ends < at.FLOW_SWITCHED:
            slot = at.GUARD_RATE + ends - at.FLAGGED
            delta = divided(-t[slot * width + k], b[slot])
        t[at.DELTA * width + k] = delta
    if ends >= at.FLAGGED:
        return
    move_tangents(b, t, 1.0)
    if b[at.HAS_PEAK] > 0.0 and b[at.PEAK] == abs(b[at.CURRENT]):
        rate = b[at.CURRENT_RATE] if b[at.CURRENT] > 0.0 else -b[at.CURRENT_RATE]
        for k in range(width):
            t[at.PEAK * width + k] += rate * t[at.DELTA * width + k]


def arrive(b: Block, t: Block) -> None:
    """Move the tangents of the states back from where the event is."""
    if b[at.WIDTH] > 0.0:
        invoke(b[at.LOOK], b, t)
        move_tangents(b, t, -1.0)


def move_tangents(b: Block, t: Block, way: float) -> None:
    """Add to the tangents of the states their rates times δ, times `way`."""
    width = int(b[at.WIDTH])
    states = int(b[at.STATES])
    for k in range(width):
        delta = way * t[at.DELTA * width + k]
        if b[at.MOVING] > 0.0:
            t[at.X * width + k] += b[at.V] * delta
            t[at.V * width + k] += b[at.ACCELERATION] * delta
        for i in range(states):
            t[(at.COIL + i) * width + k] += b[at.COIL_RATES + i] * delta


def flip(b: Block, t: Block, guard: int) -> None:
    """A comparison changes, and with it the rates of states; their tangents change by that jump times δ.

    Where nothing jumps, rounding does: δ may be as large as it likes where what is compared hardly changes.
    """
    flag = at.FLAG + guard
    b[flag] = 1.0 - b[flag]
    b[at.FLIPPED] = guard
    b[at.FLIPPED_AT] = b[at.TIME]
    width = int(b[at.WIDTH])
    if width == 0:
        return
    states = int(b[at.STATES])
    before = b[at.SCRATCH :]
    before[0] = b[at.ACCELERATION]
    for i in range(states):
        before[1 + i] = b[at.COIL_RATES + i]
    invoke(b[at.LOOK], b, t)
    jump = jump_of(before[0], b[at.ACCELERATION]) if b[at.MOVING] > 0.0 else 0.0
    for k in range(width):
        delta = t[at.DELTA * width + k]
        if jump != 0.0:
            t[at.V * width + k] += jump * delta
        for i in range(states):
            rate = jump_of(before[1 + i], b[at.COIL_RATES + i])
            if rate != 0.0:
                t[(at.COIL + i) * width + k] += rate * delta


def jump_of(before: float, after: float) -> float:
    """By how much a rate was larger before an event than after it, or 0 where that is rounding."""
    return before - after if abs(before - after) > CONTINUOUS * max(abs(before), abs(after)) else 0.0


def rescale_velocity(b: Block, t: Block, ratio: int, way: float) -> None:
    """Multiply the velocity by the number in the slot `ratio` and by `way`, which is 1 or −1."""
    width = int(b[at.WIDTH])
    for k in range(width):
        t[at.V * width + k] = way * (b[ratio] * t[at.V * width + k] + t[ratio * width + k] * b[at.V])
    b[at.V] = way * b[ratio] * b[at.V]


def unseat(b: Block, t: Block) -> None:
    """The pilot plunger leaves its seat now."""
    b[at.UNSEATED_TIME] = b[at.TIME]
    set_tangents(b, t, at.UNSEATED_TIME, at.DELTA, 1.0)


def log_event(b: Block, events: Block, room: int, kind: int, v: float) -> None:
    """Note an event, if there is room, and count it."""
    count = int(b[at.COUNT])
    if count < room:
        event = events[4 * count :]
        event[0] = b[at.TIME]
        event[1] = kind
        event[2] = b[at.X]
        event[3] = v
    b[at.COUNT] = count + 1


def come_to_rest(b: Block, t: Block, mode: int) -> None:
    """The plungers stay where they are."""
    b[at.MODE] = mode
    b[at.MOVING] = 0.0
    b[at.V] = 0.0
    set_tangents(b, t, at.V, at.V, 0.0)
    enter(b, t)


def set_off(b: Block, t: Block, mode: int, direction: float) -> None:
    """The plungers move from rest."""
    if b[at.MODE] == CLOSED:
        unseat(b, t)
    b[at.MODE] = mode
    b[at.MOVING] = 1.0
    b[at.DIRECTION] = direction
    b[at.GAS_STEP] = FIRST_STEP
    enter(b, t)


def move_off(b: Block, t: Block, ends: int, events: Block, room: int) -> None:
    """Set plungers at rest in motion, in the mode that follows."""
    mode = int(b[at.MODE])
    if mode == CLOSED:
        set_off(b, t, MAIN if b[at.ONE_PLUNGER] > 0.0 else PILOT, 1.0)
        log_event(b, events, room, UNSEATED, 0.0)
    elif mode == OPEN and b[at.BEYOND] == 0.0:
        set_off(b, t, MAIN, -1.0)
        log_event(b, events, room, RELEASED, 0.0)
    elif mode == GAP_HOLD:
        if ends == at.RISE:
            set_off(b, t, MAIN, 1.0)
            log_event(b, events, room, LIFTED_OFF, 0.0)
        else:
            set_off(b, t, PILOT, -1.0)
            log_event(b, events, room, DROPPED, 0.0)
    else:
        set_off(b, t, mode, 1.0 if ends == at.RISE else -1.0)
        log_event(b, events, room, BROKE_AWAY, 0.0)


def touch(b: Block, t: Block, events: Block, room: int) -> None:
    """A contact: pick-up, hold, stop, seat; the state is at the contact with the velocity before it."""
    v = b[at.V]
    mode = int(b[at.MODE])
    if mode == OPEN:
        b[at.MODE] = MAIN
        enter(b, t)
        log_event(b, events, room, RELEASED, v)
    elif mode == MAIN and b[at.DIRECTION] > 0.0:
        if b[at.COMPLIANCE] > RIGID:
            b[at.MODE] = OPEN
            enter(b, t)
            log_event(b, events, room, REACHED_STOP, v)
        elif b[at.RESTITUTION_STOP] > 0.0 and abs(v) >= SLOWEST_REBOUND:
            rescale_velocity(b, t, at.RESTITUTION_STOP, -1.0)
            b[at.DIRECTION] = -1.0
            enter(b, t)
            log_event(b, events, room, BOUNCED_AT_STOP, v)
        else:
            come_to_rest(b, t, OPEN)
            log_event(b, events, room, REACHED_STOP, v)
    elif b[at.DIRECTION] < 0.0 and (mode == PILOT or b[at.ONE_PLUNGER] > 0.0):
        touch_seat(b, t, events, room)
    else:
        touch_gap(b, t, events, room)


def touch_seat(b: Block, t: Block, events: Block, room: int) -> None:
    """The pilot plunger, or the only one, meets its seat."""
    v = b[at.V]
    mode = int(b[at.MODE])
    if b[at.RESTITUTION_SEAT] > 0.0 and abs(v) >= SLOWEST_REBOUND:
        rescale_velocity(b, t, at.RESTITUTION_SEAT, -1.0)
        b[at.DIRECTION] = 1.0
        unseat(b, t)
        enter(b, t)
        log_event(b, events, room, BOUNCED_AT_SEAT, v)
        return
    come_to_rest(b, t, CLOSED)
    if push_now(b, t) != 0.0:
        # What pulls lifts it again at once: one event, not a seating and an unseating at one time.
        set_off(b, t, mode, 1.0)
        log_event(b, events, room, BOUNCED_AT_SEAT, v)
    else:
        log_event(b, events, room, SEATED, v)


def touch_gap(b: Block, t: Block, events: Block, room: int) -> None:
    """The contact between pilot and main plunger, from below (pick-up) or above (the main plunger seats)."""
    v = b[at.V]
    falls_on_gas = b[at.DENSITY] > 0.0 and b[at.DIRECTION] < 0.0
    if abs(v) < SLOW_AT_GAP or falls_on_gas:
        # Friction takes no part in this decision, nor does velocity.
        lifted = b[at.LIFTED]
        b[at.V] = 0.0
        b[at.LIFTED] = 0.0
        invoke(b[at.LOOK], b, t)
        of_pilot = b[at.NET]
        b[at.LIFTED] = 1.0
        invoke(b[at.LOOK], b, t)
        of_main = b[at.NET]
        b[at.LIFTED] = lifted
        b[at.V] = v
        held_by_gas = falls_on_gas and of_main <= 0.0 and of_main + b[at.CLOSING] > 0.0
        if held_by_gas or (abs(v) < SLOW_AT_GAP and of_pilot > 0.0 and of_main <= 0.0):
            come_to_rest(b, t, GAP_HOLD)
            log_event(b, events, room, HELD_AT_GAP, v)
            return
    if b[at.DIRECTION] < 0.0:
        b[at.MODE] = PILOT
        enter(b, t)
        log_event(b, events, room, MAIN_SEATED, v)
        return
    rescale_velocity(b, t, at.RATIO, 1.0)
    if b[at.V] == 0.0:
        # A full stop against the main plunger: what happens next is decided from rest.
        come_to_rest(b, t, GAP_HOLD)
    else:
        b[at.MODE] = MAIN
        enter(b, t)
    log_event(b, events, room, PICKED_UP, v)


def turn_round(b: Block, t: Block, events: Block, room: int) -> None:
    """The velocity reached zero: go on, turn round, or stay where dry friction holds."""
    come_to_rest(b, t, int(b[at.MODE]))
    push = push_now(b, t)
    if push != 0.0:
        b[at.MOVING] = 1.0
        b[at.DIRECTION] = push
        enter(b, t)
    else:
        log_event(b, events, room, STUCK, 0.0)


def block_diode(b: Block, t: Block) -> None:
    """The current has gone and the diode blocks; eddy currents continue, and pull."""
    b[at.PATH] = CUT_OFF
    b[at.SEEN] = 0.0
    b[at.BLOCKED] = 1.0
    b[at.FREEWHEELS] = 0.0
    if b[at.IS_FLUX] == 0.0 or b[at.EDDY] < SHORTEST_LAG:
        b[at.COIL] = 0.0
        set_tangents(b, t, at.COIL, at.COIL, 0.0)
    set_tangents(b, t, at.SEEN, at.SEEN, 0.0)
    enter(b, t)


def close_circuit(b: Block, t: Block) -> None:
    """Decide what closes the coil's circuit under the command in force: afresh, but a diode that blocks goes on so."""
    stays_blocked = b[at.PATH] == CUT_OFF
    b[at.SEEN] = b[at.VOLTS]
    set_tangents(b, t, at.SEEN, at.VOLTS, 1.0)
    b[at.PATH] = DRIVEN
    b[at.BLOCKED] = 0.0
    b[at.FREEWHEELS] = 0.0
    if b[at.RELEASE] == 0.0 or b[at.VOLTS] != 0.0:
        enter(b, t)
        return
    if stays_blocked or b[at.COIL] == 0.0 or b[at.LAG] < SHORTEST_LAG:
        block_diode(b, t)
        return
    sign = 1.0 if b[at.COIL] > 0.0 else -1.0
    b[at.PATH] = FREEWHEELING
    b[at.SEEN] = -sign * b[at.RELEASE]
    set_tangents(b, t, at.SEEN, at.RELEASE, -sign)
    b[at.FREEWHEELS] = sign
    enter(b, t)
    invoke(b[at.LOOK], b, t)
    if not (b[at.CURRENT] * sign > 0.0):
        block_diode(b, t)


def set_voltage(b: Block, t: Block, volts: float) -> None:
    """A command takes effect now, at the state's time."""
    b[at.VOLTS] = volts
    b[at.CHANGED] = b[at.TIME]
    close_circuit(b, t)
    if b[at.HAS_PEAK] > 0.0:
        invoke(b[at.LOOK], b, t)
        if abs(b[at.CURRENT]) > b[at.PEAK]:
            b[at.PEAK] = abs(b[at.CURRENT])
            set_tangents(b, t, at.PEAK, at.CURRENT, 1.0 if b[at.CURRENT] > 0.0 else -1.0)
        enter(b, t)


def end_step(b: Block, t: Block, ends: int, events: Block, room: int) -> None:
    """Apply the event that ended a step; the state is that of its end."""
    leave(b, t, ends)
    if ends == at.CONTACT:
        b[at.X] = b[at.AHEAD]
        touch(b, t, events, room)
    elif ends == at.TURN:
        turn_round(b, t, events, room)
    elif ends in (at.RISE, at.FALL):
        move_off(b, t, ends, events, room)
    elif ends == at.CURRENT_GONE:
        block_diode(b, t)
        log_event(b, events, room, GONE, b[at.V])
    elif b[at.CURVE] > 0.0 and ends - at.FLAGGED == b[at.LOW_GUARD]:
        place_curve(b, t, b[at.CURVE_INDEX] - 1.0)
    elif b[at.CURVE] > 0.0 and ends - at.FLAGGED == b[at.HIGH_GUARD]:
        place_curve(b, t, b[at.CURVE_INDEX] + 1.0)
    elif ends == at.FLOW_SWITCHED:
        switch_flow(b, events, room)
    else:
        flip(b, t, ends - at.FLAGGED)
    b[at.GAS_KNOWN] = 0.0
    if ends < at.FLAGGED:
        arrive(b, t)


def switch_flow(b: Block, events: Block, room: int) -> None:
    """The flow of gas became choked or subsonic, or turned round."""
    before = b[at.REGIME]
    b[at.REGIME] = b[at.REGIME_AHEAD]
    kind = FLOW_SUBSONIC
    if b[at.REGIME] * before < 0.0:
        kind = FLOW_REVERSED
    elif abs(b[at.REGIME]) > 1.5:
        kind = FLOW_CHOKED
    log_event(b, events, room, kind, b[at.V])


FUNCTIONS: Final = (
    leave, arrive, flip, jump_of, move_tangents, rescale_velocity, unseat, log_event, come_to_rest, set_off, move_off,
    touch, touch_seat, touch_gap, turn_round, block_diode, close_circuit, set_voltage, end_step, switch_flow,
)  # fmt: skip
"""What is compiled."""
