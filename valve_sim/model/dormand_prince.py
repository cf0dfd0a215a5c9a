"""One step of the Dormand–Prince 5(4) pair with dense output, compiled.

Source: Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I*, 2nd ed., section II.4 (coefficients,
step control) and II.6; dense output of order 4 after Shampine, Math. Comp. 46 (1986) 135–150.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.equations import (
    acceleration,
    acceleration_at,
    coil_decay,
    coil_rates,
    coil_state,
    coil_that_pulls,
    eddy_decay,
    flux_rates,
    is_plain,
    mechanical_rates,
    phase_of,
)
from valve_sim.model.flux import resting_current
from valve_sim.model.taylor_coefficients import ORDER
from valve_sim.model.taylor_series import acceleration_after, position_after, velocity_after

STAGES: Final = 7
"""Stages of the pair; the seventh is the first of the next step."""
MECHANICAL_STATES: Final = 2
"""x and v."""
FLUX_STATES: Final = 3
"""x, v and w, where the current follows the flux."""
ALL_STATES: Final = 5
"""x, v and, while the coil heats, u, w and T; where the current follows the flux w, nothing and T."""
# NumPy's numbers: Numba compiles a function once for all of them, but anew for each of Python's literals.
POSITION, VELOCITY, CURRENT, PULLING_CURRENT, TEMPERATURE = np.arange(ALL_STATES)
FIRST, SECOND, THIRD, FOURTH, FIFTH, SIXTH, LAST = np.arange(STAGES)

WORK_RECORD: Final = np.dtype(
    [
        ("states", "i8"),  # how many of the states are integrated, 2, 3 or 5
        ("rests", "i8"),  # 1 while w follows in closed form what the coil sees at rest
        ("start_is_known", "i8"),  # 1 while k[0] holds y' at y: it was the last stage of the step before
        ("y", "f8", (ALL_STATES,)),  # at the start of the step
        ("y_stage", "f8", (ALL_STATES,)),  # where a stage looks
        ("y_new", "f8", (ALL_STATES,)),  # at the end of the step
        ("k", "f8", (STAGES, ALL_STATES)),  # y' at the stages
        ("dense", "f8", (ALL_STATES, 4)),  # coefficients of the dense output
        ("is_series", "i8"),  # 1 if motion is expanded in series, see `taylor_series`
        ("has_effects", "i8"),  # 1 if effects take part in these
        ("in_series", "i8"),  # 1 while the step is one of them
        ("series", "f8", (ORDER + 1,)),  # of x, about the start of the step, m/s^k
        ("velocity_series", "f8", (ORDER,)),  # of v
        ("slopes", "f8", (4,)),  # of what a sensor filters
        # The last sample of a current: see `sampling`.
        ("decayed_at", "f8"),  # s after the last command
        ("decay", "f8"),  # what was left there of the current's start
        ("interval", "f8"),  # s, between samples
        ("factor", "f8"),  # by which `decay` falls over it
        ("chained", "i8"),  # so many samples may still follow by it
        # Of gas, see `gas.step`: density, mass in and mass out at the start and at the end of the step; their slopes.
        ("gas", "f8", (3,)),
        ("gas_new", "f8", (3,)),
        ("gas_k", "f8", (6, 3)),
        ("gas_dense", "f8", (3, 3)),
        ("regime_ahead", "f8"),  # of the flow, after the event in the step
        ("stiffness", "f8"),  # how many times the gas relaxes in the step
    ],
    align=True,
)
"""The scratch paper of one run; a record, because arrays that are passed around cost reference counts."""

# The tableau, row by row: when a stage looks (the sixth and the last at the end), and where, from y and the slopes k.
C2, C3, C4, C5 = 1 / 5, 3 / 10, 4 / 5, 8 / 9
COMMON: Final = 90
"""Denominator of them all."""
STAGE_TIMES: Final = (0.0, C2, C3, C4, C5, 1.0, 1.0)
"""When each stage looks, in steps."""


@inlined
def at_second(y, h, k1):
    """Where the second stage looks."""
    return y + h * (1 / 5 * k1)


@inlined
def at_third(y, h, k1, k2):
    """Where the third stage looks."""
    return y + h * (3 / 40 * k1 + 9 / 40 * k2)


@inlined
def at_fourth(y, h, k1, k2, k3):
    """Where the fourth stage looks."""
    return y + h * (44 / 45 * k1 + -56 / 15 * k2 + 32 / 9 * k3)


@inlined
def at_fifth(y, h, k1, k2, k3, k4):
    """Where the fifth stage looks."""
    return y + h * (19372 / 6561 * k1 + -25360 / 2187 * k2 + 64448 / 6561 * k3 + -212 / 729 * k4)


@inlined
def at_sixth(y, h, k1, k2, k3, k4, k5):
    """Where the sixth stage looks."""
    return y + h * (9017 / 3168 * k1 + -355 / 33 * k2 + 46732 / 5247 * k3 + 49 / 176 * k4 + -5103 / 18656 * k5)


@inlined
def at_end(y, h, k1, k3, k4, k5, k6):
    """The fifth-order end of the step."""
    return y + h * (35 / 384 * k1 + 500 / 1113 * k3 + 125 / 192 * k4 + -2187 / 6784 * k5 + 11 / 84 * k6)


@inlined
def _error(h, k1, k3, k4, k5, k6, k7):
    """The fifth-order end of a step less the fourth-order one."""
    parts = -71 / 57600 * k1 + 71 / 16695 * k3 + -71 / 1920 * k4 + 17253 / 339200 * k5 + -22 / 525 * k6 + 1 / 40 * k7
    return h * parts


SMALLEST_SCALE = np.array([1e-5, 1e-2, 1e-2, 1e-2, 1e-1])
"""Below these sizes (m, m/s, –, –, K), a hundredth of what a stroke moves, the error is held absolutely."""


@inner
def rates(p, s, work, t, y, stage):
    """Write y' into row `stage` of work.k; y is one of work's states."""
    if work.states == MECHANICAL_STATES and s.moving:
        work.k[stage, 0], work.k[stage, 1] = y[1], acceleration_at(p, s, t, y[0], y[1])
        return
    u, w = coil_state(p, s, t, y[2], y[3], y[4])
    dx, dv = mechanical_rates(p, s, t, y[0], y[1], u, w)
    work.k[stage, 0], work.k[stage, 1] = dx, dv
    if work.states > MECHANICAL_STATES:
        work.k[stage, 2], work.k[stage, 3], work.k[stage, 4] = coil_rates(p, s, (y[0], dx), u, w, y[4])


@inner
def try_step(p, s, work, h):
    """One trial step of size h, s, from work.y; work.k[0] holds y' there. Writes work.y_new and work.k."""
    if work.in_series:
        work.y_new[0], work.y_new[1] = position_after(work, h), velocity_after(work, h)
        work.k[LAST, 0], work.k[LAST, 1] = work.y_new[1], acceleration_after(work, h)
    elif work.states == MECHANICAL_STATES:
        _try_mechanical_step(p, s, work, h)
    elif work.states == FLUX_STATES:
        _try_flux_step(p, s, work, h)
    else:
        _try_heated_step(p, s, work, h)


@inlined
def _at_stages(start, root):
    """What is left of a decaying quantity at the second to the sixth stage: powers, which take less than exponentials.

    Args:
        start: what is left at the start of the step. root: the share of it that is left after 1/`COMMON` of the step.
    """
    at_8 = root * root
    at_8 *= at_8
    at_8 *= at_8
    at_9 = at_8 * root
    at_18 = at_9 * at_9
    at_36 = at_18 * at_18
    at_72 = at_36 * at_36
    return start * at_18, start * (at_18 * at_9), start * at_72, start * (at_72 * at_8), start * (at_72 * at_18)


@inner
def _try_mechanical_step(p, s, work, h):
    """The step of x and v alone, in motion, without a loop: nearly all of a run's time is spent here."""
    elapsed = s.time - s.segment_time
    decay2, decay3, decay4, decay5, decay6 = _at_stages(coil_decay(p, elapsed), coil_decay(p, h / COMMON))
    eddy2, eddy3, eddy4, eddy5, eddy6 = 0.0, 0.0, 0.0, 0.0, 0.0
    if p.eddy_time_constant != 0.0:
        eddy2, eddy3, eddy4, eddy5, eddy6 = _at_stages(eddy_decay(p, elapsed), eddy_decay(p, h / COMMON))
    coils = (
        coil_that_pulls(p, s, elapsed + C2 * h, (decay2, eddy2)),
        coil_that_pulls(p, s, elapsed + C3 * h, (decay3, eddy3)),
        coil_that_pulls(p, s, elapsed + C4 * h, (decay4, eddy4)),
        coil_that_pulls(p, s, elapsed + C5 * h, (decay5, eddy5)),
        coil_that_pulls(p, s, elapsed + h, (decay6, eddy6)),
    )
    # Compiled twice: without effects there is nothing to call, and all stays in registers.
    if is_plain(p):
        _mechanical_stages(p, s, work, h, coils, True)
    else:
        _mechanical_stages(p, s, work, h, coils, False)


@inlined
def _mechanical_stages(p, s, work, h, coils, plain):
    """The stages, given (u, u²) at the second to the sixth of them."""
    t, k = s.time, work.k
    coil2, coil3, coil4, coil5, coil6 = coils
    phase, condition = phase_of(p, s.mode), (s.mode, s.direction, s.unseated_time)
    x, x1, a1 = work.y[0], k[0, 0], k[0, 1]
    x2 = at_second(x1, h, a1)
    a2 = acceleration(p, phase, t + C2 * h, (at_second(x, h, x1), x2), coil2, condition, plain)
    x3 = at_third(x1, h, a1, a2)
    a3 = acceleration(p, phase, t + C3 * h, (at_third(x, h, x1, x2), x3), coil3, condition, plain)
    x4 = at_fourth(x1, h, a1, a2, a3)
    a4 = acceleration(p, phase, t + C4 * h, (at_fourth(x, h, x1, x2, x3), x4), coil4, condition, plain)
    x5 = at_fifth(x1, h, a1, a2, a3, a4)
    a5 = acceleration(p, phase, t + C5 * h, (at_fifth(x, h, x1, x2, x3, x4), x5), coil5, condition, plain)
    x6 = at_sixth(x1, h, a1, a2, a3, a4, a5)
    a6 = acceleration(p, phase, t + h, (at_sixth(x, h, x1, x2, x3, x4, x5), x6), coil6, condition, plain)
    x_new, x7 = at_end(x, h, x1, x3, x4, x5, x6), at_end(x1, h, a1, a3, a4, a5, a6)
    a7 = acceleration_at(p, s, t + h, x_new, x7)
    k[1, 0], k[2, 0], k[3, 0], k[4, 0], k[5, 0], k[6, 0] = x2, x3, x4, x5, x6, x7
    k[1, 1], k[2, 1], k[3, 1], k[4, 1], k[5, 1], k[6, 1] = a2, a3, a4, a5, a6, a7
    work.y_new[0], work.y_new[1] = x_new, x7


@inner
def _try_flux_step(p, s, work, h):
    """The step of x, v and w, likewise."""
    t, k = s.time, work.k
    x, v, w = work.y[0], work.y[1], work.y[2]
    x1, v1, w1 = k[0, 0], k[0, 1], k[0, 2]
    x_stage, v_stage, w_stage = at_second(x, h, x1), at_second(v, h, v1), at_second(w, h, w1)
    x2, v2, w2 = flux_rates(p, s, t + C2 * h, x_stage, v_stage, w_stage)
    x_stage, v_stage, w_stage = at_third(x, h, x1, x2), at_third(v, h, v1, v2), at_third(w, h, w1, w2)
    x3, v3, w3 = flux_rates(p, s, t + C3 * h, x_stage, v_stage, w_stage)
    x_stage, v_stage = at_fourth(x, h, x1, x2, x3), at_fourth(v, h, v1, v2, v3)
    x4, v4, w4 = flux_rates(p, s, t + C4 * h, x_stage, v_stage, at_fourth(w, h, w1, w2, w3))
    x_stage, v_stage = at_fifth(x, h, x1, x2, x3, x4), at_fifth(v, h, v1, v2, v3, v4)
    x5, v5, w5 = flux_rates(p, s, t + C5 * h, x_stage, v_stage, at_fifth(w, h, w1, w2, w3, w4))
    x_stage, v_stage = at_sixth(x, h, x1, x2, x3, x4, x5), at_sixth(v, h, v1, v2, v3, v4, v5)
    x6, v6, w6 = flux_rates(p, s, t + h, x_stage, v_stage, at_sixth(w, h, w1, w2, w3, w4, w5))
    x_new, v_new = at_end(x, h, x1, x3, x4, x5, x6), at_end(v, h, v1, v3, v4, v5, v6)
    w_new = at_end(w, h, w1, w3, w4, w5, w6)
    k[6, 0], k[6, 1], k[6, 2] = flux_rates(p, s, t + h, x_new, v_new, w_new)
    k[1, 0], k[2, 0], k[3, 0], k[4, 0], k[5, 0] = x2, x3, x4, x5, x6
    k[1, 1], k[2, 1], k[3, 1], k[4, 1], k[5, 1] = v2, v3, v4, v5, v6
    k[1, 2], k[2, 2], k[3, 2], k[4, 2], k[5, 2] = w2, w3, w4, w5, w6
    work.y_new[0], work.y_new[1], work.y_new[2] = x_new, v_new, w_new


@inner
def _try_heated_step(p, s, work, h):
    """The step of x, v, u, w and T."""
    t = s.time
    k, y, y_stage, y_new = work.k, work.y, work.y_stage, work.y_new
    for j in range(work.states):
        y_stage[j] = at_second(y[j], h, k[0, j])
    rates(p, s, work, t + C2 * h, y_stage, SECOND)
    for j in range(work.states):
        y_stage[j] = at_third(y[j], h, k[0, j], k[1, j])
    rates(p, s, work, t + C3 * h, y_stage, THIRD)
    for j in range(work.states):
        y_stage[j] = at_fourth(y[j], h, k[0, j], k[1, j], k[2, j])
    rates(p, s, work, t + C4 * h, y_stage, FOURTH)
    for j in range(work.states):
        y_stage[j] = at_fifth(y[j], h, k[0, j], k[1, j], k[2, j], k[3, j])
    rates(p, s, work, t + C5 * h, y_stage, FIFTH)
    for j in range(work.states):
        y_stage[j] = at_sixth(y[j], h, k[0, j], k[1, j], k[2, j], k[3, j], k[4, j])
    rates(p, s, work, t + h, y_stage, SIXTH)
    for j in range(work.states):
        y_new[j] = at_end(y[j], h, k[0, j], k[2, j], k[3, j], k[4, j], k[5, j])
    rates(p, s, work, t + h, y_new, LAST)


@inlined
def error_norm(work, h, tolerance):
    """Root mean square of the error in units of the tolerance (Hairer II.4.11); above 1 the step is rejected."""
    total = 0.0
    k = work.k
    for j in range(work.states):
        error = _error(h, k[0, j], k[2, j], k[3, j], k[4, j], k[5, j], k[6, j])
        ratio = error / (tolerance * max(abs(work.y[j]), abs(work.y_new[j]), SMALLEST_SCALE[j]))
        total += ratio * ratio
    return math.sqrt(total / work.states)


@inlined
def step_factor(error):
    """The factor from one step size to the next, given the error in units of the tolerance.

    The exponent of an elementary controller is 1/5 (Hairer II.4.13). 1/4 is as stable, since the error grows with the
    fifth power of the step (1 − 5/4 is well inside the unit circle), and two square roots are faster.
    """
    return 0.9 / math.sqrt(math.sqrt(error))


@inlined
def fill_dense(work):
    """Work out the dense-output coefficients of the step just taken.

    The polynomial is that of order 4 which Shampine found, with y and y' of both ends.
    """
    k, dense = work.k, work.dense
    for j in range(work.states):
        k1, k3, k4, k5, k6, k7 = k[0, j], k[2, j], k[3, j], k[4, j], k[5, j], k[6, j]
        mean = at_end(0.0, 1.0, k1, k3, k4, k5, k6)
        fourth = -12715105075 / 11282082432 * k1 + 87487479700 / 32700410799 * k3 + -10690763975 / 1880347072 * k4
        fourth += 701980252875 / 199316789632 * k5 + -1453857185 / 822651844 * k6 + 69997945 / 29380423 * k7
        third = k7 - k1 - 2.0 * (mean - k1 + fourth)
        dense[j, 0], dense[j, 1], dense[j, 2], dense[j, 3] = k1, mean - k1 - third - fourth, third, fourth


@inlined
def interpolate(work, h, j, theta):
    """State j at the fraction theta of a step of size h, from its dense output."""
    if work.in_series:
        return position_after(work, theta * h) if j == POSITION else velocity_after(work, theta * h)
    slopes = work.dense[j, 1] + theta * (work.dense[j, 2] + theta * work.dense[j, 3])
    return work.y[j] + h * theta * (work.dense[j, 0] + theta * slopes)


@inlined
def dense_slope(work, h, j, theta):
    """Derivative of state j with respect to time at the fraction theta of a step of size h, from its dense output."""
    if work.in_series:
        return velocity_after(work, theta * h) if j == POSITION else acceleration_after(work, theta * h)
    slopes = 2.0 * work.dense[j, 1] + theta * (3.0 * work.dense[j, 2] + theta * 4.0 * work.dense[j, 3])
    return work.dense[j, 0] + theta * slopes


@inner
def coil_within(p, s, work, h, theta):
    """Give u and w at the fraction theta of a step."""
    t = s.time + theta * h
    if work.states == MECHANICAL_STATES:
        return coil_state(p, s, t, 0.0, 0.0, 0.0)
    if work.rests:
        return coil_state(p, s, t, resting_current(p, s, theta * h), 0.0, s.temperature)
    u, w = interpolate(work, h, CURRENT, theta), interpolate(work, h, PULLING_CURRENT, theta)
    return coil_state(p, s, t, u, w, interpolate(work, h, TEMPERATURE, theta))


@inner
def shorten(work, h, fraction):
    """End a step at a fraction of it: its dense output is a polynomial in the fraction of the step."""
    for j in range(work.states):
        work.y_new[j] = interpolate(work, h, j, fraction)
        stretch = 1.0
        for power in range(4):
            work.dense[j, power] *= stretch
            stretch *= fraction
