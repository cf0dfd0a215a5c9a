"""One step of the variational equations, compiled: (V1) by (V4) of `variational`, for tiles of parameters."""

from __future__ import annotations

from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.gas.linearised import CONDITIONS, FIRST_CONDITION
from valve_sim.model.gas.record import GAS_NUMBERS

LANES: Final = 4
"""Parameters of one tile."""
NODES: Final = 4
"""Nodes of a step of the variational equations."""
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
