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
    coil_current_between_commands,
    coil_state,
    heating_rates,
    mechanical_rates,
)

STAGES: Final = 7
"""Stages of the pair; the seventh is the first of the next step."""
MECHANICAL_STATES: Final = 2
"""x and v."""
ALL_STATES: Final = 5
"""x, v and, while the coil heats, u, w and T."""
# NumPy's numbers: Numba compiles a function once for all of them, but anew for each of Python's literals.
POSITION, VELOCITY, CURRENT, PULLING_CURRENT, TEMPERATURE = np.arange(ALL_STATES)
FIRST, SECOND, THIRD, FOURTH, FIFTH, SIXTH, LAST = np.arange(STAGES)

WORK_RECORD: Final = np.dtype(
    [
        ("states", "i8"),  # how many of the states are integrated, 2 or 5
        ("start_is_known", "i8"),  # 1 while k[0] holds y' at y: it was the last stage of the step before
        ("y", "f8", (ALL_STATES,)),  # at the start of the step
        ("y_stage", "f8", (ALL_STATES,)),  # where a stage looks
        ("y_new", "f8", (ALL_STATES,)),  # at the end of the step
        ("k", "f8", (STAGES, ALL_STATES)),  # y' at the stages
        ("dense", "f8", (ALL_STATES, 4)),  # coefficients of the dense output
        ("slopes", "f8", (4,)),  # of what a sensor filters
    ],
    align=True,
)
"""The scratch paper of one run; a record, because arrays that are passed around cost reference counts."""

C2, C3, C4, C5 = 1 / 5, 3 / 10, 4 / 5, 8 / 9
A21 = 1 / 5
A31, A32 = 3 / 40, 9 / 40
A41, A42, A43 = 44 / 45, -56 / 15, 32 / 9
A51, A52, A53, A54 = 19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729
A61, A62, A63, A64, A65 = 9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656
B1, B3, B4, B5, B6 = 35 / 384, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84
E1, E3, E4, E5, E6, E7 = -71 / 57600, 71 / 16695, -71 / 1920, 17253 / 339200, -22 / 525, 1 / 40

_DENSE = np.array(
    [
        [1, -8048581381 / 2820520608, 8663915743 / 2820520608, -12715105075 / 11282082432],
        [0, 0, 0, 0],
        [0, 131558114200 / 32700410799, -68118460800 / 10900136933, 87487479700 / 32700410799],
        [0, -1754552775 / 470086768, 14199869525 / 1410260304, -10690763975 / 1880347072],
        [0, 127303824393 / 49829197408, -318862633887 / 49829197408, 701980252875 / 199316789632],
        [0, -282668133 / 205662961, 2019193451 / 616988883, -1453857185 / 822651844],
        [0, 40617522 / 29380423, -110615467 / 29380423, 69997945 / 29380423],
    ]
)

SMALLEST_SCALE = np.array([1e-5, 1e-2, 1e-2, 1e-2, 1e-1])
"""Below these sizes (m, m/s, –, –, K), a hundredth of what a stroke moves, the error is held absolutely."""


@inner
def rates(p, s, work, t, y, stage):
    """Write y' into row `stage` of work.k; y is one of work's states."""
    u, w = coil_state(p, s, t, y[2], y[3], y[4])
    work.k[stage, 0], work.k[stage, 1] = mechanical_rates(p, s, t, y[0], y[1], u, w)
    if work.states > MECHANICAL_STATES:
        work.k[stage, 2], work.k[stage, 3], work.k[stage, 4] = heating_rates(p, s, u, w, y[4])


@inner
def try_step(p, s, work, h):
    """One trial step of size h, s, from work.y; work.k[0] holds y' there. Writes work.y_new and work.k."""
    if work.states == MECHANICAL_STATES:
        _try_mechanical_step(p, s, work, h)
    else:
        _try_heated_step(p, s, work, h)


@inner
def _try_mechanical_step(p, s, work, h):
    """The step of x and v alone, without a loop: nearly all of a run's time is spent here."""
    t, k = s.time, work.k
    x, v = work.y[0], work.y[1]
    x1, v1 = k[0, 0], k[0, 1]
    u, w = coil_current_between_commands(p, s, t + C2 * h)
    x2, v2 = mechanical_rates(p, s, t + C2 * h, x + h * (A21 * x1), v + h * (A21 * v1), u, w)
    u, w = coil_current_between_commands(p, s, t + C3 * h)
    x3, v3 = mechanical_rates(p, s, t + C3 * h, x + h * (A31 * x1 + A32 * x2), v + h * (A31 * v1 + A32 * v2), u, w)
    u, w = coil_current_between_commands(p, s, t + C4 * h)
    stage_x = x + h * (A41 * x1 + A42 * x2 + A43 * x3)
    stage_v = v + h * (A41 * v1 + A42 * v2 + A43 * v3)
    x4, v4 = mechanical_rates(p, s, t + C4 * h, stage_x, stage_v, u, w)
    u, w = coil_current_between_commands(p, s, t + C5 * h)
    stage_x = x + h * (A51 * x1 + A52 * x2 + A53 * x3 + A54 * x4)
    stage_v = v + h * (A51 * v1 + A52 * v2 + A53 * v3 + A54 * v4)
    x5, v5 = mechanical_rates(p, s, t + C5 * h, stage_x, stage_v, u, w)
    u, w = coil_current_between_commands(p, s, t + h)
    stage_x = x + h * (A61 * x1 + A62 * x2 + A63 * x3 + A64 * x4 + A65 * x5)
    stage_v = v + h * (A61 * v1 + A62 * v2 + A63 * v3 + A64 * v4 + A65 * v5)
    x6, v6 = mechanical_rates(p, s, t + h, stage_x, stage_v, u, w)
    x_new = x + h * (B1 * x1 + B3 * x3 + B4 * x4 + B5 * x5 + B6 * x6)
    v_new = v + h * (B1 * v1 + B3 * v3 + B4 * v4 + B5 * v5 + B6 * v6)
    k[6, 0], k[6, 1] = mechanical_rates(p, s, t + h, x_new, v_new, u, w)
    k[1, 0], k[2, 0], k[3, 0], k[4, 0], k[5, 0] = x2, x3, x4, x5, x6
    k[1, 1], k[2, 1], k[3, 1], k[4, 1], k[5, 1] = v2, v3, v4, v5, v6
    work.y_new[0] = x_new
    work.y_new[1] = v_new


@inner
def _try_heated_step(p, s, work, h):
    """The step of x, v, u, w and T."""
    t = s.time
    k, y, y_stage, y_new = work.k, work.y, work.y_stage, work.y_new
    for j in range(work.states):
        y_stage[j] = y[j] + h * (A21 * k[0, j])
    rates(p, s, work, t + C2 * h, y_stage, SECOND)
    for j in range(work.states):
        y_stage[j] = y[j] + h * (A31 * k[0, j] + A32 * k[1, j])
    rates(p, s, work, t + C3 * h, y_stage, THIRD)
    for j in range(work.states):
        y_stage[j] = y[j] + h * (A41 * k[0, j] + A42 * k[1, j] + A43 * k[2, j])
    rates(p, s, work, t + C4 * h, y_stage, FOURTH)
    for j in range(work.states):
        y_stage[j] = y[j] + h * (A51 * k[0, j] + A52 * k[1, j] + A53 * k[2, j] + A54 * k[3, j])
    rates(p, s, work, t + C5 * h, y_stage, FIFTH)
    for j in range(work.states):
        y_stage[j] = y[j] + h * (A61 * k[0, j] + A62 * k[1, j] + A63 * k[2, j] + A64 * k[3, j] + A65 * k[4, j])
    rates(p, s, work, t + h, y_stage, SIXTH)
    for j in range(work.states):
        y_new[j] = y[j] + h * (B1 * k[0, j] + B3 * k[2, j] + B4 * k[3, j] + B5 * k[4, j] + B6 * k[5, j])
    rates(p, s, work, t + h, y_new, LAST)


@inner
def error_norm(work, h, tolerance):
    """Root mean square of the error in units of the tolerance (Hairer II.4.11); above 1 the step is refused."""
    total = 0.0
    k = work.k
    for j in range(work.states):
        error = h * (E1 * k[0, j] + E3 * k[2, j] + E4 * k[3, j] + E5 * k[4, j] + E6 * k[5, j] + E7 * k[6, j])
        ratio = error / (tolerance * max(abs(work.y[j]), abs(work.y_new[j]), SMALLEST_SCALE[j]))
        total += ratio * ratio
    return math.sqrt(total / work.states)


@inner
def step_factor(error):
    """What to multiply a step by after its error, in units of the tolerance.

    The exponent of an elementary controller is 1/5 (Hairer II.4.13). With 1/4 it settles as surely, since the error
    goes with the fifth power of the step (1 − 5/4 is well inside the unit circle), and two square roots are faster.
    """
    return 0.9 / math.sqrt(math.sqrt(error))


@inner
def fill_dense(work):
    """Work out the dense-output coefficients of the step just taken."""
    for j in range(work.states):
        for power in range(4):
            total = _DENSE[0, power] * work.k[0, j]
            for i in range(2, STAGES):
                total += _DENSE[i, power] * work.k[i, j]
            work.dense[j, power] = total


@inlined
def interpolate(work, h, j, theta):
    """State j at the fraction theta of a step of size h, from its dense output."""
    slopes = work.dense[j, 1] + theta * (work.dense[j, 2] + theta * work.dense[j, 3])
    return work.y[j] + h * theta * (work.dense[j, 0] + theta * slopes)


@inlined
def dense_slope(work, j, theta):
    """Derivative of state j with respect to time at the fraction theta of a step, from its dense output."""
    slopes = 2.0 * work.dense[j, 1] + theta * (3.0 * work.dense[j, 2] + theta * 4.0 * work.dense[j, 3])
    return work.dense[j, 0] + theta * slopes
