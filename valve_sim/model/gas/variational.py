"""The variational equations: how a trace changes with its parameters, through every event, compiled.

For a parameter θ let δ = ∂(x, v)/∂θ at a fixed time. Between events, in the plain trace's own steps,

    (V1)  δ' = A δ + b,    A = ∂f/∂(x, v),    b = ∂f/∂θ,

where f are the rates of `equations` and the derivatives those of `linearised`, evaluated once for each node and
shared by all parameters. An event, where a guard g(x, v, t, θ) is 0, moves in time, and δ jumps (saltation):

    (V2)  t_e' = −(∂g/∂θ + ∂g/∂(x, v) δ⁻) / (dg/dt)⁻
    (V3)  δ⁺ = ∂r/∂θ + ∂r/∂(x, v) (δ⁻ + f⁻ t_e') − f⁺ t_e',    r what the event makes of (x, v).

A step of size h is one of Lobatto IIIA of order 6, with four nodes c_i and the start's the end of the step before:

    (V4)  δ_i = δ_0 + h Σ_j a_ij δ_j',    δ_j' at t + c_j h.

It is A-stable, which the long steps of a creeping plunger require, and evaluates the forces three times, where the
stages of the plain pair would take six; the two equations for v and x leave one for the velocities at the last three
nodes, the same for all parameters except for its right-hand side.

Sources: Hairer, Nørsett and Wanner, section I.14; Hairer and Wanner, *Solving Ordinary Differential Equations II*,
section IV.5 (V4); Rozenvasser, Automation and Remote Control 28 (1967) 400. Parameters
go in tiles of `LANES`, which fill a processor's vector unit. Without derivatives `vary` is None, and every
function here compiles to nothing. Otherwise `vary` is

    tiles (p,) TILE_RECORD; slopes (SLOPES,) SLOPES_RECORD; nodes (NODES,) places of those of the nodes among these;
    commands: derivatives of their times and of their voltages, (p, c, LANES) each; outputs: of positions, of
    currents and of outlet pressures, (n, p, LANES) each, written; of pressures none where none are shown.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN, PILOT
from valve_sim.model.gas.equations import coil_decay, coil_now, has_one_plunger
from valve_sim.model.gas.linearised import (
    PEAK_CURRENT,
    SEGMENT_TIME,
    SEGMENT_U,
    SEGMENT_W,
    TARGET,
    UNSEATED_TIME,
    add_term_time_slopes,
    coil_slopes,
    coil_slopes_since,
    force_slopes,
)
from valve_sim.model.gas.location import CONTACT, TURN
from valve_sim.model.gas.sampling import lag_moments
from valve_sim.model.gas.step_memory import LAST, POSITION, VELOCITY, interpolate
from valve_sim.model.gas.variational_pressure import add_gas_force, gather_gas_force, show_pressures
from valve_sim.model.gas.variational_steps import LANES, OF_U, OF_W, SCRATCH, gather

LEAST_CHANGE: Final = 1e-3
"""Of u since the last command, from which on a current says how much of its start is left, to twelve digits."""


@inner
def _acceleration_now(p, s, slopes):
    """Of the state, m/s²; 0 at rest."""
    if not s.moving:
        return 0.0
    g = slopes[SCRATCH]
    force_slopes(p, s, g, s.time, s.x, s.v)
    add_gas_force(p, s, g)
    return g.force * g.per_mass


@inner
def vary_event(p, s, work, before, vary):
    """Move δ through a contact or a turn that has just happened, by (V2) and (V3).

    Args:
        p, s: as after it. work: of the step that it ended.
        before: what ended the step; mode, direction and v before it.
    """
    if vary is None:
        return
    ends, mode, direction, v_before = before
    tiles, slopes, _, _, _ = vary
    if ends not in (CONTACT, TURN):
        return
    a_before = work.k[LAST, 1]
    a_after = _acceleration_now(p, s, slopes)
    for i in range(len(tiles)):
        tile = tiles[i]
        for lane in range(LANES):
            x, v = tile.x[lane], tile.v[lane]
            if ends == TURN:
                dt = -v / a_before
                v = 0.0
            else:
                guard = _guard(tile, mode, direction, lane)
                dt = (guard - x) / v_before
                x = guard
                v = _velocity_after(p, s, tile, before, v + a_before * dt, lane)
            tile.x[lane] = x - s.v * dt
            tile.v[lane] = v - a_after * dt
            tile.event_time[lane] = dt
            if s.unseated_time == s.time:
                tile.condition[UNSEATED_TIME, lane] = dt


@inlined
def _guard(tile, mode, direction, lane):
    """By how much the contact ahead moves."""
    if mode == MAIN and direction > 0:
        return tile.stroke[lane]
    return 0.0 if mode == PILOT and direction < 0 else tile.pilot_gap[lane]


@inlined
def _velocity_after(p, s, tile, before, dv, lane):
    """By how much the velocity after a contact changes, for dv before it."""
    _, mode, direction, v_before = before
    if s.v == 0.0:
        return 0.0
    if mode == MAIN and direction > 0:
        return -p.restitution_stop * dv - tile.restitution_stop[lane] * v_before
    if direction < 0 and (mode == PILOT or has_one_plunger(p)):
        return -p.restitution_seat * dv - tile.restitution_seat[lane] * v_before
    if mode == PILOT:
        return p.pickup_velocity_ratio * dv + tile.pickup_velocity_ratio[lane] * v_before
    return dv


@inner
def vary_release(p, s, since, vary):
    """Move δ through a release from rest that has just happened, by (V2) and (V3).

    Either the forces have grown beyond what holds, or an event or a command at this very time has freed the plungers.

    Args:
        p, s: as after it. since: s, when the last event or command was.
    """
    if vary is None:
        return
    tiles, slopes, _, _, _ = vary
    g = slopes[SCRATCH]
    force_slopes(p, s, g, s.time, s.x, s.v)
    if p.term_count > 0:
        u, _ = coil_now(p, s)
        add_term_time_slopes(p, g, s.mode, (s.x, s.v, u, s.time))
    if has_one_plunger(p) and s.unseated_time == s.time:
        # Of the net force that freed it: with the seat's load, which no mass enters, and before the pressure fell.
        g.seat_load, g.unseated_time, g.moving_mass = -1.0, 0.0, 0.0
    # The forces know time by what has passed since a command, or since the pilot left its seat.
    rate = g.t - g.segment_time - g.unseated_time + add_gas_force(p, s, g)
    a_after = g.force * g.per_mass
    for i in range(len(tiles)):
        tile = tiles[i]
        gather(tile, g, tile.total)
        gather_gas_force(p, tile, g)
        for lane in range(LANES):
            if s.time > since and rate != 0.0:
                tile.event_time[lane] = -(tile.total[lane] + g.x * tile.x[lane]) / rate
            tile.v[lane] = -a_after * tile.event_time[lane]
            if s.unseated_time == s.time:
                tile.condition[UNSEATED_TIME, lane] = tile.event_time[lane]


@inner
def leave_segment(p, s, command, vary):
    """Prepare δ and the conditions of the forces for a command that is about to take effect."""
    if vary is None:
        return
    tiles, slopes, _, (times, _), _ = vary
    a_before = _acceleration_now(p, s, slopes)
    of_u, of_w = slopes[OF_U], slopes[OF_W]
    coil_slopes(p, s, of_u, s.time, 1.0, 0.0)
    coil_slopes(p, s, of_w, s.time, 0.0, 1.0)
    for i in range(len(tiles)):
        tile = tiles[i]
        gather(tile, of_u, tile.b[0])
        gather(tile, of_w, tile.b[1])
        for lane in range(LANES):
            dt = times[i, command, lane]
            tile.condition[SEGMENT_U, lane] = tile.b[0, lane] - of_u.segment_time * dt
            tile.condition[SEGMENT_W, lane] = tile.b[1, lane] - of_w.segment_time * dt
            tile.condition[SEGMENT_TIME, lane] = dt
            tile.event_time[lane] = dt
            tile.v[lane] += a_before * dt


@inner
def enter_segment(p, s, command, peak_before, vary):
    """The same once it has taken effect; `peak_before` is the largest |u| before it."""
    if vary is None:
        return
    tiles, slopes, _, (times, volts), _ = vary
    a_after = _acceleration_now(p, s, slopes)
    u, _ = coil_now(p, s)
    sign = 1.0 if u >= 0.0 else -1.0
    follows = SEGMENT_U if p.coil_time_constant > 0.0 else TARGET
    for i in range(len(tiles)):
        tile = tiles[i]
        for lane in range(LANES):
            target = volts[i, command, lane] - s.volts / p.reference_voltage * tile.reference_voltage[lane]
            tile.condition[TARGET, lane] = target / p.reference_voltage
            tile.v[lane] -= a_after * times[i, command, lane]
            if s.peak_current > peak_before:
                tile.condition[PEAK_CURRENT, lane] = sign * tile.condition[follows, lane]


@inner
def show_variations(p, s, work, h, samples, done, vary):
    """Write the derivatives of the samples of a step.

    Args:
        samples: see `run`. done: how many positions and currents were written before the step, and are now.
    """
    if vary is None:
        return
    times, _, _, _ = samples
    tiles, _, _, _, (positions, _, _) = vary
    (first, first_current), (end, end_current) = done
    if end > first:
        if p.sensor_time_constant > 0.0:
            _show_lagged(p, s, work, h, (times, first, end), tiles, positions)
        else:
            for i in range(len(tiles)):
                _show_positions(p, s, work, h, (times, first, end, i), tiles[i], positions)
    vary_sensor(p, s, work, h, vary)
    if end_current > first_current:
        _show_currents(p, s, samples, (first_current, end_current), vary)
    show_pressures(p, s, work, h, samples, done, vary)


@inner
def _show_currents(p, s, samples, which, vary):
    """Write the derivatives of currents, of which the values are written already."""
    _, _, times, values = samples
    first, end = which
    tiles, slopes, _, _, (_, currents, _) = vary
    g = slopes[OF_U]
    target = s.volts / p.reference_voltage
    from_target = s.segment_u - target
    for at in range(first, end):
        elapsed = times[at] - s.segment_time
        # The current says how much of its start is left: cheaper than an exponential.
        is_said = abs(from_target) > LEAST_CHANGE
        decay = (values[at] - target) / from_target if is_said else coil_decay(p, elapsed)
        coil_slopes_since(p, s, g, (elapsed, decay), 1.0, 0.0)
        for i in range(len(tiles)):
            tile = tiles[i]
            gather(tile, g, tile.total)
            for lane in range(LANES):
                currents[at, i, lane] = tile.total[lane] - g.segment_time * tile.current_time[lane]


@inner
def _show_positions(p, s, work, h, which, tile, positions):
    """Of tile i, as the sensor shows them; plungers at rest stay where they are."""
    times, first, end, i = which
    for at in range(first, end):
        if s.moving or at == first:
            theta = max(0.0, (times[at] - s.time) / h)
            x, v = interpolate(work, h, POSITION, theta), p.sensor_gain * interpolate(work, h, VELOCITY, theta)
            along = p.sensor_gain * h * theta if s.moving else 0.0
            for lane in range(LANES):
                slope = tile.dense[2, lane] + theta * (tile.dense[3, lane] + theta * tile.dense[4, lane])
                slope = tile.dense[1, lane] + theta * slope
                tile.total[lane] = (
                    p.sensor_gain * tile.x[lane] + x * tile.sensor_gain[lane] + v * tile.position_time[lane]
                    + along * (tile.dense[0, lane] + theta * slope)
                )  # fmt: skip
        for lane in range(LANES):
            positions[at, i, lane] = tile.total[lane]


@inner
def _show_lagged(p, s, work, h, which, tiles, positions):
    """Of all tiles, as a first-order sensor z' = (x − z)/τ shows them."""
    times, first, end = which
    for at in range(first, end):
        theta = max(0.0, (times[at] - s.time) / h)
        z = _lag(p, s, work, h, theta, tiles)
        rate = p.sensor_gain * (interpolate(work, h, POSITION, theta) - z) / p.sensor_time_constant
        for i in range(len(tiles)):
            tile = tiles[i]
            for lane in range(LANES):
                positions[at, i, lane] = (
                    p.sensor_gain * tile.total[lane] + z * tile.sensor_gain[lane] + rate * tile.position_time[lane]
                )


@inner
def vary_sensor(p, s, work, h, vary):
    """Carry what a first-order sensor shows through a step of size h; it goes on steadily through every event."""
    if vary is None:
        return
    if p.sensor_time_constant == 0.0:
        return
    tiles, _, _, _, _ = vary
    _lag(p, s, work, h, 1.0, tiles)
    for i in range(len(tiles)):
        tile = tiles[i]
        for lane in range(LANES):
            tile.shown_new[lane] = tile.total[lane]


@inner
def _lag(p, s, work, h, theta, tiles):
    """z, z' = (x − z)/τ, at the fraction theta of a step; its derivatives are written to `total` of each tile.

    z is linear in its start and in x, so that δz follows from δx as z does from x. To τ it changes as b = h θ/τ does:
    dM_k/db = M_k/b − M_k + M_{k+1} of the moments.
    """
    b = h * theta / p.sensor_time_constant
    kept, taken = math.exp(-b), -np.expm1(-b)
    m1, m2, m3, m4, m5 = lag_moments(b) if s.moving else (0.0, 0.0, 0.0, 0.0, 0.0)
    dense = work.dense
    s1, s2, s3, s4 = dense[0, 0], dense[0, 1], dense[0, 2], dense[0, 3]
    moved = s1 * m1 + theta * (s2 * m2 + theta * (s3 * m3 + theta * s4 * m4))
    later = s1 * m2 + theta * (s2 * m3 + theta * (s3 * m4 + theta * s4 * m5))
    by_constant = b * kept * (s.shown_pilot - work.y[0]) - h * theta * (moved + b * (later - moved))
    by_constant /= p.sensor_time_constant
    along = h * theta if s.moving else 0.0
    for i in range(len(tiles)):
        tile = tiles[i]
        for lane in range(LANES):
            slope = tile.dense[2, lane] * m3 + theta * (tile.dense[3, lane] * m4 + theta * tile.dense[4, lane] * m5)
            slope = tile.dense[0, lane] * m1 + theta * (tile.dense[1, lane] * m2 + theta * slope)
            tile.total[lane] = (
                kept * tile.shown[lane] + taken * tile.x[lane] + along * slope
                + by_constant * tile.sensor_time_constant[lane]
            )  # fmt: skip
    return kept * s.shown_pilot + taken * work.y[0] + h * theta * moved
