"""The integrator: steps from event to event, from whose polynomials all samples are read.

A step ends where error control or an event ends it, never at the time of a sample: samples within it are read from its
polynomial. Only a command cuts a step. So the state does not depend on when it was sampled, and a valve that is stepped
live equals one whole run, to the last bit.

Begin to read at `run`. These functions are compiled by `lowering`; the kernels that they invoke are made by `kernels`.
`b` is the block of a valve, one array with all its parameters and states; `layout` names its slots. `t` has the
tangents of the block, (slots, directions); the block says how many directions.

Derivatives go through an event by its saltation: the states are moved to where the event is, by the rates before it
times the derivative δ of its time, changed there as the event changes them, and moved back by the rates after it.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.core import gas_steps, polynomials
from valve_sim.model.core.gas_steps import (
    FIRST_STEP,
    MARGIN,
    MARGIN_OF_PRESSURE,
    controlled_gas_step,
    finish_gas_step,
    know_rate,
    regime_at,
    regime_of,
    rest_at,
    take_gas_step,
)
from valve_sim.model.core.layout import (
    ACCELERATION,
    AHEAD,
    AT,
    BEYOND,
    BLOCKED,
    CHANGED,
    CHATTER,
    CLOSED_NOW,
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
    CURVE_C,
    CURVE_HIGH,
    CURVE_INDEX,
    CURVE_INTERVALS,
    CURVE_LOW,
    CURVE_PLACE,
    DECIDE,
    DECLARED_DEMAND,
    DECLARED_TANK,
    DEFECT,
    DELAY,
    DELTA,
    DEMAND,
    DENSITY,
    DIRECTION,
    DOWN,
    DOWN_RATE,
    EDDY,
    ELAPSED,
    END,
    END_PEAK,
    END_V,
    END_X,
    ENDS,
    FALL,
    FIRST_DENSITY,
    FLAG,
    FLAGGED,
    FLOW_SWITCHED,
    FREEWHEELS,
    GAIN,
    GAP,
    GAS_KNOWN,
    GAS_STEP,
    GUARD,
    GUARDS,
    HAS_PEAK,
    HIGH_GUARD,
    IS_CHECKED,
    IS_FLUX,
    IS_PERIODIC,
    LAG,
    LATE,
    LIFTED,
    LIFTED_DOWN,
    LIFTED_UP,
    LONGEST,
    LOOK,
    LOW_GUARD,
    MASS_FLOW,
    MAY_FALL,
    MAY_RISE,
    MODE,
    MOVE,
    MOVING,
    NET,
    NO_EVENT,
    NUMBER_COUNT,
    NUMBERS,
    ON_SEAT,
    ONE_PLUNGER,
    ORDER,
    OUTCOME,
    OUTLET,
    OUTLET_RATE,
    PATH,
    PEAK,
    PENDING,
    PLACE,
    PREPARE,
    PULL,
    RATED,
    RATIO,
    REGIME,
    REGIME_AHEAD,
    RELEASE,
    REST,
    RESTITUTION_SEAT,
    RESTITUTION_STOP,
    RISE,
    ROW,
    ROW_V,
    ROW_X,
    ROWS,
    ROWS_AT,
    ROWS_LANES,
    SAMPLED,
    SAMPLED_ROWS,
    SCRATCH,
    SEEN,
    SENSOR_LAG,
    SERIES_X,
    SHOWN_MAIN,
    SHOWN_PILOT,
    SIZE,
    SPOT,
    STATES,
    STEP,
    STROKE,
    SUSPECT,
    TANK,
    TANK_RATE,
    TANK_TIME,
    TERMINAL,
    TERMS,
    TIME,
    TOLERANCE,
    TURN,
    UNSEATED_TIME,
    UP,
    UP_RATE,
    VOLTS,
    WARM,
    WATCH,
    WIDTH,
    V,
    X,
)  # fmt: skip
from valve_sim.model.core.polynomials import Block, extent, first_fall, invoke, root, value_at
from valve_sim.model.core_types import EventKind, Outcome, Phase

CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = (int(phase) for phase in Phase)
UNSEATED, PICKED_UP, HELD_AT_GAP, LIFTED_OFF, DROPPED, REACHED_STOP, BOUNCED_AT_STOP = (
    int(k) for k in list(EventKind)[:7]
)
RELEASED, MAIN_SEATED, SEATED, BOUNCED_AT_SEAT, STUCK, BROKE_AWAY, GONE = (int(k) for k in list(EventKind)[7:14])
FLOW_CHOKED, FLOW_SUBSONIC, FLOW_REVERSED = (int(k) for k in list(EventKind)[14:])
FINISHED, STEP_TOO_SMALL, TOO_MANY_STEPS, CHATTERING = (int(outcome) for outcome in list(Outcome)[:4])
DRIVEN, FREEWHEELING, CUT_OFF = 0, 1, 2
"""What closes the coil's circuit: its driver, the freewheeling path, or nothing."""

SLOW_AT_GAP: Final = 1e-3
"""m/s: a slower contact at the gap may be held there."""
SLOWEST_REBOUND: Final = 5e-3
"""m/s: a slower contact does not rebound."""
SHORTEST_LAG: Final = 2e-8
"""s: the current of a coil that is faster is gone at once when it freewheels."""
SHORTEST_STEP: Final = 1e-16
"""s: if error control asks for less, it has failed."""
SHORTEST_PROGRESS: Final = 1e-12
LONGEST_CHATTER: Final = 1000
"""Steps in a row that are shorter, s, after which a run ends with an error."""
ANY_STEP: Final = 1e9
"""s: no limit of a step."""
RETAKEN: Final = 0.6
"""Of the step whose series was too far off its equation: what is tried next."""
OWN_ERROR: Final = 1e-3
"""m/s times the tolerance: a velocity that small has no sign; a crawl would turn for ever."""
ROUNDING: Final = 1e-13
"""N, or of the size of a polynomial: below it a guard has no sign."""
RIGID: Final = 1e-11
"""m/N: a stop that gives way less is rigid: 0.2 nm at 20 N, below the 1 nm to which contacts are located. A softer one
swings in less than 10 µs, and its steps would be as short."""
JUMPED: Final = 1e-9
"""N: so much more than what holds them pushes plungers at rest only after a jump of the force."""
RECOVERS: Final = 1e-3
"""Of a step: a comparison that holds again so soon has just begun to hold."""
ON_EQUATION: Final = 4
"""Newton steps on the balance of forces with which the end of a rest is found."""
ROW_COLUMNS: Final = 9
GAS_COLUMNS: Final = ROW_COLUMNS + 2
"""Of a whole row of output: pilot and main plunger as shown, m; velocity, m/s; attraction, N; phase; the pilot itself,
m; V at the terminals; the current u, and in A; with gas the outlet's pressure, Pa, and the mass flow, kg/s."""
UPWARDS: Final = 6.0
"""Time constants of the low-pass above which its moments are found upwards; so neither way loses two digits."""
MOST_STEPS: Final = 1_000_000
"""Steps that a run may take, and as many again for each second of it."""
LONGEST_RUN: Final = 1e9
"""s, of which the steps are counted."""
NO_TRAVEL: Final = -1
"""In place of an Outcome: the gap is not inside the stroke."""
LIVE_EVENTS: Final = 256
"""Events of a live valve that are kept from one look to the next."""
LIVE_STEPS: Final = 4_000_000
"""Steps of a live valve between two looks, after which it ends with an error."""
SPACING: Final = 1.2e-16
"""Half of the relative distance between doubles, and a little more: rounding takes less than that to the next one."""
FAR: Final = 1e30
"""Intervals from the ends of a curve beyond which nothing changes."""
NO_CURRENT: Final = 1e-12
"""Of the reference current: less is none, where there is no voltage."""
NEGLIGIBLE: Final = 1e-17
"""Of a sum: a term that ends its series."""
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
CHANGES: Final = 5
"""Numbers of a command: see `drive`."""


def enter(b: Block, t: Block) -> None:
    """Derive from the mode, and from whether and which way the plungers move, what the equations ask for."""
    mode = b[MODE]
    one = b[ONE_PLUNGER]
    up = b[DIRECTION] > 0.0
    b[BEYOND] = 1.0 if mode == OPEN and b[COMPLIANCE] > RIGID else 0.0
    b[LIFTED] = 1.0 if mode >= MAIN else 0.0
    b[LIFTED_UP] = 1.0 if mode >= GAP_HOLD or one > 0.0 else 0.0
    b[LIFTED_DOWN] = 1.0 if mode >= MAIN else 0.0
    b[CLOSED_NOW] = 1.0 if mode == CLOSED else 0.0
    b[ON_SEAT] = one * b[CLOSED_NOW]
    b[MAY_RISE] = 1.0 if mode != OPEN or b[BEYOND] > 0.0 else 0.0
    b[MAY_FALL] = 1.0 - b[CLOSED_NOW]
    if mode == OPEN and up:
        b[AHEAD] = 1e300
    elif mode < MAIN and not up:
        b[AHEAD] = 0.0
    else:
        b[AHEAD] = b[contact_ahead(b)]
    if b[CURVE] > 0.0:
        invoke(b[PLACE], b, t)
        place_curve(b, t, whole_below(b[CURVE_PLACE]))
    if b[GUARDS] > 0.0:
        invoke(b[DECIDE], b, t)
    if b[CURVE] > 0.0:
        b[FLAG + int(b[LOW_GUARD])] = 1.0
        b[FLAG + int(b[HIGH_GUARD])] = 1.0
    b[PENDING] = 0.0


def whole_below(a: float) -> float:
    """The largest whole number that is not above a number."""
    return float(math.floor(a))


def place_curve(b: Block, t: Block, index: float) -> None:
    """Put the cubic of an interval of the curve of splines into the equations; beyond its ends a constant."""
    last = b[CURVE_INTERVALS] - 1.0
    b[CURVE_INDEX] = index
    b[CURVE_LOW] = index
    b[CURVE_HIGH] = index + 1.0
    first = index
    at = 0.0
    varies = 1.0
    if b[IS_PERIODIC] > 0.0:
        first = index - (last + 1.0) * whole_below(index / (last + 1.0))
    elif not (index >= 0.0):
        b[CURVE_LOW] = -FAR
        b[CURVE_HIGH] = 0.0
        first = 0.0
        varies = 0.0
    elif index > last:
        b[CURVE_LOW] = last + 1.0
        b[CURVE_HIGH] = FAR
        first = last
        at = 1.0
        varies = 0.0
    if not (0.0 <= first <= last):
        first = 0.0  # of a place that is no number, with which the step fails
    width = int(b[WIDTH])
    set_cubic(b, 1, b, first, at, varies)
    for k in range(width):
        set_cubic(t[k:], width, b, first, at, varies)


def set_cubic(own: Block, stride: int, b: Block, first: float, at: float, varies: float) -> None:
    """The coefficients of the cubic of four B-splines, of values or of their tangents in one direction.

    Args:
        own: the values, or the tangents. stride: from one slot to the next. first: number of the first B-spline.
        at, varies: 0 and 1; beyond an end the place where the curve stays, and 0.
    """
    slot = int(b[CURVE]) + int(first)
    beyond = int(b[CURVE]) + int(b[CURVE_INTERVALS])
    back = int(b[CURVE_INTERVALS]) if b[IS_PERIODIC] > 0.0 else 0
    c0 = own[slot * stride]
    slot += 1
    c1 = own[(slot if slot < beyond else slot - back) * stride]
    slot += 1
    c2 = own[(slot if slot < beyond else slot - back) * stride]
    slot += 1
    c3 = own[(slot if slot < beyond else slot - back) * stride]
    d1 = 0.5 * (c2 - c0)
    d2 = 0.5 * (c0 - 2.0 * c1 + c2)
    d3 = (c3 - 3.0 * c2 + 3.0 * c1 - c0) / 6.0
    own[CURVE_C * stride] = (c0 + 4.0 * c1 + c2) / 6.0 + at * (d1 + d2 + d3)
    own[(CURVE_C + 1) * stride] = varies * d1
    own[(CURVE_C + 2) * stride] = varies * d2
    own[(CURVE_C + 3) * stride] = varies * d3


def contact_ahead(b: Block) -> int:
    """The slot of the position of the contact that the plungers move towards; that of the time for the seat."""
    if b[MODE] == OPEN:
        return STROKE
    if b[MODE] == MAIN:
        return STROKE if b[DIRECTION] > 0.0 else GAP
    return GAP if b[DIRECTION] > 0.0 else TIME


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


def settle_coil(b: Block, t: Block) -> None:
    """Set negligible currents of a coil without voltage to 0: while they fade, an hour takes a million steps."""
    states = int(b[STATES])
    warm = int(b[WARM])
    gas = int(b[DENSITY])
    for i in range(states):
        if i != warm and COIL + i != gas and abs(b[COIL + i]) > NO_CURRENT:
            return
    for i in range(states):
        if i != warm and COIL + i != gas:
            b[COIL + i] = 0.0
            set_tangents(b, t, COIL + i, COIL + i, 0.0)


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


def divided(a: float, c: float) -> float:
    """A quotient, or 0 where it has no value: an event that comes and goes at no rate has no derivative."""
    return a / c if c != 0.0 else 0.0


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


def set_tangents(b: Block, t: Block, slot: int, source: int, factor: float) -> None:
    """Make the tangents in a slot those of another one, times a factor."""
    width = int(b[WIDTH])
    for k in range(width):
        t[slot * width + k] = factor * t[source * width + k]


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


def push_now(b: Block, t: Block) -> float:
    """Which way the forces move plungers at rest: +1, −1, or 0 for not at all."""
    invoke(b[LOOK], b, t)
    if b[UP] > 0.0:
        return 1.0
    return -1.0 if b[DOWN] > 0.0 else 0.0


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


def lag_moments(b: float, into: Block) -> None:
    """Moments M_k = ∫ e^{−b(1−φ)} φᵏ b dφ over φ from 0 to 1, of a low-pass after b time constants; k to ORDER.

    They obey M_k = 1 − (k/b) M_{k−1}: used upwards where b is large, and downwards from a series of positive terms
    where it is small, so that rounding errors shrink.
    """
    if b > UPWARDS:
        into[0] = -math.expm1(-b)
        for k in range(1, ORDER + 1):
            into[k] = 1.0 - k / b * into[k - 1]
        return
    term = b * math.exp(-b)
    total = 0.0
    j = 0
    while j < b or term > NEGLIGIBLE * total:
        total += term / (ORDER + 1 + j)
        j += 1
        term *= b / j
    into[ORDER] = total
    for k in range(ORDER, 0, -1):
        into[k - 1] = (1.0 - into[k]) * b / k


def lagged(b: Block, h: float, shown: float, offset: float) -> float:
    """What the low-pass of a sensor shows of x − offset at h since the start of the step, m; exact for its polynomial.

    Args:
        shown: m, at the start of the step.
    """
    moments = b[SCRATCH + TERMS :]
    rate = h / b[SENSOR_LAG]
    lag_moments(rate, moments)
    power = 1.0
    total: float = (b[SERIES_X] - offset) * moments[0]
    for k in range(1, ORDER + 1):
        power *= h
        total += b[SERIES_X + k] * power * moments[k]
    return shown * math.exp(-rate) + total


def lag_tangents(b: Block, t: Block, h: float, k: int) -> None:
    """Advance the tangents, in direction k, of what the sensors show to h since the start of the step.

    The moments must be those of h, as `lagged` leaves them, and h above 0. By M_k' = 1 − M_k (1 + k/b), the derivative
    of a moment by the time constants b that have passed.
    """
    width = int(b[WIDTH])
    moments = b[SCRATCH + TERMS :]
    rate = h / b[SENSOR_LAG]
    left = math.exp(-rate)
    moved = 0.0
    slope = 0.0
    power = 1.0
    for j in range(ORDER + 1):
        moved += t[(SERIES_X + j) * width + k] * power * moments[j]
        slope += b[SERIES_X + j] * power * (1.0 - moments[j] * (1.0 + j / rate))
        power *= h
    longer = -rate / b[SENSOR_LAG] * t[SENSOR_LAG * width + k]
    pilot = SHOWN_PILOT * width + k
    t[pilot] = left * t[pilot] + moved + longer * (slope - left * b[SHOWN_PILOT])
    main = SHOWN_MAIN * width + k
    if b[LIFTED] > 0.0:
        moved -= t[GAP * width + k] * moments[0]
        slope -= b[GAP] * (1.0 - moments[0])
    else:
        moved = 0.0
        slope = 0.0
    t[main] = left * t[main] + moved + longer * (slope - left * b[SHOWN_MAIN])


def shown_pilot(b: Block, h: float) -> float:
    """What the sensor of the pilot plunger shows at h since the start of the step, m, without gain."""
    if b[SENSOR_LAG] > 0.0:
        return lagged(b, h, b[SHOWN_PILOT], 0.0)
    return value_at(b, SERIES_X, h, ORDER + 1)


def shown_main(b: Block, h: float) -> float:
    """The position of the main plunger as its sensor shows it, at h after the beginning of the step, m."""
    if b[LIFTED] == 0.0:
        return b[SHOWN_MAIN] * math.exp(-h / b[SENSOR_LAG]) if b[SENSOR_LAG] > 0.0 else 0.0
    if b[SENSOR_LAG] > 0.0:
        return lagged(b, h, b[SHOWN_MAIN], b[GAP])
    return float(value_at(b, SERIES_X, h, ORDER + 1) - b[GAP])


def before(time: float) -> float:
    """The last double before a time, s, or one close to it."""
    return time - SPACING * abs(time) - 1e-300


def fill(
    b: Block, t: Block, last: float, times: Block, count: int, rows: Block, columns: int, slopes: Block,
    current_times: Block, current_count: int, currents: Block, current_slopes: Block,
) -> None:  # fmt: skip
    """Write the samples of the step up to `last`, s: positions late by the sensor's delay, all else not."""
    start = b[TIME]
    delay = b[DELAY]
    first = int(b[SAMPLED])
    end = first
    while end < count and times[end] - b[DELAY] <= last:
        end += 1
    if end > first:
        if columns == 1 and b[SENSOR_LAG] == 0.0:
            fill_positions(b, times, first, end, rows)
        else:
            for i in range(first, end):
                h = max(0.0, times[i] - delay - start)
                row = rows[i * columns :]
                row[0] = b[GAIN] * shown_pilot(b, h)
                if columns > 1:
                    row[1] = b[GAIN] * shown_main(b, h)
        if b[WIDTH] > 0.0:
            fill_slopes(b, t, times, first, end, slopes)
        b[SAMPLED] = end
    if columns > 1 or current_count > 0:
        fill_others(b, t, last, times, count, rows, columns, current_times, current_count, currents, current_slopes)


def fill_others(
    b: Block, t: Block, last: float, times: Block, count: int, rows: Block, columns: int, current_times: Block,
    current_count: int, currents: Block, current_slopes: Block,
) -> None:  # fmt: skip
    """Write all but positions of the samples up to `last`: whole rows, or the current."""
    first = int(b[SAMPLED_ROWS])
    end = first
    if columns > 1:
        while end < count and times[end] <= last:
            end += 1
        fill_whole_rows(b, t, times, first, end, rows, columns)
    else:
        while end < current_count and current_times[end] <= last:
            end += 1
        if b[WIDTH] > 0.0:
            fill_sloped_currents(b, t, current_times, first, end, currents, current_slopes)
        else:
            fill_currents(b, t, current_times, first, end, currents)
    b[SAMPLED_ROWS] = end


def fill_slopes(b: Block, t: Block, times: Block, first: int, end: int, slopes: Block) -> None:
    """Write the tangents of the positions of some samples, as the sensor shows them."""
    width = int(b[WIDTH])
    start = b[TIME]
    delay = b[DELAY]
    lag = b[SENSOR_LAG]
    for i in range(first, end):
        out = slopes[i * width :]
        h = max(0.0, times[i] - delay - start)
        b[ELAPSED] = h
        shown = b[X]
        speed = 0.0
        of_shown = X * width
        if lag > 0.0 or b[MOVING] > 0.0:
            invoke(b[SPOT], b, t)
            shown = b[ROW_X]
            speed = b[ROW_V]
            of_shown = ROW_X * width
        if lag > 0.0:
            x = shown
            shown = shown_pilot(b, h)
            speed = (x - shown) / lag
            for k in range(width):
                before = t[SHOWN_PILOT * width + k]
                main = t[SHOWN_MAIN * width + k]
                if h > 0.0:
                    lag_tangents(b, t, h, k)
                t[ROW_X * width + k] = t[SHOWN_PILOT * width + k]
                t[SHOWN_PILOT * width + k] = before
                t[SHOWN_MAIN * width + k] = main
        for k in range(width):
            later = t[LATE * width + k] - t[DELAY * width + k]
            out[k] = b[GAIN] * (t[of_shown + k] + speed * later) + t[GAIN * width + k] * shown


def fill_positions(b: Block, times: Block, first: int, end: int, rows: Block) -> None:
    """Write positions alone, of a sensor that filters nothing: most of what a fit asks for."""
    start = b[TIME]
    delay = b[DELAY]
    gain = b[GAIN]
    if b[MOVING] == 0.0:
        shown = gain * b[X]
        for i in range(first, end):
            rows[i] = shown
        return
    c = b[SERIES_X:]
    c0 = c[0]
    c1 = c[1]
    c2 = c[2]
    c3 = c[3]
    c4 = c[4]
    c5 = c[5]
    c6 = c[6]
    c7 = c[7]
    c8 = c[8]
    c9 = c[9]
    c10 = c[10]
    c11 = c[11]
    c12 = c[12]
    c13 = c[13]
    c14 = c[14]
    for i in range(first, end):
        h = max(0.0, times[i] - delay - start)
        high = c7 + h * (c8 + h * (c9 + h * (c10 + h * (c11 + h * (c12 + h * (c13 + h * c14))))))
        rows[i] = gain * (c0 + h * (c1 + h * (c2 + h * (c3 + h * (c4 + h * (c5 + h * (c6 + h * high)))))))


def fill_sloped_currents(
    b: Block, t: Block, times: Block, first: int, end: int, currents: Block, slopes: Block
) -> None:
    """Write the currents u of some samples, and their tangents."""
    width = int(b[WIDTH])
    for i in range(first, end):
        b[ELAPSED] = max(0.0, times[i] - b[TIME])
        invoke(b[ROW], b, t)
        if b[DENSITY] > 0.0:
            currents[2 * i] = b[CURRENT]
            currents[2 * i + 1] = b[OUTLET]
            out = slopes[2 * i * width :]
            for k in range(width):
                out[width + k] = t[OUTLET * width + k] + b[OUTLET_RATE] * t[LATE * width + k]
        else:
            currents[i] = b[CURRENT]
            out = slopes[i * width :]
        for k in range(width):
            out[k] = t[CURRENT * width + k] + b[CURRENT_RATE] * t[LATE * width + k]


def fill_currents(b: Block, t: Block, times: Block, first: int, end: int, currents: Block) -> None:
    """Write the currents u of some samples, ROWS_LANES of them at once; what is left over of these is the last one."""
    for i in range(first, end, ROWS_LANES):
        for lane in range(ROWS_LANES):
            b[ROWS + lane] = max(0.0, times[min(i + lane, end - 1)] - b[TIME])
        invoke(b[ROWS_AT], b, t)
        for lane in range(min(ROWS_LANES, end - i)):
            if b[DENSITY] > 0.0:
                currents[2 * (i + lane)] = b[ROWS + 5 * ROWS_LANES + lane]
                currents[2 * (i + lane) + 1] = b[ROWS + 6 * ROWS_LANES + lane]
            else:
                currents[i + lane] = b[ROWS + 5 * ROWS_LANES + lane]


def fill_whole_rows(b: Block, t: Block, times: Block, first: int, end: int, rows: Block, columns: int) -> None:
    """Write whole rows of some samples, ROWS_LANES of them at once; what is left over of these is the last one."""
    for i in range(first, end, ROWS_LANES):
        for lane in range(ROWS_LANES):
            b[ROWS + lane] = max(0.0, times[min(i + lane, end - 1)] - b[TIME])
        invoke(b[ROWS_AT], b, t)
        for lane in range(min(ROWS_LANES, end - i)):
            shown = b[ROWS + lane :]
            row = rows[(i + lane) * columns :]
            row[5] = shown[ROWS_LANES]
            row[2] = shown[2 * ROWS_LANES]
            row[3] = shown[3 * ROWS_LANES]
            row[4] = b[MODE]
            row[6] = shown[4 * ROWS_LANES]
            row[7] = shown[5 * ROWS_LANES]
            row[8] = shown[5 * ROWS_LANES] * b[RATED]
            if b[DENSITY] > 0.0:
                row[9] = shown[6 * ROWS_LANES]
                row[10] = shown[7 * ROWS_LANES]


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


def start_gas(b: Block, t: Block) -> None:
    """Put the declared gas into the outlet of a valve at rest, and the declared pressures at both ends."""
    b[TANK] = b[DECLARED_TANK]
    b[TANK_RATE] = 0.0
    b[TANK_TIME] = b[TIME]
    b[DEMAND] = b[DECLARED_DEMAND]
    b[int(b[DENSITY])] = b[FIRST_DENSITY]
    set_tangents(b, t, TANK, DECLARED_TANK, 1.0)
    set_tangents(b, t, DEMAND, DECLARED_DEMAND, 1.0)
    set_tangents(b, t, int(b[DENSITY]), FIRST_DENSITY, 1.0)


def settle_flow(b: Block, t: Block) -> None:
    """Decide afresh what the flow of gas does at the state, of a valve whose pressures are set."""
    rest_at(b, t)
    b[REGIME] = 0.0
    b[REGIME] = regime_at(b, t, 0.0, 0.0, 0.0)


def supply(b: Block, t: Block, change: Block) -> None:
    """Pressures change now: of the tank, Pa, and its rate, Pa/s, and behind the demand, Pa; NaN where one does not."""
    b[GAS_KNOWN] = 0.0
    if change[0] == change[0]:
        b[TANK] = change[0]
        b[TANK_RATE] = change[1]
        b[TANK_TIME] = b[TIME]
        set_tangents(b, t, TANK, TANK, 0.0)
        set_tangents(b, t, TANK_TIME, DELTA, 1.0)
    if change[2] == change[2]:
        b[DEMAND] = change[2]
        set_tangents(b, t, DEMAND, DEMAND, 0.0)
    b[PENDING] = 0.0


def run(
    b: Block, t: Block, end: float, cuts: bool, most: int, times: Block, count: int, rows: Block,
    columns: int, slopes: Block, current_times: Block, current_count: int, currents: Block, current_slopes: Block,
    events: Block, room: int,
) -> int:  # fmt: skip
    """Step a valve from its state to a time under one voltage; returns an Outcome.

    Args:
        b, t: see the module.
        end: s. cuts: whether to stop exactly there, before a command, or at the last whole step.
        most: steps, after which the run ends with an error.
        times: s, ascending, of `count` samples. rows: what they show, `columns` numbers each: 1, the pilot plunger as
            shown, or ROW_COLUMNS, or GAS_COLUMNS of a valve with gas.
        current_times: s, ascending, of `current_count` samples of the current u, and with gas of the outlet's pressure,
            Pa, in turn, unless whole rows are asked for.
        slopes, current_slopes: with derivatives, those of the pilot plunger and of u: (samples, directions); with gas
            (samples, 2, directions) of u and the pressure.
        events: four numbers each, time, kind, position and the velocity before, for `room` of them.
    """
    others = count if columns > 1 else current_count
    for _ in range(most):
        if b[PENDING] == 0.0:
            if b[TIME] >= end and b[SAMPLED] >= count and b[SAMPLED_ROWS] >= others:
                return FINISHED
            ends = step(b, t)
            if ends < 0:
                return STEP_TOO_SMALL
            b[ENDS] = ends
            b[PENDING] = 1.0
        following = b[TIME] + b[STEP]
        if count + others > 0:
            # A sample at the very end of a step is of the next one, as it is live: that has what happens there.
            last = end if following > end else before(following)
            fill(
                b, t, last, times, count, rows, columns, slopes, current_times, current_count, currents, current_slopes
            )
        if following > end:
            if cuts:
                if end > b[TIME]:
                    cut(b, t, end)
                b[PENDING] = 0.0
            return FINISHED
        b[CHATTER] = b[CHATTER] + 1.0 if b[STEP] < SHORTEST_PROGRESS else 0.0
        if b[CHATTER] > LONGEST_CHATTER:
            return CHATTERING
        ends = int(b[ENDS])
        commit(b, t, following)
        if ends != NO_EVENT:
            end_step(b, t, ends, events, room)
        elif b[DENSITY] > 0.0:
            know_rate(b, t)
    return TOO_MANY_STEPS


def cut(b: Block, t: Block, end: float) -> None:
    """End the step that is under way at a time, s, before a command; with gas it is made anew, to be as exact."""
    if b[DENSITY] > 0.0:
        take_gas_step(b, t, end - b[TIME])
        finish_gas_step(b, t)
        b[GAS_KNOWN] = 0.0
    else:
        b[ELAPSED] = end - b[TIME]
        invoke(b[AT], b, t)
    commit(b, t, end)


def drive(
    b: Block, t: Block, commands: Block, command_count: int, end: float, most: int, times: Block,
    count: int, rows: Block, columns: int, slopes: Block, current_times: Block, current_count: int, currents: Block,
    current_slopes: Block, moves: Block, events: Block, room: int,
) -> int:  # fmt: skip
    """Step a valve through a whole drive; arguments as for `run`.

    Args:
        commands: CHANGES numbers each: s, V, and of a valve with gas Pa of the tank, Pa/s, and Pa behind the demand,
            see `supply`; NaN where something does not change. What is before the state's time was so from the start.
        moves: with derivatives, those of time and voltage: (commands, 2, directions).
    """
    width = int(b[WIDTH])
    for command in range(command_count):
        change = commands[CHANGES * command :]
        when = change[0]
        is_new = when >= b[TIME]
        if when > end:
            break
        outcome = run(
            b, t, when, True, most, times, count, rows, columns, slopes, current_times, current_count, currents,
            current_slopes, events, room,
        )  # fmt: skip
        if outcome != FINISHED:
            return outcome
        own = moves[2 * command * width :]
        for k in range(width):
            t[DELTA * width + k] = own[k]
        if is_new:
            leave(b, t, NO_EVENT)
        if change[1] == change[1]:
            for k in range(width):
                t[VOLTS * width + k] = own[width + k]
            set_voltage(b, t, change[1])
        if b[DENSITY] > 0.0:
            supply(b, t, change[2:])
        if is_new:
            arrive(b, t)
    return run(
        b, t, end, False, most, times, count, rows, columns, slopes, current_times, current_count, currents,
        current_slopes, events, room,
    )  # fmt: skip


def renumber(b: Block, t: Block, numbers: Block, slopes: Block) -> None:
    """Go on with other numbers of the same valve, from the state's time, that of the last command, on.

    Args:
        numbers: of the valve. slopes: with derivatives, the tangents of these: (numbers, directions).
    """
    leave(b, t, NO_EVENT)
    width = int(b[WIDTH])
    count = int(b[NUMBER_COUNT])
    for i in range(count):
        b[NUMBERS + i] = numbers[i]
    for i in range(count * width):
        t[NUMBERS * width + i] = slopes[i]
    invoke(b[PREPARE], b, t)
    enter(b, t)
    arrive(b, t)


def start(b: Block, t: Block, blank: Block, numbers: Block, count: int, time: float) -> None:
    """Make the block of a valve that rests closed and without current at a time, s.

    Args:
        blank: the block of no valve in particular, with the addresses of its kernels. numbers: `count` of the valve.
    """
    for i in range(SERIES_X):
        b[i] = blank[i]
    for i in range(count):
        b[NUMBERS + i] = numbers[i]
    b[TIME] = time
    b[UNSEATED_TIME] = time
    invoke(b[PREPARE], b, t)
    b[ONE_PLUNGER] = 1.0 if b[GAP] == 0.0 else 0.0
    if b[DENSITY] > 0.0:
        b[CHANGED] = time
        start_gas(b, t)
    enter(b, t)
    if b[DENSITY] > 0.0:
        settle_flow(b, t)


def whole(
    blank: Block, blank_count: int, numbers: Block, number_count: int, commands: Block, command_doubles: int,
    times: Block, count: int, memory: Block, memory_count: int, time: float, end: float, tolerance: float,
) -> int:  # fmt: skip
    """Run one valve that rests closed and without current at a time, s, through a drive; returns an Outcome.

    Args:
        blank, numbers: as for `start`. commands, times, end: as for `drive`. tolerance: relative error of one step.
        memory: room for the block, for as many events as are left room for, and for whole rows of output at its end.
    """
    start(memory, memory, blank, numbers, number_count, time)
    memory[TOLERANCE] = tolerance
    columns = GAS_COLUMNS if memory[DENSITY] > 0.0 else ROW_COLUMNS
    rows = memory_count - columns * count
    room = (rows - SIZE) // 4
    if not (0.0 <= memory[GAP] < memory[STROKE]):
        return NO_TRAVEL
    most = int(MOST_STEPS * (1.0 + min(max(0.0, end - time), LONGEST_RUN)))
    return drive(
        memory, memory, commands, command_doubles // CHANGES, end, most, times, count, memory[rows:], columns,
        memory, times, 0, memory, memory, memory, memory[SIZE:], room,
    )  # fmt: skip


def batch(
    b: Block, blank: Block, numbers: Block, number_count: int, valves: int, time: float, commands: Block,
    command_count: int, end: float, most: int, times: Block, count: int, rows: Block,
) -> int:  # fmt: skip
    """The positions of many valves under one drive, each (count,) in a row; returns how many ran to their end.

    Args:
        b: room for the block of one valve. numbers: of each valve in turn. Others: as for `start` and `drive`.
    """
    for valve in range(valves):
        start(b, b, blank, numbers[valve * number_count :], number_count, time)
        outcome = drive(
            b, b, commands, command_count, end, most, times, count, rows[valve * count :], 1, b, times, 0, b, b, b, b, 0
        )
        if outcome != FINISHED:
            b[OUTCOME] = outcome
            return valve
    return valves


def read(b: Block, t: Block, time: float, row: Block) -> None:
    """Fill a row of ROW_COLUMNS at a time within the step that is under way, without the sensor's delay."""
    h = max(0.0, time - b[TIME])
    row[0] = b[GAIN] * shown_pilot(b, h)
    row[1] = b[GAIN] * shown_main(b, h)
    b[ELAPSED] = h
    invoke(b[ROW], b, t)
    row[2] = b[ROW_V]
    row[3] = b[PULL]
    row[4] = b[MODE]
    row[5] = b[ROW_X]
    row[6] = b[TERMINAL]
    row[7] = b[CURRENT]
    row[8] = b[CURRENT] * b[RATED]
    if b[DENSITY] > 0.0:
        row[9] = b[OUTLET]
        row[10] = b[MASS_FLOW]


def advance(b: Block, time: float) -> int:
    """Step a live valve to a time, s, or to where it is if that is later, and read it there; returns an Outcome.

    Args:
        b: its block; behind it a row of output, and room for LIVE_EVENTS events, of which COUNT have been counted.
    """
    row = b[SIZE:]
    events = b[SIZE + GAS_COLUMNS :]
    outcome = run(b, b, time, False, LIVE_STEPS, row, 0, row, 1, row, row, 0, row, row, events, LIVE_EVENTS)
    if outcome == FINISHED and b[PENDING] == 0.0:
        b[ENDS] = step(b, b)
        b[PENDING] = 1.0
        if b[ENDS] < 0.0:
            outcome = STEP_TOO_SMALL
    if outcome == FINISHED:
        read(b, b, time, row)
    return outcome


def halt(b: Block, time: float) -> int:
    """Step a live valve exactly to a time, s; returns an Outcome."""
    row = b[SIZE:]
    events = b[SIZE + GAS_COLUMNS :]
    return run(b, b, time, True, LIVE_STEPS, row, 0, row, 1, row, row, 0, row, row, events, LIVE_EVENTS)


def command(b: Block, time: float, volts: float) -> int:
    """Command a live valve: a voltage in force from a time on, or from where it is; reads it there, see `advance`."""
    when = max(time, b[TIME])
    outcome = halt(b, when)
    if outcome != FINISHED:
        return outcome
    set_voltage(b, b, volts)
    return advance(b, when)


def set_pressures(b: Block, change: Block) -> None:
    """Change the pressures at both ends of a live valve with gas at its state's time, see `supply`."""
    supply(b, b, change)


def settle(b: Block) -> None:
    """Make a state agree with another valve: only a contact or a blocking diode makes it jump."""
    at_contact = b[MOVING] == 0.0 and (b[MODE] == GAP_HOLD or b[MODE] == OPEN)
    contact = b[STROKE] if b[MODE] == OPEN else b[GAP]
    if b[COMPLIANCE] <= RIGID:
        b[X] = min(b[X], b[STROKE])
    if at_contact and b[X] != contact:
        # The contact has gone: at rest between contacts, free to move off.
        b[MODE] = MAIN if b[X] >= b[GAP] else PILOT
    elif (b[MODE] == OPEN and b[X] < b[STROKE]) or (b[MODE] == PILOT and b[X] >= b[GAP]):
        b[MODE] = MAIN
    elif b[MODE] == MAIN and b[X] < b[GAP]:
        b[MODE] = PILOT
    if b[MODE] == MAIN and b[X] >= b[STROKE] and b[V] >= 0.0:
        b[MODE] = OPEN
        if b[COMPLIANCE] <= RIGID:
            b[MOVING] = 0.0
            b[V] = 0.0
    set_voltage(b, b, b[VOLTS])


FUNCTIONS: Final = (
    *polynomials.FUNCTIONS, *gas_steps.FUNCTIONS, enter, whole_below, place_curve, set_cubic, contact_ahead, step,
    settle_coil, step_with_gas, first_with_gas, happened_by, polish_gas_step, look_at_end, first_event, first_of_motion,
    first_of_rest, balance, commit, divided, leave, arrive, move_tangents, set_tangents, rescale_velocity, unseat,
    log_event, come_to_rest, set_off, push_now, move_off, touch, touch_seat, touch_gap, turn_round, block_diode,
    close_circuit, set_voltage, lag_moments, lagged, lag_tangents, before, shown_pilot, shown_main, fill, fill_others,
    fill_slopes, fill_positions, fill_sloped_currents, fill_currents, fill_whole_rows, end_step, switch_flow, start_gas,
    settle_flow, supply, run, cut, drive, renumber, start, whole, batch, read, advance, halt, command, set_pressures,
    settle,
)  # fmt: skip
"""The functions that `lowering` compiles."""
