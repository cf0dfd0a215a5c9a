"""The valve's equations, linearised: derivatives of the net force to state, coil and parameters, compiled.

Symbols and equation numbers are those of `equations`. Every derivative stands under the name of what it is to: of the
valve's record, of the state, or of a condition under which the present interval began. So `g.spring_rate = −x` reads:
the force of (4) falls by x for each N/m. Compiled terms f_j of (5), a user's among them, need no derivatives of their
own: difference quotients of the term alone stand for them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN, MAXIMUM_TERM_PARAMETERS, MAXIMUM_TERMS
from valve_sim.model.effects.record import VALVE_RECORD
from valve_sim.model.gas import calls
from valve_sim.model.gas.equations import (
    FORCES,
    PULLS,
    acceleration,
    attraction,
    coil_decay,
    decayed_coil,
    eddy_decay,
    eddy_share,
    is_plain,
    phase_of,
    pull_squared,
)
from valve_sim.model.gas.record import SLOPES_OF_GAS

PARAMETERS: Final = tuple(name for name in VALVE_RECORD.names or () if VALVE_RECORD[name] == np.float64)
"""Every number of a valve's record except those that terms read."""
CONDITIONS: Final = ("target", "segment_time", "segment_u", "segment_w", "unseated_time", "peak_current")
"""What the forces depend on besides state and time: the target of u since the last command, when that was, and u and w
then; when the pilot last left its seat; the largest |u| so far."""
_STATE: Final = ("x", "v", "t", "force", "per_mass")


def _slopes_record() -> np.dtype[np.void]:
    names = (*PARAMETERS, "terms", *CONDITIONS, *_STATE)
    formats = [("f8", (MAXIMUM_TERMS, MAXIMUM_TERM_PARAMETERS)) if name == "terms" else "f8" for name in names]
    sizes = [np.dtype(form).itemsize for form in formats]
    places = [sum(sizes[:index]) for index in range(len(names) + 1)]
    end = places.pop()
    asked = ("i8", (MAXIMUM_TERMS, MAXIMUM_TERM_PARAMETERS))
    after: dict[str, Any] = {"all": ("f8", (end // 8,)), "asked": asked, "asks_effects": "i8", "asks_shapes": "i8"}
    after |= SLOPES_OF_GAS
    sizes = [0, *(np.dtype(form).itemsize for name, form in after.items() if name != "all")]
    return np.dtype(
        {
            "names": [*names, *after],
            "formats": [*formats, *after.values()],
            "offsets": [*places, 0, *(end + sum(sizes[: index + 1]) for index in range(len(sizes) - 1))],
        }
    )


SLOPES_RECORD: Final = _slopes_record()
"""Derivatives of the net force, N over the unit of what each is to.

`terms` holds those to the numbers that compiled terms read; `asked` is 1 for those that are needed. `all` is
the same memory as everything before it. `force` times `per_mass` is the acceleration. `asks_effects` is 1 if
any of `OF_EFFECTS` is needed, `asks_shapes` if any of `SHAPES`, which take an exponential each. What follows is of
gas, see `gas.record`.
"""

FIRST_CONDITION: Final = len(PARAMETERS) + MAXIMUM_TERMS * MAXIMUM_TERM_PARAMETERS
"""Index in `all` of the first condition; the numbers of terms are before it."""
TARGET, SEGMENT_TIME, SEGMENT_U, SEGMENT_W, UNSEATED_TIME, PEAK_CURRENT = np.arange(len(CONDITIONS))

OF_EFFECTS: Final = tuple(name for effect in FORCES for name in effect.fields)
"""Numbers of the forces of effects, which most runs have none of."""
SHAPES: Final = ("breakaway", "pressure_force")

QUOTIENT: Final = 1e-6
"""Relative step of a difference quotient to a number that a term reads."""
QUOTIENT_AT_ZERO: Final = 1e-9
"""The step where the number is 0."""
FINE_QUOTIENT: Final = 1e-7
"""Step to x, in strokes, to v, m/s, to u, and to τ, relative: rounding and curvature leave nine digits."""
TIME_QUOTIENT: Final = 1e-9
"""Step to t, s."""


call_term: Any = calls.call_term


def _each(functions: Sequence[Any]) -> Any:
    """One compiled function in which each of many adds its derivatives."""
    if not functions:
        return inlined(lambda p, g, t, motion, coil, condition: None)
    first, rest = functions[0], _each(functions[1:])

    def both(p: Any, g: Any, t: Any, motion: Any, coil: Any, condition: Any) -> None:
        first(p, g, t, motion, coil, condition)
        rest(p, g, t, motion, coil, condition)

    return inlined(both)


_add_slopes_of_effects: Final = _each([effect.core_force_slopes for effect in FORCES])
(_pull_slope_of_effects,) = [effect.core_pull_slope for effect in PULLS]


@inner
def force_slopes(p, s, g, t, x, v):
    """Differentiate the right-hand side of (3) or (4) with its dry friction (6), of plungers in motion.

    Args:
        p: valve record. s: state record: mode, direction and conditions. g: `SLOPES_RECORD`, written.
        t: s. x, v: m, m/s.
    """
    elapsed = t - s.segment_time
    decay = coil_decay(p, elapsed)
    u, w = decayed_coil(p, s, elapsed, (decay, eddy_decay(p, elapsed)))
    peak = max(s.peak_current, abs(u))
    pull2 = pull_squared(p, w, peak)
    condition = (s.mode, s.direction, s.unseated_time)
    per_pull = attraction(p, x, 1.0)
    plain = is_plain(p)
    phase = phase_of(p, s.mode)
    g.per_mass = phase[3]
    rate = acceleration(p, phase, t, (x, v), (u, pull2), condition, plain)
    g.force = rate / g.per_mass
    # (2)
    g.a0, g.a1, g.a2, g.a3 = pull2, pull2 * x, pull2 * x * x, pull2 * x * x * x
    g.x = pull2 * (p.a1 + x * (2.0 * p.a2 + x * 3.0 * p.a3))
    # (3) and (4)
    in_phase_2 = 1.0 if s.mode >= MAIN else 0.0
    in_phase_1 = 1.0 - in_phase_2
    g.spring_preload, g.spring_rate, g.main_damping = -in_phase_2, -in_phase_2 * x, -in_phase_2 * v
    g.seat_load, g.pilot_damping = -in_phase_1, -in_phase_1 * v
    g.x -= in_phase_2 * p.spring_rate
    g.v = -(in_phase_2 * p.main_damping + in_phase_1 * p.pilot_damping)
    g.moving_mass, g.pilot_mass = -in_phase_2 * rate, -in_phase_1 * rate
    # (5)
    g.unseated_time, g.t = 0.0, 0.0
    if not plain or g.asks_effects != 0:
        _add_slopes_of_effects(p, g, t, (x, v), (u, pull2), condition)
    to_u = _add_term_slopes(p, g, s.mode, (x, v, u, t)) if p.term_count > 0 else 0.0
    _friction_slopes(p, g, v, s.direction)
    to_u_of_pull, to_w = _pull_slopes(p, s, g, u, w, per_pull)
    coil_slopes_since(p, s, g, (elapsed, decay), to_u + to_u_of_pull, to_w)


@inlined
def _friction_slopes(p, g, v, direction):
    """Equation (6)."""
    g.friction_opening = -1.0 if direction > 0 else 0.0
    g.friction_closing = 1.0 if direction < 0 else 0.0
    g.breakaway, g.stribeck_velocity = 0.0, 0.0
    if p.breakaway == 0.0 and g.asks_shapes == 0:
        return
    ratio = v / p.stribeck_velocity
    g.breakaway = -direction * math.exp(-ratio * ratio)
    by_ratio = -2.0 * ratio * g.breakaway * p.breakaway
    g.v += by_ratio / p.stribeck_velocity
    g.stribeck_velocity = -by_ratio * ratio / p.stribeck_velocity


@inlined
def _pull_slopes(p, s, g, u, w, per_pull):
    """Equations (7) and (8). Returns the derivatives to u, by way of the peak current, and to w."""
    peak = max(s.peak_current, abs(u))
    floor = p.residual_current * min(1.0, peak)
    pull = max(abs(w), floor)
    per_square = _pull_slope_of_effects(p, g, pull * pull, per_pull)
    to_pull = per_pull * per_square * 2.0 * pull
    g.residual_current, g.peak_current = 0.0, 0.0
    if s.held_by_residual == 0:  # also at the very end of the step that this ends
        return 0.0, to_pull if w >= 0.0 else -to_pull
    g.residual_current = to_pull * min(1.0, peak)
    to_peak = to_pull * p.residual_current if peak < 1.0 else 0.0
    if abs(u) > s.peak_current:
        return (to_peak if u >= 0.0 else -to_peak), 0.0
    g.peak_current = to_peak
    return 0.0, 0.0


@inlined
def coil_slopes(p, s, g, t, to_u, to_w):
    """Differentiate (1) and (9), between commands, of a coil that does not heat.

    Args:
        p, s, g, t: as of `force_slopes`. to_u, to_w: the weights of the derivatives of u and of w.
    """
    elapsed = t - s.segment_time
    coil_slopes_since(p, s, g, (elapsed, coil_decay(p, elapsed)), to_u, to_w)


@inlined
def coil_slopes_since(p, s, g, since, to_u, to_w):
    """The same, given the time since the last command and the coil's decay meanwhile."""
    elapsed, decay = since
    target, tau, tau_e = s.volts / p.reference_voltage, p.coil_time_constant, p.eddy_time_constant
    if tau_e == 0.0:
        to_u += to_w
        to_w = 0.0
    from_target = (s.segment_u - target) * decay
    g.target, g.segment_u, g.segment_w = to_u * (1.0 - decay), to_u * decay, 0.0
    g.segment_time, g.coil_time_constant, g.eddy_time_constant = 0.0, 0.0, 0.0
    if tau > 0.0:
        g.segment_time = to_u * from_target / tau
        g.coil_time_constant = g.segment_time * elapsed / tau
    if tau_e > 0.0 and to_w != 0.0:
        left = eddy_decay(p, elapsed)
        share = 0.0
        if tau > 0.0:
            share = eddy_share(tau, tau_e, elapsed, decay, left)
            step = 1e-5 * tau
            above = eddy_share(tau + step, tau_e, elapsed, math.exp(-elapsed / (tau + step)), left)
            below = eddy_share(tau - step, tau_e, elapsed, math.exp(-elapsed / (tau - step)), left)
            share_by_tau = (above - below) / (2.0 * step)
            # The share does not change where all three times are scaled alike.
            share_by_tau_e = -(elapsed * (decay - share) / tau_e + tau * share_by_tau) / tau_e
            g.coil_time_constant += to_w * (s.segment_u - target) * share_by_tau
            g.eddy_time_constant += to_w * (s.segment_u - target) * share_by_tau_e
        w_from_target = (s.segment_w - target) * left
        g.eddy_time_constant += to_w * w_from_target * elapsed / (tau_e * tau_e)
        u_from_w = from_target - w_from_target - (s.segment_u - target) * share
        g.segment_time -= to_w * u_from_w / tau_e
        g.segment_u += to_w * share
        g.segment_w = to_w * left
        g.target += to_w * (1.0 - share - left)
    g.reference_voltage = 0.0  # acts through the target


@inner
def _add_term_slopes(p, g, mode, at):
    """The compiled terms of (5), by central difference quotients. Returns their derivative to u."""
    x, v, u, t = at
    dx, d = FINE_QUOTIENT * p.stroke, FINE_QUOTIENT
    to_u = 0.0
    for j in range(p.term_count):
        acts = mode >= MAIN or p.term_in_phase_2_only[j] == 0
        f, numbers = p.term_address[j], p.term_parameters[j]
        if acts:
            g.x += (call_term(f, x + dx, v, u, t, numbers) - call_term(f, x - dx, v, u, t, numbers)) / (2.0 * dx)
            g.v += (call_term(f, x, v + d, u, t, numbers) - call_term(f, x, v - d, u, t, numbers)) / (2.0 * d)
            to_u += (call_term(f, x, v, u + d, t, numbers) - call_term(f, x, v, u - d, t, numbers)) / (2.0 * d)
        for i in range(MAXIMUM_TERM_PARAMETERS):
            if g.asked[j, i] == 0:
                continue
            g.terms[j, i] = 0.0
            if acts:
                number = numbers[i]
                step = QUOTIENT * abs(number) if number != 0.0 else QUOTIENT_AT_ZERO
                numbers[i] = number + step
                above = call_term(f, x, v, u, t, numbers)
                numbers[i] = number - step
                g.terms[j, i] = (above - call_term(f, x, v, u, t, numbers)) / (2.0 * step)
                numbers[i] = number
    return to_u


@inner
def add_term_time_slopes(p, g, mode, at):
    """The same to t, where a rest ends because time passes."""
    x, v, u, t = at
    for j in range(p.term_count):
        if mode >= MAIN or p.term_in_phase_2_only[j] == 0:
            f, numbers = p.term_address[j], p.term_parameters[j]
            above = call_term(f, x, v, u, t + TIME_QUOTIENT, numbers)
            g.t += (above - call_term(f, x, v, u, t - TIME_QUOTIENT, numbers)) / (2.0 * TIME_QUOTIENT)
