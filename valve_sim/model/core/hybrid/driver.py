"""The integrator of hybrid machines, in the part of Python that `lowering` compiles.

A step ends where error control or an event ends it, never where somebody looks: samples are read from its polynomials,
so that a run in pieces is the same run to the last bit. Only an input that changes cuts a step. At an event tangents
jump by what its time changes (saltation): they are moved to where the event is along the rates before it, through what
it sets, and back along the rates after it (Hiskens and Pai 2000). `b` is the block of a machine, `t` its tangents.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.core import polynomials
from valve_sim.model.core.hybrid import layout as at
from valve_sim.model.core.polynomials import Block, extent, first_fall, invoke

FINISHED, NOT_FINITE, TOO_MANY, STANDS_STILL = 0, 1, 2, 3
"""Outcomes."""
FAR: Final = 1e9
"""s: the longest step."""
SHORTEST: Final = 1e-16
"""s: a step that would have to be shorter cannot be found."""
PROGRESS: Final = 1e-12
"""s: a shorter step is none; after `MOST_STALLED` of them in a row time is taken to stand still."""
MOST_STALLED: Final = 1000
RETAKEN: Final = 0.6
"""Of a step whose series is off its equation: the next trial."""
ROUNDING: Final = 1e-13
"""Of the size of a polynomial: below it a guard has no sign."""
OF_TANGENTS: Final = 1e3
"""Times the tolerance of states: that of their tangents."""
RECOVERS: Final = 1e-3
"""Of a step: a guard that holds again so soon has just begun to hold, and is off its root by rounding."""
DEFLATIONS: Final = 4
POLISHED: Final = 4
"""Trials in which an event is located on the guard itself, and not on its series."""
EDGE: Final = 1e-9
"""Of the jump across a switch: a rate so small does not hold the state on it."""
ROUNDS: Final = 24
"""Times that switches are decided again, as one may depend on another."""
LOWER, UPPER, BETWEEN = 0, 1, 2
"""Sides of a switch."""
SPACING: Final = 1.2e-16
EVENT: Final = 3
"""Numbers of an event: its time, s, the transition, and which of its cases."""


def before(time: float) -> float:
    """The last double before a time, s, or one close to it."""
    return time - SPACING * abs(time) - 1e-300


# -- looking -----------------------------------------------------------------------------------------------------------


def look_at(b: Block, t: Block, h: float) -> None:
    """Look at a time within the step, s since its start."""
    b[at.ELAPSED] = h
    invoke(b[at.AT], b, t)
    invoke(b[at.LOOK], b, t)


def look(b: Block, t: Block) -> None:
    """Look at the state itself."""
    states = int(b[at.STATES])
    width = int(b[at.WIDTH])
    for i in range(states):
        b[at.END + i] = b[at.STATE + i]
    for i in range(states * width):
        t[at.END * width + i] = t[at.STATE * width + i]
    b[at.ELAPSED] = 0.0
    invoke(b[at.LOOK], b, t)


# -- a step ------------------------------------------------------------------------------------------------------------


def step(b: Block, t: Block) -> int:
    """Find the next step: its series, its size, and what ends it, which is returned. −1: it cannot be found."""
    kernel = b[at.MOVE + int(b[at.GROUP])]
    longest = b[at.LONGEST]
    ends = -1
    while b[at.LONGEST] > SHORTEST:
        invoke(kernel, b, t)
        while b[at.DEFECT] > 1.0 and b[at.STEP] > SHORTEST:
            b[at.LONGEST] = RETAKEN * b[at.STEP]
            invoke(kernel, b, t)
        shorter = step_of_tangents(b, t)
        if shorter < b[at.STEP]:
            b[at.LONGEST] = shorter
            invoke(kernel, b, t)
        if not (b[at.DEFECT] >= 0.0) or not (b[at.STEP] >= SHORTEST) or not is_finite(b):
            break
        ends = at.NO_EVENT
        if b[at.SUSPECT] > 0.0:
            ends = first_event(b, t)
        if ends == at.NO_EVENT or b[at.STEP] == 0.0 or not is_off(b, t):
            break
        b[at.LONGEST] = RETAKEN * b[at.STEP]
        ends = -1
    b[at.LONGEST] = longest
    return ends


def step_of_tangents(b: Block, t: Block) -> float:
    """The step in which the last two terms of all tangents' series are small, too; s, at most the step at hand.

    Tangents fade, and turn, even where what they are of stands still. Errors are relative to their largest size so far.
    One that begins with its last terms is still nothing: no step, however short, would have it begin otherwise.
    """
    h = b[at.STEP]
    states = int(b[at.STATES])
    width = int(b[at.WIDTH])
    tolerated = OF_TANGENTS * b[at.TOLERANCE]
    power = h
    for _ in range(at.ORDER - 2):
        power *= h
    shortest = h
    for i in range(states if h < FAR else 0):
        for k in range(width):
            c = t[at.SERIES * width + i * at.TERMS * width + k :]
            last = max(abs(c[(at.ORDER - 1) * width]), abs(c[at.ORDER * width]) * h) * power
            if last > tolerated * t[(at.PEAK + i) * width + k]:
                size = abs(c[0])
                grown = h
                for order in range(1, at.ORDER - 1):
                    size = max(size, abs(c[order * width]) * grown)
                    grown *= h
                if last > tolerated * size and size > 0.0:
                    shortest = min(shortest, h * math.sqrt(math.sqrt(math.sqrt(tolerated * size / last))))
    return float(shortest)


def is_finite(b: Block) -> bool:
    """Whether all states are finite at the end of a step."""
    states = int(b[at.STATES])
    total = 0.0
    for i in range(states):
        total += b[at.END + i] - b[at.END + i]
    return total == 0.0


def is_off(b: Block, t: Block) -> bool:
    """Whether a series is off its equation where an event ends the step: it was compared further on only."""
    if b[at.IS_CHECKED] == 0.0:
        return False
    h = b[at.STEP]
    look_at(b, t, h)
    states = int(b[at.STATES])
    off = False
    for i in range(states):
        if b[at.CHECKED + i] > 0.0:
            c = b[at.SERIES + i * at.TERMS :]
            slope = 0.0
            for k in range(at.TERMS - 1, 0, -1):
                slope = k * c[k] + h * slope
            tolerated = b[at.TOLERANCE] * max(abs(c[0]), 1e-6, b[at.PEAK + i])
            if not (abs(slope - b[at.RATE + i]) * h <= tolerated):
                off = True
    return off


def first_event(b: Block, t: Block) -> int:
    """The first event in a step, to whose time the step is shortened."""
    ends = at.NO_EVENT
    count = int(b[at.WATCHES])
    for i in range(count):
        watch = at.WATCH + at.WATCH_SLOTS * i
        if not (b[watch] > 0.0):
            c = at.WATCH_SERIES + i * at.TERMS
            unsure = max(b[watch + 2], ROUNDING * extent(b, c, b[at.STEP], at.TERMS))
            held_already = 1.0 if b[c] < -unsure else 0.0
            deflate(b, c, b[at.STEP], unsure)
            found = first_fall(b, c, b[at.STEP], unsure, at.TERMS, b[at.SCRATCH :])
            if found < b[at.STEP]:
                b[at.STEP] = found
                ends = int(b[watch + 1])
                b[at.HELD_ALREADY] = held_already if found == 0.0 else 0.0
    if ends != at.NO_EVENT:
        if b[at.STEP] > 0.0:
            polish(b, t, ends)
        b[at.ELAPSED] = b[at.STEP]
        invoke(b[at.AT], b, t)
    return ends


def deflate(b: Block, c: int, h: float, unsure: float) -> None:
    """Divide a polynomial that begins at 0, within rounding, by the time: that root is of the event before."""
    for _ in range(DEFLATIONS):
        recovers = b[c] < 0.0 and -b[c] < RECOVERS * b[c + 1] * h
        if abs(b[c]) > unsure and not recovers:
            break
        for k in range(at.TERMS - 1):
            b[c + k] = h * b[c + k + 1]
        b[c + at.TERMS - 1] = 0.0


def slack(b: Block, ends: int) -> float:
    """Of an event what falls through 0 at it, where it was looked at last."""
    if ends < at.OF_SWITCH:
        return float(-b[at.GUARD + ends - at.OF_TRANSITION])
    if ends < at.OF_EXIT:
        which = ends - at.OF_SWITCH
        return float(b[at.EXCESS + which] if b[at.FLAG + which] > 0.5 else -b[at.EXCESS + which])
    k = (ends - at.OF_EXIT) // 2
    return float(-b[at.ABOVE + k] if ends == at.OF_EXIT + 2 * k else b[at.BELOW + k])


def polish(b: Block, t: Block, ends: int) -> None:
    """Find the end of a step on the guard itself, by the secant method: its series is less exact than the states'."""
    h = b[at.STEP]
    h0 = 0.9999 * h
    look_at(b, t, h0)
    f0 = slack(b, ends)
    for _ in range(POLISHED):
        look_at(b, t, h)
        f = slack(b, ends)
        if f == 0.0 or f - f0 == 0.0:
            break
        better = h - f * (h - h0) / (f - f0)
        if not (abs(better - h) <= 0.5 * b[at.STEP]) or better < 0.0 or better == h:
            break
        h0 = h
        f0 = f
        h = better
    b[at.STEP] = h


def commit(b: Block, t: Block, time: float) -> None:
    """Make what the states are at the end of the step, a time in s, the state."""
    h = time - b[at.TIME]
    b[at.TIME] = time
    states = int(b[at.STATES])
    for i in range(states):
        b[at.STATE + i] = b[at.END + i]
        b[at.PEAK + i] = max(b[at.PEAK + i], abs(b[at.STATE + i]))
    width = int(b[at.WIDTH])
    for i in range(states * width):
        t[at.STATE * width + i] = t[at.END * width + i]
        t[at.PEAK * width + i] = max(t[at.PEAK * width + i], abs(t[at.STATE * width + i]))
    inputs = int(b[at.INPUTS])
    for i in range(inputs):
        b[at.INPUT + i] += h * b[at.SLOPE + i]
    if h > 0.0:
        b[at.HAS_CHANGED] = 0.0
    b[at.IS_PENDING] = 0.0


# -- switches ----------------------------------------------------------------------------------------------------------


def is_held_by_others(b: Block, j: int) -> bool:
    """Whether what slides along other switches keeps a state on this one, too: then its own side is of no effect."""
    k = int(b[at.SLIDER_OF + j])
    held = False
    if k >= 0 and b[at.SLIDES + k] < 0.5 and b[at.SPAN + k] > 0.0:
        is_on = abs(b[at.EXCESS + j]) <= b[at.UNSURE + j]
        held = is_on and b[at.BELOW + k] - b[at.ABOVE + k] <= EDGE * b[at.SPAN + k]
    return held


def side_of(b: Block, j: int, crossed: int) -> int:
    """The side of a switch on which the state is, where it was looked at: `LOWER`, `UPPER`, or, sliding, `BETWEEN`.

    By what the switch compares, and where that is equal by what it comes to. crossed: a switch that has just changed.
    """
    excess = b[at.EXCESS + j]
    k = int(b[at.SLIDER_OF + j])
    above = b[at.ABOVE + k] if k >= 0 else b[at.EXCESS_RATE + j]
    below = b[at.BELOW + k] if k >= 0 else above
    span = below - above
    least = EDGE * span
    side = UPPER if excess > 0.0 else LOWER
    # A transition, or another input, may have thrown the state off a switch along which it slid.
    if k >= 0 and b[at.SLIDES + k] > 0.5 and (crossed >= 0 or abs(excess) <= b[at.UNSURE + j]):
        side = UPPER if above > 0.0 else LOWER
        if span > 0.0 and above <= least and below >= -least:
            side = BETWEEN
    elif is_held_by_others(b, j):
        side = int(b[at.FLAG + j])
    elif j == crossed:
        # It came from the side that it left; what counts is whether the other one pushes it back.
        side = int(b[at.FLAG + j])
        if span > 0.0 and (below > least if side == LOWER else above < -least):
            side = BETWEEN
    elif abs(excess) <= b[at.UNSURE + j]:
        side = UPPER if above >= -least and below + above > 0.0 else LOWER
        if span > 0.0 and above < -least and below > least:
            side = BETWEEN
    return side


def decide(b: Block, t: Block, crossed: int) -> None:
    """Decide the sides of all switches; `crossed` has just changed, −1: none. Each may depend on others.

    One begins to slide at a time: it may be enough to hold others.
    """
    switches = int(b[at.SWITCHES])
    for _ in range(ROUNDS if switches > 0 else 0):
        look(b, t)
        changed = 0
        for j in range(switches):
            side = side_of(b, j, crossed)
            flag = 1.0 if side == UPPER else 0.0  # between them it is that of the lower side, which shares are added to
            if flag != b[at.FLAG + j]:
                b[at.FLAG + j] = flag
                changed = 1
            k = int(b[at.SLIDER_OF + j])
            slides = 1.0 if side == BETWEEN else 0.0
            if k >= 0 and slides != b[at.SLIDES + k]:
                b[at.SLIDES + k] = slides
                changed = 1
                if slides > 0.5:
                    break
        if changed == 0:
            break
    choose_group(b, t)


def choose_group(b: Block, t: Block) -> None:
    """The kernel of the step that follows, and the masks of what slides; a state along which it slides stays at 0."""
    slides = 0.0
    sliders = int(b[at.SLIDERS])
    width = int(b[at.WIDTH])
    for k in range(sliders):
        switch = int(b[at.SWITCH_OF + k])
        b[at.SLIDER_MASK + k] = at.HUGE
        b[at.SWITCH_MASK + switch] = at.HUGE if is_held_by_others(b, switch) else 0.0
        if b[at.SLIDES + k] > 0.5:
            slides = 1.0
            b[at.SLIDER_MASK + k] = 0.0
            b[at.SWITCH_MASK + switch] = at.HUGE
            place = int(b[at.SNAP + switch])
            if place >= 0:
                b[at.STATE + place] = 0.0
                for i in range(width):
                    t[(at.STATE + place) * width + i] = 0.0
    b[at.GROUP] = 2.0 * b[at.BASE_GROUP] + slides


# -- events ------------------------------------------------------------------------------------------------------------


def leave(b: Block, t: Block, ends: int) -> None:
    """Find the derivatives δ of the time of an event, and move the tangents of the states to where it is.

    Of a guard g that came to 0 by itself, δ = −δg/ġ. One that held at once was set off by the event, or the change of
    an input, before it at the same time, and has the δ of that. Where sliding ends nothing jumps.
    """
    width = int(b[at.WIDTH])
    if width == 0:
        return
    look(b, t)
    if ends < at.OF_EXIT and (b[at.HELD_ALREADY] == 0.0 or b[at.HAS_CHANGED] == 0.0):
        guard = at.GUARD + ends - at.OF_TRANSITION
        rate = b[at.GUARD_RATE + ends - at.OF_TRANSITION]
        if ends >= at.OF_SWITCH:
            guard = at.EXCESS + ends - at.OF_SWITCH
            rate = b[at.EXCESS_RATE + ends - at.OF_SWITCH]
        for k in range(width):
            t[at.DELTA * width + k] = -t[guard * width + k] / rate if rate != 0.0 else 0.0
    if ends >= at.OF_EXIT:
        for k in range(width):
            t[at.DELTA * width + k] = 0.0
    move_tangents(b, t, 1.0)


def move_tangents(b: Block, t: Block, way: float) -> None:
    """Add to the tangents of the states their rates times δ, times `way`."""
    width = int(b[at.WIDTH])
    states = int(b[at.STATES])
    for i in range(states):
        for k in range(width):
            t[(at.STATE + i) * width + k] += b[at.RATE + i] * way * t[at.DELTA * width + k]


def end_step(b: Block, t: Block, ends: int, events: Block, room: int) -> None:
    """Apply the event that ended a step; the state is that of its end."""
    leave(b, t, ends)
    crossed = -1
    if ends < at.OF_SWITCH:
        transition = ends - at.OF_TRANSITION
        invoke(b[at.JUMP + transition], b, t)
        invoke(b[at.ENTER], b, t)
        log_event(b, transition, events, room)
    elif ends < at.OF_EXIT:
        crossed = ends - at.OF_SWITCH
        b[at.FLAG + crossed] = 1.0 - b[at.FLAG + crossed]
        place = int(b[at.SNAP + crossed])
        if place >= 0:
            b[at.STATE + place] = 0.0
    else:
        k = (ends - at.OF_EXIT) // 2
        b[at.SLIDES + k] = 0.0
        crossed = int(b[at.SWITCH_OF + k])
        b[at.FLAG + crossed] = 1.0 if ends == at.OF_EXIT + 2 * k else 0.0
    decide(b, t, crossed)
    if b[at.WIDTH] > 0.0:
        look(b, t)
        move_tangents(b, t, -1.0)
    b[at.HAS_CHANGED] = 1.0


def log_event(b: Block, transition: int, events: Block, room: int) -> None:
    """Note an event, if there is room, and count it."""
    count = int(b[at.EVENTS])
    if count < room:
        event = events[EVENT * count :]
        event[0] = b[at.TIME]
        event[1] = 1.0 * transition
        event[2] = b[at.CASE]
    b[at.EVENTS] = count + 1


def take_inputs(b: Block, t: Block, change: Block, moves: Block, has_moves: int) -> None:
    """Inputs change now: a value and a slope each.

    moves: (1 + inputs, width) derivatives of when, and of the values, if there are any.
    """
    width = int(b[at.WIDTH])
    moved = 0
    for k in range(width):
        t[at.DELTA * width + k] = 0.0
        if has_moves > 0 and moves[k] != 0.0:
            t[at.DELTA * width + k] = moves[k]
            moved = 1
    if moved > 0:
        look(b, t)
        move_tangents(b, t, 1.0)
    inputs = int(b[at.INPUTS])
    for i in range(inputs):
        b[at.INPUT + i] = change[2 * i]
        b[at.SLOPE + i] = change[2 * i + 1]
        for k in range(width if has_moves > 0 else 0):
            t[(at.INPUT + i) * width + k] = moves[(1 + i) * width + k]
    b[at.HAS_CHANGED] = 1.0
    b[at.IS_PENDING] = 0.0
    decide(b, t, -1)
    if moved > 0:
        look(b, t)
        move_tangents(b, t, -1.0)


# -- runs --------------------------------------------------------------------------------------------------------------


def fill(b: Block, t: Block, last: float, times: Block, count: int, rows: Block, slopes: Block) -> None:
    """Write the samples of the step up to a time, s."""
    outputs = int(b[at.OUTPUTS])
    width = int(b[at.WIDTH])
    sample = int(b[at.SAMPLED])
    while sample < count and times[sample] <= last:
        b[at.ELAPSED] = max(0.0, times[sample] - b[at.TIME])
        invoke(b[at.ROW], b, t)
        row = rows[sample * outputs :]
        for i in range(outputs):
            row[i] = b[at.OUT + i]
        slope = slopes[sample * outputs * width :]
        for i in range(outputs * width):
            slope[i] = t[at.OUT * width + i]
        sample += 1
    b[at.SAMPLED] = sample


def run(
    b: Block, t: Block, end: float, cuts: bool, most: float, times: Block, count: int, rows: Block, slopes: Block,
    events: Block, room: int,
) -> int:  # fmt: skip
    """Step a machine from its state to a time, s, while no input changes; returns an outcome.

    Args:
        cuts: whether the state is to be that of the end, where an input changes; else the step that is under way there
            stays as it is. most: steps. times: (count,) s. rows, slopes: (count, outputs) and (count, outputs, width).
        events: (room, EVENT).
    """
    while b[at.TAKEN] <= most:
        if b[at.IS_PENDING] == 0.0:
            if b[at.TIME] >= end and (cuts or b[at.SAMPLED] >= count):
                return FINISHED
            b[at.LONGEST] = FAR
            if b[at.IS_STRAIGHT] > 0.0 and cuts:  # it is known no further how such an input goes on
                b[at.LONGEST] = end - b[at.TIME]
            b[at.ENDS] = step(b, t)
            if b[at.ENDS] < 0.0:
                return NOT_FINITE
            b[at.IS_PENDING] = 1.0
        following = b[at.TIME] + b[at.STEP]
        if cuts and b[at.STEP] == end - b[at.TIME]:
            following = end
        last = before(following)
        if following > end:
            last = before(end) if cuts else end
        if count > 0:
            fill(b, t, last, times, count, rows, slopes)
        if following > end:
            if cuts:
                b[at.ELAPSED] = end - b[at.TIME]
                invoke(b[at.AT], b, t)
                commit(b, t, end)
            return FINISHED
        b[at.STALLED] = b[at.STALLED] + 1.0 if b[at.STEP] < PROGRESS else 0.0
        if b[at.STALLED] > MOST_STALLED:
            return STANDS_STILL
        ends = int(b[at.ENDS])
        commit(b, t, following)
        b[at.TAKEN] += 1.0
        if ends != at.NO_EVENT:
            end_step(b, t, ends, events, room)
    return TOO_MANY


def drive(
    b: Block, t: Block, changes: Block, change_count: int, moves: Block, has_moves: int, end: float, most: float,
    times: Block, count: int, rows: Block, slopes: Block, events: Block, room: int,
) -> int:  # fmt: skip
    """Step a machine through changes of its inputs to a time, s; arguments and outcome: see `run`.

    changes: (change_count, 1 + 2 inputs) s, and a value and a slope of each input; the first is that of the start.
    moves: (change_count, 1 + inputs, width) derivatives of the times of the changes, and of the values, if any.
    """
    invoke(b[at.ENTER], b, t)
    size = 1 + 2 * int(b[at.INPUTS])
    moved = (1 + int(b[at.INPUTS])) * int(b[at.WIDTH])
    for number in range(change_count):
        change = changes[size * number :]
        if change[0] > end:
            break
        if change[0] > b[at.TIME]:
            outcome = run(b, t, change[0], True, most, times, count, rows, slopes, events, room)
            if outcome != FINISHED:
                return outcome
        take_inputs(b, t, change[1:], moves[number * moved :], has_moves)
    return run(b, t, end, False, most, times, count, rows, slopes, events, room)


FUNCTIONS: Final = (
    *polynomials.FUNCTIONS, before, look_at, look, step, step_of_tangents, is_finite, is_off, first_event, deflate,
    slack, polish, commit, is_held_by_others, side_of, decide, choose_group, leave, move_tangents, end_step, log_event,
    take_inputs, fill, run, drive,
)  # fmt: skip
"""What is compiled."""
