"""Where in a step something happens, compiled: contacts, turns, the end of a rest, a switch of the pull.

An event is searched as a person would: the velocity keeps its sign until the plungers turn, so between two turns x
is monotone and can cross only the contact ahead of it; whichever comes first ends the step. It is located on the
dense output and then polished by retaking the step, so that its time has the accuracy of the step itself.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN
from valve_sim.model.gas.equations import coil_now, residual_floor
from valve_sim.model.gas.flux import DRIVEN, FREEWHEELING, follows_flux, freewheels_for, last_pulling_current
from valve_sim.model.gas.step import difference_within, regime_change, try_step
from valve_sim.model.gas.step_memory import (
    CURRENT,
    FIRST,
    LAST,
    MECHANICAL_STATES,
    POSITION,
    SMALLEST_SCALE,
    VELOCITY,
    coil_within,
    dense_slope,
    interpolate,
)
from valve_sim.model.gas.transitions import push_at_rest

NO_EVENT, CONTACT, TURN, PULL_SWITCH, MOVED_OFF, CURRENT_GONE, CURRENT_PEAK, FLOW_SWITCH = 0, 1, 2, 3, 4, 5, 6, 7
"""What ends a step."""

SHORTEST_STEP: Final = 1e-16
"""s: if error control asks for less, it has failed."""
SOONEST: Final = 2e-12
"""s: what moves off sooner moves off at once, as a valve does that nothing holds when its coil is powered."""
LOOKS_AT_REST: Final = 8
"""How often in such a step it is asked whether the forces move it."""
BISECTIONS: Final = 28
"""Halvings of a step that locate an event to 4e-9 of it, 4e-12 s of the longest; contacts and turns are polished."""
BISECTED: Final = 5e-12
"""s: accuracy of the end of a rest, however long the step."""
MOST_BISECTIONS: Final = 60
"""Halvings for that, at most."""
LOCATED: Final = 1e-9
"""Fraction of a step to which a contact or turn is located on the dense output, before it is polished."""
NO_PEAK: Final = 1e-6
"""Fraction of a step: a peak closer to its start ended the step before."""
POLISHED: Final = 1e-15
"""s: accuracy of a polished event."""
MOST_POLISHING: Final = 5
"""Newton steps for that, at most; two are common."""
DENSE_OUTPUT_EXCESS: Final = 1e3
"""Error of the dense output inside a step after a sudden change of force, in units of the error at its end, at most."""


@inlined
def guard_ahead(p, s):
    """The contact that the plungers move towards, as a position of x."""
    if s.mode == MAIN:
        return p.stroke if s.direction > 0 else p.pilot_gap
    return p.pilot_gap if s.direction > 0 else 0.0


@inner
def first_event(p, s, work, h, tolerance):
    """What ends a step first, and at which fraction of it."""
    fraction = _pull_switch(p, s, work, h)
    ends = PULL_SWITCH if fraction <= 1.0 else NO_EVENT
    if work.states > MECHANICAL_STATES:
        fraction, ends = _first_of_current(p, s, work, h, fraction, ends)
    change = regime_change(p, s, work, h)
    if change < fraction:
        fraction, ends = change, FLOW_SWITCH
    if not s.moving:
        return fraction, ends
    turn = _first_turn(work, h, s.direction, tolerance)
    if turn < fraction:
        fraction, ends = turn, TURN
    latest = min(fraction, 1.0)
    guard = guard_ahead(p, s)
    x_latest = work.y_new[0] if latest == 1.0 else interpolate(work, h, POSITION, latest)
    if (x_latest - guard) * s.direction >= 0.0:
        return _crossing(work, h, POSITION, s.direction, guard, 0.0, latest), CONTACT
    return fraction, ends


@inlined
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
        slope = h * dense_slope(work, h, state, theta) * direction
        better = theta - ahead / slope if slope > 0.0 else low
        if abs(better - theta) < LOCATED:
            return min(max(better, low), high)
        theta = better if low < better < high else 0.5 * (low + high)
    return theta


@inner
def polish(p, s, work, h, ends):
    """Retake a step so that it ends exactly at what ends it: x at the contact, or v at 0. Returns its size, s."""
    state, target = POSITION, guard_ahead(p, s)
    if ends == TURN:
        state, target = VELOCITY, 0.0
    elif ends == CURRENT_GONE:
        state, target = CURRENT, current_when_gone(p, s)
    is_bisected = ends in (PULL_SWITCH, CURRENT_PEAK, FLOW_SWITCH)
    longest = h * 1.001
    for _ in range(MOST_POLISHING):
        try_step(p, s, work, h)
        slope = work.k[LAST, state]
        better = h - (work.y_new[state] - target) / slope
        # A slope of 0 makes it infinite or NaN.
        if is_bisected or not 0.0 < better <= longest:
            break
        if abs(better - h) <= POLISHED:
            break
        h = better
    if not is_bisected:
        work.y_new[state] = target
    return h


@inner
def current_when_gone(p, s):
    """The integrated current at which a freewheeling coil has none at its terminals."""
    return last_pulling_current(p, s) if follows_flux(p) else 0.0


@inner
def _first_of_current(p, s, work, h, fraction, ends):
    """The first event of an integrated current and its fraction of the step, or those given if there is none before."""
    if s.path == FREEWHEELING:
        way = 1 if s.seen > 0.0 else -1
        target = current_when_gone(p, s)
        latest = min(fraction, 1.0)
        last = work.y_new[2] if latest == 1.0 else interpolate(work, h, CURRENT, latest)
        if (last - target) * way >= 0.0:
            return _crossing(work, h, CURRENT, way, target, 0.0, latest), CURRENT_GONE
    elif s.path == DRIVEN and p.residual_current != 0.0 and follows_flux(p):
        peak = _current_peak(s, work, h)
        if peak < fraction:
            return peak, CURRENT_PEAK
    return fraction, ends


@inner
def _current_peak(s, work, h):
    """The fraction of the step at which a current that grew begins to shrink, or 2 for not in this step.

    The largest current sets the residual magnetism; where motion makes the current dip, it lies inside a step.
    """
    way = 1.0 if work.y[2] > 0.0 else -1.0
    if work.k[FIRST, 2] * way <= 0.0 or work.k[LAST, 2] * way >= 0.0:
        return 2.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if dense_slope(work, h, CURRENT, middle) * way > 0.0:
            low = middle
        else:
            high = middle
    return high if low > NO_PEAK else 2.0


@inlined
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
def _is_held(p, s, work, h, theta):
    """Whether the pull is at the residual floor at the fraction theta of a step."""
    u, w = coil_within(p, s, work, h, theta)
    return 1 if abs(w) < residual_floor(p, max(s.peak_current, abs(u))) else 0


@inner
def moved_off(p, s, work, h):
    """The fraction of a step at rest at which the forces begin to move the plungers, or 2 for not in this step."""
    low, unpulled = 0.0, _pull_vanishes(p, s, work, h)
    for look in range(1, LOOKS_AT_REST + 1):
        high = look / LOOKS_AT_REST
        if low < unpulled < high and _push_after(p, s, work, h, unpulled) != 0:
            high = unpulled
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
def _pull_vanishes(p, s, work, h):
    """The fraction of a step at rest at which the pulling current changes its sign, or 2 for not in this step.

    A voltage of the other sign lets go for an instant that may lie between two looks.
    """
    _, before = coil_within(p, s, work, h, 0.0)
    if before * s.seen >= 0.0 or before * coil_within(p, s, work, h, 1.0)[1] >= 0.0:
        return 2.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if before * coil_within(p, s, work, h, middle)[1] > 0.0:
            low = middle
        else:
            high = middle
    return high


@inner
def _push_after(p, s, work, h, theta):
    """Which way the forces push plungers that have rested for the fraction theta of a step."""
    coil, difference = coil_within(p, s, work, h, theta), difference_within(p, s, work, h, theta)
    return push_at_rest(p, s, s.time + theta * h, coil, difference)


@inlined
def current_lasts(p, s, work):
    """Seconds until a freewheeling current with a closed form is gone; infinity for any other, located in the step.

    Beyond its end the formula grows again, and would pull: no step may look there.
    """
    if s.path != FREEWHEELING or (work.states > MECHANICAL_STATES and not work.rests):
        return math.inf
    return max(freewheels_for(p, s, coil_now(p, s)[0]), SHORTEST_STEP)
