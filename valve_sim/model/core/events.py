"""What happens at an event: contacts, rest, the coil's circuit, the flow of gas, and what that does to derivatives.

Derivatives go through an event by its saltation: the states are moved to where the event is, by the rates before it
times the derivative δ of its time, changed there as the event changes them, and moved back by the rates after it.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

from typing import Final

from valve_sim.model.core.gas_steps import FIRST_STEP
from valve_sim.model.core.layout import (
    ACCELERATION,
    AHEAD,
    BEYOND,
    BLOCKED,
    CHANGED,
    CLOSING,
    COIL,
    COIL_RATES,
    COMPLIANCE,
    CONTACT,
    COUNT,
    CURRENT,
    CURRENT_GONE,
    CURRENT_RATE,
    CURVE,
    CURVE_INDEX,
    DELTA,
    DENSITY,
    DIRECTION,
    DOWN,
    DOWN_RATE,
    EDDY,
    FALL,
    FLAG,
    FLAGGED,
    FLOW_SWITCHED,
    FREEWHEELS,
    GAS_KNOWN,
    GAS_STEP,
    HAS_PEAK,
    HIGH_GUARD,
    IS_FLUX,
    LAG,
    LIFTED,
    LOOK,
    LOW_GUARD,
    MODE,
    MOVING,
    NET,
    NO_EVENT,
    ONE_PLUNGER,
    PATH,
    PEAK,
    RATIO,
    REGIME,
    REGIME_AHEAD,
    RELEASE,
    RESTITUTION_SEAT,
    RESTITUTION_STOP,
    RISE,
    SEEN,
    STATES,
    STEP,
    TIME,
    TURN,
    UNSEATED_TIME,
    UP,
    UP_RATE,
    VOLTS,
    WIDTH,
    V,
    X,
)  # fmt: skip
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
JUMPED: Final = 1e-9
"""N: so much more than what holds them pushes plungers at rest only after a jump of the force."""


def leave(b: Block, t: Block, ends: int) -> None:
    """Find the derivative δ of the time of an event, and move the tangents of the states to where it is.

    That of a command, NO_EVENT, is known. A comparison that changes changes nothing at once: its δ does not matter.
    What a jump of the force at the event before sets off at once has the δ of that event.
    """
    width = int(b[WIDTH])
    if width == 0:
        return
    invoke(b[LOOK], b, t)
    ahead = contact_ahead(b)
    for k in range(width):
        delta = 0.0
        if ends == NO_EVENT or (b[STEP] == 0.0 and max(b[UP], b[DOWN]) > JUMPED):
            delta = t[DELTA * width + k]
        elif ends == CONTACT:
            delta = divided(t[ahead * width + k] - t[X * width + k], b[V])
        elif ends == TURN:
            delta = divided(-t[V * width + k], b[ACCELERATION])
        elif ends == RISE:
            delta = divided(-t[UP * width + k], b[UP_RATE])
        elif ends == FALL:
            delta = divided(-t[DOWN * width + k], b[DOWN_RATE])
        elif ends == CURRENT_GONE:
            delta = divided(-t[CURRENT * width + k], b[CURRENT_RATE])
        t[DELTA * width + k] = delta
    move_tangents(b, t, 1.0)
    if b[HAS_PEAK] > 0.0 and b[PEAK] == abs(b[CURRENT]):
        rate = b[CURRENT_RATE] if b[CURRENT] > 0.0 else -b[CURRENT_RATE]
        for k in range(width):
            t[PEAK * width + k] += rate * t[DELTA * width + k]


def arrive(b: Block, t: Block) -> None:
    """Move the tangents of the states back from where the event is."""
    if b[WIDTH] > 0.0:
        invoke(b[LOOK], b, t)
        move_tangents(b, t, -1.0)


def move_tangents(b: Block, t: Block, way: float) -> None:
    """Add to the tangents of the states their rates times δ, times `way`."""
    width = int(b[WIDTH])
    states = int(b[STATES])
    for k in range(width):
        delta = way * t[DELTA * width + k]
        if b[MOVING] > 0.0:
            t[X * width + k] += b[V] * delta
            t[V * width + k] += b[ACCELERATION] * delta
        for i in range(states):
            t[(COIL + i) * width + k] += b[COIL_RATES + i] * delta


def rescale_velocity(b: Block, t: Block, ratio: int, way: float) -> None:
    """Multiply the velocity by the number in the slot `ratio` and by `way`, which is 1 or −1."""
    width = int(b[WIDTH])
    for k in range(width):
        t[V * width + k] = way * (b[ratio] * t[V * width + k] + t[ratio * width + k] * b[V])
    b[V] = way * b[ratio] * b[V]


def unseat(b: Block, t: Block) -> None:
    """The pilot plunger leaves its seat now."""
    b[UNSEATED_TIME] = b[TIME]
    set_tangents(b, t, UNSEATED_TIME, DELTA, 1.0)


def log_event(b: Block, events: Block, room: int, kind: int, v: float) -> None:
    """Note an event, if there is room, and count it."""
    count = int(b[COUNT])
    if count < room:
        event = events[4 * count :]
        event[0] = b[TIME]
        event[1] = kind
        event[2] = b[X]
        event[3] = v
    b[COUNT] = count + 1


def come_to_rest(b: Block, t: Block, mode: int) -> None:
    """The plungers stay where they are."""
    b[MODE] = mode
    b[MOVING] = 0.0
    b[V] = 0.0
    set_tangents(b, t, V, V, 0.0)
    enter(b, t)


def set_off(b: Block, t: Block, mode: int, direction: float) -> None:
    """The plungers move from rest."""
    if b[MODE] == CLOSED:
        unseat(b, t)
    b[MODE] = mode
    b[MOVING] = 1.0
    b[DIRECTION] = direction
    b[GAS_STEP] = FIRST_STEP
    enter(b, t)


def move_off(b: Block, t: Block, ends: int, events: Block, room: int) -> None:
    """Set plungers at rest in motion, in the mode that follows."""
    mode = int(b[MODE])
    if mode == CLOSED:
        set_off(b, t, MAIN if b[ONE_PLUNGER] > 0.0 else PILOT, 1.0)
        log_event(b, events, room, UNSEATED, 0.0)
    elif mode == OPEN and b[BEYOND] == 0.0:
        set_off(b, t, MAIN, -1.0)
        log_event(b, events, room, RELEASED, 0.0)
    elif mode == GAP_HOLD:
        if ends == RISE:
            set_off(b, t, MAIN, 1.0)
            log_event(b, events, room, LIFTED_OFF, 0.0)
        else:
            set_off(b, t, PILOT, -1.0)
            log_event(b, events, room, DROPPED, 0.0)
    else:
        set_off(b, t, mode, 1.0 if ends == RISE else -1.0)
        log_event(b, events, room, BROKE_AWAY, 0.0)


def touch(b: Block, t: Block, events: Block, room: int) -> None:
    """A contact: pick-up, hold, stop, seat; the state is at the contact with the velocity before it."""
    v = b[V]
    mode = int(b[MODE])
    if mode == OPEN:
        b[MODE] = MAIN
        enter(b, t)
        log_event(b, events, room, RELEASED, v)
    elif mode == MAIN and b[DIRECTION] > 0.0:
        if b[COMPLIANCE] > RIGID:
            b[MODE] = OPEN
            enter(b, t)
            log_event(b, events, room, REACHED_STOP, v)
        elif b[RESTITUTION_STOP] > 0.0 and abs(v) >= SLOWEST_REBOUND:
            rescale_velocity(b, t, RESTITUTION_STOP, -1.0)
            b[DIRECTION] = -1.0
            enter(b, t)
            log_event(b, events, room, BOUNCED_AT_STOP, v)
        else:
            come_to_rest(b, t, OPEN)
            log_event(b, events, room, REACHED_STOP, v)
    elif b[DIRECTION] < 0.0 and (mode == PILOT or b[ONE_PLUNGER] > 0.0):
        touch_seat(b, t, events, room)
    else:
        touch_gap(b, t, events, room)


def touch_seat(b: Block, t: Block, events: Block, room: int) -> None:
    """The pilot plunger, or the only one, meets its seat."""
    v = b[V]
    mode = int(b[MODE])
    if b[RESTITUTION_SEAT] > 0.0 and abs(v) >= SLOWEST_REBOUND:
        rescale_velocity(b, t, RESTITUTION_SEAT, -1.0)
        b[DIRECTION] = 1.0
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
    v = b[V]
    falls_on_gas = b[DENSITY] > 0.0 and b[DIRECTION] < 0.0
    if abs(v) < SLOW_AT_GAP or falls_on_gas:
        # Friction takes no part in this decision, nor does velocity.
        lifted = b[LIFTED]
        b[V] = 0.0
        b[LIFTED] = 0.0
        invoke(b[LOOK], b, t)
        of_pilot = b[NET]
        b[LIFTED] = 1.0
        invoke(b[LOOK], b, t)
        of_main = b[NET]
        b[LIFTED] = lifted
        b[V] = v
        held_by_gas = falls_on_gas and of_main <= 0.0 and of_main + b[CLOSING] > 0.0
        if held_by_gas or (abs(v) < SLOW_AT_GAP and of_pilot > 0.0 and of_main <= 0.0):
            come_to_rest(b, t, GAP_HOLD)
            log_event(b, events, room, HELD_AT_GAP, v)
            return
    if b[DIRECTION] < 0.0:
        b[MODE] = PILOT
        enter(b, t)
        log_event(b, events, room, MAIN_SEATED, v)
        return
    rescale_velocity(b, t, RATIO, 1.0)
    if b[V] == 0.0:
        # A full stop against the main plunger: what happens next is decided from rest.
        come_to_rest(b, t, GAP_HOLD)
    else:
        b[MODE] = MAIN
        enter(b, t)
    log_event(b, events, room, PICKED_UP, v)


def turn_round(b: Block, t: Block, events: Block, room: int) -> None:
    """The velocity reached zero: go on, turn round, or stay where dry friction holds."""
    come_to_rest(b, t, int(b[MODE]))
    push = push_now(b, t)
    if push != 0.0:
        b[MOVING] = 1.0
        b[DIRECTION] = push
        enter(b, t)
    else:
        log_event(b, events, room, STUCK, 0.0)


def block_diode(b: Block, t: Block) -> None:
    """The current has gone and the diode blocks; eddy currents continue, and pull."""
    b[PATH] = CUT_OFF
    b[SEEN] = 0.0
    b[BLOCKED] = 1.0
    b[FREEWHEELS] = 0.0
    if b[IS_FLUX] == 0.0 or b[EDDY] < SHORTEST_LAG:
        b[COIL] = 0.0
        set_tangents(b, t, COIL, COIL, 0.0)
    set_tangents(b, t, SEEN, SEEN, 0.0)
    enter(b, t)


def close_circuit(b: Block, t: Block) -> None:
    """Decide what closes the coil's circuit under the command in force: afresh, but a diode that blocks goes on so."""
    stays_blocked = b[PATH] == CUT_OFF
    b[SEEN] = b[VOLTS]
    set_tangents(b, t, SEEN, VOLTS, 1.0)
    b[PATH] = DRIVEN
    b[BLOCKED] = 0.0
    b[FREEWHEELS] = 0.0
    if b[RELEASE] == 0.0 or b[VOLTS] != 0.0:
        enter(b, t)
        return
    if stays_blocked or b[COIL] == 0.0 or b[LAG] < SHORTEST_LAG:
        block_diode(b, t)
        return
    sign = 1.0 if b[COIL] > 0.0 else -1.0
    b[PATH] = FREEWHEELING
    b[SEEN] = -sign * b[RELEASE]
    set_tangents(b, t, SEEN, RELEASE, -sign)
    b[FREEWHEELS] = sign
    enter(b, t)
    invoke(b[LOOK], b, t)
    if not (b[CURRENT] * sign > 0.0):
        block_diode(b, t)


def set_voltage(b: Block, t: Block, volts: float) -> None:
    """A command takes effect now, at the state's time."""
    b[VOLTS] = volts
    b[CHANGED] = b[TIME]
    close_circuit(b, t)
    if b[HAS_PEAK] > 0.0:
        invoke(b[LOOK], b, t)
        if abs(b[CURRENT]) > b[PEAK]:
            b[PEAK] = abs(b[CURRENT])
            set_tangents(b, t, PEAK, CURRENT, 1.0 if b[CURRENT] > 0.0 else -1.0)
        enter(b, t)


def end_step(b: Block, t: Block, ends: int, events: Block, room: int) -> None:
    """Apply the event that ended a step; the state is that of its end."""
    leave(b, t, ends)
    if ends == CONTACT:
        b[X] = b[AHEAD]
        touch(b, t, events, room)
    elif ends == TURN:
        turn_round(b, t, events, room)
    elif ends in (RISE, FALL):
        move_off(b, t, ends, events, room)
    elif ends == CURRENT_GONE:
        block_diode(b, t)
        log_event(b, events, room, GONE, b[V])
    elif b[CURVE] > 0.0 and ends - FLAGGED == b[LOW_GUARD]:
        place_curve(b, t, b[CURVE_INDEX] - 1.0)
    elif b[CURVE] > 0.0 and ends - FLAGGED == b[HIGH_GUARD]:
        place_curve(b, t, b[CURVE_INDEX] + 1.0)
    elif ends == FLOW_SWITCHED:
        switch_flow(b, events, room)
    else:
        b[FLAG + ends - FLAGGED] = 1.0 - b[FLAG + ends - FLAGGED]
    b[GAS_KNOWN] = 0.0
    arrive(b, t)


def switch_flow(b: Block, events: Block, room: int) -> None:
    """The flow of gas became choked or subsonic, or turned round."""
    before = b[REGIME]
    b[REGIME] = b[REGIME_AHEAD]
    kind = FLOW_SUBSONIC
    if b[REGIME] * before < 0.0:
        kind = FLOW_REVERSED
    elif abs(b[REGIME]) > 1.5:
        kind = FLOW_CHOKED
    log_event(b, events, room, kind, b[V])


FUNCTIONS: Final = (
    leave, arrive, move_tangents, rescale_velocity, unseat, log_event, come_to_rest, set_off, move_off, touch,
    touch_seat, touch_gap, turn_round, block_diode, close_circuit, set_voltage, end_step, switch_flow,
)  # fmt: skip
"""What is compiled."""
