"""Motion as a Taylor series: one long step of high order where the pull and (3), (4) are polynomials.

With the pulling current a sum of two exponentials, w = T + A e^{−t/τ} + B e^{−t/τ_e}, the coefficients of x follow
from each other: those of products by Cauchy's rule, that of x'' from (3) or (4),

    (k + 1)(k + 2) m x_{k+2} = Σ_j s_j g_{k−j} − r x_k − c (k + 1) x_{k+1} − L δ_{k0},
    s = w²,  g = a0 + a1 x + a2 x² + a3 x³,

where L is what neither moves nor pulls: seat load or preload, and dry friction, which is constant while the plungers
slide one way. An opening takes 13 steps where the Dormand–Prince pair, by which all else moves, takes 47.

Forces of effects take part where all of them are of a `Form`: constant or growing with v, which changes L or c, or
D v² + K x³ + P e^{−t/τ_p}, whose coefficients are added. So does saturation (7), with z in place of s:

    z (1 + κ s) = (1 + κ) s,    (1 + κ s_0) z_k = (1 + κ) s_k − κ Σ_{j>0} s_j z_{k−j}.

No force is written a second time: D, K and P are what its own function gives for 1 m/s, 1 m and the start of the step.

Source: À. Jorba and M. Zou, Experimental Mathematics 14 (2005) 99–117 (recurrences, choice of the step).
"""

from __future__ import annotations

import math
from typing import Any, Final

from valve_sim.model import calls
from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN
from valve_sim.model.effects.entry import Form
from valve_sim.model.equations import (
    FORCES,
    NEARLY_EQUAL,
    PULLS,
    any_is_on,
    coil_decay,
    eddy_decay,
    is_plain,
    phase_of,
    sliding_friction,
    summed,
)
from valve_sim.model.flux import SHORTEST_INTEGRATED
from valve_sim.model.taylor_coefficients import ORDER, coefficients
from valve_sim.model.taylor_with_effects import coefficients_with_effects

call_term: Any = calls.call_term

SAFETY: Final = 1.1
"""Of the step at which the last terms are as large as the tolerance: what is left out is smaller than these."""

_CONSTANT, _OF_V, _OF_V_SQUARED, _OF_X_CUBED, _DECAYING = (
    summed([effect.core_force for effect in FORCES if effect.form is form]) for form in Form
)
"""The core's forces of each form."""
(_TIME_CONSTANT,) = [effect.decays_over for effect in FORCES if effect.form is Form.DECAYING]
(_SATURATION,) = [effect.saturates_by for effect in PULLS if effect.saturates_by]
_has_force_without_form: Final = any_is_on([effect for effect in FORCES if effect.form is None])
_has_pull_without_form: Final = any_is_on([effect for effect in PULLS if not effect.saturates_by])


@inlined
def _has_forms(p):
    """Whether all forces and pulls of the effects are of forms that are known here."""
    for j in range(p.term_count):
        if p.term_form[j] == 0:
            return False
    return p.breakaway == 0.0 and not _has_force_without_form(p) and not _has_pull_without_form(p)


@inlined
def is_series(p):
    """Whether a valve without gas, whose coil has a closed form, moves as this page says, and shows where it is."""
    coil, eddies = p.coil_time_constant, p.eddy_time_constant
    apart = 1.0 - eddies / coil if coil > 0.0 else 1.0
    is_slow = (coil == 0.0 or coil >= SHORTEST_INTEGRATED) and (eddies == 0.0 or eddies >= SHORTEST_INTEGRATED)
    is_smooth = is_slow and abs(apart) >= NEARLY_EQUAL
    is_shown = p.sensor_time_constant == 0.0
    return _has_forms(p) and p.residual_current == 0.0 and is_smooth and is_shown


@inlined
def has_effects(p):
    """Whether effects take part in the series, dry friction aside."""
    return p[_SATURATION] != 0.0 or not is_plain(p)


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
    start, attraction = (work.y[0], work.y[1]), (p.a0, p.a1, p.a2, p.a3)
    coil = (target, current, rate, eddies, eddy_rate)
    load, spring, damping, per_mass = phase_of(p, s.mode)
    load += s.direction * sliding_friction(p, s.direction)
    if work.has_effects:
        constant, of_v, effects = _forces_by_form(p, s)
        motion = (load - constant, spring, damping - of_v, per_mass)
        coefficients_with_effects(work.series, work.velocity_series, start, coil, attraction, motion, effects)
    else:
        motion = (load, spring, damping, per_mass)
        coefficients(work.series, work.velocity_series, start, coil, attraction, motion)


@inlined
def _forces_by_form(p, s):
    """The forces of the effects by form: what they are now, or for each unit of what they grow with.

    The equations' own functions say so: the forces are asked for at 1 m, and at 1 m/s in the direction of motion.

    Returns:
        N of those that are constant; N·s/m of those that grow with v; the rest as `coefficients_with_effects` takes it.
    """
    way = 1.0 * s.direction
    condition, motion, coil = (s.mode, s.direction, s.unseated_time), (1.0, way), (0.0, 0.0)
    constant = _CONSTANT(p, s.time, motion, coil, condition)
    of_v = _OF_V(p, s.time, motion, coil, condition)
    of_v_squared = _OF_V_SQUARED(p, s.time, motion, coil, condition)
    of_x_cubed = _OF_X_CUBED(p, s.time, motion, coil, condition)
    decaying = _DECAYING(p, s.time, motion, coil, condition)
    for j in range(p.term_count):
        if s.mode >= MAIN or p.term_in_phase_2_only[j] == 0:
            force = call_term(p.term_address[j], 1.0, way, 0.0, s.time, p.term_parameters[j])
            form = p.term_form[j]
            constant += force if form == Form.CONSTANT else 0.0
            of_v += force if form == Form.OF_V else 0.0
            of_v_squared += force if form == Form.OF_V_SQUARED else 0.0
            of_x_cubed += force if form == Form.OF_X_CUBED else 0.0
    rate, saturation = 1.0 / p[_TIME_CONSTANT], p[_SATURATION]
    return constant, of_v * way, (of_v_squared, of_x_cubed, decaying, rate, saturation)


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
