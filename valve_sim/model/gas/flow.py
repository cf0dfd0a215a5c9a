"""What the gas does at given pressures, compiled: flux, effective area, flows, and the forces on the plungers.

With r = p/p_up, β = b p_up/(R T), k = (γ − 1)/γ and the reference flux p_up/√(R T), an isentropic expansion of an
Abel–Noble gas to p makes, per reference flux,

    (G1)  g(r) = √(2 N)/D,  N = (1 − r^k)/k + β (1 − r),  D = r^{−1/γ} + β
    (G2)  choked where g is largest: D² r = 2 N r^{−1/γ}/γ
    (G3)  A = C_d [min(π d_p x, κ π d_p²/4) + min(π d_s y, π d_m²/4) + leak],  y = max(0, x − gap)
    (G4)  V_o ρ' = A G(p_i, p_o) − A_d G(p_o, p_d),  ρ = p/(R T + b p)
    (G5)  Phase 1: −Δp (π d_p²/4) max(0, 1 − 4 x/d_p);  Phase 2: −Δp (π d_s²/4) max(0, 1 − 4 y/d_s);
          Δp = max(0, p_i − p_o)

Source of (G1) and (G2): isentropic flow of a gas with h = c_p T + b p and p^{(1−γ)/γ} T constant, which is what
p (1/ρ − b) = R T with constant specific heats has; (G4) is isothermal.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN
from valve_sim.model.gas.record import for_gas

NEVER_CHOKED: Final = 0.7
"""Ratio of pressures above which no gas chokes: (2/(γ + 1))^{1/k} is 0.61 at γ = 1, less with γ, and less with β."""
SAME: Final = 4e-16
"""Relative difference of two pressures that rounding makes of equal ones."""


@inlined
def density_at(p, pressure):
    """Of the gas at the inlet's temperature, kg/m³."""
    return pressure / (p.gas_constant * p.inlet_temperature + p.covolume * pressure)


@inlined
def pressure_at(p, density):
    """The other way round, Pa."""
    return density * p.gas_constant * p.inlet_temperature / (1.0 - p.covolume * density)


@inlined
def density_slope(p, pressure):
    """Of `density_at`, kg/m³ per Pa."""
    rt = p.gas_constant * p.inlet_temperature
    total = rt + p.covolume * pressure
    return rt / (total * total)


@inlined
def _expansion(p, beta, ratio, shortfall):
    """N, D and r^{−1/γ} of (G1); shortfall is 1 − r, exact where r is almost 1."""
    k = 1.0 - 1.0 / p.heat_capacity_ratio
    drop = -math.expm1(k * math.log1p(-shortfall))
    volume = (1.0 - drop) / ratio
    return drop / k + beta * shortfall, volume + beta, volume


@inlined
def critical_ratio(p, beta):
    """The r of (G2), by a cubic that leaves 1e-5 of it and, since g is flat there, 1e-10 of g."""
    s = math.log1p(beta)
    return p.critical_0 + s * (p.critical_1 + s * (p.critical_2 + s * p.critical_3))


@inner
def flux(p, up, difference):
    """Mass flux from a higher pressure to a lower one, by `difference`, and its derivatives.

    Returns:
        G, kg/(m² s); its derivatives with respect to the upstream and the downstream pressure, s/m. These are finite
        where the pressures are equal: as if they differed by rounding.
    """
    rt = p.gas_constant * p.inlet_temperature
    per_root = 1.0 / math.sqrt(rt)
    beta = p.covolume * up / rt
    shortfall = max(difference / up, SAME)
    ratio = 1.0 - shortfall
    choked = False
    if ratio < NEVER_CHOKED:
        critical = critical_ratio(p, beta)
        if ratio <= critical:
            choked = True
            ratio, shortfall = critical, 1.0 - critical
    n, d, volume = _expansion(p, beta, ratio, shortfall)
    root = math.sqrt(2.0 * n)
    g = root / d
    by_beta = shortfall / (root * d) - root / (d * d)
    by_ratio = 0.0 if choked else root * volume / (p.heat_capacity_ratio * ratio * d * d) - 1.0 / root
    total = up * per_root * g if difference > SAME * up else 0.0
    return total, per_root * (g - ratio * by_ratio + beta * by_beta), per_root * by_ratio


@inlined
def effective_area(p, x):
    """A of (G3), m²."""
    d_p, d_m = p.pilot_orifice_diameter, p.main_orifice_diameter
    lift = max(0.0, x - p.pilot_gap)
    pilot = min(math.pi * d_p * max(0.0, x), p.clogging_ratio * 0.25 * math.pi * d_p * d_p)
    main = min(math.pi * p.seat_diameter * lift, 0.25 * math.pi * d_m * d_m)
    return p.discharge_coefficient * (pilot + main + p.leak_area)


@inlined
def through(p, area, here, there):
    """Mass flow from one side to the other, kg/s, and its derivative with respect to the pressure there."""
    if here >= there:
        total, _, slope = flux(p, here, here - there)
        return area * total, area * slope
    total, slope, _ = flux(p, there, there - here)
    return -area * total, -area * slope


@inlined
def outflow(p, s, outlet):
    """What the demand takes, kg/s."""
    if p.demand_area == 0.0:
        return 0.0
    return -through(p, p.demand_area, s.demand_pressure, outlet)[0]


@inner
def flows(p, s, area, inlet, outlet):
    """Both terms of (G4), kg/s, and the derivative of their difference with respect to the outlet pressure.

    Args:
        p, s: valve and state. area: A, m². inlet, outlet: Pa.
    """
    mass_in, slope = through(p, area, inlet, outlet)
    if p.demand_area == 0.0:
        return mass_in, 0.0, slope
    drawn, drawn_slope = through(p, p.demand_area, s.demand_pressure, outlet)
    return mass_in, -drawn, slope + drawn_slope


@inlined
def inlet_pressure(s, t):
    """Of the tank at time t, Pa."""
    return s.tank_pressure + s.tank_rate * (t - s.tank_time)


@inlined
def _no_pressure(p, s):
    """Of a valve without gas."""
    return 0.0


@for_gas(_no_pressure)
def pressure_difference(p, s):
    """p_i − p_o of the state, Pa."""
    return inlet_pressure(s, s.time) - pressure_at(p, s.density)


@inlined
def _no_force(p, mode, x, difference):
    """Of a valve without gas."""
    return 0.0


@for_gas(_no_force)
def closing_force(p, mode, x, difference):
    """Of the gas on the plungers that move, or would, N; (G5) with its sign turned."""
    diameter, lift = p.pilot_orifice_diameter, x
    if mode >= MAIN:
        diameter, lift = p.seat_diameter, x - p.pilot_gap
    held = max(0.0, 1.0 - 4.0 * max(0.0, lift) / diameter)
    return max(0.0, difference) * 0.25 * math.pi * diameter * diameter * held


@inner
def flow_regime(p, s, inlet, outlet, margin):
    """2 choked, 1 subsonic, negative from the outlet to the inlet.

    Args:
        margin: (relative, Pa): by how much the pressures must have passed a limit to leave the state's regime.
    """
    relative, absolute = margin
    before = s.flow_regime
    beyond = absolute + relative * inlet
    is_forward = inlet - outlet > beyond if before < 0.0 else inlet - outlet >= -beyond
    way = 1.0 if is_forward else -1.0
    up, down = max(inlet, outlet), min(inlet, outlet)
    ratio = down / up
    if ratio >= NEVER_CHOKED:
        return way
    critical = critical_ratio(p, p.covolume * up / (p.gas_constant * p.inlet_temperature))
    critical *= 1.0 + relative if abs(before) > 1.5 else 1.0 - relative
    return 2.0 * way if ratio < critical else way
