"""The variational equations of a valve with gas: how its pressure changes with parameters, through every event.

With the outlet's density ρ, (V1) of `variational` has one state more, δρ' = ∂f/∂ρ δρ + ∂f/∂x δx + ∂f/∂θ of (G4), and
the forces have the terms of (G5). They are solved by the pair of `step`, stage by stage along that of the plain trace,

    (V5)  δρ_i (1 − h γ ∂f/∂ρ) = known + h γ (∂f/∂x δx_i + ∂f/∂θ),

so that nothing is lost to the infinite slope of the flow at equal pressures, where δρ follows the inlet. Neither a
contact nor a change of the flow between choked, subsonic and backward makes f jump, and (V3) leaves δρ as it is; only
a pressure behind the demand's orifice that is set anew does. How the flux changes with the temperature follows
from its other two derivatives, since G(λ p_u, λ p_d, λ T) = √λ G:

    (V6)  T ∂G/∂T = G/2 − p_u ∂G/∂p_u − p_d ∂G/∂p_d
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN
from valve_sim.model.gas.flow import density_slope, flux, inlet_pressure, pressure_at
from valve_sim.model.gas.linearised import force_slopes
from valve_sim.model.gas.record import GAS_NUMBERS, for_gas
from valve_sim.model.gas.step import (
    DENSE,
    DENSITY,
    DIAGONAL,
    EXPLICIT,
    IMPLICIT,
    PRESSURE_COLUMN,
    STAGES,
    STIFF,
    TIMES,
    WEIGHTS,
    density_within,
)
from valve_sim.model.gas.step_memory import POSITION, VELOCITY, interpolate
from valve_sim.model.gas.variational_steps import LANES, SCRATCH, gather

(
    INLET, TEMPERATURE, VOLUME, PILOT_ORIFICE, MAIN_ORIFICE, SEAT, DEMAND_PRESSURE, DISCHARGE, CLOGGING, LEAK,
    DEMAND_AREA,
) = np.arange(len(GAS_NUMBERS))  # fmt: skip
OF_X, OF_V, OF_DENSITY = np.arange(3)
KINK_BISECTIONS: Final = 40
"""Halvings of a step that locate a kink."""
LEAST_PIECE: Final = 1e-9
"""Of a step: a shorter piece is none."""


@inlined
def _flux_between(p, here, there):
    """Mass flux from one side to the other, negative backwards, and its derivatives to the pressures of both."""
    if here >= there:
        return flux(p, here, here - there)
    total, by_up, by_down = flux(p, there, there - here)
    return -total, -by_down, -by_up


@inlined
def _pilot_opens(p):
    """The x from which on the pilot's orifice limits the flow, no longer its lift, m."""
    return 0.25 * p.clogging_ratio * p.pilot_orifice_diameter


@inlined
def _main_opens(p):
    """The same of the main plunger."""
    return p.pilot_gap + 0.25 * p.main_orifice_diameter * p.main_orifice_diameter / p.seat_diameter


@inlined
def _force_ends(p, mode):
    """The x from which on the gas does not close the plungers, m; (G5)."""
    return p.pilot_gap + 0.25 * p.seat_diameter if mode >= MAIN else 0.25 * p.pilot_orifice_diameter


@inlined
def _area_slopes(p, x, side):
    """A of (G3), and its derivatives to x by the pilot's lift and by the main plunger's, to (d_p, d_m, d_s, κ).

    That to the gap is the second of them, negative. `side`: x, m, by which it is decided what limits the flow.
    """
    d_p, d_m, d_s, lift = p.pilot_orifice_diameter, p.main_orifice_diameter, p.seat_diameter, x - p.pilot_gap
    is_lifted, is_curtain, is_main_curtain = side > p.pilot_gap, side < _pilot_opens(p), side < _main_opens(p)
    pilot, by_x, by_pilot, by_clogging = math.pi * d_p * max(0.0, x), 0.0, 0.0, 0.0
    bore = 0.25 * math.pi * d_p * d_p
    if is_curtain:
        by_x, by_pilot = math.pi * d_p, math.pi * max(0.0, x)
    else:
        pilot, by_pilot, by_clogging = p.clogging_ratio * bore, 0.5 * math.pi * d_p * p.clogging_ratio, bore
    main, by_lift, by_main, by_seat = math.pi * d_s * max(0.0, lift), 0.0, 0.0, 0.0
    if not is_main_curtain:
        main, by_main = 0.25 * math.pi * d_m * d_m, 0.5 * math.pi * d_m
    elif is_lifted:
        by_lift, by_seat = math.pi * d_s, math.pi * lift
    c = p.discharge_coefficient
    area = c * (pilot + main + p.leak_area)
    return area, c * by_x, c * by_lift, (c * by_pilot, c * by_main, c * by_seat, c * by_clogging)


@inner
def flow_slopes(p, s, g, t, x, side, density):
    """Differentiate (G4).

    Args:
        p, s: valve and state. g: `SLOPES_RECORD`, whose `flow…` are written. t, x, density: s, m, kg/m³.
        side: x, m, by which it is decided on which side of a kink of (G3) this is.
    """
    volume, temperature = p.outlet_volume, p.inlet_temperature
    inlet, outlet = inlet_pressure(s, t), pressure_at(p, density)
    area, by_x, by_lift, (by_pilot, by_main, by_seat, by_clogging) = _area_slopes(p, x, side)
    came, by_inlet, by_outlet = _flux_between(p, inlet, outlet)
    by_temperature = area * (0.5 * came - inlet * by_inlet - outlet * by_outlet)
    by_pressure = area * by_outlet
    g.flow, g.flow_by[DEMAND_PRESSURE], g.flow_by[DEMAND_AREA] = area * came, 0.0, 0.0
    if p.demand_area > 0.0:
        drawn, by_here, by_there = _flux_between(p, outlet, s.demand_pressure)
        by_pressure -= p.demand_area * by_here
        by_temperature -= p.demand_area * (0.5 * drawn - outlet * by_here - s.demand_pressure * by_there)
        g.flow -= p.demand_area * drawn
        g.flow_by[DEMAND_PRESSURE] = -p.demand_area * by_there / volume
        g.flow_by[DEMAND_AREA] = -drawn / volume
    g.flow /= volume
    per_volume = came / volume
    g.flow_by_density = by_pressure / (volume * density_slope(p, outlet))
    g.flow_by_x, g.flow_by_gap = (by_x + by_lift) * per_volume, -by_lift * per_volume
    g.flow_by[INLET] = area * by_inlet / volume
    # At a given density the pressure grows with the temperature as well.
    g.flow_by[TEMPERATURE] = (by_temperature + by_pressure * outlet) / (volume * temperature)
    g.flow_by[VOLUME] = -g.flow / volume
    g.flow_by[PILOT_ORIFICE], g.flow_by[MAIN_ORIFICE] = by_pilot * per_volume, by_main * per_volume
    g.flow_by[SEAT], g.flow_by[CLOGGING] = by_seat * per_volume, by_clogging * per_volume
    g.flow_by[DISCHARGE] = area / p.discharge_coefficient * per_volume
    g.flow_by[LEAK] = p.discharge_coefficient * per_volume


@inner
def gas_force_slopes(p, s, g, t, x, side, density):
    """Add (G5) to what `force_slopes` has differentiated; arguments as of `flow_slopes`."""
    outlet = pressure_at(p, density)
    difference = inlet_pressure(s, t) - outlet
    for number in range(len(GAS_NUMBERS)):
        g.force_by[number] = 0.0
    g.force_by_density, g.force_by_gap = 0.0, 0.0
    if difference <= 0.0 or side >= _force_ends(p, s.mode):
        return
    in_phase_2 = 1.0 if s.mode >= MAIN else 0.0
    diameter, lift = p.pilot_orifice_diameter, max(0.0, x)
    if s.mode >= MAIN:
        diameter, lift = p.seat_diameter, max(0.0, x - p.pilot_gap)
    held = 1.0 - 4.0 * lift / diameter
    by_difference = 0.25 * math.pi * diameter * diameter * held
    force = difference * by_difference
    g.force -= force
    g.moving_mass += in_phase_2 * force * g.per_mass
    g.pilot_mass += (1.0 - in_phase_2) * force * g.per_mass
    by_lift = -difference * math.pi * diameter
    g.x -= by_lift
    g.force_by_gap = in_phase_2 * by_lift
    g.force_by[SEAT if s.mode >= MAIN else PILOT_ORIFICE] = -difference * math.pi * (0.5 * diameter * held + lift)
    g.force_by[INLET] = -by_difference
    g.force_by[TEMPERATURE] = by_difference * outlet / p.inlet_temperature
    g.force_by_density = by_difference / density_slope(p, outlet)


@inlined
def _no_gas(p, s, g):
    return 0.0


@for_gas(_no_gas)
def add_gas_force(p, s, g):
    """Add the gas to the force slopes of the state; returns how the force grows with time as pressures change, N/s."""
    gas_force_slopes(p, s, g, s.time, s.x, s.x, s.density)
    flow_slopes(p, s, g, s.time, s.x, s.x, s.density)
    return g.force_by_density * g.flow + g.force_by[INLET] * s.tank_rate


@inlined
def _no_addition(p, tile, g):
    return None


@for_gas(_no_addition)
def gather_gas_force(p, tile, g):
    """Add to tile.total what the gas's force changes with the parameters, at a fixed time and x."""
    for lane in range(LANES):
        tile.total[lane] += g.force_by_density * tile.density[lane] + g.force_by_gap * tile.pilot_gap[lane]
    if tile.has_gas:
        for number in range(len(GAS_NUMBERS)):
            for lane in range(LANES):
                tile.total[lane] += g.force_by[number] * tile.gas[number, lane]


@inner
def vary_step(p, s, work, h, vary):
    """Carry δ through a step of size h that the plain trace takes, by (V1) and (V5)."""
    if vary is None:
        return
    tiles, slopes, _, _, _ = vary
    g = slopes[SCRATCH]
    end = _next_kink(p, s, work, h, 0.0)
    if end >= 1.0:
        side = interpolate(work, h, POSITION, 0.5) if s.moving else s.x
        for stage in range(STAGES):
            x, v, density = work.y[0], work.y[1], work.gas[DENSITY]
            for i in range(stage):
                x += h * EXPLICIT[stage, i] * work.k[i, 0]
                v += h * EXPLICIT[stage, i] * work.k[i, 1]
                density += h * IMPLICIT[stage, i] * work.gas_k[i, DENSITY]
            if stage > 0:
                density += h * DIAGONAL * work.gas_k[stage, DENSITY]
            _slopes_at(p, s, g, s.time + TIMES[stage] * h, (x, v, side, density))
            for i in range(len(tiles)):
                _vary_stage(s, tiles[i], g, h, stage, True)
        for i in range(len(tiles)):
            _end_step(tiles[i], h, work.stiffness > STIFF)
        return
    start, is_first = 0.0, True
    while start < 1.0:
        side = interpolate(work, h, POSITION, 0.5 * (start + end))
        size = (end - start) * h
        for stage in range(STAGES):
            theta = start + (end - start) * TIMES[stage]
            x, v = interpolate(work, h, POSITION, theta), interpolate(work, h, VELOCITY, theta)
            _slopes_at(p, s, g, s.time + theta * h, (x, v, side, density_within(work, h, theta)))
            for i in range(len(tiles)):
                _vary_stage(s, tiles[i], g, size, stage, is_first)
        for i in range(len(tiles)):
            _end_piece(tiles[i], size, is_first)
        start, is_first = end, False
        end = _next_kink(p, s, work, h, start)
    for i in range(len(tiles)):
        _fill_between(tiles[i], h)


@inlined
def _slopes_at(p, s, g, t, at):
    """Of flow and, in motion, forces; at: x, v, the side of kinks, and the density."""
    x, v, side, density = at
    flow_slopes(p, s, g, t, x, side, density)
    if s.moving:
        force_slopes(p, s, g, t, x, v)
        gas_force_slopes(p, s, g, t, x, side, density)


@inner
def _next_kink(p, s, work, h, start):
    """The fraction of a step, beyond `start`, at which (V1) has a jump, which no stage may span; 1 for not in it.

    There an orifice, not a lift, comes to limit the flow, or the gas's force ends; or the other way round.
    """
    found = 1.0
    if not s.moving:
        return found
    from_x, to_x = interpolate(work, h, POSITION, start), work.y_new[0]
    for kink in (_pilot_opens(p), _main_opens(p), _force_ends(p, s.mode)):
        if (from_x - kink) * (to_x - kink) < 0.0:
            low, high = start, found
            if (interpolate(work, h, POSITION, found) - kink) * (from_x - kink) > 0.0:
                continue
            for _ in range(KINK_BISECTIONS):
                middle = 0.5 * (low + high)
                if (interpolate(work, h, POSITION, middle) - kink) * (from_x - kink) > 0.0:
                    low = middle
                else:
                    high = middle
            if high > start + LEAST_PIECE:
                found = high
    return found if found < 1.0 - LEAST_PIECE else 1.0


@inner
def _vary_stage(s, tile, g, h, stage, is_first):
    """One tile's slopes at a stage; `is_first`: whether the step starts with it, or goes on from its end so far."""
    if s.moving:
        gather(tile, g, tile.total)
    stages = tile.stages
    share = h * DIAGONAL if stage > 0 else 0.0
    per = 1.0 / (1.0 - share * g.flow_by_density)
    for lane in range(LANES):
        x, v, density = tile.x_new[lane], tile.v_new[lane], tile.density_new[lane]
        if is_first:
            x, v, density = tile.x[lane], tile.v[lane], tile.density[lane]
        for i in range(stage):
            x += h * EXPLICIT[stage, i] * stages[OF_X, i, lane]
            v += h * EXPLICIT[stage, i] * stages[OF_V, i, lane]
            density += h * IMPLICIT[stage, i] * stages[OF_DENSITY, i, lane]
        of_flow = g.flow_by_x * x + g.flow_by_gap * tile.pilot_gap[lane]
        if tile.has_gas:
            for number in range(len(GAS_NUMBERS)):
                of_flow += g.flow_by[number] * tile.gas[number, lane]
        rate = (g.flow_by_density * density + of_flow) * per
        stages[OF_DENSITY, stage, lane] = rate
        density += share * rate
        stages[OF_X, stage, lane], stages[OF_V, stage, lane] = 0.0, 0.0
        if s.moving:
            force = tile.total[lane] + g.x * x + g.v * v + g.force_by_density * density
            force += g.force_by_gap * tile.pilot_gap[lane]
            if tile.has_gas:
                for number in range(len(GAS_NUMBERS)):
                    force += g.force_by[number] * tile.gas[number, lane]
            stages[OF_X, stage, lane], stages[OF_V, stage, lane] = v, force * g.per_mass


@inlined
def _end_piece(tile, h, is_first):
    """One tile's δ at the end of a step, or of a piece of one."""
    stages = tile.stages
    for lane in range(LANES):
        x, v, density = tile.x_new[lane], tile.v_new[lane], tile.density_new[lane]
        if is_first:
            x, v, density = tile.x[lane], tile.v[lane], tile.density[lane]
        for i in range(STAGES):
            x += h * WEIGHTS[i] * stages[OF_X, i, lane]
            v += h * WEIGHTS[i] * stages[OF_V, i, lane]
            density += h * WEIGHTS[i] * stages[OF_DENSITY, i, lane]
        tile.x_new[lane], tile.v_new[lane], tile.density_new[lane] = x, v, density


@inner
def _end_step(tile, h, is_stiff):
    """The end of one tile's step, and its dense output: of the density, where it is stiff, a straight line."""
    _end_piece(tile, h, True)
    for lane in range(LANES):
        tile.dense[3, lane], tile.dense[4, lane] = 0.0, 0.0
        for power in range(3):
            of_x, of_density = 0.0, 0.0
            for i in range(STAGES):
                of_x += DENSE[i, power] * tile.stages[OF_X, i, lane]
                of_density += DENSE[i, power] * tile.stages[OF_DENSITY, i, lane]
            tile.dense[power, lane] = of_x
            tile.density_dense[power, lane] = of_density
    if is_stiff:
        _straighten(tile, h)


@inner
def _fill_between(tile, h):
    """The dense output of a step that was made in pieces: by what is at its ends."""
    for lane in range(LANES):
        v, v_new, mean = tile.v[lane], tile.v_new[lane], (tile.x_new[lane] - tile.x[lane]) / h
        tile.dense[0, lane], tile.dense[1, lane] = v, 3.0 * mean - 2.0 * v - v_new
        tile.dense[2, lane], tile.dense[3, lane], tile.dense[4, lane] = v + v_new - 2.0 * mean, 0.0, 0.0
    _straighten(tile, h)


@inlined
def _straighten(tile, h):
    for lane in range(LANES):
        tile.density_dense[0, lane] = (tile.density_new[lane] - tile.density[lane]) / h
        tile.density_dense[1, lane], tile.density_dense[2, lane] = 0.0, 0.0


@inlined
def _no_pressures(p, s, work, h, samples, done, vary):
    return None


@for_gas(_no_pressures)
def show_pressures(p, s, work, h, samples, done, vary):
    """Write the derivatives of the outlet's pressure at the samples of a step; arguments as of `show_variations`."""
    if vary is None:
        return
    times, rows, _, _ = samples
    tiles, _, _, _, (_, _, pressures) = vary
    if len(pressures) == 0:
        return
    (first, _), (end, _) = done
    temperature = p.inlet_temperature
    is_stiff = work.stiffness > STIFF
    mean = (work.gas_new[DENSITY] - work.gas[DENSITY]) / h
    dense = work.gas_dense[DENSITY]
    for at in range(first, end):
        theta = max(0.0, (times[at] - s.time) / h)
        outlet = rows[at, PRESSURE_COLUMN]
        per_density = 1.0 / density_slope(p, outlet)
        rate = mean if is_stiff else dense[0] + theta * (2.0 * dense[1] + theta * 3.0 * dense[2])
        for i in range(len(tiles)):
            tile = tiles[i]
            for lane in range(LANES):
                change = tile.density_dense[1, lane] + theta * tile.density_dense[2, lane]
                change = tile.density[lane] + h * theta * (tile.density_dense[0, lane] + theta * change)
                pressures[at, i, lane] = (
                    per_density * (change + rate * tile.current_time[lane])
                    + outlet / temperature * tile.gas[TEMPERATURE, lane]
                )  # fmt: skip


@inner
def vary_inlet(rate, change, vary):
    """Move the tank's pressure with the time of this change, from which on it changes at a rate, Pa/s."""
    if vary is None:
        return
    tiles, _, _, (times, _), _ = vary
    for i in range(len(tiles)):
        for lane in range(LANES):
            tiles[i].gas[INLET, lane] = -rate * times[i, change, lane]


@inner
def leave_demand(p, s, change, vary):
    """Move δρ, by (V3), out of a time at which the pressure behind the demand's orifice is about to be set anew."""
    _vary_demand(p, s, change, 1.0, vary)


@inner
def enter_demand(p, s, change, vary):
    """The same once it has been set."""
    _vary_demand(p, s, change, -1.0, vary)


@inner
def _vary_demand(p, s, change, sign, vary):
    if vary is None:
        return
    tiles, slopes, _, (times, _), _ = vary
    g = slopes[SCRATCH]
    flow_slopes(p, s, g, s.time, s.x, s.x, s.density)
    for i in range(len(tiles)):
        for lane in range(LANES):
            tiles[i].density[lane] += sign * g.flow * times[i, change, lane]
