"""The coil as energy conservation gives it: its flux linkage, the voltage that motion induces, and its release.

The work of the attraction must come from the source. With the co-energy of the linear coil and the work of
the attraction at u = 1 from the seat to x, W(x) = ∫ (a0 + a1 ξ + a2 ξ² + a3 ξ³) dξ, and the power P at u = 1,

    (C1)  φ(x, w) = τ w + σ W(x)/P κ'(w)         flux linkage; κ(w) = w², or its saturated form (7); σ the share
    (C2)  φ' = V/V_ref − r u                     r = R/R_0; V is what the coil sees at its terminals
    (C3)  u = w + φ'/ρ,  ρ = τ/τ_e               eddy currents: a resistance parallel to it; w pulls, u is measured
    (C4)  w' = (φ' − φ_x v)/φ_w
    (C5)  freewheeling: V = −V_r while the command is 0 and u > 0. Then the diode blocks: u = 0 and φ' = −ρ w

For u < 0 the signs of (C5) are mirrored. Where `motional_emf` is not declared, (1) and (9) hold in place of (C1) to
(C4).
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from valve_sim.model.compiling import compiled, inlined, inner
from valve_sim.model.effects.magnetic_saturation import co_energy_slopes

COPPER_TEMPERATURE_COEFFICIENT: Final = 0.00393
"""α, 1/K: the resistance of copper at 20 °C (IEC 60028)."""

SHORTEST_INTEGRATED: Final = 2e-8
"""s: while the coil heats, (1) and (9) are integrated; a current that settles faster than this follows at once instead.
Integrating it would take tens of millions of steps a second, and events move by no more than its time constant."""

DRIVEN, FREEWHEELING, BLOCKED = np.array([0, 1, 2])
"""What closes the coil's circuit: its driver, the freewheeling path, or nothing."""

PLACES: Final = 64
"""Places along the stroke at which the flux is checked to grow with the current."""


@inlined
def follows_flux(p):
    """Whether (C1) to (C4) hold. With a share of 0 and without eddy currents they are (1)."""
    return p.flux_linkage != 0.0 and (p.motional_share != 0.0 or p.eddy_time_constant != 0.0)


@inlined
def share_per_power(p):
    """σ/P, 1/W, with the declared power: a gain of the drive changes V alone."""
    return p.motional_share * p.coil_resistance / (p.reference_voltage * p.reference_voltage * p.drive_gain)


@inlined
def work_of_attraction(p, x):
    """W(x), J."""
    return x * (p.a0 + x * (1 / 2 * p.a1 + x * (1 / 3 * p.a2 + x * (1 / 4 * p.a3))))


@inlined
def terminal_current(p, s, w, resistance_ratio):
    """Solve (C2) and (C3) for u."""
    if s.path == BLOCKED:
        return 0.0
    eddy = p.eddy_time_constant / p.coil_time_constant
    return (w + eddy * (s.seen / p.reference_voltage)) / (1.0 + eddy * resistance_ratio)


@inlined
def flux_rate(p, s, u, w, resistance_ratio):
    """Rate of the flux linkage, (C2), or (C5) where the diode blocks, 1/s of τ u."""
    if s.path == BLOCKED:
        if p.eddy_time_constant < SHORTEST_INTEGRATED:
            return 0.0
        return -w * p.coil_time_constant / p.eddy_time_constant
    return s.seen / p.reference_voltage - resistance_ratio * u


@inlined
def terminal_voltage(p, s, w):
    """V at the terminals, V: what the coil sees, or what its flux induces while the diode blocks."""
    if s.path == BLOCKED and follows_flux(p):
        return p.reference_voltage * flux_rate(p, s, 0.0, w, 1.0)
    return s.seen


@inlined
def current_rate(p, x, v, w, rate):
    """Equation (C4), with φ'."""
    share = share_per_power(p)
    slope, curvature = co_energy_slopes(p, w)
    force = p.a0 + x * (p.a1 + x * (p.a2 + x * p.a3))
    return (rate - share * force * slope * v) / (p.coil_time_constant + share * work_of_attraction(p, x) * curvature)


@inner
def is_linear_at_rest(p, s):
    """Whether (C4) has a solution in closed form while the plungers rest: no heating, and no effective saturation."""
    if p.temperature_rate != 0.0:
        return False
    return p.saturation == 0.0 or s.x == 0.0 or s.w == s.seen / p.reference_voltage


@inner
def _at_rest(p, s):
    """The value that w tends to while the plungers rest, and its rate of decay, 1/s."""
    slope = p.coil_time_constant + 2.0 * share_per_power(p) * work_of_attraction(p, s.x)
    eddy = p.eddy_time_constant / p.coil_time_constant
    if s.path == BLOCKED:
        return 0.0, (1.0 / (eddy * slope) if eddy != 0.0 else 0.0)
    return s.seen / p.reference_voltage, 1.0 / ((1.0 + eddy) * slope)


@inner
def resting_current(p, s, elapsed):
    """The current w some seconds after the state's time, while the plungers rest; see `is_linear_at_rest`."""
    target, speed = _at_rest(p, s)
    return target + (s.w - target) * math.exp(-speed * elapsed)


@inlined
def last_pulling_current(p, s):
    """The w at which a freewheeling current u is 0."""
    return -p.eddy_time_constant / p.coil_time_constant * s.seen / p.reference_voltage


@inner
def freewheels_for(p, s, u):
    """Seconds from the state's time until a freewheeling current is 0, where (1) or (C4) has a closed form.

    Args:
        p, s: valve and state. u: the current at the state's time.
    """
    if follows_flux(p):
        target, speed = _at_rest(p, s)
        return math.log((s.w - target) / (last_pulling_current(p, s) - target)) / speed
    target = s.seen / p.reference_voltage
    return p.coil_time_constant * math.log((u - target) / -target)


@inner
def close_circuit(p, s, u):
    """Decide what closes the coil's circuit under the command in force: afresh, but a diode that blocks goes on so.

    Args:
        p, s: valve and state, written. u: the current before, while `s.w` is the current that pulls.
    """
    stays_blocked = s.path == BLOCKED
    s.seen = s.volts
    s.path = DRIVEN
    if p.release_voltage == 0.0 or s.volts != 0.0:
        return
    current = s.w if follows_flux(p) else u
    if not stays_blocked and current != 0.0:
        s.path = FREEWHEELING
        s.seen = -p.release_voltage if current > 0.0 else p.release_voltage
        last = last_pulling_current(p, s) if follows_flux(p) else 0.0
        is_instant = p.coil_time_constant < SHORTEST_INTEGRATED
        if not is_instant and (current - last) * current > 0.0:
            return
    block(p, s)


@inner
def block(p, s):
    """The current has gone and the diode blocks; eddy currents continue, and pull."""
    s.path = BLOCKED
    s.seen = 0.0
    s.u = 0.0
    s.segment_time = s.time
    s.segment_u = 0.0
    if p.eddy_time_constant < SHORTEST_INTEGRATED:
        s.w = 0.0
    s.segment_w = s.w


@inner
def smallest_flux_slope(p):
    """The smallest φ_w of (C1) between seat and stop, at any current, s; above 0 in a valid coil.

    κ'' is 2 where nothing saturates, else between −(1 + k)/2, at w = u_s, and 2 (1 + k), at w = 0, k = 1/u_s².
    """
    share = share_per_power(p)
    least, most = 2.0, 2.0 * (1.0 + p.saturation)
    if p.saturation != 0.0:
        least = -0.5 * (1.0 + p.saturation)
    smallest = p.coil_time_constant
    for place in range(PLACES + 1):
        weight = share * work_of_attraction(p, p.stroke * place / PLACES)
        smallest = min(smallest, p.coil_time_constant + weight * (least if weight > 0.0 else most))
    return smallest


@compiled
def flux_slope(valve):
    """The same of a (1,) VALVE_RECORD, for Python."""
    return smallest_flux_slope(valve[0])


def why_no_flux(record: Any) -> str:
    """Why no current follows from the flux of a (1,) VALVE_RECORD, in words; empty where one does."""
    if record[0]["flux_linkage"] == 0.0:
        return ""
    time_constant = float(record[0]["coil_time_constant"])
    if time_constant == 0.0:
        return (
            "motional_emf: found a coil time constant of 0 s, expected above 0: a coil without inductance has no flux; "
            "declare valve.coil_time_constant, the coil's L/R at its largest gap"
        )
    smallest = flux_slope(record)
    if smallest > 0.0:
        return ""
    return (
        f"motional_emf: found a coil time constant of {time_constant:g} s, expected above "
        f"{time_constant - smallest:.6g} s: somewhere in the stroke more current would make less flux; check "
        "valve.coil_time_constant, the attraction, valve.coil_resistance and magnetic_saturation"
    )
