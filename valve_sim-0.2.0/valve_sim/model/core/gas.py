"""Equations of the gas that flows through a valve, traced as those of `equations` are.

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

Limits that only the lift passes are events; where the flow chokes or turns round, both formulas meet (`choice`), and
the integrator of `gas_steps` looks for that itself.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Condition, Node, choice, expm1, log1p, maximum, minimum, polynomial, sqrt, where

NUMBERS: Final = (
    "inlet_pressure", "outlet_volume", "pilot_orifice_diameter", "main_orifice_diameter", "seat_diameter",
    "inlet_temperature", "outlet_pressure", "demand_orifice_diameter", "demand_pressure", "discharge_coefficient",
    "gas_constant", "covolume", "heat_capacity_ratio", "critical_0", "critical_1", "critical_2", "critical_3",
)  # fmt: skip
"""Numbers of a valve with gas beside those of every valve: those of the group `gas`, and what its fluid is."""
PREFIX: Final = "gas."
"""What these are called among the parameters of a valve's equations."""
SAME: Final = 4e-16
"""Relative difference of two pressures that rounding makes of equal ones; below it the flow is linear in it."""
_LARGEST_BETA: Final = 2.0
_ITERATIONS: Final = 5
"""Of Newton's method, which comes to rounding in four."""


@dataclass(frozen=True)
class Gas:
    """The gas of one valve as expressions.

    Attributes:
        inlet, outlet: pressures, Pa. density_of_inlet, density_of_demand: of gas at the pressures at both ends, kg/m³;
            None for the second one where there is no demand.
        first_density: in the outlet at the start, kg/m³. critical: ratio of pressures at which the flow chokes.
        flow: through the valve, kg/s. rate: ρ' of (G4), kg/(m³ s).
    """

    inlet: Node
    outlet: Node
    density_of_inlet: Node
    density_of_demand: Node | None
    first_density: Node
    critical: Node
    flow: Node
    rate: Node


def gas_of(m: Motion, *, has_demand: bool) -> Gas:
    """The gas of a valve, whose state is the density in its outlet volume.

    Args:
        m: the symbols of the equations; `m.p` holds `NUMBERS`, too. has_demand: whether gas leaves the outlet volume.
    """
    p, trace = m.p, m.x.trace
    density = trace.state("density")
    inlet, outlet = inlet_pressure(m), pressure_at(p, density)
    upstream = choice(inlet > outlet, inlet, outlet)
    flow = through(p, area(m), inlet, outlet)
    balance, of_demand = flow, None
    if has_demand:
        demand = trace.number("demand")
        taken = through(p, p.discharge_coefficient * round_hole(p.demand_orifice_diameter), outlet, demand)
        balance, of_demand = flow - taken, density_at(p, demand)
    return Gas(
        inlet, outlet, density_at(p, inlet), of_demand, density_at(p, p.outlet_pressure),
        critical_ratio(p, compression(p, upstream)), flow, balance / p.outlet_volume,
    )  # fmt: skip


def inlet_pressure(m: Motion) -> Node:
    """Of the tank, Pa: linear in time."""
    trace = m.x.trace
    return trace.number("tank") + trace.number("tank rate") * (m.t - trace.number("tank time"))


def density_at(p: Own, pressure: Node) -> Node:
    """Of the gas at the inlet's temperature, kg/m³."""
    return pressure / (p.gas_constant * p.inlet_temperature + p.covolume * pressure)


def pressure_at(p: Own, density: Node) -> Node:
    """The other way round, Pa."""
    return density * (p.gas_constant * p.inlet_temperature) / (1.0 - p.covolume * density)


def compression(p: Own, pressure: Node) -> Node:
    """β."""
    return pressure * (p.covolume / (p.gas_constant * p.inlet_temperature))


def critical_ratio(p: Own, beta: Node) -> Node:
    """The r of (G2), by a cubic that leaves 1e-5 of it and, since g is flat there, 1e-10 of g."""
    return polynomial(log1p(beta), p.critical_0, p.critical_1, p.critical_2, p.critical_3)


def flux(p: Own, up: Node, drop: Node) -> Node:
    """G from a pressure to one that is lower by so much of it, kg/(m² s)."""
    beta = compression(p, up)
    critical, ratio = critical_ratio(p, beta), 1.0 - drop
    choked = critical > ratio
    r, shortfall = choice(choked, critical, ratio), choice(choked, 1.0 - critical, drop)
    k = 1.0 - 1.0 / p.heat_capacity_ratio
    fall = -expm1(k * log1p(-shortfall))
    n, d = fall / k + beta * shortfall, (1.0 - fall) / r + beta  # (G1)
    return up / sqrt(p.gas_constant * p.inlet_temperature) * sqrt(2.0 * n) / d


def through(p: Own, hole: Node, here: Node, there: Node) -> Node:
    """Mass flow from one side of a hole of an area, C_d A in m², to the other, kg/s."""
    up = choice(here > there, here, there)
    drop = (here - there) / up
    size = choice(drop > 0.0, drop, -drop)
    size = choice(size > SAME, size, SAME)
    return hole * flux(p, up, size) * (drop / size)


def lift(m: Motion) -> Node:
    """Y of (G3), m."""
    above = m.x - m.p.pilot_gap
    return choice(above > 0.0, above, 0.0)


def round_hole(diameter: Node) -> Node:
    """Area of a round hole, m²."""
    return math.pi / 4.0 * diameter * diameter


def area(m: Motion) -> Node:
    """C_d A of (G3), m²."""
    p = m.p
    pilot = minimum(math.pi * p.pilot_orifice_diameter * m.x, p.clogging_ratio * round_hole(p.pilot_orifice_diameter))
    main = minimum(math.pi * p.seat_diameter * lift(m), round_hole(p.main_orifice_diameter))
    return p.discharge_coefficient * (pilot + main + p.leak_area)


def closing_force(m: Motion, gas: Gas) -> Node:
    """Of the gas on the plungers that move, or would, N; (G5) with its sign turned."""
    p, difference = m.p, gas.inlet - gas.outlet

    def held(diameter: Node, opened: Node) -> Node:
        return round_hole(diameter) * maximum(0.0, 1.0 - 4.0 * opened / diameter)

    acts_on = where(m.lifted, held(p.seat_diameter, lift(m)), held(p.pilot_orifice_diameter, m.x))
    return choice(Condition(difference), difference, 0.0) * acts_on


@functools.cache
def critical_cubic(gamma: float) -> list[float]:
    """Coefficients of the critical ratio in ln(1 + β), rising: (G2) solved at Chebyshev's points.

    There N' = −D makes Newton's step r ← (r + 2 N r^{−1/γ}/D²)/(γ + 1). Up to β = 2, which hydrogen at 15 °C has at
    309 MPa, the ratio is within 1e-5, and the flux there within 1e-10.
    """
    k = 1.0 - 1.0 / gamma

    def critical(logarithm: Any) -> Any:
        beta = np.expm1(logarithm)
        ratio = np.full_like(beta, (2.0 / (gamma + 1.0)) ** (1.0 / k))
        for _ in range(_ITERATIONS):
            volume = ratio ** (-1.0 / gamma)
            n = (1.0 - ratio**k) / k + beta * (1.0 - ratio)
            ratio = (ratio + 2.0 * n * volume / (volume + beta) ** 2) / (gamma + 1.0)
        return ratio

    cubic = Chebyshev.interpolate(critical, 3, domain=[0.0, math.log1p(_LARGEST_BETA)])
    return [float(coefficient) for coefficient in cubic.convert(kind=Polynomial).coef]
