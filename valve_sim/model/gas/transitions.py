"""What happens to the plungers at an event, compiled: contacts, turns, moving off, a new voltage, other geometry."""

from __future__ import annotations

from typing import Final

import numpy as np

from valve_sim.model.compiling import compiled, inner
from valve_sim.model.core_types import CLOSED, GAP_HOLD, MAIN, OPEN, PILOT, EventKind
from valve_sim.model.gas.equations import (
    coil_now,
    force_without_dry_friction,
    has_one_plunger,
    pull_squared,
    residual_floor,
)
from valve_sim.model.gas.flow import closing_force, pressure_difference
from valve_sim.model.gas.flux import block, close_circuit
from valve_sim.model.gas.record import has_gas
from valve_sim.model.gas.step import switch_regime

# NumPy's numbers: Numba compiles a function once for all of them, but anew for each of Python's literals.
OPENING, CLOSING = np.array([1, -1])
UNSEATED, PICKED_UP, HELD_AT_GAP, LIFTED, DROPPED, REACHED_STOP, BOUNCED_AT_STOP = np.array(list(EventKind)[:7])
RELEASED, MAIN_SEATED, SEATED, BOUNCED_AT_SEAT, STUCK, BROKE_AWAY, GONE = np.array(list(EventKind)[7:14])

SLOW_AT_GAP: Final = 1e-3
"""m/s: a slower contact at the gap may be held there."""
SLOWEST_REBOUND: Final = 5e-3
"""m/s: a slower contact does not rebound."""
SEAT_HOLDS: Final = 1e-9
"""N: a smaller net force does not lift the pilot plunger off its seat. Without a seat load it would float on the tail
of a current that has gone; event times move by nanoseconds."""
FIRST_STEP: Final = 1e-5
"""s, tried when motion begins; error control takes over from there."""


@inner
def _net_at_rest(p, s, way, t, coil, difference):
    """Net force without dry friction on plungers at rest, N; see `push_at_rest`. way: (mode, direction)."""
    u, w = coil
    mode, direction = way
    pull2 = pull_squared(p, w, max(s.peak_current, abs(u)))
    unseated_time, seat_load = s.unseated_time, 0.0
    if s.mode == CLOSED and has_one_plunger(p):
        # On its seat the seat's load and the whole pressure hold the only plunger.
        unseated_time, seat_load = t, p.seat_load
    force = force_without_dry_friction(p, t, (s.x, 0.0), (u, pull2), (mode, direction, unseated_time))
    return force - closing_force(p, mode, s.x, difference) - seat_load


@inner
def push_at_rest(p, s, t, coil, difference):
    """Which way the forces move plungers at rest at time t: +1, −1, or 0 for not at all.

    Args:
        p, s, t: valve, state, s. coil: u and w. difference: of the gas's pressures at inlet and outlet, Pa.
    """
    hold_up = p.friction_opening + p.breakaway
    if s.mode == CLOSED:
        hold_up = max(hold_up, SEAT_HOLDS)
    hold_down = p.friction_closing + p.breakaway
    lifting = PILOT if s.mode <= PILOT and not has_one_plunger(p) else MAIN
    if s.mode != OPEN and _net_at_rest(p, s, (lifting, OPENING), t, coil, difference) > hold_up:
        return 1
    falling = MAIN if s.mode >= MAIN else PILOT
    if s.mode != CLOSED and _net_at_rest(p, s, (falling, CLOSING), t, coil, difference) < -hold_down:
        return -1
    return 0


@inner
def push_now(p, s):
    """The same at the state's time."""
    return push_at_rest(p, s, s.time, coil_now(p, s), pressure_difference(p, s))


@inner
def _log(events, count, time, kind, x, v):
    """Note an event, if there is room; return how many happened."""
    if count < len(events):
        events[count].time = time
        events[count].kind = kind
        events[count].x = x
        events[count].v = v
    return count + 1


@inner
def _come_to_rest(s, mode):
    s.mode = mode
    s.moving = 0
    s.v = 0.0


@inner
def _lift_off(p, s):
    """The pilot plunger, or the only one, leaves its seat from rest."""
    s.unseated_time = s.time
    s.mode = MAIN if has_one_plunger(p) else PILOT
    s.moving = 1
    s.direction = OPENING
    s.step = FIRST_STEP


@inner
def move_off(p, s, push, events, count):
    """Set plungers at rest in motion, in the mode that follows."""
    kind = BROKE_AWAY
    if s.mode == CLOSED:
        _lift_off(p, s)
        return _log(events, count, s.time, UNSEATED, s.x, 0.0)
    if s.mode == OPEN:
        kind = RELEASED
        s.mode = MAIN
    elif s.mode == GAP_HOLD:
        kind = LIFTED if push > 0 else DROPPED
        s.mode = MAIN if push > 0 else PILOT
    s.moving = 1
    s.direction = push
    s.step = FIRST_STEP
    return _log(events, count, s.time, kind, s.x, 0.0)


@inner
def touch(p, s, events, count):
    """A contact: pick-up, hold, stop, seat; the state is at the guard with the velocity before it."""
    v = s.v
    if s.mode == MAIN and s.direction > 0:
        if p.restitution_stop > 0.0 and abs(v) >= SLOWEST_REBOUND:
            s.v = -p.restitution_stop * v
            s.direction = -1
            return _log(events, count, s.time, BOUNCED_AT_STOP, s.x, v)
        _come_to_rest(s, OPEN)
        return _log(events, count, s.time, REACHED_STOP, s.x, v)
    if s.direction < 0 and (s.mode == PILOT or has_one_plunger(p)):
        if p.restitution_seat > 0.0 and abs(v) >= SLOWEST_REBOUND:
            s.v = -p.restitution_seat * v
            s.direction = 1
            s.unseated_time = s.time
            return _log(events, count, s.time, BOUNCED_AT_SEAT, s.x, v)
        _come_to_rest(s, CLOSED)
        if push_now(p, s) != 0:
            # What pulls lifts it again at once: one event, not a seating and an unseating at one time.
            _lift_off(p, s)
            return _log(events, count, s.time, BOUNCED_AT_SEAT, s.x, v)
        return _log(events, count, s.time, SEATED, s.x, v)
    return _touch_gap(p, s, events, count)


@inner
def _touch_gap(p, s, events, count):
    """The contact between pilot and main plunger, from below (pick-up) or above (the main plunger seats)."""
    v = s.v
    falls_on_gas = has_gas(p) and s.direction < 0
    if abs(v) < SLOW_AT_GAP or falls_on_gas:
        # Friction takes no part in this decision.
        coil, difference = coil_now(p, s), pressure_difference(p, s)
        phase_1 = _net_at_rest(p, s, (PILOT, s.direction), s.time, coil, difference)
        phase_2 = _net_at_rest(p, s, (MAIN, s.direction), s.time, coil, difference)
        held_by_gas = falls_on_gas and phase_2 <= 0.0 < phase_2 + closing_force(p, MAIN, s.x, difference)
        if held_by_gas or (abs(v) < SLOW_AT_GAP and phase_1 > 0.0 and phase_2 <= 0.0):
            _come_to_rest(s, GAP_HOLD)
            return _log(events, count, s.time, HELD_AT_GAP, s.x, v)
    if s.direction < 0:
        s.mode = PILOT
        return _log(events, count, s.time, MAIN_SEATED, s.x, v)
    s.v = p.pickup_velocity_ratio * v
    if s.v == 0.0:
        # A full stop against the main plunger: what happens next is decided from rest.
        _come_to_rest(s, GAP_HOLD)
    else:
        s.mode = MAIN
    return _log(events, count, s.time, PICKED_UP, s.x, v)


@inner
def turn(p, s, events, count):
    """The velocity reached zero: go on, turn round, or stay where dry friction holds."""
    s.v = 0.0
    s.moving = 0
    push = push_now(p, s)
    if push != 0:
        s.moving = 1
        s.direction = push
        return count
    return _log(events, count, s.time, STUCK, s.x, 0.0)


@inner
def end_current(p, s, events, count):
    """The current of the freewheeling path is gone."""
    _, s.w = coil_now(p, s)
    block(p, s)
    return _log(events, count, s.time, GONE, s.x, s.v)


@inner
def switch_flow(p, s, work, events, count):
    """The flow of gas became choked or subsonic, or turned round."""
    return _log(events, count, s.time, switch_regime(p, s, work), s.x, s.v)


@compiled
def set_voltage(valve, state, volts):
    """A command takes effect now, at the state's time."""
    p, s = valve[0], state[0]
    u, w = coil_now(p, s)
    s.segment_time = s.time
    s.segment_u = u
    s.segment_w = w
    s.u = u
    s.w = w
    s.volts = volts
    close_circuit(p, s, u)
    u, w = coil_now(p, s)
    s.peak_current = max(s.peak_current, abs(u))
    s.held_by_residual = 1 if abs(w) < residual_floor(p, s.peak_current) else 0


@compiled
def settle(valve, state):
    """Make the state agree with another valve: only a contact or a blocking diode makes it jump."""
    p, s = valve[0], state[0]
    close_circuit(p, s, s.u)
    s.x = min(s.x, p.stroke)
    at_rest_in_contact = not s.moving and s.mode in (GAP_HOLD, OPEN)
    if at_rest_in_contact and s.x != (p.stroke if s.mode == OPEN else p.pilot_gap):
        # The contact has gone: at rest between contacts, free to move off.
        s.mode = MAIN if s.x >= p.pilot_gap else PILOT
    elif s.mode == PILOT and s.x >= p.pilot_gap:
        s.mode = MAIN
    elif s.mode == MAIN and s.x < p.pilot_gap:
        s.mode = PILOT
    if s.mode == MAIN and s.x >= p.stroke and s.v >= 0.0:
        _come_to_rest(s, OPEN)
