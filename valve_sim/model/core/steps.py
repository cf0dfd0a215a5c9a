"""One step, from where the valve is to what ends it: its size, the first event in it, and the state at its end.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

from typing import Final

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
from valve_sim.model.core.layout import (
    ACCELERATION,
    AHEAD,
    AT,
    COIL,
    CONTACT,
    CURRENT,
    CURRENT_GONE,
    CURRENT_RATE,
    DEFECT,
    DENSITY,
    DIRECTION,
    DOWN,
    DOWN_RATE,
    ELAPSED,
    END,
    END_PEAK,
    END_V,
    END_X,
    FALL,
    FLAGGED,
    FLOW_SWITCHED,
    FREEWHEELS,
    GUARD,
    GUARDS,
    HAS_PEAK,
    IS_CHECKED,
    LONGEST,
    LOOK,
    MOVE,
    MOVING,
    NO_EVENT,
    ORDER,
    PEAK,
    PENDING,
    REGIME,
    REGIME_AHEAD,
    REST,
    RISE,
    SCRATCH,
    SENSOR_LAG,
    SERIES_X,
    SHOWN_MAIN,
    SHOWN_PILOT,
    STATES,
    STEP,
    SUSPECT,
    TERMS,
    TIME,
    TOLERANCE,
    TURN,
    UP,
    UP_RATE,
    VOLTS,
    WARM,
    WATCH,
    WIDTH,
    X,
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
    if b[DENSITY] > 0.0:
        return step_with_gas(b, t)
    if b[MOVING] == 0.0:
        if b[WARM] >= 0.0 and b[VOLTS] == 0.0 and b[WIDTH] == 0.0:
            settle_coil(b, t)
        invoke(b[REST], b, t)
    else:
        invoke(b[MOVE], b, t)
        if b[IS_CHECKED] > 0.0:
            while b[DEFECT] > 1.0 and b[STEP] > SHORTEST_STEP:
                b[LONGEST] = RETAKEN * b[STEP]
                invoke(b[MOVE], b, t)
            b[LONGEST] = ANY_STEP
    h = b[STEP]
    if not (h >= SHORTEST_STEP) or b[END_X] - b[END_X] != 0.0 or b[END_V] - b[END_V] != 0.0:
        return -1
    if b[SUSPECT] == 0.0:
        return NO_EVENT
    ends = first_event(b, t)
    if ends not in (NO_EVENT, RISE, FALL):
        b[ELAPSED] = b[STEP]
        invoke(b[AT], b, t)
    return ends


def step_with_gas(b: Block, t: Block) -> int:
    """`step` of a valve with gas."""
    if b[MOVING] == 0.0 and b[WARM] >= 0.0 and b[VOLTS] == 0.0 and b[WIDTH] == 0.0:
        settle_coil(b, t)
    if b[MOVING] == 0.0:
        push = push_now(b, t)
        if push != 0.0:
            rest_at(b, t)
            return RISE if push > 0.0 else FALL
    if not controlled_gas_step(b, t) or b[END_X] - b[END_X] != 0.0 or b[END_V] - b[END_V] != 0.0:
        return -1
    ends = first_with_gas(b, t)
    if ends != NO_EVENT:
        polish_gas_step(b, t, ends)
    finish_gas_step(b, t)
    return ends


def first_with_gas(b: Block, t: Block) -> int:
    """What ends a step of a valve with gas first; sets its size to when that happens."""
    whole = b[STEP]
    ends = first_of_motion(b) if b[MOVING] > 0.0 else NO_EVENT
    at_rest = b[MOVING] == 0.0
    looks = LOOKS_AT_REST if at_rest else LOOKS_IN_MOTION
    longest = b[STEP]
    low = 0.0
    for look in range(1, looks + 1):
        high = longest * look / looks
        found = happened_by(b, t, high)
        if found != NO_EVENT:
            for _ in range(MOST_HALVINGS):
                if high - low < HALVED:
                    break
                middle = 0.5 * (low + high)
                sooner = happened_by(b, t, middle)
                if sooner != NO_EVENT:
                    high = middle
                    found = sooner
                else:
                    low = middle
            ends = found
            b[STEP] = high
            break
        low = high
    if regime_at(b, t, b[STEP], MARGIN, MARGIN_OF_PRESSURE) != b[REGIME]:
        ahead = regime_of(b, MARGIN, MARGIN_OF_PRESSURE)
        low = 0.0
        high = b[STEP]
        for _ in range(MOST_HALVINGS):
            if high - low < HALVED:
                break
            middle = 0.5 * (low + high)
            if regime_at(b, t, middle, 0.0, 0.0) == b[REGIME]:
                low = middle
            else:
                high = middle
        there = regime_at(b, t, high, 0.0, 0.0)
        b[REGIME_AHEAD] = there if there != b[REGIME] else ahead
        b[STEP] = high
        ends = FLOW_SWITCHED
    if ends != NO_EVENT and b[STEP] > whole:
        b[STEP] = whole
    return ends


def happened_by(b: Block, t: Block, elapsed: float) -> int:
    """What has happened by some time within the step at hand of a valve with gas, but for turns and contacts."""
    b[ELAPSED] = elapsed
    invoke(b[WATCH], b, t)
    if b[MOVING] == 0.0:
        if b[GUARD] < 0.0:
            return RISE
        if b[GUARD + 1] < 0.0:
            return FALL
    if b[FREEWHEELS] != 0.0 and b[GUARD + 2] < 0.0:
        return CURRENT_GONE
    count = int(b[GUARDS])
    for guard in range(count):
        if b[GUARD + 3 + guard] < 0.0:
            return FLAGGED + guard
    return NO_EVENT


def polish_gas_step(b: Block, t: Block, ends: int) -> None:
    """Retake a step of a valve with gas so that it ends exactly at what ends it."""
    longest = POLISHED_WITHIN * b[STEP]
    h = b[STEP]
    for _ in range(MOST_POLISHING):
        take_gas_step(b, t, h)
        off = 0.0
        slope = 0.0
        if ends == CONTACT:
            off = b[END_X] - b[AHEAD]
            slope = b[END_V]
        elif ends in (TURN, RISE, FALL, CURRENT_GONE):
            look_at_end(b, t)
            if ends == TURN:
                off = b[END_V]
                slope = b[ACCELERATION]
            elif ends == CURRENT_GONE:
                off = b[CURRENT]
                slope = b[CURRENT_RATE]
            else:
                off = b[UP] if ends == RISE else b[DOWN]
                slope = b[UP_RATE] if ends == RISE else b[DOWN_RATE]
        if slope == 0.0:
            return
        better = h - off / slope
        if not (0.0 < better <= longest) or abs(better - h) <= POLISHED:
            return
        h = better


def look_at_end(b: Block, t: Block) -> None:
    """Look at the end of the step at hand as if it were the state."""
    states = 2 + int(b[STATES])
    kept = b[SCRATCH:]
    time = b[TIME]
    h = b[STEP]
    density = b[END + int(b[DENSITY]) - X]
    b[ELAPSED] = h
    invoke(b[AT], b, t)
    b[END + int(b[DENSITY]) - X] = density
    for i in range(states):
        kept[i] = b[X + i]
        b[X + i] = b[END + i]
    b[TIME] = time + h
    invoke(b[LOOK], b, t)
    b[TIME] = time
    for i in range(states):
        b[X + i] = kept[i]


def first_event(b: Block, t: Block) -> int:
    """The first event in a step, to whose time the step is shortened."""
    ends = first_of_motion(b) if b[MOVING] > 0.0 else first_of_rest(b)
    if b[FREEWHEELS] != 0.0:
        gone = first_fall(b, GUARD + 2 * TERMS, b[STEP], 0.0)
        if gone < b[STEP]:
            b[STEP] = gone
            ends = CURRENT_GONE
    count = int(b[GUARDS])
    for guard in range(count):
        latest = b[STEP]
        c = GUARD + (3 + guard) * TERMS
        if b[c] < 0.0 and -b[c] < RECOVERS * b[c + 1] * latest:
            # It has just changed, and the state is off the root of the series before by rounding.
            b[c] = 0.0
        changes = first_fall(b, c, latest, ROUNDING * extent(b, c, latest))
        if changes < latest:
            b[STEP] = changes
            ends = FLAGGED + guard
    if ends in (RISE, FALL):
        balance(b, t, ends)
    return ends


def first_of_motion(b: Block) -> int:
    """The first turn or contact of a step: between two turns x is monotone, and meets the contact ahead only."""
    for k in range(TERMS):
        b[GUARD + k] = b[DIRECTION] * (k + 1) * b[SERIES_X + k + 1]
    ends = NO_EVENT
    x = b[END_X]
    turn = first_fall(b, GUARD, b[STEP], OWN_ERROR * b[TOLERANCE])
    if turn < b[STEP]:
        b[STEP] = turn
        ends = TURN
        x = value_at(b, SERIES_X, turn, ORDER + 1)
    if (x - b[AHEAD]) * b[DIRECTION] >= 0.0:
        b[STEP] = root(b, SERIES_X, b[STEP], b[AHEAD], b[DIRECTION], ORDER + 1)
        ends = CONTACT
    return ends


def first_of_rest(b: Block) -> int:
    """The direction, if any, in which plungers at rest are first pushed off in a step."""
    ends = NO_EVENT
    rise = first_fall(b, GUARD, b[STEP], ROUNDING)
    if rise < b[STEP]:
        b[STEP] = rise
        ends = RISE
    fall = first_fall(b, GUARD + TERMS, b[STEP], ROUNDING)
    if fall < b[STEP]:
        b[STEP] = fall
        ends = FALL
    return ends


def balance(b: Block, t: Block, ends: int) -> None:
    """Find the end of a rest by Newton's method on the balance of forces itself; sets the step and its end."""
    start = b[TIME]
    coil = b[SCRATCH:]
    states = int(b[STATES])
    peak = b[PEAK]
    for i in range(states):
        coil[i] = b[COIL + i]
    h = b[STEP]
    for _ in range(ON_EQUATION):
        b[ELAPSED] = h
        invoke(b[AT], b, t)
        b[TIME] = start + h
        for i in range(states):
            b[COIL + i] = b[END + 2 + i]
        invoke(b[LOOK], b, t)
        b[TIME] = start
        for i in range(states):
            b[COIL + i] = coil[i]
        excess = b[UP] if ends == RISE else b[DOWN]
        rate = b[UP_RATE] if ends == RISE else b[DOWN_RATE]
        if not (rate > 0.0):
            break
        better = h - excess / rate
        if not (abs(better - h) <= 0.5 * b[STEP]) or better < 0.0 or better == h:
            break
        h = better
    b[PEAK] = peak
    b[STEP] = h
    b[ELAPSED] = h
    invoke(b[AT], b, t)


def commit(b: Block, t: Block, time: float) -> None:
    """Make the end of the step, which is in the block, the state."""
    if b[SENSOR_LAG] > 0.0:
        h = time - b[TIME]
        pilot = lagged(b, h, b[SHOWN_PILOT], 0.0)
        if h > 0.0:
            for k in range(int(b[WIDTH])):
                lag_tangents(b, t, h, k)
        b[SHOWN_MAIN] = shown_main(b, h)
        b[SHOWN_PILOT] = pilot
    b[TIME] = time
    states = 2 + int(b[STATES])
    for i in range(states):
        b[X + i] = b[END + i]
    width = int(b[WIDTH])
    for i in range(states * width):
        t[X * width + i] = t[END * width + i]
    if b[HAS_PEAK] > 0.0:
        b[PEAK] = b[END_PEAK]
        for k in range(width):
            t[PEAK * width + k] = t[END_PEAK * width + k]
    b[PENDING] = 0.0


FUNCTIONS: Final = (
    step, step_with_gas, first_with_gas, happened_by, polish_gas_step, look_at_end, first_event, first_of_motion,
    first_of_rest, balance, commit,
)  # fmt: skip
"""What is compiled."""
