"""The variational equations: how a trace changes with its parameters, through every event, compiled.

For a parameter θ let δ = ∂(x, v)/∂θ at a fixed time. Between events it follows the plain trace's own steps,

    (V1)  δ' = A δ + b,    A = ∂f/∂(x, v),    b = ∂f/∂θ,

where f are the rates of `equations` and the derivatives those of `linearised`, worked out once for each stage and
shared by all parameters. An event, where a guard g(x, v, t, θ) is 0, moves in time, and δ jumps (saltation):

    (V2)  t_e' = −(∂g/∂θ + ∂g/∂(x, v) δ⁻) / (dg/dt)⁻
    (V3)  δ⁺ = ∂r/∂θ + ∂r/∂(x, v) (δ⁻ + f⁻ t_e') − f⁺ t_e',    r what the event makes of (x, v).

Sources: Hairer, Nørsett and Wanner, section I.14; Rozenvasser, Automation and Remote Control 28 (1967) 400. Parameters
go in tiles of `LANES`, which fill a processor's vector unit. Whoever wants no derivatives says None for `vary`, and
every function here is compiled to nothing. Otherwise `vary` is

    tiles (p,) TILE_RECORD; slopes (STAGES + 1,) SLOPES_RECORD; commands: derivatives of their times and of their
    voltages, (p, c, LANES) each; outputs: of positions and of currents, (n, p, LANES) each, written.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN, PILOT
from valve_sim.model.dormand_prince import (
    C2,
    C3,
    C4,
    C5,
    DENSE,
    LAST,
    POSITION,
    VELOCITY,
    at_end,
    at_fifth,
    at_fourth,
    at_second,
    at_sixth,
    at_third,
    interpolate,
)
from valve_sim.model.equations import coil_now
from valve_sim.model.linearised import (
    CONDITIONS,
    FIRST_CONDITION,
    PEAK_CURRENT,
    SEGMENT_TIME,
    SEGMENT_U,
    SEGMENT_W,
    TARGET,
    UNSEATED_TIME,
    add_term_time_slopes,
    coil_slopes,
    force_slopes,
)
from valve_sim.model.location import CONTACT, TURN

LANES: Final = 8
"""Parameters of one tile."""
STAGES: Final = 6
"""That the variational equations look at: where the last one looks, its own δ' is no part of the step's end."""
OF_U, OF_W = STAGES, STAGES + 1
"""Places among the records of slopes, after those of the stages: derivatives of u and of w."""
_LANE: Final = ("f8", (LANES,))
CONTACTS: Final = (
    "pilot_gap", "stroke", "pickup_velocity_ratio", "restitution_stop", "restitution_seat", "sensor_gain",
    "reference_voltage",
)  # fmt: skip
"""Numbers of the valve that act by events, by the sensor or by where u goes, and not by the force."""

TILE_RECORD: Final = np.dtype(
    [
        # What the parameters are: how each moves the numbers of the valve that forces read, the others, and clocks.
        ("row_count", "i8"),
        ("row_number", "i8", (FIRST_CONDITION,)),  # place in SLOPES_RECORD's `all`
        ("row", "f8", (FIRST_CONDITION, LANES)),
        *((name, *_LANE) for name in CONTACTS),
        ("position_time", *_LANE),  # by how much later the samples of positions are taken
        ("current_time", *_LANE),
        # Where δ is: at the start of a step, at its end; what the forces remember; when the last event was.
        ("x", *_LANE),
        ("v", *_LANE),
        ("x_new", *_LANE),
        ("v_new", *_LANE),
        ("dense", "f8", (4, LANES)),
        ("condition", "f8", (len(CONDITIONS), LANES)),
        ("event_time", *_LANE),
        # Scratch paper.
        ("b", "f8", (STAGES, LANES)),
        ("total", *_LANE),
    ],
    align=True,
)
"""Some parameters, and the derivatives to them."""


@inner
def vary_step(p, s, work, h, vary):
    """Carry δ through a step of size h that the plain trace takes, by (V1)."""
    if vary is None:
        return
    tiles, slopes, _, _ = vary
    if s.moving:
        _stage_slopes(p, s, work, h, slopes)
    for i in range(len(tiles)):
        if s.moving:
            _vary_tile(tiles[i], slopes, h)
        else:
            _rest(tiles[i])


@inner
def _stage_slopes(p, s, work, h, slopes):
    """A and b of (V1) where the stages of the plain step looked, as derivatives of the force."""
    t, k, x, v = s.time, work.k, work.y[0], work.y[1]
    force_slopes(p, s, slopes[0], t, x, v)
    force_slopes(p, s, slopes[1], t + C2 * h, at_second(x, h, k[0, 0]), at_second(v, h, k[0, 1]))
    x_stage, v_stage = at_third(x, h, k[0, 0], k[1, 0]), at_third(v, h, k[0, 1], k[1, 1])
    force_slopes(p, s, slopes[2], t + C3 * h, x_stage, v_stage)
    x_stage = at_fourth(x, h, k[0, 0], k[1, 0], k[2, 0])
    v_stage = at_fourth(v, h, k[0, 1], k[1, 1], k[2, 1])
    force_slopes(p, s, slopes[3], t + C4 * h, x_stage, v_stage)
    x_stage = at_fifth(x, h, k[0, 0], k[1, 0], k[2, 0], k[3, 0])
    v_stage = at_fifth(v, h, k[0, 1], k[1, 1], k[2, 1], k[3, 1])
    force_slopes(p, s, slopes[4], t + C5 * h, x_stage, v_stage)
    x_stage = at_sixth(x, h, k[0, 0], k[1, 0], k[2, 0], k[3, 0], k[4, 0])
    v_stage = at_sixth(v, h, k[0, 1], k[1, 1], k[2, 1], k[3, 1], k[4, 1])
    force_slopes(p, s, slopes[5], t + h, x_stage, v_stage)


@inlined
def _gather(tile, g, total):
    """Derivatives to the parameters of what g is of, at a fixed time and state."""
    for lane in range(LANES):
        total[lane] = 0.0
    for row in range(tile.row_count):
        slope = g.all[tile.row_number[row]]
        for lane in range(LANES):
            total[lane] += slope * tile.row[row, lane]
    for place in range(len(CONDITIONS)):
        slope = g.all[FIRST_CONDITION + place]
        for lane in range(LANES):
            total[lane] += slope * tile.condition[place, lane]


@inlined
def _gather_stages(tile, slopes, per_mass):
    """The same at all stages, over the mass: row by row, so that no sum waits for itself."""
    for stage in range(STAGES):
        for lane in range(LANES):
            tile.b[stage, lane] = 0.0
    for row in range(tile.row_count):
        number = tile.row_number[row]
        for stage in range(STAGES):
            slope = slopes[stage].all[number] * per_mass
            for lane in range(LANES):
                tile.b[stage, lane] += slope * tile.row[row, lane]
    for place in range(len(CONDITIONS)):
        for stage in range(STAGES):
            slope = slopes[stage].all[FIRST_CONDITION + place] * per_mass
            for lane in range(LANES):
                tile.b[stage, lane] += slope * tile.condition[place, lane]


@inner
def _rest(tile):
    for lane in range(LANES):
        tile.x_new[lane] = tile.x[lane]
        tile.v_new[lane] = tile.v[lane]


@inner
def _vary_tile(tile, slopes, h):
    """One tile's step and its dense output: the stages of the plain step, linearised."""
    per_mass = 1.0 / slopes[0].mass
    _gather_stages(tile, slopes, per_mass)
    a1, a2, a3 = slopes[0].x * per_mass, slopes[1].x * per_mass, slopes[2].x * per_mass
    a4, a5, a6 = slopes[3].x * per_mass, slopes[4].x * per_mass, slopes[5].x * per_mass
    c1, c2, c3 = slopes[0].v * per_mass, slopes[1].v * per_mass, slopes[2].v * per_mass
    c4, c5, c6 = slopes[3].v * per_mass, slopes[4].v * per_mass, slopes[5].v * per_mass
    b, dense = tile.b, tile.dense
    for lane in range(LANES):
        x, v = tile.x[lane], tile.v[lane]
        x1, v1 = v, a1 * x + c1 * v + b[0, lane]
        x2 = at_second(v, h, v1)
        v2 = a2 * at_second(x, h, x1) + c2 * x2 + b[1, lane]
        x3 = at_third(v, h, v1, v2)
        v3 = a3 * at_third(x, h, x1, x2) + c3 * x3 + b[2, lane]
        x4 = at_fourth(v, h, v1, v2, v3)
        v4 = a4 * at_fourth(x, h, x1, x2, x3) + c4 * x4 + b[3, lane]
        x5 = at_fifth(v, h, v1, v2, v3, v4)
        v5 = a5 * at_fifth(x, h, x1, x2, x3, x4) + c5 * x5 + b[4, lane]
        x6 = at_sixth(v, h, v1, v2, v3, v4, v5)
        v6 = a6 * at_sixth(x, h, x1, x2, x3, x4, x5) + c6 * x6 + b[5, lane]
        x7 = at_end(v, h, v1, v3, v4, v5, v6)
        tile.x_new[lane] = at_end(x, h, x1, x3, x4, x5, x6)
        tile.v_new[lane] = x7
        dense[0, lane] = x1
        for power in range(1, 4):
            dense[power, lane] = (
                DENSE[0, power] * x1 + DENSE[2, power] * x3 + DENSE[3, power] * x4 + DENSE[4, power] * x5
                + DENSE[5, power] * x6 + DENSE[6, power] * x7
            )  # fmt: skip


@inner
def commit_variations(vary):
    """Go on from the end of the step."""
    if vary is None:
        return
    tiles = vary[0]
    for i in range(len(tiles)):
        tile = tiles[i]
        for lane in range(LANES):
            tile.x[lane] = tile.x_new[lane]
            tile.v[lane] = tile.v_new[lane]


@inner
def _acceleration_now(p, s, slopes):
    """Of the state, m/s²; 0 at rest."""
    if not s.moving:
        return 0.0
    force_slopes(p, s, slopes[0], s.time, s.x, s.v)
    return slopes[0].force / slopes[0].mass


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
    tiles, slopes, _, _ = vary
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
    if mode == PILOT and direction < 0:
        return -p.restitution_seat * dv - tile.restitution_seat[lane] * v_before
    if mode == PILOT:
        return p.pickup_velocity_ratio * dv + tile.pickup_velocity_ratio[lane] * v_before
    return dv


@inner
def vary_release(p, s, since, vary):
    """Move δ through a release from rest that has just happened, by (V2) and (V3).

    Forces outgrow what holds as time passes; or an event or a command at this very time has freed the plungers.

    Args:
        p, s: as after it. since: s, when the last event or command was.
    """
    if vary is None:
        return
    tiles, slopes, _, _ = vary
    g = slopes[0]
    force_slopes(p, s, g, s.time, s.x, s.v)
    if p.term_count > 0:
        u, _ = coil_now(p, s)
        add_term_time_slopes(p, g, s.mode, (s.x, s.v, u, s.time))
    # The forces know time by what has passed since a command, or since the pilot left its seat.
    rate = g.t - g.segment_time - g.unseated_time
    a_after = g.force / g.mass
    for i in range(len(tiles)):
        tile = tiles[i]
        _gather(tile, g, tile.total)
        for lane in range(LANES):
            if s.time > since and rate != 0.0:
                tile.event_time[lane] = -(tile.total[lane] + g.x * tile.x[lane]) / rate
            tile.v[lane] = -a_after * tile.event_time[lane]
            if s.unseated_time == s.time:
                tile.condition[UNSEATED_TIME, lane] = tile.event_time[lane]


@inner
def leave_segment(p, s, command, vary):
    """What a command that is about to take effect makes of δ, and of what the forces remember."""
    if vary is None:
        return
    tiles, slopes, (times, _), _ = vary
    a_before = _acceleration_now(p, s, slopes)
    of_u, of_w = slopes[OF_U], slopes[OF_W]
    coil_slopes(p, s, of_u, s.time, 1.0, 0.0)
    coil_slopes(p, s, of_w, s.time, 0.0, 1.0)
    for i in range(len(tiles)):
        tile = tiles[i]
        _gather(tile, of_u, tile.b[0])
        _gather(tile, of_w, tile.b[1])
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
    tiles, slopes, (times, volts), _ = vary
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
    times, _, current_times, _ = samples
    tiles, slopes, _, (positions, currents) = vary
    (first, first_current), (end, end_current) = done
    for i in range(len(tiles)):
        _show_positions(p, s, work, h, (times, first, end), tiles[i], positions[:, i])
    for at in range(first_current, end_current):
        coil_slopes(p, s, slopes[OF_U], current_times[at], 1.0, 0.0)
        for i in range(len(tiles)):
            tile = tiles[i]
            _gather(tile, slopes[OF_U], tile.total)
            for lane in range(LANES):
                currents[at, i, lane] = tile.total[lane] - slopes[OF_U].segment_time * tile.current_time[lane]


@inner
def _show_positions(p, s, work, h, which, tile, positions):
    """Of one tile, as the sensor shows them; plungers at rest stay where they are."""
    times, first, end = which
    for at in range(first, end):
        if s.moving or at == first:
            theta = max(0.0, (times[at] - s.time) / h)
            x, v = interpolate(work, h, POSITION, theta), p.sensor_gain * interpolate(work, h, VELOCITY, theta)
            along = p.sensor_gain * h * theta if s.moving else 0.0
            for lane in range(LANES):
                slope = tile.dense[1, lane] + theta * (tile.dense[2, lane] + theta * tile.dense[3, lane])
                tile.total[lane] = (
                    p.sensor_gain * tile.x[lane] + x * tile.sensor_gain[lane] + v * tile.position_time[lane]
                    + along * (tile.dense[0, lane] + theta * slope)
                )  # fmt: skip
        for lane in range(LANES):
            positions[at, lane] = tile.total[lane]
