"""The hybrid automaton: modes, contacts and dry friction around the equations, compiled.

A run is a chain of committed steps. A step ends where error control wants it to, or at an event, and never at the
time that a caller asks for: asking in between reads the step's dense output and commits nothing. So the state
does not depend on how time was cut. Only a command cuts a step (`commit_end`).

An event is searched as a person would: the velocity keeps its sign until the plungers turn, so between two turns x
is monotone and can cross only the contact ahead of it; whichever comes first ends the step. It is located on the
dense output and then polished by retaking the step, so that its time has the accuracy of the step itself.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import compiled, inner
from valve_sim.model.core_types import EVENT_RECORD, EventKind, Outcome, Phase
from valve_sim.model.dormand_prince import (
    ALL_STATES,
    CURRENT,
    FIRST,
    LAST,
    MECHANICAL_STATES,
    POSITION,
    PULLING_CURRENT,
    SMALLEST_SCALE,
    TEMPERATURE,
    VELOCITY,
    WORK_RECORD,
    dense_slope,
    error_norm,
    fill_dense,
    interpolate,
    rates,
    step_factor,
    try_step,
)
from valve_sim.model.equations import (
    attraction,
    coil_state,
    force_without_dry_friction,
    pull_squared,
    residual_floor,
)

# NumPy's numbers: Numba compiles a function once for all of them, but anew for each of Python's literals.
CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = np.array(list(Phase))
OPENING, CLOSING = np.array([1, -1])
FINISHED, STEP_TOO_SMALL, TOO_MANY_STEPS, CHATTERING = (int(outcome) for outcome in Outcome)
UNSEATED, PICKED_UP, HELD_AT_GAP, LIFTED, DROPPED, REACHED_STOP, BOUNCED_AT_STOP = np.array(list(EventKind)[:7])
RELEASED, MAIN_SEATED, SEATED, BOUNCED_AT_SEAT, STUCK, BROKE_AWAY = np.array(list(EventKind)[7:])

SLOW_AT_GAP: Final = 1e-3
"""m/s, MODEL section 2: a slower contact at the gap may be held there."""
SLOWEST_REBOUND: Final = 5e-3
"""m/s, MODEL section 3, stop_bounce: a slower contact does not rebound."""

FIRST_STEP: Final = 1e-5
"""s, tried when motion begins; error control takes over from there."""
LONGEST_STEP: Final = 1e-3
"""s, in motion: a stroke takes milliseconds, so that no turn and return hides inside a step."""
SEAT_HOLDS: Final = 1e-9
"""N: a smaller net force does not lift the pilot plunger off its seat. Without a seat load it would float on the tail
of a current that has gone; event times move by nanoseconds."""
SOONEST: Final = 2e-12
"""s: what moves off sooner moves off at once, as a valve does that nothing holds when its coil is powered."""
LONGEST_REST: Final = 2e-3
"""s: how far ahead a valve at rest is looked at in one step, at least."""
LONGEST_REST_SHARE: Final = 0.25
"""Of the time since the last command or lift-off, at least. What still changes the forces at rest are exponentials
that began there, so those that decay quickly have gone, and an hour of rest takes a hundred steps."""
LOOKS_AT_REST: Final = 8
"""How often in such a step it is asked whether the forces move it."""
DECAYED: Final = 40.0
"""Time constants after which a current is less than rounding."""
LONGEST_MOTION: Final = 0.1
"""s without voltage, after which what still moves creeps."""
NO_CURRENT: Final = 1e-12
"""Of the reference current: what is left without voltage is none, so that a coil that heats may rest in long steps."""
SHORTEST_STEP: Final = 1e-16
"""s: error control that wants less has failed."""
LARGEST_GROWTH: Final = 8.0
"""Of one step over the one before."""
BISECTIONS: Final = 28
"""Halvings of a step that locate an event to 4e-9 of it, 4e-12 s of the longest; contacts and turns are polished."""
BISECTED: Final = 5e-12
"""s, to which the end of a rest is located, however long the step."""
MOST_BISECTIONS: Final = 60
"""Halvings that do so."""
LOCATED: Final = 1e-9
"""Fraction of a step to which a contact or turn is located on the dense output, before it is polished."""
POLISHED: Final = 1e-15
"""s, to which it is polished."""
MOST_POLISHING: Final = 5
"""Newton steps that do so; two are common."""
DENSE_OUTPUT_EXCESS: Final = 1e3
"""How far dense output may be off inside a step, in units of the error at its end, after a sudden change of force."""
SHORTEST_PROGRESS: Final = 1e-12
"""s: a step that ends sooner made no progress."""
LONGEST_CHATTER: Final = 1000
"""Events without progress in time after which a run is given up."""

ROW: Final = 6
"""Columns of a whole row of output: pilot and main plunger as shown, velocity, attraction, phase, the pilot itself."""

NO_EVENT, CONTACT, TURN, PULL_SWITCH, MOVED_OFF = 0, 1, 2, 3, 4


@inner
def _guard_ahead(p, s):
    """The contact that the plungers move towards, as a position of x."""
    if s.mode == MAIN:
        return p.stroke if s.direction > 0 else p.pilot_gap
    return p.pilot_gap if s.direction > 0 else 0.0


@inner
def _coil_now(p, s):
    """Give u and w at the state's time."""
    return coil_state(p, s, s.time, s.u, s.w, s.temperature)


@inner
def _coil_within(p, s, work, h, theta):
    """Give u and w at the fraction theta of a step."""
    t = s.time + theta * h
    if work.states == MECHANICAL_STATES:
        return coil_state(p, s, t, 0.0, 0.0, 0.0)
    u, w = interpolate(work, h, CURRENT, theta), interpolate(work, h, PULLING_CURRENT, theta)
    return coil_state(p, s, t, u, w, interpolate(work, h, TEMPERATURE, theta))


@inner
def _net_at_rest(p, s, mode, direction, t, u, w):
    """Net force without dry friction on plungers at rest, N."""
    pull2 = pull_squared(p, w, max(s.peak_current, abs(u)))
    return force_without_dry_friction(p, mode, s.x, 0.0, direction, u, pull2, t, s.unseated_time)


@inner
def _push_at_rest(p, s, t, u, w):
    """Which way the forces move plungers at rest at time t: +1, −1, or 0 for not at all."""
    hold_up = p.friction_opening + p.breakaway
    if s.mode == CLOSED:
        hold_up = max(hold_up, SEAT_HOLDS)
    hold_down = p.friction_closing + p.breakaway
    lifting = PILOT if s.mode <= PILOT else MAIN
    if s.mode != OPEN and _net_at_rest(p, s, lifting, OPENING, t, u, w) > hold_up:
        return 1
    falling = MAIN if s.mode >= MAIN else PILOT
    if s.mode != CLOSED and _net_at_rest(p, s, falling, CLOSING, t, u, w) < -hold_down:
        return -1
    return 0


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
def _lift_off(s):
    """The pilot plunger leaves its seat from rest."""
    s.unseated_time = s.time
    s.mode = PILOT
    s.moving = 1
    s.direction = OPENING
    s.step = FIRST_STEP


@inner
def _move_off(p, s, push, events, count):
    """From rest into motion: the right-hand column of MODEL section 2's table."""
    kind = BROKE_AWAY
    if s.mode == CLOSED:
        _lift_off(s)
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
def _touch(p, s, events, count):
    """A contact: pick-up, hold, stop, seat; the state is at the guard with the velocity before it."""
    v = s.v
    if s.mode == MAIN and s.direction > 0:
        if p.restitution_stop > 0.0 and abs(v) >= SLOWEST_REBOUND:
            s.v = -p.restitution_stop * v
            s.direction = -1
            return _log(events, count, s.time, BOUNCED_AT_STOP, s.x, v)
        _come_to_rest(s, OPEN)
        return _log(events, count, s.time, REACHED_STOP, s.x, v)
    if s.mode == PILOT and s.direction < 0:
        if p.restitution_seat > 0.0 and abs(v) >= SLOWEST_REBOUND:
            s.v = -p.restitution_seat * v
            s.direction = 1
            s.unseated_time = s.time
            return _log(events, count, s.time, BOUNCED_AT_SEAT, s.x, v)
        _come_to_rest(s, CLOSED)
        u, w = _coil_now(p, s)
        if _push_at_rest(p, s, s.time, u, w) != 0:
            # What pulls lifts it again at once: one event, not a seating and an unseating at one time.
            _lift_off(s)
            return _log(events, count, s.time, BOUNCED_AT_SEAT, s.x, v)
        return _log(events, count, s.time, SEATED, s.x, v)
    return _touch_gap(p, s, events, count)


@inner
def _touch_gap(p, s, events, count):
    """The contact between pilot and main plunger, from below (pick-up) or above (the main plunger seats)."""
    v = s.v
    if abs(v) < SLOW_AT_GAP:
        # Friction takes no part in this decision (MODEL section 3).
        u, w = _coil_now(p, s)
        phase_1 = _net_at_rest(p, s, PILOT, s.direction, s.time, u, w)
        phase_2 = _net_at_rest(p, s, MAIN, s.direction, s.time, u, w)
        if phase_1 > 0.0 and phase_2 <= 0.0:
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
def _turn(p, s, events, count):
    """The velocity reached zero: go on, turn round, or stay where dry friction holds."""
    s.v = 0.0
    s.moving = 0
    u, w = _coil_now(p, s)
    push = _push_at_rest(p, s, s.time, u, w)
    if push != 0:
        s.moving = 1
        s.direction = push
        return count
    return _log(events, count, s.time, STUCK, s.x, 0.0)


@inner
def _first_turn(work, h, direction, tolerance):
    """The fraction of the step at which v first changes sign against `direction`, or 2 for never.

    A velocity within the integrator's own error has no sign: a crawl would turn for ever.
    """
    before = 0.0
    for quarter in range(1, 5):
        theta = 0.25 * quarter
        v = work.y_new[1] if quarter == 4 else interpolate(work, h, VELOCITY, theta)
        unsure = tolerance * SMALLEST_SCALE[1] * (1.0 if quarter == 4 else DENSE_OUTPUT_EXCESS)
        if v * direction < -unsure:
            return _crossing(work, h, VELOCITY, -direction, 0.0, before, theta)
        before = theta
    return 2.0


@inner
def _crossing(work, h, state, direction, target, low, high):
    """The fraction, between `low` and `high`, at which a state, monotone there, reaches its target.

    Newton's method on the dense output, kept inside a bracket that halves where Newton leaves it.
    """
    theta = high
    for _ in range(BISECTIONS):
        ahead = (interpolate(work, h, state, theta) - target) * direction
        if ahead >= 0.0:
            high = theta
        else:
            low = theta
        slope = h * dense_slope(work, state, theta) * direction
        better = theta - ahead / slope if slope > 0.0 else low
        if abs(better - theta) < LOCATED:
            return min(max(better, low), high)
        theta = better if low < better < high else 0.5 * (low + high)
    return theta


@inner
def _polish(p, s, work, h, ends):
    """Retake a step so that it ends exactly at what ends it: x at the contact, or v at 0. Returns its size, s."""
    state = VELOCITY if ends == TURN else POSITION
    target = 0.0 if ends == TURN else _guard_ahead(p, s)
    longest = h * 1.001
    for _ in range(MOST_POLISHING):
        try_step(p, s, work, h)
        slope = work.k[LAST, state]
        better = h - (work.y_new[state] - target) / slope
        # A slope of 0 makes it infinite or no number.
        if ends == PULL_SWITCH or not 0.0 < better <= longest:
            break
        if abs(better - h) <= POLISHED:
            break
        h = better
    if ends != PULL_SWITCH:
        work.y_new[state] = target
    return h


@inner
def _is_held(p, s, work, h, theta):
    """Whether the pull is at the residual floor at the fraction theta of a step."""
    u, w = _coil_within(p, s, work, h, theta)
    return 1 if abs(w) < residual_floor(p, max(s.peak_current, abs(u))) else 0


@inner
def _pull_switch(p, s, work, h):
    """The fraction of the step at which residual magnetism takes over or lets go, or 2 for not in this step."""
    if p.residual_current == 0.0 or _is_held(p, s, work, h, 1.0) == s.held_by_residual:
        return 2.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _is_held(p, s, work, h, middle) == s.held_by_residual:
            low = middle
        else:
            high = middle
    return high


@inner
def _integrated_step(p, s, work, tolerance):
    """The next step as far as error control or the first event of plungers in motion or of the coil.

    Returns:
        its size in s, what ends it, the size for the step after it, and an Outcome.
    """
    if not work.start_is_known:
        rates(p, s, work, s.time, work.y, FIRST)
    h = min(s.step, _rest(p, s) if _has_settled(p, s, work) else LONGEST_STEP)
    while True:
        try_step(p, s, work, h)
        error = error_norm(work, h, tolerance)
        if error <= 1.0:
            break
        h *= max(0.1, step_factor(error)) if math.isfinite(error) else 0.1
        if h < SHORTEST_STEP:
            return h, NO_EVENT, h, STEP_TOO_SMALL
    following = h * min(LARGEST_GROWTH, step_factor(error))
    fill_dense(work)
    fraction, ends = _first_event(p, s, work, h, tolerance)
    if ends != NO_EVENT:
        h = _polish(p, s, work, h * fraction, ends)
        fill_dense(work)
    return h, ends, following, FINISHED


@inner
def _first_event(p, s, work, h, tolerance):
    """What ends a step first, and at which fraction of it."""
    fraction = _pull_switch(p, s, work, h)
    ends = PULL_SWITCH if fraction <= 1.0 else NO_EVENT
    if not s.moving:
        return fraction, ends
    turn = _first_turn(work, h, s.direction, tolerance)
    if turn < fraction:
        fraction, ends = turn, TURN
    latest = min(fraction, 1.0)
    guard = _guard_ahead(p, s)
    x_latest = work.y_new[0] if latest == 1.0 else interpolate(work, h, POSITION, latest)
    if (x_latest - guard) * s.direction >= 0.0:
        return _crossing(work, h, POSITION, s.direction, guard, 0.0, latest), CONTACT
    return fraction, ends


@inner
def _shorten(work, h, fraction):
    """End a step at a fraction of it: its dense output is a polynomial in the fraction of the step."""
    for j in range(work.states):
        work.y_new[j] = interpolate(work, h, j, fraction)
        stretch = 1.0
        for power in range(4):
            work.dense[j, power] *= stretch
            stretch *= fraction


@inner
def _moved_off(p, s, work, h):
    """The fraction of a rest at which the forces start to move the plungers, or 2 for not in it."""
    low = 0.0
    for look in range(1, LOOKS_AT_REST + 1):
        high = look / LOOKS_AT_REST
        if _push_after(p, s, work, h, high) != 0:
            soonest = low + SOONEST / h
            if soonest >= high or _push_after(p, s, work, h, soonest) != 0:
                return min(soonest, high)
            for _ in range(MOST_BISECTIONS):
                if (high - low) * h < BISECTED:
                    break
                middle = 0.5 * (low + high)
                if _push_after(p, s, work, h, middle) != 0:
                    high = middle
                else:
                    low = middle
            return high
        low = high
    return 2.0


@inner
def _push_after(p, s, work, h, theta):
    """Which way the forces push plungers that have rested for the fraction theta of a step."""
    u, w = _coil_within(p, s, work, h, theta)
    return _push_at_rest(p, s, s.time + theta * h, u, w)


@inner
def _rest(p, s):
    """How far ahead plungers at rest are looked at in one step, s."""
    if p.terms_read_time:
        return LONGEST_REST
    return max(LONGEST_REST, LONGEST_REST_SHARE * (s.time - max(s.segment_time, s.unseated_time)))


@inner
def _has_settled(p, s, work):
    """Whether error control alone may choose the step: no current is left, and all that moves creeps.

    A pilot plunger that nothing returns may float for hours.
    """
    if s.volts != 0.0:
        return False
    if work.states > MECHANICAL_STATES:
        return not s.moving and s.u == 0.0 and s.w == 0.0
    decay = DECAYED * (p.coil_time_constant + p.eddy_time_constant)
    return s.time - s.segment_time > max(decay, LONGEST_MOTION)


@inner
def _next_step(p, s, work, tolerance):
    """Find the next committed step from the state. Arguments and result as for `_integrated_step`."""
    h, ends, following, outcome = _rest(p, s), NO_EVENT, s.step, FINISHED
    if s.moving or work.states > MECHANICAL_STATES:
        h, ends, following, outcome = _integrated_step(p, s, work, tolerance)
    else:
        for j in range(work.states):
            work.y_new[j] = work.y[j]
            for power in range(4):
                work.dense[j, power] = 0.0
    if not s.moving and outcome == FINISHED:
        fraction = _moved_off(p, s, work, h)
        if fraction <= 1.0:
            _shorten(work, h, fraction)
            h *= fraction
            ends = MOVED_OFF
    return h, ends, following, outcome


@inner
def _lagged(shown, a, value, work, theta):
    """A first-order sensor after a piece of a step: exact for the dense output's polynomial.

    Solves z' = (x − z) a/h over the fraction theta, x = value + Σ slopes_k θ^k, by the moments
    M_k = ∫ e^{−b(1−φ)} φ^k b dφ, b = a θ, which obey M_k = 1 − (k/b) M_{k−1}; a power series where b is small.
    """
    b = a * theta
    result = shown * math.exp(-b) - value * np.expm1(-b)
    power = 1.0
    moment = -np.expm1(-b)
    for order in range(1, 5):
        if b > 1.0:
            moment = 1.0 - order / b * moment
        else:
            term = b / (order + 1.0)
            moment = term
            for j in range(1, 20):
                term *= -b / (order + 1.0 + j)
                moment += term
        power *= theta
        result += work.slopes[order - 1] * power * moment
    return result


@inner
def _show(p, s, work, h, theta):
    """What position sensors show at the fraction theta of a step: pilot and main plunger, m, without gain."""
    x = interpolate(work, h, POSITION, theta)
    above = s.mode >= MAIN
    if p.sensor_time_constant == 0.0:
        return x, x - p.pilot_gap if above else 0.0
    for order in range(4):
        work.slopes[order] = h * work.dense[0, order]
    a = h / p.sensor_time_constant
    pilot = _lagged(s.shown_pilot, a, work.y[0], work, theta)
    if above:
        return pilot, _lagged(s.shown_main, a, work.y[0] - p.pilot_gap, work, theta)
    for order in range(4):
        work.slopes[order] = 0.0
    return pilot, _lagged(s.shown_main, a, 0.0, work, theta)


@inner
def _sample(p, s, work, h, theta, rows, i):
    """Fill row i of the output: the pilot as shown and, where there is room, the other `ROW` columns."""
    pilot, main = _show(p, s, work, h, theta)
    rows[i, 0] = p.sensor_gain * pilot
    if rows.shape[1] == 1:
        return
    u, w = _coil_within(p, s, work, h, theta)
    x = interpolate(work, h, POSITION, theta)
    rows[i, 1] = p.sensor_gain * main
    rows[i, 2] = interpolate(work, h, VELOCITY, theta)
    rows[i, 3] = attraction(p, x, pull_squared(p, w, max(s.peak_current, abs(u))))
    rows[i, 4] = s.mode
    rows[i, 5] = x


@inner
def _commit(p, s, work, h, time):
    """Make the end of a step of size h the state, at `time`."""
    if p.sensor_time_constant > 0.0:
        s.shown_pilot, s.shown_main = _show(p, s, work, h, 1.0)
    s.time = time
    s.x = work.y_new[0]
    s.v = work.y_new[1]
    if work.states > MECHANICAL_STATES:
        s.u = work.y_new[2]
        s.w = work.y_new[3]
        s.temperature = work.y_new[4]
        # A coil that does not heat moves u one way between commands: there the largest is at an end.
        s.peak_current = max(s.peak_current, abs(_coil_now(p, s)[0]))


@inner
def _settle_coil(p, s, work):
    """Let what is left of an integrated current, at rest without voltage, be none."""
    if work.states == MECHANICAL_STATES or s.moving or s.volts != 0.0 or (s.u == 0.0 and s.w == 0.0):
        return
    u, w = _coil_now(p, s)
    if max(abs(u), abs(w)) < NO_CURRENT:
        s.u = 0.0
        s.w = 0.0
        work.start_is_known = 0


@inner
def _start_from(s, work):
    """Put the state where the integrator starts."""
    work.y[0] = s.x
    work.y[1] = s.v
    work.y[2] = s.u
    work.y[3] = s.w
    work.y[4] = s.temperature


@compiled
def set_voltage(valve, state, volts):
    """A command takes effect now, at the state's time."""
    p, s = valve[0], state[0]
    u, w = _coil_now(p, s)
    s.segment_time = s.time
    s.segment_u = u
    s.segment_w = w
    s.u = u
    s.w = w
    s.volts = volts
    u, w = _coil_now(p, s)
    s.peak_current = max(s.peak_current, abs(u))
    s.held_by_residual = 1 if abs(w) < residual_floor(p, s.peak_current) else 0


@compiled
def run(  # noqa: PLR0912 - the steps of a run in the order in which they happen
    valve, state, t_end, commit_end, times, rows, current_times, currents, events, count, tolerance, most_steps
):
    """Step the valve from its state to t_end under one voltage.

    Args:
        valve: (1,) valve record. state: (1,) state record, advanced. t_end: s. (Arrays of one, because Numba takes
            them from Python ten times faster than bare records.)
        commit_end: whether the state shall stop exactly at t_end (before a command), or at the last whole step.
        times: (i,) ascending times of position samples, s. rows: (i, 1) or (i, ROW) their output, see `_sample`.
        current_times: (j,) ascending times of current samples, s. currents: (j,) u there, written.
        events: (e,) event log. count: events noted so far. tolerance: relative error of a step.
        most_steps: the steps after which a run is given up.

    Returns:
        position samples written, current samples written, events counted, Outcome.
    """
    p, s = valve[0], state[0]
    work = np.zeros(1, WORK_RECORD)[0]
    work.states = ALL_STATES if p.temperature_rate != 0.0 else MECHANICAL_STATES
    at, at_current, chatter = 0, 0, 0
    work.start_is_known = 0
    for _ in range(most_steps):
        _settle_coil(p, s, work)
        _start_from(s, work)
        if not s.moving:
            u, w = _coil_now(p, s)
            push = _push_at_rest(p, s, s.time, u, w)
            if push != 0:
                count = _move_off(p, s, push, events, count)
                work.start_is_known = 0
        sampled = at == len(times) or times[at] > s.time
        if s.time >= t_end and sampled and (at_current == len(current_times) or current_times[at_current] > s.time):
            return at, at_current, count, FINISHED
        h, ends, following, outcome = _next_step(p, s, work, tolerance)
        if outcome != FINISHED:
            return at, at_current, count, outcome
        t_new = s.time + h
        last = min(t_new, t_end)
        while at < len(times) and times[at] <= last:
            _sample(p, s, work, h, max(0.0, (times[at] - s.time) / h), rows, at)
            at += 1
        while at_current < len(current_times) and current_times[at_current] <= last:
            theta = max(0.0, (current_times[at_current] - s.time) / h)
            currents[at_current], _ = _coil_within(p, s, work, h, theta)
            at_current += 1
        if t_new > t_end:
            if commit_end and t_end > s.time:
                h = t_end - s.time
                if s.moving or work.states > MECHANICAL_STATES:
                    try_step(p, s, work, h)
                    fill_dense(work)
                _commit(p, s, work, h, t_end)
            return at, at_current, count, FINISHED
        chatter = chatter + 1 if h < SHORTEST_PROGRESS else 0
        if chatter > LONGEST_CHATTER:
            return at, at_current, count, CHATTERING
        _commit(p, s, work, h, t_new)
        if ends in (NO_EVENT, MOVED_OFF):
            s.step = following
        work.start_is_known = 1 if ends == NO_EVENT else 0
        if ends == NO_EVENT:
            for j in range(work.states):
                work.k[0, j] = work.k[LAST, j]
        elif ends == CONTACT:
            count = _touch(p, s, events, count)
        elif ends == TURN:
            count = _turn(p, s, events, count)
        elif ends == PULL_SWITCH:
            s.held_by_residual = 1 - s.held_by_residual
    return at, at_current, count, TOO_MANY_STEPS


@compiled
def run_drive(
    valve, state, command_times, volts, t_end, times, rows, current_times, currents, events, tolerance, most_steps
):
    """Step the valve through a whole drive; arguments as for `run`, `command_times` (c,) ascending, `volts` (c,).

    Returns:
        events counted, Outcome.
    """
    at, at_current, count = 0, 0, 0
    for command in range(len(command_times) + 1):
        is_last = command == len(command_times)
        end = t_end if is_last else min(command_times[command], t_end)
        done, done_current, count, outcome = run(
            valve, state, end, not is_last, times[at:], rows[at:], current_times[at_current:], currents[at_current:],
            events, count, tolerance, most_steps,
        )  # fmt: skip
        at += done
        at_current += done_current
        if outcome != FINISHED or is_last or command_times[command] > t_end:
            return count, outcome
        set_voltage(valve, state, volts[command])
    return count, FINISHED


@compiled
def run_batch(records, states, command_times, volts, times, positions, tolerance, most_steps):
    """`run_drive` for many valves; positions (k, n) receives the pilot plunger as shown, m.

    Returns:
        the first set that failed (or the number of sets), and its Outcome.
    """
    rows = np.empty((len(times), 1))
    nothing = np.empty(0)
    events = np.empty(0, EVENT_RECORD)
    for i in range(len(records)):
        shifted = times - records[i].sensor_delay
        _, outcome = run_drive(
            records[i : i + 1], states[i : i + 1], command_times, volts, shifted[-1], shifted, rows, nothing, nothing,
            events, tolerance, most_steps,
        )  # fmt: skip
        if outcome != FINISHED:
            return i, outcome
        positions[i] = rows[:, 0]
    return len(records), FINISHED


@compiled
def settle_geometry(valve, state):
    """Make mode and position agree after the contacts moved: nothing jumps but what a contact must push."""
    p, s = valve[0], state[0]
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
