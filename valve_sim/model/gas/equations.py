"""The valve's equations. This page is what is compiled.

Symbols and equation numbers:

    (1)  τ u' = V/V_ref − u                                      coil
    (2)  F_a(x, u) = u² (a0 + a1 x + a2 x² + a3 x³)              attraction
    (3)  Phase 1:  m_1 v' = F_a − F_seat − c_1 v + Σ effects     the paper's equation for 0 ≤ t ≤ t1
    (4)  Phase 2:  m_2 v' = F_a − F_0 − k x − c_2 v + Σ effects  the paper's equation for t1 ≤ t ≤ t2

Effects that are part of the hybrid automaton or of the coil are here, with numbers. The forces of all others are in
their own files: (5) adds those of the core, g_i, and compiled terms f_j, wherever these were registered.

    (5)  Σ effects = Σ_i g_i(x, v, u, t, mode, direction, t_o) + Σ_j f_j(x, v, u, t)
    (6)  dry friction: F_± + F_b exp(−(v/v_s)²) against the motion; at rest it holds up to F_± + F_b
    (7)  saturation: the effects replace u² by h_i(u²), one after the other
    (8)  residual magnetism: the u that pulls never falls below u_r min(1, max |u| so far)
    (9)  eddy currents: τ_e w' = u − w; w pulls, u is measured
    (10) heating: T' = q u² − T/τ_c; R/R_0 = 1 + α T divides u's target and τ in (1)

Here τ_c is the cooling time constant and t_o the time when the pilot last left its seat. A valve with one plunger has
a pilot gap of 0, no Phase 1, and leaves its seat when the net force of (4) exceeds F_seat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN
from valve_sim.model.effects.catalogue import shipped
from valve_sim.model.effects.entry import Effect
from valve_sim.model.gas.calls import call_term
from valve_sim.model.gas.flux import (
    COPPER_TEMPERATURE_COEFFICIENT,
    SHORTEST_INTEGRATED,
    current_rate,
    flux_rate,
    follows_flux,
    terminal_current,
)


def summed(forces: Sequence[Any]) -> Any:
    """One compiled function for the sum of many, nothing for none."""
    if not forces:
        return inlined(lambda p, t, motion, coil, condition: 0.0)
    first, rest = forces[0], summed(forces[1:])
    return inlined(
        lambda p, t, motion, coil, condition: first(p, t, motion, coil, condition) + rest(p, t, motion, coil, condition)
    )


def _chained(pulls: Sequence[Any]) -> Any:
    """One compiled function that applies many, one after the other."""
    if not pulls:
        return inlined(lambda p, squared: squared)
    first, rest = pulls[0], _chained(pulls[1:])
    return inlined(lambda p, squared: rest(p, first(p, squared)))


def _any_differs(fields: Sequence[tuple[str, float]]) -> Any:
    """One compiled function that tells whether a field of a record has another value than its neutral one."""
    if not fields:
        return inlined(lambda p: False)
    (name, neutral), rest = fields[0], _any_differs(fields[1:])
    return inlined(lambda p: p[name] != neutral or rest(p))


_OF_DRY_FRICTION: Final = ("friction_opening", "friction_closing")
"""Fields that (6) reads, whichever effects set them."""


def any_is_on(effects: Sequence[Effect]) -> Any:
    """One compiled function that tells whether a record has any of these effects, but for the dry friction of (6)."""
    fields = [field for effect in effects for field in effect.fields.items() if field[0] not in _OF_DRY_FRICTION]
    return _any_differs(fields)


FORCES: Final = [effect for effect in shipped() if effect.core_force is not None]
PULLS: Final = [effect for effect in shipped() if effect.core_pull is not None]
_has_force_of_effects: Final = any_is_on(FORCES)
_force_of_effects: Final = summed([effect.core_force for effect in FORCES])
_pull_of_effects: Final = _chained([effect.core_pull for effect in PULLS])

NO_TIME: Final = 1e-300
"""s: the reciprocal of a shorter time constant overflows, and 0 s of it would be NaN."""
NEARLY_EQUAL: Final = 0.1
"""Relative difference of two time constants below which the difference of their exponentials loses digits at first."""


@inlined
def attraction(p, x, pull_squared):
    """F_a of equation (2), N, given u² after (7) and (8)."""
    return pull_squared * (p.a0 + x * (p.a1 + x * (p.a2 + x * p.a3)))


@inlined
def residual_floor(p, peak_current):
    """The smallest u that pulls, equation (8)."""
    return p.residual_current * min(1.0, peak_current)


@inlined
def pull_squared(p, w, peak_current):
    """The u² of equation (2), after residual magnetism (8) and saturation (7)."""
    pull = max(abs(w), residual_floor(p, peak_current))
    return _pull_of_effects(p, pull * pull)


@inner
def compiled_terms(p, mode, x, v, u, t):
    """The terms f_j(x, v, u, t) of (5), N."""
    force = 0.0
    for j in range(p.term_count):
        if mode >= MAIN or p.term_in_phase_2_only[j] == 0:
            force += call_term(p.term_address[j], x, v, u, t, p.term_parameters[j])  # type: ignore[call-arg]
    return force


@inlined
def has_one_plunger(p):
    """Whether that is all the valve has: (4) alone, from its seat at x = 0, where F_seat holds it too, to the stop."""
    return p.pilot_gap == 0.0


@inlined
def phase_of(p, mode):
    """What tells (4) from (3): load, N; spring rate, N/m; damping, N·s/m; 1/mass, 1/kg, for no stage to divide."""
    if mode >= MAIN:
        return p.spring_preload, p.spring_rate, p.main_damping, 1.0 / p.moving_mass
    return p.seat_load, 0.0, p.pilot_damping, 1.0 / p.pilot_mass


@inlined
def net_force(p, phase, x, v, pull2, effects):
    """Right-hand sides of (3) and (4), N, given the forces of the effects.

    What waits longest is added last: a stage has its velocity after its position, and all else before.
    """
    load, rate, damping, _ = phase
    return attraction(p, x, pull2) + (effects - load - rate * x) - damping * v


@inlined
def forces_of_effects(p, t, motion, coil, condition):
    """Sum (5), N; arguments as of `force_without_dry_friction`."""
    force = _force_of_effects(p, t, motion, coil, condition)
    if p.term_count > 0:
        force += compiled_terms(p, condition[0], motion[0], motion[1], coil[0], t)
    return force


@inlined
def force_without_dry_friction(p, t, motion, coil, condition):
    """Right-hand sides of (3) and (4), N, with (5); the dry friction of (6) is the caller's.

    Args:
        p: valve record. t: s. motion: (x, v), m and m/s. coil: (u, u²), the current and, after (7) and (8), the
            square that pulls. condition: (mode, direction, when the pilot last left its seat).
    """
    effects = forces_of_effects(p, t, motion, coil, condition)
    return net_force(p, phase_of(p, condition[0]), motion[0], motion[1], coil[1], effects)


@inlined
def sliding_friction(p, direction):
    """F_± of (6), N."""
    return p.friction_opening if direction > 0 else p.friction_closing


@inlined
def dry_friction(p, v, direction):
    """Magnitude of (6), N; it acts against `direction`."""
    level = sliding_friction(p, direction)
    if p.breakaway != 0.0:
        ratio = v / p.stribeck_velocity
        level += p.breakaway * math.exp(-ratio * ratio)
    return level


@inlined
def is_plain(p):
    """Whether the forces of the effects are none but F_± of (6)."""
    return p.term_count == 0 and p.breakaway == 0.0 and not _has_force_of_effects(p)


@inlined
def acceleration(p, phase, t, motion, coil, condition, plain):
    """Acceleration v' of equation (3) or (4) in motion, m/s².

    Args:
        phase: see `phase_of`. plain: see `is_plain`; False is right for all. Others: as for
            `force_without_dry_friction`.
    """
    direction = condition[1]
    if plain:
        effects = -direction * sliding_friction(p, direction)
    else:
        effects = forces_in_motion(p, t, motion, coil, condition)
    return net_force(p, phase, motion[0], motion[1], coil[1], effects) * phase[3]


@inner
def forces_in_motion(p, t, motion, coil, condition):
    """Sum (5) less (6), N; called, because pasted into each stage it is no faster."""
    friction = condition[1] * dry_friction(p, motion[1], condition[1])
    return forces_of_effects(p, t, motion, coil, condition) - friction


@inlined
def eddy_share(tau, tau_e, elapsed, decay, eddy_decay):
    """(τ/(τ − τ_e)) (e^{−t/τ} − e^{−t/τ_e}), also where τ is near τ_e: the response of (9) to (1)."""
    apart = 1.0 - tau_e / tau
    gap = elapsed * apart / tau_e
    if abs(apart) >= NEARLY_EQUAL or abs(gap) >= 1.0:
        return (decay - eddy_decay) * (1.0 / apart)
    share = decay * (-np.expm1(-gap) / gap if gap != 0.0 else 1.0)
    return share * elapsed / tau_e


@inlined
def coil_decay(p, elapsed):
    """The share of the initial value of (1) that is left some time after a command."""
    return math.exp(-elapsed / p.coil_time_constant) if p.coil_time_constant > NO_TIME else 0.0


@inlined
def eddy_decay(p, elapsed):
    """The same of (9)."""
    return math.exp(-elapsed / p.eddy_time_constant) if p.eddy_time_constant > NO_TIME else 0.0


@inlined
def decayed_coil(p, s, elapsed, decays):
    """Solve (1) and (9) for a coil that does not heat: u and w.

    Args:
        p, s: valve and state. elapsed: s, since the last command. decays: `coil_decay` and `eddy_decay` since then.
    """
    target = s.seen / p.reference_voltage
    u = target + (s.segment_u - target) * decays[0]
    if p.eddy_time_constant == 0.0:
        return u, u
    return u, eddy_current(p, s, elapsed, decays)


@inner
def eddy_current(p, s, elapsed, decays):
    """The w of `decayed_coil`, behind an eddy pole."""
    decay, decay_of_eddies = decays
    target = s.seen / p.reference_voltage
    w = target + (s.segment_w - target) * decay_of_eddies
    if p.coil_time_constant > 0.0:
        share = eddy_share(p.coil_time_constant, p.eddy_time_constant, elapsed, decay, decay_of_eddies)
        w += (s.segment_u - target) * share
    return w


@inlined
def coil_that_pulls(p, s, elapsed, decays):
    """The same as (u, u²), the current and the square that pulls."""
    u, w = decayed_coil(p, s, elapsed, decays)
    return u, pull_squared(p, w, max(s.peak_current, abs(u)))


@inner
def coil_current_between_commands(p, s, t):
    """The same at time t."""
    elapsed = t - s.segment_time
    return decayed_coil(p, s, elapsed, (coil_decay(p, elapsed), eddy_decay(p, elapsed)))


@inner
def coil_state(p, s, t, u, w, temperature):
    """The current u and the pulling current w at time t; the last three arguments are integrated while the coil heats.

    If the flux is modelled, w is integrated, and given as u.
    """
    if follows_flux(p):
        return terminal_current(p, s, u, 1.0 + COPPER_TEMPERATURE_COEFFICIENT * temperature), u
    if p.temperature_rate == 0.0:
        return coil_current_between_commands(p, s, t)
    if p.coil_time_constant < SHORTEST_INTEGRATED:
        u = s.seen / p.reference_voltage / (1.0 + COPPER_TEMPERATURE_COEFFICIENT * temperature)
    return u, w if p.eddy_time_constant >= SHORTEST_INTEGRATED else u


@inner
def coil_now(p, s):
    """Give u and w at the state's time."""
    return coil_state(p, s, s.time, s.w if follows_flux(p) else s.u, s.w, s.temperature)


@inner
def acceleration_at(p, s, t, x, v):
    """Acceleration v' in motion at time t, m/s², of a coil with a closed form.

    One function for the end of a step and the start of the next, so that both are one number, to the last bit.
    """
    elapsed = t - s.segment_time
    coil = coil_that_pulls(p, s, elapsed, (coil_decay(p, elapsed), eddy_decay(p, elapsed)))
    phase, condition = phase_of(p, s.mode), (s.mode, s.direction, s.unseated_time)
    if is_plain(p):
        return acceleration(p, phase, t, (x, v), coil, condition, True)
    return acceleration(p, phase, t, (x, v), coil, condition, False)


@inlined
def mechanical_rates(p, s, t, x, v, u, w):
    """Rates x' and v' of (3) and (4); plungers at rest stay there."""
    if not s.moving:
        return 0.0, 0.0
    pull2 = pull_squared(p, w, max(s.peak_current, abs(u)))
    return v, acceleration(p, phase_of(p, s.mode), t, (x, v), (u, pull2), (s.mode, s.direction, s.unseated_time), False)


@inner
def coil_rates(p, s, motion, u, w, temperature):
    """Rates of the integrated states of the coil: u', w' and T' of (1), (9) and (10), or w', nothing and T'.

    Args:
        p, s: valve and state. motion: (x, x'), m and m/s. u, w: –. temperature: K above the start.
    """
    if follows_flux(p):
        resistance_ratio = 1.0 + COPPER_TEMPERATURE_COEFFICIENT * temperature
        dw = current_rate(p, motion[0], motion[1], w, flux_rate(p, s, u, w, resistance_ratio))
        return dw, 0.0, p.temperature_rate * u * u - temperature / p.cooling_time_constant
    return heating_rates(p, s, u, w, temperature)


@inner
def heating_rates(p, s, u, w, temperature):
    """Rates u', w' and T' of (1), (9) and (10) while the coil heats."""
    resistance_ratio = 1.0 + COPPER_TEMPERATURE_COEFFICIENT * temperature
    du = 0.0
    if p.coil_time_constant >= SHORTEST_INTEGRATED:
        du = (s.seen / p.reference_voltage - u * resistance_ratio) / p.coil_time_constant
    dw = (u - w) / p.eddy_time_constant if p.eddy_time_constant >= SHORTEST_INTEGRATED else 0.0
    return du, dw, p.temperature_rate * u * u - temperature / p.cooling_time_constant
