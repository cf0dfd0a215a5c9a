"""One step of plungers, coil and gas together: the gas implicitly, all else explicitly.

An additive Runge–Kutta pair of order 4(3), ARK4(3)6L[2]SA: Kennedy and Carpenter, Applied Numerical Mathematics 44
(2003) 139–181. Its explicit part steps the plungers and the coil, its implicit part, L-stable and stiffly accurate, the
density in the outlet volume. So nothing is lost to the infinite slope of the flow where both pressures are equal: each
stage is one equation in the density,

    (G6)  ρ − h γ f(ρ) = known,     f = (A G(p_i, p_o) − A_d G(p_o, p_d))/V_o,

whose left side only grows with ρ. It is solved by Newton's method in √|ρ − ρ_i|, in which the flow is smooth, or in
√|ρ − ρ_d| where that is nearer; ρ_i and ρ_d are the densities at the pressures of both ends.

A step leaves polynomials behind, as a Taylor step does, and all that looks at a step reads these: of each state the
cubic that has its values and rates at both ends, of x the integral of that of v, and of a density that is not stiff the
one of fifth order that has the rates of its rates, too. Tangents are those of the step itself, at its size: each stage
is differentiated as it stands.

These functions are compiled by `lowering`, as those of `driver`.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.core import layout as at
from valve_sim.model.core.polynomials import Block, invoke

TIMES: Final = (0.0, 1 / 2, 83 / 250, 31 / 50, 17 / 20, 1.0)
COLUMNS: Final = 5
"""Of the tables of stages, one row for each stage."""
EXPLICIT: Final = (
    0.0, 0.0, 0.0, 0.0, 0.0,
    1 / 2, 0.0, 0.0, 0.0, 0.0,
    13861 / 62500, 6889 / 62500, 0.0, 0.0, 0.0,
    -116923316275 / 2393684061468, -2731218467317 / 15368042101831, 9408046702089 / 11113171139209, 0.0, 0.0,
    -451086348788 / 2902428689909, -2682348792572 / 7519795681897, 12662868775082 / 11960479115383,
    3355817975965 / 11060851509271, 0.0,
    647845179188 / 3216320057751, 73281519250 / 8382639484533, 552539513391 / 3454668386233,
    3354512671639 / 8306763924573, 4040 / 17871,
)  # fmt: skip
IMPLICIT: Final = (
    0.0, 0.0, 0.0, 0.0, 0.0,
    1 / 4, 0.0, 0.0, 0.0, 0.0,
    8611 / 62500, -1743 / 31250, 0.0, 0.0, 0.0,
    5012029 / 34652500, -654441 / 2922500, 174375 / 388108, 0.0, 0.0,
    15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768, 2285395 / 8070912, 0.0,
    82889 / 524892, 0.0, 15625 / 83664, 69875 / 102672, -2260 / 8211,
)  # fmt: skip
DIAGONAL: Final = 1 / 4
WEIGHTS: Final = (82889 / 524892, 0.0, 15625 / 83664, 69875 / 102672, -2260 / 8211, 1 / 4)
EMBEDDED: Final = (
    4586570599 / 29645900160, 0.0, 178811875 / 945068544, 814220225 / 1159782912, -3700637 / 11593932, 61727 / 225920,
)  # fmt: skip

LOOSER: Final = 30.0
LOOSER_IN_MOTION: Final = 3.0
"""By what the tolerance of a step is larger than without gas, at rest and in motion: the pair is of order 4, a valve
waits half a second for its pressure, and a stroke of some milliseconds decides what the derivatives are."""
SIZE_OF_X: Final = 1e-5
SIZE_OF_RATES: Final = 1e-2
SIZE_OF_TEMPERATURE: Final = 1e-1
"""m; m/s, or of a current; K: below these sizes, a hundredth of what a stroke moves, the error is held absolutely."""
SIZE_OF_DENSITY: Final = 1e-2
"""Of that of the inlet: likewise."""
MOST_ITERATIONS: Final = 60
"""Of (G6); three to five are common."""
ROUNDING: Final = 1e-16
"""Of the density: an error of (G6) that needs no more of them. Newton's method leaves the square of its last change
times the curvature of the flow, which is its slope over the distance from equal pressures."""
PREDICTED: Final = 0.1
"""Times that the gas relaxes in a stage, up to which it begins with the rate of the stage before."""
CLOSE: Final = 0.1
"""Of that distance: a larger change is one of its root."""
SOLVED: Final = 1e-5
NEAR: Final = 1e-6
"""Relative change of the root that ends them so near to equal densities, of which it leaves the square."""
SAME: Final = 4e-16
"""Relative difference of two densities that rounding makes of equal ones."""
STIFF: Final = 1.0
"""Times that the gas relaxes in a step, from which on a cubic may leave what is between the ends: see `limit`."""
STEEPEST: Final = 3.0
"""Of the rise over the step: a cubic with such rates at its ends only rises (Fritsch and Carlson 1980)."""
FIRST_STEP: Final = 1e-5
"""s, tried when motion begins; error control takes over from there."""
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
LARGEST_GROWTH: Final = 8.0
LARGEST_CUT: Final = 0.1
"""Ratio of one step to the one before, at most, and of one trial to the one before, at least."""
SAFETY: Final = 0.9
NEVER_CHOKED: Final = 0.7
"""Ratio of pressures above which no gas chokes: (2/(γ + 1))^{1/k} is 0.61 at γ = 1, less with γ, and less with β."""
MARGIN: Final = 1e-6
MARGIN_OF_PRESSURE: Final = 1.0
"""Relative, and in Pa: by how much a limit between choked, subsonic and backward flow is passed before it counts."""
NEVER: Final = 1e300
SHORTEST: Final = 1e-16
"""s: if error control asks for less, it has failed."""


def longest_gas_step(b: Block) -> float:
    """The largest step, s, even if its error would allow more."""
    rest = LONGEST_REST
    if b[at.READS_TIME] == 0.0:
        rest = max(rest, LONGEST_REST_SHARE * (b[at.TIME] - max(b[at.CHANGED], b[at.UNSEATED_TIME])))
    if b[at.MOVING] == 0.0:
        return rest
    # No current is left, and all that moves creeps: a pilot plunger that nothing returns may float for hours.
    creeps = b[at.TIME] - b[at.CHANGED] > max(DECAYED * (b[at.LAG] + b[at.EDDY]), LONGEST_MOTION)
    if b[at.VOLTS] == 0.0 and b[at.WARM] < 0.0 and creeps:
        return rest
    return LONGEST_STEP


def stage_states(own: Block, stride: int, h: float, stage: int, states: int) -> None:
    """The states but for the density at a stage, or their tangents in one direction.

    Args:
        own: the values, or the tangents. stride: from one slot to the next. states: how many there are.
    """
    for j in range(states):
        total = 0.0
        for i in range(stage):
            total += EXPLICIT[stage * COLUMNS + i] * own[(at.GAS_K + i * at.WIDE + j) * stride]
        own[(at.END + j) * stride] = own[(at.X + j) * stride] + h * total


def end_states(own: Block, stride: int, h: float, states: int) -> None:
    """The states but for the density at the end of a step, or their tangents; arguments: see `stage_states`."""
    for j in range(states):
        total = 0.0
        for i in range(at.STAGES):
            total += WEIGHTS[i] * own[(at.GAS_K + i * at.WIDE + j) * stride]
        own[(at.END + j) * stride] = own[(at.X + j) * stride] + h * total


def known_density(own: Block, stride: int, h: float, stage: int, j: int) -> float:
    """The right-hand side of (G6), or its tangent; j is the place of the density among the states."""
    total = 0.0
    for i in range(stage):
        total += IMPLICIT[stage * COLUMNS + i] * own[(at.GAS_K + i * at.WIDE + j) * stride]
    return float(own[(at.X + j) * stride] + h * total)


def solve_density(b: Block, t: Block, share: float, known: float, guess: float) -> float:
    """Solve (G6), kg/m³; share is h γ. Leaves the slope of f where it was last asked for in the block."""
    slot = at.END + int(b[at.DENSITY]) - at.X
    density = guess
    low = known
    high = known
    for iteration in range(MOST_ITERATIONS):
        b[slot] = density
        invoke(b[at.FLOW], b, t)
        if iteration == 0:
            # The flow takes the density towards those at the ends, and not beyond.
            low = min(known, b[at.INLET_DENSITY])
            high = max(known, b[at.INLET_DENSITY])
            if b[at.HAS_DEMAND] > 0.0:
                low = min(low, b[at.DEMAND_DENSITY])
                high = max(high, b[at.DEMAND_DENSITY])
        excess = density - share * b[at.FLOW_RATE] - known
        if excess > 0.0:
            high = min(high, density)
        else:
            low = max(low, density)
        anchor = b[at.INLET_DENSITY]
        if b[at.HAS_DEMAND] > 0.0 and abs(density - b[at.DEMAND_DENSITY]) < abs(density - anchor):
            anchor = b[at.DEMAND_DENSITY]
        apart = density - anchor
        slope = share * b[at.FLOW_SLOPE]
        change = -excess / (1.0 - slope)
        better = density + change
        is_last = abs(slope) * change * change <= ROUNDING * density * abs(apart)
        if abs(change) > CLOSE * abs(apart):
            root = math.sqrt(max(abs(apart), SAME * anchor))
            moved = change / (2.0 * root)
            signed = (root if apart >= 0.0 else -root) + moved
            better = anchor + signed * abs(signed)
            is_last = abs(moved) <= SOLVED * root and abs(apart) <= NEAR * anchor
        if low <= better <= high:
            density = better
            if is_last:
                break
        elif high - low <= SAME * high:
            break
        else:
            density = 0.5 * (low + high)
    b[slot] = density
    return float(density)


def stage_rates(b: Block, t: Block, stage: int) -> None:
    """Keep the rates of all states but the density at a stage, or at the end of the step: stage STAGES."""
    k = at.GAS_K + stage * at.WIDE
    is_integrated = b[at.WARM] >= 0.0
    if b[at.MOVING] > 0.0 or is_integrated:
        invoke(b[at.STAGE], b, t)
    b[k] = 0.0
    b[k + 1] = 0.0
    if b[at.MOVING] > 0.0:
        b[k] = b[at.END + 1]
        b[k + 1] = b[at.STAGE_RATES + 1]
    states = 2 + int(b[at.STATES])
    for j in range(2, states):
        if at.X + j != int(b[at.DENSITY]):
            b[k + j] = b[at.STAGE_RATES + j] if is_integrated else 0.0


def try_gas_step(b: Block, t: Block, h: float) -> None:
    """One trial step of size h, s, from the state: rates at all stages, and the end of all that is integrated."""
    states = 2 + int(b[at.STATES])
    place = int(b[at.DENSITY]) - at.X
    density = b[at.X + place]
    for stage in range(at.STAGES):
        b[at.ELAPSED] = TIMES[stage] * h
        stage_states(b, 1, h, stage, states)
        k = at.GAS_K + stage * at.WIDE + place
        if stage == 0:
            b[at.END + place] = density
            invoke(b[at.FLOW], b, t)
            # Where the gas is stiff, the formula multiplies rounding; what the step before ended with does not.
            b[k] = b[at.GAS_RATE] if b[at.GAS_KNOWN] > 0.0 else b[at.FLOW_RATE]
        else:
            known = known_density(b, 1, h, stage, place)
            if h * DIAGONAL * abs(b[at.FLOW_SLOPE]) < PREDICTED:
                density = known + h * DIAGONAL * b[k - at.WIDE]
            density = solve_density(b, t, h * DIAGONAL, known, density)
            b[k] = (density - known) / (h * DIAGONAL)
        b[at.GAS_STAGES + stage] = density
        stage_rates(b, t, stage)
    b[at.STIFFNESS] = -h * b[at.FLOW_SLOPE]
    end_states(b, 1, h, states)
    b[at.ELAPSED] = h
    b[at.END + place] = density
    b[at.GAS_STAGES + at.STAGES] = density
    b[at.GAS_K + at.STAGES * at.WIDE + place] = b[at.GAS_K + (at.STAGES - 1) * at.WIDE + place]
    stage_rates(b, t, at.STAGES)


def error_of(b: Block, h: float, j: int) -> float:
    """Of state j at the end of the trial step."""
    error = 0.0
    for i in range(at.STAGES):
        error += (WEIGHTS[i] - EMBEDDED[i]) * b[at.GAS_K + i * at.WIDE + j]
    return h * error


def gas_error(b: Block, h: float) -> float:
    """Root mean square of the error in units of the tolerance; above 1 the step is refused."""
    total = 0.0
    count = 0
    states = 2 + int(b[at.STATES])
    for j in range(states):
        size = SIZE_OF_RATES
        if j == 0:
            size = SIZE_OF_X
        elif at.X + j == int(b[at.DENSITY]):
            size = SIZE_OF_DENSITY * b[at.INLET_DENSITY]
        elif b[at.WARM] >= 0.0 and at.COIL + int(b[at.WARM]) == at.X + j:
            size = SIZE_OF_TEMPERATURE
        if j < 2 or at.X + j == int(b[at.DENSITY]) or b[at.WARM] >= 0.0:
            ratio = error_of(b, h, j) / max(abs(b[at.X + j]), abs(b[at.END + j]), size)
            total += ratio * ratio
            count += 1
    looser = LOOSER if b[at.MOVING] == 0.0 else LOOSER_IN_MOTION
    return float(math.sqrt(total / count) / (looser * b[at.TOLERANCE]))


def step_factor(error: float) -> float:
    """The factor from one step size to the next, given the error in units of the tolerance.

    The exponent of an elementary controller is 1/4: the error grows with the fourth power of the step.
    """
    return SAFETY / math.sqrt(math.sqrt(error))


def limit(rate: float, rise: float) -> float:
    """How a rate at an end of a stiff step enters its cubic: 0 not, 1 as it is, 2 as STEEPEST times the rise."""
    if rate * rise <= 0.0:
        return 0.0
    return 2.0 if abs(rate) > STEEPEST * abs(rise) else 1.0


def fill_polynomials(own: Block, stride: int, b: Block, h: float) -> None:
    """The coefficients of all states within the step, or their tangents in one direction; arguments as `stage_states`.

    Those of the density are kept between its ends by the limits in the block, where the step is stiff.
    """
    for k in range(at.ORDER + 1):
        own[(at.SERIES_X + k) * stride] = 0.0
    a = at.GAS_K * stride
    end = (at.GAS_K + at.STAGES * at.WIDE) * stride
    own[at.SERIES_X * stride] = own[at.X * stride]
    if b[at.MOVING] > 0.0:
        v = own[(at.X + 1) * stride]
        rise = own[(at.END + 1) * stride] - v
        first = h * own[a + stride]
        last = h * own[end + stride]
        own[(at.SERIES_X + 1) * stride] = v
        own[(at.SERIES_X + 2) * stride] = first / (2.0 * h)
        own[(at.SERIES_X + 3) * stride] = (3.0 * rise - 2.0 * first - last) / (3.0 * h * h)
        own[(at.SERIES_X + 4) * stride] = (first + last - 2.0 * rise) / (4.0 * h * h * h)
        own[at.END * stride] = own[at.X * stride] + h * (v + 0.5 * rise + (first - last) / 12.0)
    states = 2 + int(b[at.STATES])
    for j in range(2, states):
        c = (at.SERIES_COIL + (j - 2) * at.TERMS) * stride
        rise = own[(at.END + j) * stride] - own[(at.X + j) * stride]
        first = h * own[a + j * stride]
        last = h * own[end + j * stride]
        bent = 0.0
        bent_end = 0.0
        is_quintic = at.X + j == int(b[at.DENSITY]) and b[at.STIFFNESS] <= STIFF
        if is_quintic:
            bent = own[at.BENT_START * stride]
            bent_end = own[at.BENT_END * stride]
        elif at.X + j == int(b[at.DENSITY]):
            if b[at.LIMIT_START] != 1.0:
                first = STEEPEST * rise if b[at.LIMIT_START] > 1.0 else 0.0
            if b[at.LIMIT_END] != 1.0:
                last = STEEPEST * rise if b[at.LIMIT_END] > 1.0 else 0.0
        for k in range(6, at.TERMS):
            own[c + k * stride] = 0.0
        own[c] = own[(at.X + j) * stride]
        own[c + stride] = first / h
        # What the terms of higher order make of the value, the rate and its rate at the end.
        half = 0.5 * h * h * bent if is_quintic else 3.0 * rise - 2.0 * first - last
        d0 = rise - first - half
        d1 = last - first - 2.0 * half
        d2 = h * h * (bent_end - bent) if is_quintic else 6.0 * d0
        own[c + 2 * stride] = half / (h * h)
        own[c + 3 * stride] = (10.0 * d0 - 4.0 * d1 + 0.5 * d2) / (h * h * h)
        own[c + 4 * stride] = (-15.0 * d0 + 7.0 * d1 - d2) / (h * h * h * h)
        own[c + 5 * stride] = (6.0 * d0 - 3.0 * d1 + 0.5 * d2) / (h * h * h * h * h)


def bend_at(b: Block, t: Block, h: float, stage: int, bend: float) -> None:
    """Look how the rate of the density changes at the start of the step at hand, or at its end, stage STAGES.

    Args:
        bend: address of the kernel.
    """
    states = 2 + int(b[at.STATES])
    if stage == at.STAGES:
        end_states(b, 1, h, states)
        b[at.ELAPSED] = h
    else:
        stage_states(b, 1, h, 0, states)
        b[at.ELAPSED] = 0.0
    b[at.END + int(b[at.DENSITY]) - at.X] = b[at.GAS_STAGES + stage]
    invoke(bend, b, t)


def gas_polynomials(b: Block, t: Block, h: float) -> None:
    """Make the polynomials of a step that has been tried."""
    j = int(b[at.DENSITY]) - at.X
    b[at.LIMIT_START] = 1.0
    b[at.LIMIT_END] = 1.0
    if b[at.STIFFNESS] <= STIFF:
        bend_at(b, t, h, 0, b[at.BEND])
        b[at.BENT_START] = b[at.BENT]
        bend_at(b, t, h, at.STAGES, b[at.BEND])
        b[at.BENT_END] = b[at.BENT]
    else:
        rise = b[at.END + j] - b[at.X + j]
        b[at.LIMIT_START] = limit(h * b[at.GAS_K + j], rise)
        b[at.LIMIT_END] = limit(h * b[at.GAS_K + at.STAGES * at.WIDE + j], rise)
    fill_polynomials(b, 1, b, h)


def take_gas_step(b: Block, t: Block, h: float) -> None:
    """Make a step of size h, s, the one at hand: its polynomials and its end, without tangents."""
    try_gas_step(b, t, h)
    gas_polynomials(b, t, h)
    b[at.STEP] = h


def gas_tangents(b: Block, t: Block) -> None:
    """Tangents of the step at hand: of its stages one after the other, and of its polynomials."""
    width = int(b[at.WIDTH])
    h = b[at.STEP]
    if width == 0 or h == 0.0:
        return
    states = 2 + int(b[at.STATES])
    place = int(b[at.DENSITY]) - at.X
    for stage in range(at.STAGES + 1):
        if stage < at.STAGES:
            b[at.ELAPSED] = TIMES[stage] * h
            stage_states(b, 1, h, stage, states)
        else:
            b[at.ELAPSED] = h
            end_states(b, 1, h, states)
        b[at.END + place] = b[at.GAS_STAGES + stage]
        for k in range(width):
            if stage < at.STAGES:
                stage_states(t[k:], width, h, stage, states)
            else:
                end_states(t[k:], width, h, states)
        tangents_of_density(b, t, h, stage, place)
        tangents_of_rates(b, t, stage, states, place)
        if b[at.STIFFNESS] <= STIFF and stage in (0, at.STAGES):
            bent = at.BENT_START if stage == 0 else at.BENT_END
            invoke(b[at.BEND_SLOPES], b, t)
            for k in range(width):
                t[bent * width + k] = t[at.BENT * width + k]
    for k in range(width):
        fill_polynomials(t[k:], width, b, h)


def tangents_of_density(b: Block, t: Block, h: float, stage: int, place: int) -> None:
    """Tangents of the density at a stage, and of its rate: of (G6), whose right-hand side is explicit."""
    width = int(b[at.WIDTH])
    own = (at.GAS_K + stage * at.WIDE + place) * width
    here = (at.END + place) * width
    if stage < at.STAGES:
        for k in range(width):
            t[here + k] = known_density(t[k:], width, h, stage, place)
        invoke(b[at.FLOW_SLOPES], b, t)
    share = h * DIAGONAL if stage > 0 else 0.0
    for k in range(width):
        if stage == at.STAGES:
            # The last stage is the end.
            t[own + k] = t[own - at.WIDE * width + k]
            t[here + k] = t[(at.GAS_STAGES + at.STAGES - 1) * width + k]
        elif stage == 0 and b[at.GAS_KNOWN] > 0.0:
            t[own + k] = t[at.GAS_RATE * width + k]
        else:
            t[own + k] = t[at.FLOW_RATE * width + k] / (1.0 - share * b[at.FLOW_SLOPE])
            t[here + k] += share * t[own + k]
        t[(at.GAS_STAGES + stage) * width + k] = t[here + k]


def tangents_of_rates(b: Block, t: Block, stage: int, states: int, place: int) -> None:
    """Tangents of what `stage_rates` keeps."""
    width = int(b[at.WIDTH])
    moves = b[at.MOVING] > 0.0
    is_integrated = b[at.WARM] >= 0.0
    if moves or is_integrated:
        invoke(b[at.STAGE_SLOPES], b, t)
    row = (at.GAS_K + stage * at.WIDE) * width
    for k in range(width):
        t[row + k] = t[(at.END + 1) * width + k] if moves else 0.0
        t[row + width + k] = t[(at.STAGE_RATES + 1) * width + k] if moves else 0.0
        for j in range(2, states):
            if j != place:
                t[row + j * width + k] = t[(at.STAGE_RATES + j) * width + k] if is_integrated else 0.0


def finish_gas_step(b: Block, t: Block) -> None:
    """Fill in the end of the step at hand, with tangents; the density to its last digit."""
    gas_tangents(b, t)
    b[at.ELAPSED] = b[at.STEP]
    invoke(b[at.AT], b, t)
    b[at.END + int(b[at.DENSITY]) - at.X] = b[at.GAS_STAGES + at.STAGES]


def know_rate(b: Block, t: Block) -> None:
    """The end of the step at hand has become the state, and nothing happens there: keep the rate of a stiff density."""
    last = at.GAS_K + at.STAGES * at.WIDE + int(b[at.DENSITY]) - at.X
    b[at.GAS_KNOWN] = 1.0 if b[at.STIFFNESS] > STIFF else 0.0
    b[at.GAS_RATE] = b[last]
    width = int(b[at.WIDTH])
    for k in range(width):
        t[at.GAS_RATE * width + k] = t[last * width + k]


def rest_at(b: Block, t: Block) -> None:
    """Make a step of no length the one at hand, of plungers that something pushes at once."""
    for k in range(at.ORDER + 1):
        b[at.SERIES_X + k] = 0.0
    b[at.SERIES_X] = b[at.X]
    states = int(b[at.STATES])
    for i in range(states):
        for k in range(at.TERMS):
            b[at.SERIES_COIL + i * at.TERMS + k] = 0.0
        b[at.SERIES_COIL + i * at.TERMS] = b[at.COIL + i]
    width = int(b[at.WIDTH])
    for k in range(width):
        t[at.SERIES_X * width + k] = t[at.X * width + k]
        for i in range(states):
            t[(at.SERIES_COIL + i * at.TERMS) * width + k] = t[(at.COIL + i) * width + k]
    b[at.STEP] = 0.0
    b[at.ELAPSED] = 0.0
    invoke(b[at.AT], b, t)
    b[at.END + int(b[at.DENSITY]) - at.X] = b[int(b[at.DENSITY])]


def controlled_gas_step(b: Block, t: Block) -> bool:
    """Make the next step that error control accepts the one at hand; whether there is one."""
    h = min(b[at.GAS_STEP], longest_gas_step(b))
    error = NEVER
    while not (error <= 1.0):
        try_gas_step(b, t, h)
        error = gas_error(b, h)
        if not (error <= 1.0):
            h *= max(LARGEST_CUT, step_factor(error)) if error < NEVER else LARGEST_CUT
            if h < SHORTEST:
                return False
    b[at.GAS_STEP] = h * min(LARGEST_GROWTH, step_factor(error))
    gas_polynomials(b, t, h)
    b[at.STEP] = h
    return True


def regime_of(b: Block, relative: float, absolute: float) -> float:
    """What the flow does at the pressures in the block: 2 choked, 1 subsonic, negative from outlet to inlet.

    Args:
        relative, absolute: –, Pa: by how much the pressures must have passed a limit to leave the state's regime.
    """
    inlet = b[at.INLET]
    outlet = b[at.OUTLET]
    before = b[at.REGIME]
    beyond = absolute + relative * inlet
    is_forward = inlet - outlet > beyond if before < 0.0 else inlet - outlet >= -beyond
    way = 1.0 if is_forward else -1.0
    ratio = min(inlet, outlet) / max(inlet, outlet)
    if ratio >= NEVER_CHOKED:
        return way
    critical = b[at.CRITICAL] * (1.0 + relative if abs(before) > 1.5 else 1.0 - relative)
    return 2.0 * way if ratio < critical else way


def regime_at(b: Block, t: Block, elapsed: float, relative: float, absolute: float) -> float:
    """The regime of the flow, as `regime_of` says it, at a time within the step."""
    b[at.ELAPSED] = elapsed
    invoke(b[at.WATCH], b, t)
    return regime_of(b, relative, absolute)


FUNCTIONS: Final = (
    longest_gas_step, stage_states, end_states, known_density, solve_density, stage_rates, try_gas_step, error_of,
    gas_error, step_factor, limit, fill_polynomials, bend_at, gas_polynomials, take_gas_step, gas_tangents,
    tangents_of_density, tangents_of_rates, finish_gas_step, know_rate, rest_at, controlled_gas_step, regime_of,
    regime_at,
)  # fmt: skip
"""What is compiled."""
