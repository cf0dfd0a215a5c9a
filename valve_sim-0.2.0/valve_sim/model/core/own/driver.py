"""The integrator of a machine of a user's own, in the part of Python that `lowering` compiles.

Steps end where error control, a corner of an input or an event ends them. An event is where a comparison changes: it is
located on the step's polynomial, tangents jump there by what the event's time changes (saltation), and where the rates
on both sides point at the switch the state slides along it.
"""

from __future__ import annotations

from typing import Any, Final

from valve_sim.model.core.own import layout as at

Block = Any


def invoke(address: float, b: Block, t: Block) -> None:
    """Call a kernel, whose address stands in a block as bits: the compiled driver has it as an instruction."""
    raise NotImplementedError("kernels exist as machine code only")


LOOKS: Final = 16
"""Places of a step at which a guard is looked at, where its terms do not tell that it keeps its sign."""
HALVINGS: Final = 60
ROUNDS: Final = 12
"""Times that switches are decided anew, as one may depend on another."""
TOO_MANY, NOT_FINITE = 1, 2
"""Outcomes other than 0."""


def polynomial(b: Block, first: int, h: float) -> float:
    """A series at a time after the start of the step."""
    total = 0.0
    for order in range(at.ORDER, -1, -1):
        total = total * h + b[first + order]
    return total


def first_below(b: Block, first: int, offset: float, sign: float, h: float) -> float:
    """When offset + sign · series falls below 0 within a step, s; −1: it does not."""
    start = offset + sign * b[first]
    rest = 0.0
    power = 1.0
    for order in range(1, at.TERMS):
        power = power * h
        rest = rest + abs(b[first + order]) * power
    if start > rest:
        return -1.0
    before = start
    for look in range(1, LOOKS + 1):
        late = h * look / LOOKS
        now = offset + sign * polynomial(b, first, late)
        if now < 0.0 and now < before:
            early = h * (look - 1) / LOOKS
            if before < 0.0:
                return early
            for _ in range(HALVINGS):
                middle = 0.5 * (early + late)
                if offset + sign * polynomial(b, first, middle) < 0.0:
                    late = middle
                else:
                    early = middle
            return late
        before = now
    return -1.0


def slider_of(b: Block, guard: int) -> int:
    """The number of a guard among those along which the machine may slide; −1: it may not."""
    count = int(b[at.SLIDING])
    for k in range(count):
        if int(b[at.SLIDE_GUARD + k]) == guard:
            return k
    return -1


def is_sliding(b: Block) -> bool:
    """Whether the state slides along any switch."""
    count = int(b[at.SLIDING])
    slides = False
    for k in range(count):
        if b[at.SLIDES + k] > 0.5:
            slides = True
    return slides


def snap(b: Block, t: Block) -> None:
    """Put states that are the excess of a switch along which the machine slides exactly to 0."""
    count = int(b[at.SLIDING])
    width = int(b[at.WIDTH])
    for k in range(count):
        place = int(b[at.SNAP + k])
        if b[at.SLIDES + k] > 0.5 and place >= 0:
            b[at.STATE + place] = 0.0
            for i in range(width):
                t[(at.STATE + place) * width + i] = 0.0


def settle(b: Block, t: Block) -> None:
    """Leave switches along which the machine can slide no longer: α of equation (1) is not between 0 and 1."""
    count = int(b[at.SLIDING])
    for _ in range(ROUNDS):
        if not is_sliding(b):
            return
        invoke(b[at.LOOK], b, t)
        worst = 0.0
        which = -1
        for k in range(count):
            if b[at.SLIDES + k] > 0.5:
                alpha = b[at.ALPHA + k]
                beyond = max(-alpha, alpha - 1.0)
                if beyond > worst or not (alpha >= 0.0 or alpha < 0.0):
                    worst = beyond
                    which = k
        if which < 0:
            return
        b[at.SLIDES + which] = 0.0
        b[at.FLAG + int(b[at.SLIDE_GUARD + which])] = 1.0 if b[at.ALPHA + which] > 1.0 else 0.0


def flag_of(b: Block, guard: int) -> float:
    """Whether a comparison holds, 0 or 1, by what it compares and, where that is equal, by what it comes to."""
    k = slider_of(b, guard)
    now = b[at.EXCESS + guard]
    flag = 1.0 if now > 0.0 else 0.0
    if now == 0.0:
        flag = 1.0 if b[at.EXCESS_RATE + guard] > 0.0 else 0.0
        if k >= 0:
            flag = b[at.FLAG + guard]
    if k >= 0 and b[at.SLIDES + k] > 0.5:
        flag = b[at.FLAG + guard]
    return flag * 1.0


def decide(b: Block, t: Block) -> None:
    """Decide all comparisons by what they compare, as where an input jumps."""
    guards = int(b[at.GUARDS])
    for _ in range(ROUNDS):
        changed = 0
        invoke(b[at.LOOK], b, t)
        for j in range(guards):
            flag = flag_of(b, j)
            if flag != b[at.FLAG + j]:
                b[at.FLAG + j] = flag
                changed = 1
        if changed == 0:
            for j in range(guards):
                if meets(b, t, j):
                    changed = 1
            settle(b, t)
            if changed == 0:
                return


def meets(b: Block, t: Block, guard: int) -> bool:
    """Whether the state stands exactly on a switch along which it may slide, and that is decided anew."""
    k = slider_of(b, guard)
    if k < 0:
        return False
    if b[at.SLIDES + k] > 0.5 or b[at.EXCESS + guard] != 0.0:
        return False
    return stand(b, t, guard, k)


def stand(b: Block, t: Block, guard: int, k: int) -> bool:
    """Decide a switch on which the state stands exactly: slide along it, or leave it; True if that is new."""
    was = b[at.FLAG + guard]
    b[at.FLAG + guard] = 1.0
    invoke(b[at.LOOK], b, t)
    above = b[at.EXCESS_RATE + guard]
    b[at.FLAG + guard] = 0.0
    invoke(b[at.LOOK], b, t)
    below = b[at.EXCESS_RATE + guard]
    if above < below and above <= 0.0 and below >= 0.0:
        b[at.SLIDES + k] = 1.0
        return True
    now = 1.0 if above > 0.0 else 0.0
    b[at.FLAG + guard] = now
    invoke(b[at.LOOK], b, t)
    is_new = True
    if now == was:
        is_new = False
    return is_new


def cross(b: Block, t: Block, guard: int) -> None:
    """A comparison changes: the other side, or sliding; tangents jump by what the time of the event changes."""
    states = int(b[at.STATES])
    width = int(b[at.WIDTH])
    invoke(b[at.LOOK], b, t)
    rate = b[at.EXCESS_RATE + guard]
    for i in range(states):
        b[at.BEFORE + i] = b[at.RATE + i]
    old = b[at.FLAG + guard]
    b[at.FLAG + guard] = 1.0 - old
    k = slider_of(b, guard)
    if k >= 0:
        invoke(b[at.LOOK], b, t)
        beyond = b[at.EXCESS_RATE + guard]
        if (old > 0.5 and beyond > 0.0) or (old < 0.5 and beyond < 0.0):
            b[at.FLAG + guard] = 0.0
            b[at.SLIDES + k] = 1.0
    invoke(b[at.LOOK], b, t)
    if rate != 0.0:
        for i in range(states):
            jump = (b[at.RATE + i] - b[at.BEFORE + i]) / rate
            if jump != 0.0:
                for w in range(width):
                    t[(at.STATE + i) * width + w] += jump * t[(at.EXCESS + guard) * width + w]
    snap(b, t)
    settle(b, t)


def set_inputs(b: Block, knots: Block, levels: Block, held: Block, following: int, count: int) -> None:
    """The inputs between two of their samples: held, or on a straight line."""
    inputs = int(b[at.INPUTS])
    for i in range(inputs):
        first = max(following - 1, 0)
        value = levels[first * inputs + i]
        slope = 0.0
        if held[i] < 0.5 and following > 0 and following < count:
            slope = (levels[following * inputs + i] - value) / (knots[following] - knots[first])
            value = value + slope * (b[at.TIME] - knots[first])
        b[at.INPUT + i] = value
        b[at.SLOPE + i] = slope


def show(b: Block, t: Block, out: Block, slopes: Block, sample: int) -> None:
    """One row of outputs, of the states in END."""
    outputs = int(b[at.OUTPUTS])
    width = int(b[at.WIDTH])
    invoke(b[at.ROW], b, t)
    for i in range(outputs):
        out[sample * outputs + i] = b[at.OUT + i]
        for w in range(width):
            slopes[(sample * outputs + i) * width + w] = t[(at.OUT + i) * width + w]


def commit(b: Block, t: Block) -> bool:
    """Take the states in END for those at the start of the next step; whether they are finite."""
    states = int(b[at.STATES])
    width = int(b[at.WIDTH])
    sound = True
    for i in range(states):
        value = b[at.END + i]
        b[at.STATE + i] = value
        if not abs(value) < 1e200:
            sound = False
        b[at.PEAK + i] = max(b[at.PEAK + i], abs(value))
        for w in range(width):
            t[(at.STATE + i) * width + w] = t[(at.END + i) * width + w]
    return sound


def hold(b: Block, t: Block) -> None:
    """Put the states at the start of the step into END, as at its first moment."""
    states = int(b[at.STATES])
    width = int(b[at.WIDTH])
    b[at.ELAPSED] = 0.0
    for i in range(states):
        b[at.END + i] = b[at.STATE + i]
        for w in range(width):
            t[(at.END + i) * width + w] = t[(at.STATE + i) * width + w]


def run(  # noqa: PLR0912, PLR0915 -- one loop, whose parts are the functions above
    b: Block, t: Block, knots: Block, levels: Block, held: Block, samples: Block, out: Block, slopes: Block,
    knot_count: int, sample_count: int, most: int,
) -> int:  # fmt: skip
    """Integrate from the time in the block to the last sample.

    Args:
        b, t: the block and its tangents. knots, levels: (k,) s and (k, inputs) of the inputs; held: (inputs,) 1 where
            one is held. samples: (n,) s. out, slopes: (n, outputs) and (n, outputs, width) are filled in.
    """
    following = 0
    while following < knot_count and knots[following] <= b[at.TIME]:
        following += 1
    set_inputs(b, knots, levels, held, following, knot_count)
    decide(b, t)
    sample = 0
    steps = 0
    events = 0
    while sample < sample_count:
        steps += 1
        b[at.TAKEN] = 1.0 * steps
        if steps > most:
            return TOO_MANY
        time = b[at.TIME]
        if samples[sample] <= time:
            hold(b, t)
            while sample < sample_count and samples[sample] <= time:
                show(b, t, out, slopes, sample)
                sample += 1
            if sample == sample_count:
                return 0
        stop = samples[sample_count - 1]
        is_knot = False
        if following < knot_count and knots[following] <= stop:
            stop = knots[following]
            is_knot = True
        longest = stop - time
        b[at.LONGEST] = longest
        sliding = is_sliding(b)
        for _ in range(ROUNDS):
            if sliding:
                invoke(b[at.SLIDE], b, t)
            else:
                invoke(b[at.MOVE], b, t)
            if not b[at.DEFECT] > 1.0:
                break
            b[at.LONGEST] = 0.5 * b[at.STEP]
        h = b[at.STEP]
        if not h > 1e-15 * longest or not b[at.DEFECT] >= 0.0:
            return NOT_FINITE
        at_stop = h >= longest
        event = -1
        slider = -1
        up = 0.0
        for j in range(int(b[at.GUARDS])):
            k = slider_of(b, j)
            slides = False
            if k >= 0:
                slides = b[at.SLIDES + k] > 0.5
            if slides:
                for end in range(2):
                    sign = 1.0 - 2.0 * end
                    found = first_below(b, at.ALPHA_SERIES + k * at.TERMS, 1.0 * end, sign, h)
                    if found >= 0.0:
                        h = found
                        event = j
                        slider = k
                        up = 1.0 * end
                        at_stop = False
            else:
                sign = 2.0 * b[at.FLAG + j] - 1.0
                found = first_below(b, at.GUARD_SERIES + j * at.TERMS, 0.0, sign, h)
                if found >= 0.0:
                    h = found
                    event = j
                    slider = -1
                    at_stop = False
        ends = time + h
        if at_stop:
            ends = stop
        while sample < sample_count and samples[sample] < ends:
            b[at.ELAPSED] = samples[sample] - time
            invoke(b[at.AT], b, t)
            show(b, t, out, slopes, sample)
            sample += 1
        b[at.ELAPSED] = h
        invoke(b[at.AT], b, t)
        if not commit(b, t):
            return NOT_FINITE
        snap(b, t)
        b[at.TIME] = ends
        for i in range(int(b[at.INPUTS])):
            b[at.INPUT + i] = b[at.INPUT + i] + h * b[at.SLOPE + i]
        if event >= 0:
            events += 1
            if slider >= 0:
                b[at.SLIDES + slider] = 0.0
                b[at.FLAG + event] = up
                settle(b, t)
            else:
                cross(b, t, event)
        elif at_stop and is_knot:
            following += 1
            set_inputs(b, knots, levels, held, following, knot_count)
            decide(b, t)
    return 0


FUNCTIONS: Final = (
    polynomial, first_below, slider_of, is_sliding, snap, settle, flag_of, decide, meets, stand, cross,
    set_inputs, show, commit, hold, run,
)  # fmt: skip
"""All of them, for `lowering`."""
