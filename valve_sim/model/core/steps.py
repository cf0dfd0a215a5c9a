"""One step, from where the valve is to what ends it: its size, the first event in it, and the state at its end.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

from typing import Final

from valve_sim.model.core import layout as at
from valve_sim.model.core.gas_steps import (
    MARGIN,
    MARGIN_OF_PRESSURE,
    controlled_gas_step,
    finish_gas_step,
    regime_at,
    regime_of,
    rest_at,
    take_gas_step,
)  # fmt: skip
from valve_sim.model.core.modes import push_now, settle_coil
from valve_sim.model.core.polynomials import Block, extent, first_fall, invoke, root, value_at
from valve_sim.model.core.samples import lag_tangents, lagged, shown_main

SHORTEST_STEP: Final = 1e-16
"""s: if error control asks for less, it has failed."""
ANY_STEP: Final = 1e9
"""s: no limit of a step."""
RETAKEN: Final = 0.6
"""Of the step whose series was too far off its equation: what is tried next."""
SIZE_OF_V: Final = 1e-2
"""m/s: below it the error of a velocity is held absolutely."""
SIZE_OF_FORCE: Final = 1.0
"""N: likewise of a force."""
MOST_STALLED: Final = 3
"""Shorter steps in a row that make a comparison no better."""
OF_TANGENTS: Final = 1e-2
"""Of the tolerance of a comparison, with derivatives: the slope of a friction that falls with speed is steep."""
LONG: Final = 1e-2
"""s: a longer step is one of polynomials that are exact, and may be shortened."""
FARTHEST: Final = 1e6
"""Of the size of a polynomial nearby: where it is larger, its roots nearby are lost in rounding."""
OWN_ERROR: Final = 1e-3
"""m/s times the tolerance: a velocity that small has no sign; a crawl would turn for ever."""
ROUNDING: Final = 1e-13
"""N, or of the size of a polynomial: below it a guard has no sign."""
RECOVERS: Final = 1e-3
"""Of a step: a comparison that holds again so soon has just begun to hold."""
ON_EQUATION: Final = 4
"""Newton steps on the balance of forces with which the end of a rest is found."""
LOOKS_AT_REST: Final = 8
LOOKS_IN_MOTION: Final = 4
"""How often in a step of a valve with gas it is asked what has happened."""
HALVED: Final = 5e-12
"""s: how exactly that is then located."""
MOST_HALVINGS: Final = 60
MOST_POLISHING: Final = 5
"""Newton steps by which the end of such a step is mended, at most; two are common."""
POLISHED: Final = 1e-15
"""s: accuracy of what is mended."""
POLISHED_WITHIN: Final = 1.001
"""Of the step found before."""


def step(b: Block, t: Block) -> int:
    """Find the next step from the state: its series, its size, and what ends it. −1 if it cannot be found."""
    if b[at.DENSITY] > 0.0:
        return step_with_gas(b, t)
    if b[at.MOVING] == 0.0 and b[at.WARM] >= 0.0 and b[at.VOLTS] == 0.0 and b[at.WIDTH] == 0.0:
        settle_coil(b, t)
    b[at.LONGEST] = ANY_STEP
    ends = try_step(b, t)
    while b[at.IS_CHECKED] > 0.0 and ends > at.NO_EVENT and is_off(b, t):
        b[at.LONGEST] = RETAKEN * b[at.STEP]
        ends = try_step(b, t)
    return ends


def try_step(b: Block, t: Block) -> int:
    """`step` of a size up to LONGEST. The series is compared with its equation within it, but not at an event."""
    kernel = b[at.MOVE] if b[at.MOVING] > 0.0 else b[at.REST]
    invoke(kernel, b, t)
    before = 2.0 * FARTHEST
    stalled = 0
    while b[at.IS_CHECKED] > 0.0 and b[at.DEFECT] > 1.0 and b[at.STEP] > SHORTEST_STEP:
        stalled = stalled + 1 if b[at.DEFECT] < FARTHEST and b[at.DEFECT] > 0.5 * before else 0
        if stalled > MOST_STALLED:
            break  # Shorter steps are no better: this is rounding, as of the sine of a large number.
        before = b[at.DEFECT]
        b[at.LONGEST] = RETAKEN * b[at.STEP]
        invoke(kernel, b, t)
    h = b[at.STEP]
    if not (h >= SHORTEST_STEP) or b[at.END_X] - b[at.END_X] != 0.0 or b[at.END_V] - b[at.END_V] != 0.0:
        return -1
    if b[at.SUSPECT] == 0.0:
        return at.NO_EVENT
    if h > LONG:
        shorten(b, t)
    ends = first_event(b, t)
    if ends not in (at.NO_EVENT, at.RISE, at.FALL):
        b[at.ELAPSED] = b[at.STEP]
        invoke(b[at.AT], b, t)
    return ends


def is_off(b: Block, t: Block) -> bool:
    """Whether the series of x is off its equation at the event that ends the step: it was compared elsewhere only."""
    if b[at.MOVING] == 0.0:
        return False
    h = b[at.STEP]
    look_at_end(b, t)
    slope = 0.0
    for k in range(at.ORDER, 1, -1):
        slope = k * (k - 1) * b[at.SERIES_X + k] + h * slope
    tolerated = b[at.TOLERANCE] * max(abs(b[at.V]), SIZE_OF_V)
    if b[at.WIDTH] > 0.0:
        tolerated *= OF_TANGENTS
    is_far: bool = abs(slope - b[at.ACCELERATION]) * h > tolerated
    return is_far


def shorten(b: Block, t: Block) -> None:
    """Shorten a step whose polynomials reach so far that their roots nearby are lost in rounding."""
    whole = b[at.STEP]
    if b[at.MOVING] > 0.0:
        bring_near(b, at.SERIES_X, b[at.STROKE])
    else:
        bring_near(b, at.GUARD, SIZE_OF_FORCE)
        bring_near(b, at.GUARD + at.TERMS, SIZE_OF_FORCE)
    count = int(b[at.GUARDS])
    for guard in range(count):
        bring_near(b, at.GUARD + (3 + guard) * at.TERMS, 0.0)
    if b[at.STEP] < whole:
        b[at.ELAPSED] = b[at.STEP]
        invoke(b[at.AT], b, t)


def bring_near(b: Block, c: int, least: float) -> None:
    """Shorten the step until a polynomial is within FARTHEST of its size nearby, or of the least that counts."""
    while b[at.STEP] > LONG:
        near = abs(b[c]) + abs(b[c + 1]) * b[at.STEP] + least
        if near == 0.0 or extent(b, c, b[at.STEP], at.TERMS) <= FARTHEST * near:
            return
        b[at.STEP] = 0.25 * b[at.STEP]


def step_with_gas(b: Block, t: Block) -> int:
    """`step` of a valve with gas."""
    if b[at.MOVING] == 0.0 and b[at.WARM] >= 0.0 and b[at.VOLTS] == 0.0 and b[at.WIDTH] == 0.0:
        settle_coil(b, t)
    if b[at.MOVING] == 0.0:
        push = push_now(b, t)
        if push != 0.0:
            rest_at(b, t)
            return at.RISE if push > 0.0 else at.FALL
    if not controlled_gas_step(b, t) or b[at.END_X] - b[at.END_X] != 0.0 or b[at.END_V] - b[at.END_V] != 0.0:
        return -1
    ends = first_with_gas(b, t)
    if ends != at.NO_EVENT:
        polish_gas_step(b, t, ends)
    finish_gas_step(b, t)
    return ends


def first_with_gas(b: Block, t: Block) -> int:
    """What ends a step of a valve with gas first; sets its size to when that happens."""
    whole = b[at.STEP]
    ends = first_of_motion(b) if b[at.MOVING] > 0.0 else at.NO_EVENT
    at_rest = b[at.MOVING] == 0.0
    looks = LOOKS_AT_REST if at_rest else LOOKS_IN_MOTION
    longest = b[at.STEP]
    low = 0.0
    for look in range(1, looks + 1):
        high = longest * look / looks
        found = happened_by(b, t, high)
        if found != at.NO_EVENT:
            for _ in range(MOST_HALVINGS):
                if high - low < HALVED:
                    break
                middle = 0.5 * (low + high)
                sooner = happened_by(b, t, middle)
                if sooner != at.NO_EVENT:
                    high = middle
                    found = sooner
                else:
                    low = middle
            ends = found
            b[at.STEP] = high
            break
        low = high
    if regime_at(b, t, b[at.STEP], MARGIN, MARGIN_OF_PRESSURE) != b[at.REGIME]:
        ahead = regime_of(b, MARGIN, MARGIN_OF_PRESSURE)
        low = 0.0
        high = b[at.STEP]
        for _ in range(MOST_HALVINGS):
            if high - low < HALVED:
                break
            middle = 0.5 * (low + high)
            if regime_at(b, t, middle, 0.0, 0.0) == b[at.REGIME]:
                low = middle
            else:
                high = middle
        there = regime_at(b, t, high, 0.0, 0.0)
        b[at.REGIME_AHEAD] = there if there != b[at.REGIME] else ahead
        b[at.STEP] = high
        ends = at.FLOW_SWITCHED
    if ends != at.NO_EVENT and b[at.STEP] > whole:
        b[at.STEP] = whole
    return ends


def happened_by(b: Block, t: Block, elapsed: float) -> int:
    """What has happened by some time within the step at hand of a valve with gas, but for turns and contacts."""
    b[at.ELAPSED] = elapsed
    invoke(b[at.WATCH], b, t)
    if b[at.MOVING] == 0.0:
        if b[at.GUARD] < 0.0:
            return at.RISE
        if b[at.GUARD + 1] < 0.0:
            return at.FALL
    if b[at.FREEWHEELS] != 0.0 and b[at.GUARD + 2] < 0.0:
        return at.CURRENT_GONE
    count = int(b[at.GUARDS])
    for guard in range(count):
        if b[at.GUARD + 3 + guard] < 0.0:
            return at.FLAGGED + guard
    return at.NO_EVENT


def polish_gas_step(b: Block, t: Block, ends: int) -> None:
    """Retake a step of a valve with gas so that it ends exactly at what ends it."""
    longest = POLISHED_WITHIN * b[at.STEP]
    h = b[at.STEP]
    for _ in range(MOST_POLISHING):
        take_gas_step(b, t, h)
        off = 0.0
        slope = 0.0
        if ends == at.CONTACT:
            off = b[at.END_X] - b[at.AHEAD]
            slope = b[at.END_V]
        elif ends in (at.TURN, at.RISE, at.FALL, at.CURRENT_GONE):
            look_at_end(b, t)
            if ends == at.TURN:
                off = b[at.END_V]
                slope = b[at.ACCELERATION]
            elif ends == at.CURRENT_GONE:
                off = b[at.CURRENT]
                slope = b[at.CURRENT_RATE]
            else:
                off = b[at.UP] if ends == at.RISE else b[at.DOWN]
                slope = b[at.UP_RATE] if ends == at.RISE else b[at.DOWN_RATE]
        if slope == 0.0:
            return
        better = h - off / slope
        if not (0.0 < better <= longest) or abs(better - h) <= POLISHED:
            return
        h = better


def look_at_end(b: Block, t: Block) -> None:
    """Look at the end of the step at hand as if it were the state."""
    states = 2 + int(b[at.STATES])
    kept = b[at.SCRATCH :]
    time = b[at.TIME]
    h = b[at.STEP]
    b[at.ELAPSED] = h
    if b[at.DENSITY] > 0.0:
        density = b[at.END + int(b[at.DENSITY]) - at.X]
        invoke(b[at.AT], b, t)
        b[at.END + int(b[at.DENSITY]) - at.X] = density
    else:
        invoke(b[at.AT], b, t)
    for i in range(states):
        kept[i] = b[at.X + i]
        b[at.X + i] = b[at.END + i]
    b[at.TIME] = time + h
    invoke(b[at.LOOK], b, t)
    b[at.TIME] = time
    for i in range(states):
        b[at.X + i] = kept[i]


def first_event(b: Block, t: Block) -> int:
    """The first event in a step, to whose time the step is shortened."""
    ends = first_of_motion(b) if b[at.MOVING] > 0.0 else first_of_rest(b)
    if b[at.FREEWHEELS] != 0.0:
        gone = first_fall(b, at.GUARD + 2 * at.TERMS, b[at.STEP], 0.0, at.TERMS, b[at.SCRATCH :])
        if gone < b[at.STEP]:
            b[at.STEP] = gone
            ends = at.CURRENT_GONE
    count = int(b[at.GUARDS])
    for guard in range(count):
        latest = b[at.STEP]
        c = at.GUARD + (3 + guard) * at.TERMS
        is_new = guard == b[at.FLIPPED] and b[at.FLIPPED_AT] == b[at.TIME]
        if b[c] < 0.0 < b[c + 1] and (is_new or -b[c] < RECOVERS * b[c + 1] * latest):
            # It has just changed, and the state is off the root of the series before by rounding.
            b[c] = 0.0
        changes = first_fall(b, c, latest, ROUNDING * extent(b, c, latest, at.TERMS), at.TERMS, b[at.SCRATCH :])
        if changes < latest:
            b[at.STEP] = changes
            ends = at.FLAGGED + guard
    if ends in (at.RISE, at.FALL):
        balance(b, t, ends)
    return ends


def first_of_motion(b: Block) -> int:
    """The first turn or contact of a step: between two turns x is monotone, and meets the contact ahead only."""
    for k in range(at.TERMS):
        b[at.GUARD + k] = b[at.DIRECTION] * (k + 1) * b[at.SERIES_X + k + 1]
    ends = at.NO_EVENT
    x = b[at.END_X]
    turn = first_fall(b, at.GUARD, b[at.STEP], OWN_ERROR * b[at.TOLERANCE], at.TERMS, b[at.SCRATCH :])
    if turn < b[at.STEP]:
        b[at.STEP] = turn
        ends = at.TURN
        x = value_at(b, at.SERIES_X, turn, at.ORDER + 1)
    if (x - b[at.AHEAD]) * b[at.DIRECTION] >= 0.0:
        b[at.STEP] = root(b, at.SERIES_X, b[at.STEP], b[at.AHEAD], b[at.DIRECTION], at.ORDER + 1)
        ends = at.CONTACT
    return ends


def first_of_rest(b: Block) -> int:
    """The direction, if any, in which plungers at rest are first pushed off in a step."""
    ends = at.NO_EVENT
    rise = first_fall(b, at.GUARD, b[at.STEP], ROUNDING, at.TERMS, b[at.SCRATCH :])
    if rise < b[at.STEP]:
        b[at.STEP] = rise
        ends = at.RISE
    fall = first_fall(b, at.GUARD + at.TERMS, b[at.STEP], ROUNDING, at.TERMS, b[at.SCRATCH :])
    if fall < b[at.STEP]:
        b[at.STEP] = fall
        ends = at.FALL
    return ends


def balance(b: Block, t: Block, ends: int) -> None:
    """Find the end of a rest by Newton's method on the balance of forces itself; sets the step and its end."""
    start = b[at.TIME]
    coil = b[at.SCRATCH :]
    states = int(b[at.STATES])
    peak = b[at.PEAK]
    for i in range(states):
        coil[i] = b[at.COIL + i]
    h = b[at.STEP]
    for _ in range(ON_EQUATION):
        b[at.ELAPSED] = h
        invoke(b[at.AT], b, t)
        b[at.TIME] = start + h
        for i in range(states):
            b[at.COIL + i] = b[at.END + 2 + i]
        invoke(b[at.LOOK], b, t)
        b[at.TIME] = start
        for i in range(states):
            b[at.COIL + i] = coil[i]
        excess = b[at.UP] if ends == at.RISE else b[at.DOWN]
        rate = b[at.UP_RATE] if ends == at.RISE else b[at.DOWN_RATE]
        if not (rate > 0.0):
            break
        better = h - excess / rate
        if not (abs(better - h) <= 0.5 * b[at.STEP]) or better < 0.0 or better == h:
            break
        h = better
    b[at.PEAK] = peak
    b[at.STEP] = h
    b[at.ELAPSED] = h
    invoke(b[at.AT], b, t)


def commit(b: Block, t: Block, time: float) -> None:
    """Make the end of the step, which is in the block, the state."""
    if b[at.SENSOR_LAG] > 0.0:
        h = time - b[at.TIME]
        pilot = lagged(b, h, b[at.SHOWN_PILOT], 0.0)
        if h > 0.0:
            for k in range(int(b[at.WIDTH])):
                lag_tangents(b, t, h, k)
        b[at.SHOWN_MAIN] = shown_main(b, h)
        b[at.SHOWN_PILOT] = pilot
    b[at.TIME] = time
    states = 2 + int(b[at.STATES])
    for i in range(states):
        b[at.X + i] = b[at.END + i]
    width = int(b[at.WIDTH])
    for i in range(states * width):
        t[at.X * width + i] = t[at.END * width + i]
    if b[at.HAS_PEAK] > 0.0:
        b[at.PEAK] = b[at.END_PEAK]
        for k in range(width):
            t[at.PEAK * width + k] = t[at.END_PEAK * width + k]
    b[at.PENDING] = 0.0


FUNCTIONS: Final = (
    step, try_step, is_off, shorten, bring_near, step_with_gas, first_with_gas, happened_by, polish_gas_step,
    look_at_end, first_event, first_of_motion, first_of_rest, balance, commit,
)  # fmt: skip
"""What is compiled."""
