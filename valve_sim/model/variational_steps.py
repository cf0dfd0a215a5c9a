"""One step of the variational equations, compiled: (V1) by (V4) of `variational`, for tiles of parameters."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.dormand_prince import POSITION, VELOCITY, interpolate
from valve_sim.model.gas.record import GAS_NUMBERS
from valve_sim.model.linearised import CONDITIONS, FIRST_CONDITION, force_slopes

LANES: Final = 4
"""Parameters of one tile."""
NODES: Final = 4
"""Nodes of a step of the variational equations."""
C1, C2 = (5 - math.sqrt(5)) / 10, (5 + math.sqrt(5)) / 10
"""The two nodes inside, in steps; the others are its start and its end."""
_ROOT: Final = math.sqrt(5) / 120
LOBATTO: Final = (
    (11 / 120 + _ROOT, 25 / 120 - _ROOT, 25 / 120 - 13 * _ROOT, -1 / 120 + _ROOT),
    (11 / 120 - _ROOT, 25 / 120 + 13 * _ROOT, 25 / 120 + _ROOT, -1 / 120 - _ROOT),
    (1 / 12, 5 / 12, 5 / 12, 1 / 12),
)
"""The tableau of (V4): a_ij of the nodes after the start."""
OF_U, OF_W, SCRATCH = NODES, NODES + 1, NODES + 2
"""Places among the records of slopes, after those of the nodes: derivatives of u, of w, and at an event."""
SLOPES: Final = NODES + 3
"""Records of slopes."""
_LANE: Final = ("f8", (LANES,))
CONTACTS: Final = (
    "pilot_gap", "stroke", "pickup_velocity_ratio", "restitution_stop", "restitution_seat", "sensor_gain",
    "sensor_time_constant", "reference_voltage",
)  # fmt: skip
"""Numbers of the valve that act through events, the sensor or the target of u, and not through the force."""

TILE_RECORD: Final = np.dtype(
    [
        # What the parameters are: how each moves the numbers of the valve that forces read, the others, and clocks.
        ("row_count", "i8"),
        ("row_number", "i8", (FIRST_CONDITION,)),  # place in SLOPES_RECORD's `all`
        ("row", "f8", (FIRST_CONDITION, LANES)),
        *((name, *_LANE) for name in CONTACTS),
        ("position_time", *_LANE),  # by how much later the samples of positions are taken
        ("current_time", *_LANE),
        # δ at the start of a step and at its end; the conditions of the forces; the time of the last event.
        ("x", *_LANE),
        ("v", *_LANE),
        ("x_new", *_LANE),
        ("v_new", *_LANE),
        ("dense", "f8", (5, LANES)),
        ("condition", "f8", (len(CONDITIONS), LANES)),
        ("event_time", *_LANE),
        # δ of what a first-order sensor of the pilot shows, at the start of a step and at its end.
        ("shown", *_LANE),
        ("shown_new", *_LANE),
        # Working memory.
        ("b", "f8", (NODES, LANES)),
        ("total", *_LANE),
        # Of gas: how each parameter moves its numbers, whether any does; δ of the density; the slopes at the stages.
        ("gas", "f8", (len(GAS_NUMBERS), LANES)),
        ("has_gas", "i8"),
        ("density", *_LANE),
        ("density_new", *_LANE),
        ("density_dense", "f8", (3, LANES)),
        ("stages", "f8", (3, 6, LANES)),  # of x, v and the density
    ],
    align=True,
)
"""A tile of parameters, and the derivatives with respect to them."""


@inner
def vary_step(p, s, work, h, vary):
    """Carry δ through a step of size h that the plain trace takes, by (V1) and (V4)."""
    if vary is None:
        return
    tiles, slopes, nodes, _, _ = vary
    if not s.moving:
        for i in range(len(tiles)):
            _rest(tiles[i])
        return
    g = (slopes[nodes[0]], slopes[nodes[1]], slopes[nodes[2]], slopes[nodes[3]])
    if not work.start_is_known:
        force_slopes(p, s, g[0], s.time, work.y[0], work.y[1])
    x, v = interpolate(work, h, POSITION, C1), interpolate(work, h, VELOCITY, C1)
    force_slopes(p, s, g[1], s.time + C1 * h, x, v)
    x, v = interpolate(work, h, POSITION, C2), interpolate(work, h, VELOCITY, C2)
    force_slopes(p, s, g[2], s.time + C2 * h, x, v)
    force_slopes(p, s, g[3], s.time + h, work.y_new[0], work.y_new[1])
    by_velocity = _by_velocity(g, h)
    solved = _inverse(by_velocity, h)
    for i in range(len(tiles)):
        _gather_nodes(tiles[i], g)
        _vary_tile(tiles[i], g, h, by_velocity, solved)


@inlined
def _by_velocity(g, h):
    """(3, 3): derivatives of the accelerations at the last nodes to the velocities there, positions eliminated."""
    a1, a2, a3 = g[1].x * g[1].per_mass * h, g[2].x * g[2].per_mass * h, g[3].x * g[3].per_mass * h
    c1, c2, c3 = g[1].v * g[1].per_mass, g[2].v * g[2].per_mass, g[3].v * g[3].per_mass
    (_, l11, l12, l13), (_, l21, l22, l23), (_, l31, l32, l33) = LOBATTO
    return (
        (a1 * l11 + c1, a1 * l12, a1 * l13),
        (a2 * l21, a2 * l22 + c2, a2 * l23),
        (a3 * l31, a3 * l32, a3 * l33 + c3),
    )


@inlined
def _inverse(m, h):
    """(3, 3): the inverse of 1 − h a m, a the inner part of the tableau: from right sides of (V4) to velocities."""
    (m11, m12, m13), (m21, m22, m23), (m31, m32, m33) = m
    (_, l11, l12, l13), (_, l21, l22, l23), (_, l31, l32, l33) = LOBATTO
    n11 = 1.0 - h * (l11 * m11 + l12 * m21 + l13 * m31)
    n12 = -h * (l11 * m12 + l12 * m22 + l13 * m32)
    n13 = -h * (l11 * m13 + l12 * m23 + l13 * m33)
    n21 = -h * (l21 * m11 + l22 * m21 + l23 * m31)
    n22 = 1.0 - h * (l21 * m12 + l22 * m22 + l23 * m32)
    n23 = -h * (l21 * m13 + l22 * m23 + l23 * m33)
    n31 = -h * (l31 * m11 + l32 * m21 + l33 * m31)
    n32 = -h * (l31 * m12 + l32 * m22 + l33 * m32)
    n33 = 1.0 - h * (l31 * m13 + l32 * m23 + l33 * m33)
    i11, i12, i13 = n22 * n33 - n23 * n32, n13 * n32 - n12 * n33, n12 * n23 - n13 * n22
    i21, i22, i23 = n23 * n31 - n21 * n33, n11 * n33 - n13 * n31, n13 * n21 - n11 * n23
    i31, i32, i33 = n21 * n32 - n22 * n31, n12 * n31 - n11 * n32, n11 * n22 - n12 * n21
    per = 1.0 / (n11 * i11 + n12 * i21 + n13 * i31)
    return (
        (i11 * per, i12 * per, i13 * per),
        (i21 * per, i22 * per, i23 * per),
        (i31 * per, i32 * per, i33 * per),
    )


@inlined
def gather(tile, g, total):
    """Derivatives, to the parameters, of the quantity whose slopes g has, at a fixed time and state."""
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
def _gather_nodes(tile, g):
    """The same at all nodes, over the mass: row by row, so that no sum waits for itself."""
    per_mass, b = g[0].per_mass, tile.b
    for node in range(NODES):
        for lane in range(LANES):
            b[node, lane] = 0.0
    for row in range(tile.row_count):
        number = tile.row_number[row]
        b0, b1, b2, b3 = g[0].all[number], g[1].all[number], g[2].all[number], g[3].all[number]
        for lane in range(LANES):
            along = per_mass * tile.row[row, lane]
            b[0, lane] += b0 * along
            b[1, lane] += b1 * along
            b[2, lane] += b2 * along
            b[3, lane] += b3 * along
    for place in range(len(CONDITIONS)):
        number = FIRST_CONDITION + place
        b0, b1, b2, b3 = g[0].all[number], g[1].all[number], g[2].all[number], g[3].all[number]
        for lane in range(LANES):
            along = per_mass * tile.condition[place, lane]
            b[0, lane] += b0 * along
            b[1, lane] += b1 * along
            b[2, lane] += b2 * along
            b[3, lane] += b3 * along


@inner
def _rest(tile):
    for lane in range(LANES):
        tile.x_new[lane] = tile.x[lane]
        tile.v_new[lane] = tile.v[lane]


@inlined
def _vary_tile(tile, g, h, by_velocity, solved):
    """One tile's step by (V4), and its dense output."""
    per_mass = g[0].per_mass
    a0, a1, a2, a3 = g[0].x * per_mass, g[1].x * per_mass, g[2].x * per_mass, g[3].x * per_mass
    c0 = g[0].v * per_mass
    (l10, l11, l12, l13), (l20, l21, l22, l23), (l30, l31, l32, l33) = LOBATTO
    m1, m2, m3 = by_velocity[2]
    (i11, i12, i13), (i21, i22, i23), (i31, i32, i33) = solved
    b, dense = tile.b, tile.dense
    for lane in range(LANES):
        x, v = tile.x[lane], tile.v[lane]
        # Accelerations at the nodes, without the contribution of the velocities after the start.
        f0 = a0 * x + c0 * v + b[0, lane]
        f1 = a1 * (x + h * l10 * v) + b[1, lane]
        f2 = a2 * (x + h * l20 * v) + b[2, lane]
        f3 = a3 * (x + h * l30 * v) + b[3, lane]
        r1 = v + h * (l10 * f0 + l11 * f1 + l12 * f2 + l13 * f3)
        r2 = v + h * (l20 * f0 + l21 * f1 + l22 * f2 + l23 * f3)
        r3 = v + h * (l30 * f0 + l31 * f1 + l32 * f2 + l33 * f3)
        v1 = i11 * r1 + i12 * r2 + i13 * r3
        v2 = i21 * r1 + i22 * r2 + i23 * r3
        v3 = i31 * r1 + i32 * r2 + i33 * r3
        f3 += m1 * v1 + m2 * v2 + m3 * v3
        mean = l30 * v + l31 * v1 + l32 * v2 + l33 * v3
        tile.x_new[lane] = x + h * mean
        tile.v_new[lane] = v3
        # The polynomial that has position, velocity and acceleration of both ends.
        half = 0.5 * h * f0
        of_x, of_v, of_f = mean - v - half, v3 - v - 2.0 * half, h * (f3 - f0)
        dense[0, lane] = v
        dense[1, lane] = half
        dense[2, lane] = 10.0 * of_x - 4.0 * of_v + 0.5 * of_f
        dense[3, lane] = -15.0 * of_x + 7.0 * of_v - of_f
        dense[4, lane] = 6.0 * of_x - 3.0 * of_v + 0.5 * of_f


@inner
def commit_variations(vary):
    """Make the end of the step, with its slopes, the start of the next one."""
    if vary is None:
        return
    tiles, _, nodes, _, _ = vary
    nodes[0], nodes[NODES - 1] = nodes[NODES - 1], nodes[0]
    for i in range(len(tiles)):
        tile = tiles[i]
        for lane in range(LANES):
            tile.x[lane] = tile.x_new[lane]
            tile.v[lane] = tile.v_new[lane]
            tile.density[lane] = tile.density_new[lane]
            tile.shown[lane] = tile.shown_new[lane]
