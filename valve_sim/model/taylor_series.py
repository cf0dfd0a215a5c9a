"""Motion without effects as a Taylor series: one long step of high order where the pull and (3), (4) are polynomials.

With the pulling current a sum of two exponentials, w = T + A e^{−t/τ} + B e^{−t/τ_e}, the coefficients of x follow
from each other: those of products by Cauchy's rule, that of x'' from (3) or (4),

    (k + 1)(k + 2) m x_{k+2} = Σ_j s_j g_{k−j} − r x_k − c (k + 1) x_{k+1} − L δ_{k0},
    s = w²,  g = a0 + a1 x + a2 x² + a3 x³,

where L is what neither moves nor pulls: seat load or preload, and dry friction, which is constant while the plungers
slide one way. An opening takes 13 steps where the Dormand–Prince pair, by which all else moves, takes 47.

Source: À. Jorba and M. Zou, Experimental Mathematics 14 (2005) 99–117 (recurrences, choice of the step).
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.equations import (
    NEARLY_EQUAL,
    coil_decay,
    eddy_decay,
    has_pull_of_effects,
    is_plain,
    phase_of,
    sliding_friction,
)
from valve_sim.model.flux import SHORTEST_INTEGRATED
from valve_sim.model.taylor_coefficients import ORDER, coefficients

SAFETY: Final = 1.1
"""Of the step at which the last terms are as large as the tolerance: what is left out is smaller than these."""


@inlined
def is_series(p):
    """Whether a valve without gas, whose coil has a closed form, moves as this page says, and shows where it is."""
    coil, eddies = p.coil_time_constant, p.eddy_time_constant
    apart = 1.0 - eddies / coil if coil > 0.0 else 1.0
    is_slow = (coil == 0.0 or coil >= SHORTEST_INTEGRATED) and (eddies == 0.0 or eddies >= SHORTEST_INTEGRATED)
    is_smooth = is_slow and abs(apart) >= NEARLY_EQUAL
    is_shown = p.sensor_time_constant == 0.0
    return is_plain(p) and not has_pull_of_effects(p) and p.residual_current == 0.0 and is_smooth and is_shown


@inner
def expand(p, s, work):
    """Write the series about the state, in motion, into work.series."""
    elapsed = s.time - s.segment_time
    target = s.seen / p.reference_voltage
    current, rate, eddies, eddy_rate = 0.0, 0.0, 0.0, 0.0
    if p.coil_time_constant > 0.0:
        current, rate = s.segment_u - target, 1.0 / p.coil_time_constant
    if p.eddy_time_constant > 0.0:
        eddy_rate = 1.0 / p.eddy_time_constant
        # (9) under the exponential of (1): its share of that, and what began otherwise.
        current /= 1.0 - p.eddy_time_constant * rate
        eddies = (s.segment_w - target - current) * eddy_decay(p, elapsed)
    current *= coil_decay(p, elapsed)
    load, spring, damping, per_mass = phase_of(p, s.mode)
    load += s.direction * sliding_friction(p, s.direction)
    coefficients(
        work.series, work.velocity_series, (work.y[0], work.y[1]), (target, current, rate, eddies, eddy_rate),
        (p.a0, p.a1, p.a2, p.a3), (load, spring, damping, per_mass),
    )  # fmt: skip


@inlined
def series_step(work, of_x, of_v, longest):
    """The step, s, at which the last terms of v are as large as its tolerance, or `longest`; NaN if they overflow.

    The last two, since a series of even terms alone would have a last one of 0. An error of v over a step stands for
    one of x that is ORDER times smaller.

    Args:
        of_x, of_v: tolerances, m and m/s. longest: s.
    """
    tolerance = min(of_v, ORDER * of_x / longest)
    last = math.log(abs(work.velocity_series[ORDER - 1]) / tolerance)
    before = math.log(abs(work.velocity_series[ORDER - 2]) / tolerance)
    if math.isnan(last + before):
        return math.nan  # a minimum would not say so
    return min(longest, SAFETY * math.exp(min(-last / (ORDER - 1), -before / (ORDER - 2))))


@inlined
def position_after(work, time):
    """Position of x so long after the start of the step, m."""
    total = work.series[ORDER]
    for k in range(ORDER - 1, -1, -1):
        total = work.series[k] + time * total
    return total


@inlined
def velocity_after(work, time):
    """Its derivative, m/s."""
    total = work.velocity_series[ORDER - 1]
    for k in range(ORDER - 2, -1, -1):
        total = work.velocity_series[k] + time * total
    return total


@inlined
def acceleration_after(work, time):
    """Its second derivative, m/s²."""
    total = (ORDER - 1) * work.velocity_series[ORDER - 1]
    for k in range(ORDER - 2, 0, -1):
        total = k * work.velocity_series[k] + time * total
    return total
