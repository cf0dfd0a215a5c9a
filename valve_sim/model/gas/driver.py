"""The driver of the hybrid automaton, compiled: steps from event to event, under one voltage or a whole drive.

A run is a sequence of committed steps. A step ends where error control ends it, or at an event, never at a time that
a caller asks for: samples inside a step are read from its dense output and commit nothing. So the state does not
depend on when it was sampled. Only a command cuts a step (`commit_end`).
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import compiled, inlined, inner, taken_in
from valve_sim.model.core_types import EVENT_RECORD, Outcome
from valve_sim.model.gas.equations import coil_now
from valve_sim.model.gas.flux import (
    FREEWHEELING,
    follows_flux,
    is_linear_at_rest,
    resting_current,
    smallest_flux_slope,
)
from valve_sim.model.gas.location import (
    CONTACT,
    CURRENT_GONE,
    FLOW_SWITCH,
    MOVED_OFF,
    NO_EVENT,
    PULL_SWITCH,
    SHORTEST_STEP,
    TURN,
    current_lasts,
    first_event,
    moved_off,
    polish,
)
from valve_sim.model.gas.record import has_gas
from valve_sim.model.gas.sampling import fill_until, is_filled, show_main, show_pilot
from valve_sim.model.gas.step import (
    commit_gas,
    fill_dense,
    norm_of_error,
    rates,
    shorten,
    start_gas,
    tolerance_of,
    try_step,
)
from valve_sim.model.gas.step_memory import (
    ALL_STATES,
    FIRST,
    FLUX_STATES,
    LAST,
    MECHANICAL_STATES,
    WORK_RECORD,
    step_factor,
)
from valve_sim.model.gas.transitions import end_current, move_off, push_now, set_voltage, switch_flow, touch, turn
from valve_sim.model.gas.variational import (
    enter_segment,
    leave_segment,
    show_variations,
    vary_event,
    vary_release,
    vary_sensor,
)
from valve_sim.model.gas.variational_pressure import vary_step
from valve_sim.model.gas.variational_steps import commit_variations

FINISHED, STEP_TOO_SMALL, TOO_MANY_STEPS, CHATTERING, FLUX_FOLDS = (int(outcome) for outcome in Outcome)

LONGEST_STEP: Final = 1e-3
"""s, in motion: a stroke takes milliseconds, so that no turn and return hides inside a step."""
LONGEST_REST: Final = 2e-3
"""s: how far ahead a valve at rest is looked at in one step, at least."""
LONGEST_REST_SHARE: Final = 0.25
"""A step at rest is at least this share of the time since the last command or lift-off. At rest the forces change only
by exponentials that began there, and the fast ones have decayed: an hour of rest takes a hundred steps."""
DECAYED: Final = 40.0
"""Time constants after which a current is below rounding errors."""
LONGEST_MOTION: Final = 0.1
"""s without voltage, after which any motion left is a creep."""
NO_CURRENT: Final = 1e-12
"""Of the reference current: without voltage a smaller one is set to 0, so a coil that heats rests in long steps."""
LARGEST_GROWTH: Final = 8.0
"""Ratio of one step to the one before, at most."""
SHORTEST_PROGRESS: Final = 1e-12
"""s: a step that ends sooner made no progress."""
NONE: Final = np.int64(0)
"""Where a count begins. A plain 0 is of a type of its own for Numba, and all that takes it is compiled once more."""
LONGEST_CHATTER: Final = 1000
"""Events in a row without progress in time after which a run is ended with an error."""


@inner
def _integrated_step(p, s, work, tolerance, longest):
    """The next step, as far as error control allows or up to the first event of the plungers or of the coil.

    Args:
        longest: s, that it may take at most.

    Returns:
        its size in s, what ends it, the size for the step after it, and an Outcome.
    """
    if not work.start_is_known:
        rates(p, s, work, s.time, work.y, FIRST)
    h = min(s.step, longest, _longest_step(p, s, work))
    while True:
        try_step(p, s, work, h)
        error = norm_of_error(p, work, h, tolerance)
        if error <= 1.0:
            break
        h *= max(0.1, step_factor(error)) if math.isfinite(error) else 0.1
        if h < SHORTEST_STEP:
            return h, NO_EVENT, h, STEP_TOO_SMALL
    following = h * min(LARGEST_GROWTH, step_factor(error))
    fill_dense(p, work)
    fraction, ends = first_event(p, s, work, h, tolerance)
    if ends != NO_EVENT:
        h = polish(p, s, work, h * fraction, ends)
        fill_dense(p, work)
    return h, ends, following, FINISHED


@inner
def _next_step(p, s, work, tolerance):
    """Find the next committed step from the state. Arguments and result as for `_integrated_step`."""
    is_integrated = _is_integrated(p, s, work)
    longest = current_lasts(p, s, work)
    h, ends, following, outcome = min(_rest(p, s), longest), NO_EVENT, s.step, FINISHED
    if is_integrated:
        h, ends, following, outcome = _integrated_step(p, s, work, tolerance, longest)
    else:
        for j in range(work.states):
            work.y_new[j] = work.y[j]
            for power in range(4):
                work.dense[j, power] = 0.0
    if h == longest and ends == NO_EVENT:
        ends = CURRENT_GONE
    if not s.moving and outcome == FINISHED:
        fraction = moved_off(p, s, work, h)
        if fraction <= 1.0:
            shorten(p, s, work, h, fraction)
            h *= fraction
            ends = MOVED_OFF
    if work.rests:
        work.y_new[2] = resting_current(p, s, h)
    return h, ends, following, outcome


@inlined
def _is_integrated(p, s, work):
    """Whether the next step is one of the integrator: plungers in motion, gas, or a coil without a closed form.

    Writes work.rests.
    """
    work.rests = 0
    if has_gas(p):
        return True
    if s.moving or work.states == MECHANICAL_STATES:
        return s.moving != 0
    if follows_flux(p) and is_linear_at_rest(p, s):
        work.rests = 1
    return not work.rests


@inlined
def _rest(p, s):
    """How far ahead plungers at rest are looked at in one step, s."""
    if p.terms_read_time:
        return LONGEST_REST
    return max(LONGEST_REST, LONGEST_REST_SHARE * (s.time - max(s.segment_time, s.unseated_time)))


@inlined
def _longest_step(p, s, work):
    """The longest step of the integrator, s."""
    return _rest(p, s) if _has_settled(p, s, work) else LONGEST_STEP


@inlined
def _has_settled(p, s, work):
    """Whether error control alone may choose the step: no current is left, and all that moves creeps, or only gas.

    A pilot plunger that nothing returns may float for hours.
    """
    if has_gas(p) and not s.moving:
        return True
    if s.volts != 0.0:
        return False
    if work.states > MECHANICAL_STATES:
        return not s.moving and s.u == 0.0 and s.w == 0.0
    decay = DECAYED * (p.coil_time_constant + p.eddy_time_constant)
    return s.time - s.segment_time > max(decay, LONGEST_MOTION)


@inlined
def _settle_coil(p, s, work):
    """Set a negligible integrated current to 0, at rest and without voltage."""
    if work.states == MECHANICAL_STATES or s.moving:
        return
    target = s.seen / p.reference_voltage
    if work.states == FLUX_STATES and abs(s.w - target) < NO_CURRENT and s.path != FREEWHEELING:
        s.w = target
    if s.volts != 0.0 or (s.u == 0.0 and s.w == 0.0):
        return
    u, w = coil_now(p, s)
    if max(abs(u), abs(w)) < NO_CURRENT:
        s.u = 0.0
        s.w = 0.0
        work.start_is_known = 0


@inlined
def _start_from(p, s, work):
    """Copy the state to where the integrator starts."""
    work.y[0] = s.x
    work.y[1] = s.v
    work.y[2] = s.w if follows_flux(p) else s.u
    work.y[3] = s.w
    work.y[4] = s.temperature
    start_gas(p, s, work)


@inlined
def _commit(p, s, work, h, time):
    """Make the end of a step of size h the state, at `time`."""
    if p.sensor_time_constant > 0.0:
        s.shown_pilot, s.shown_main = show_pilot(p, s, work, h, 1.0), show_main(p, s, work, h, 1.0)
    s.time = time
    commit_gas(p, s, work)
    s.x = work.y_new[0]
    s.v = work.y_new[1]
    if work.states > MECHANICAL_STATES:
        if follows_flux(p):
            s.w = work.y_new[2]
            s.u = coil_now(p, s)[0]
        else:
            s.u = work.y_new[2]
            s.w = work.y_new[3]
        if work.states == ALL_STATES:
            s.temperature = work.y_new[4]
        # Without heating u is monotone between commands, so that its largest value is at an end.
        s.peak_current = max(s.peak_current, abs(coil_now(p, s)[0]))


@inlined
def _end_step(p, s, work, ends, events, count):
    """Apply the event that ended a step; returns the events counted."""
    work.start_is_known = 1 if ends == NO_EVENT else 0
    if ends == NO_EVENT:
        for j in range(work.states):
            work.k[0, j] = work.k[LAST, j]
    elif ends == CONTACT:
        count = touch(p, s, events, count)
    elif ends == TURN:
        count = turn(p, s, events, count)
    elif ends == PULL_SWITCH:
        s.held_by_residual = 1 - s.held_by_residual
    elif ends == CURRENT_GONE:
        count = end_current(p, s, events, count)
    elif has_gas(p) and ends == FLOW_SWITCH:
        count = switch_flow(p, s, work, events, count)
    return count


@inner
def _cut_step(p, s, work, t_end, vary):
    """End a step at t_end, before a command."""
    h = t_end - s.time
    if h <= 0.0:
        return
    if work.rests:
        work.y_new[2] = resting_current(p, s, h)
    elif s.moving or work.states > MECHANICAL_STATES or has_gas(p):
        try_step(p, s, work, h)
        fill_dense(p, work)
    vary_step(p, s, work, h, vary)
    vary_sensor(p, s, work, h, vary)
    commit_variations(vary)
    _commit(p, s, work, h, t_end)


@inner
def _states(p):
    """How many states are integrated."""
    if p.temperature_rate != 0.0:
        return ALL_STATES
    return FLUX_STATES if follows_flux(p) else MECHANICAL_STATES


@compiled
def run(valve, state, until, samples, log, control, vary):
    """Step the valve, and derivatives along with it, from its state to a time under one voltage.

    Args:
        valve: (1,) valve record. state: (1,) state record, advanced. (Arrays of one and plain tuples, because Numba
            takes them from Python ten times faster than bare records and named tuples.)
        until: (t_end, commit_end): s; whether to stop exactly there (before a command), or at the last whole step.
        samples: (times, rows, current_times, currents): (i,) ascending times of position samples, s; (i, 1) or
            (i, ROW) their output, see `sample`; (j,) ascending times of current samples, s; (j,) u there, written.
        log: (events, count): (e,) event log; events noted so far.
        control: (tolerance, most_steps): relative error of a step; the steps after which a run ends with an error.
        vary: what derivatives are carried along, see `variational`, or None.

    Returns:
        (position samples, current samples) written, events counted, Outcome.
    """
    return run_on(valve, state, np.zeros(1, WORK_RECORD), (*until, *control), samples, log, vary)


@taken_in
def run_on(valve, state, works, limits, samples, log, vary):
    """`run` on a (1,) work record.

    The caller owns that record: Numba frees an array after the last use of its name, so that an array of which this
    loop only kept the element would be freed while the loop goes on, and other threads would write into it.
    """
    p, s, work = valve[0], state[0], works[0]
    t_end, commit_end, tolerance, most_steps = limits
    tolerance = tolerance_of(p, tolerance)
    events, count = log
    work.states = _states(p)
    done, chatter, last_event = (NONE, NONE), 0, s.segment_time
    for _ in range(most_steps):
        _settle_coil(p, s, work)
        _start_from(p, s, work)
        if not s.moving:
            push = push_now(p, s)
            if push != 0:
                count = move_off(p, s, push, events, count)
                work.start_is_known = 0
                vary_release(p, s, last_event, vary)
                last_event = s.time
        if s.time >= t_end and is_filled(s.time, samples, done):
            return done, count, FINISHED
        h, ends, following, outcome = _next_step(p, s, work, tolerance)
        if outcome != FINISHED:
            return done, count, outcome
        t_new = s.time + h
        shown, done = done, fill_until(p, s, work, h, min(t_new, t_end), samples, done)
        vary_step(p, s, work, h, vary)
        show_variations(p, s, work, h, samples, (shown, done), vary)
        if t_new > t_end:
            if commit_end:
                _cut_step(p, s, work, t_end, vary)
            return done, count, FINISHED
        chatter = chatter + 1 if h < SHORTEST_PROGRESS else 0
        if chatter > LONGEST_CHATTER:
            return done, count, CHATTERING
        _commit(p, s, work, h, t_new)
        if ends in (NO_EVENT, MOVED_OFF):
            s.step = following
        before = (ends, s.mode, s.direction, s.v)
        count = _end_step(p, s, work, ends, events, count)
        commit_variations(vary)
        vary_event(p, s, work, before, vary)
        last_event = s.time if ends in (CONTACT, TURN) else last_event
    return done, count, TOO_MANY_STEPS


@taken_in
def run_varied(valve, state, until, samples, log, control, vary):
    """`run` of those samples that are left of a whole run, whose derivatives `vary` takes."""
    if vary is None:
        return run(valve, state, until, samples, log, control, None)
    tiles, slopes, nodes, commands, (positions, of_currents, pressures) = vary
    at, at_current = len(positions) - len(samples[0]), len(of_currents) - len(samples[2])
    shown = (positions[at:], of_currents[at_current:], pressures[at:])
    return run(valve, state, until, samples, log, control, (tiles, slopes, nodes, commands, shown))


@compiled
def run_drive(valve, state, course, samples, events, control, vary):
    """Step the valve through a whole drive; arguments as for `run`.

    Args:
        course: (times, volts, t_end): (c,) ascending, s; (c,) V; s.

    Returns:
        events counted, Outcome.
    """
    if follows_flux(valve[0]) and not smallest_flux_slope(valve[0]) > 0.0:
        return 0, FLUX_FOLDS
    command_times, volts, t_end = course
    times, rows, current_times, currents = samples
    at, at_current, count = NONE, NONE, NONE
    for command in range(len(command_times) + 1):
        is_last = command == len(command_times)
        end = t_end if is_last else min(command_times[command], t_end)
        left = (times[at:], rows[at:], current_times[at_current:], currents[at_current:])
        until, log = (end, not is_last), (events, count)
        done, count, outcome = run_varied(valve, state, until, left, log, control, vary)
        at += done[0]
        at_current += done[1]
        if outcome != FINISHED or is_last or command_times[command] > t_end:
            return count, outcome
        peak = state[0].peak_current
        leave_segment(valve[0], state[0], command, vary)
        set_voltage(valve, state, volts[command])
        enter_segment(valve[0], state[0], command, peak, vary)
    return count, FINISHED


@compiled
def run_batch(records, states, drive, times, positions, control):
    """`run_drive` for many valves; positions (k, n) receives the pilot plunger as shown, m.

    Returns:
        the first set that failed (or the number of sets), and its Outcome.
    """
    rows = np.empty((len(times), 1))
    nothing = np.empty(0)
    events = np.empty(0, EVENT_RECORD)
    for i in range(len(records)):
        shifted = times - records[i].sensor_delay
        samples = (shifted, rows, nothing, nothing)
        course = (drive[0], drive[1], shifted[-1])
        _, outcome = run_drive(records[i : i + 1], states[i : i + 1], course, samples, events, control, None)
        if outcome != FINISHED:
            return i, outcome
        positions[i] = rows[:, 0]
    return len(records), FINISHED
