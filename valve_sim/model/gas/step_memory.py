"""What a step of a valve with gas is worked out on: its rates, its dense output, and the size of the next one.

`gas.step` is the integrator. Source of the step control: Hairer, Nørsett and Wanner, *Solving Ordinary Differential
Equations I*, 2nd ed., section II.4.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.gas.equations import (
    acceleration_at,
    coil_rates,
    coil_state,
    mechanical_rates,
)
from valve_sim.model.gas.flux import resting_current

STAGES: Final = 7
"""Stages of the pair; the seventh is the first of the next step."""
MECHANICAL_STATES: Final = 2
"""x and v."""
FLUX_STATES: Final = 3
"""x, v and w, where the current follows the flux."""
ALL_STATES: Final = 5
"""x, v and, while the coil heats, u, w and T; where the current follows the flux w, nothing and T."""
# NumPy's numbers: Numba compiles a function once for all of them, but anew for each of Python's literals.
POSITION, VELOCITY, CURRENT, PULLING_CURRENT, TEMPERATURE = np.arange(ALL_STATES)
FIRST, LAST = np.array([0, STAGES - 1])

WORK_RECORD: Final = np.dtype(
    [
        ("states", "i8"),  # how many of the states are integrated, 2, 3 or 5
        ("rests", "i8"),  # 1 while w follows in closed form what the coil sees at rest
        ("start_is_known", "i8"),  # 1 while k[0] holds y' at y: it was the last stage of the step before
        ("y", "f8", (ALL_STATES,)),  # at the start of the step
        ("y_stage", "f8", (ALL_STATES,)),  # where a stage looks
        ("y_new", "f8", (ALL_STATES,)),  # at the end of the step
        ("k", "f8", (STAGES, ALL_STATES)),  # y' at the stages
        ("dense", "f8", (ALL_STATES, 4)),  # coefficients of the dense output
        ("slopes", "f8", (4,)),  # of what a sensor filters
        # The last sample of a current: see `sampling`.
        ("decayed_at", "f8"),  # s after the last command
        ("decay", "f8"),  # what was left there of the current's start
        ("interval", "f8"),  # s, between samples
        ("factor", "f8"),  # by which `decay` falls over it
        ("chained", "i8"),  # so many samples may still follow by it
        # Of gas, see `gas.step`: density, mass in and mass out at the start and at the end of the step; their slopes.
        ("gas", "f8", (3,)),
        ("gas_new", "f8", (3,)),
        ("gas_k", "f8", (6, 3)),
        ("gas_dense", "f8", (3, 3)),
        ("regime_ahead", "f8"),  # of the flow, after the event in the step
        ("stiffness", "f8"),  # how many times the gas relaxes in the step
    ],
    align=True,
)
"""The scratch paper of one run; a record, because arrays that are passed around cost reference counts."""

SMALLEST_SCALE = np.array([1e-5, 1e-2, 1e-2, 1e-2, 1e-1])
"""Below these sizes (m, m/s, –, –, K), a hundredth of what a stroke moves, the error is held absolutely."""


@inner
def rates(p, s, work, t, y, stage):
    """Write y' into row `stage` of work.k; y is one of work's states."""
    if work.states == MECHANICAL_STATES and s.moving:
        work.k[stage, 0], work.k[stage, 1] = y[1], acceleration_at(p, s, t, y[0], y[1])
        return
    u, w = coil_state(p, s, t, y[2], y[3], y[4])
    dx, dv = mechanical_rates(p, s, t, y[0], y[1], u, w)
    work.k[stage, 0], work.k[stage, 1] = dx, dv
    if work.states > MECHANICAL_STATES:
        work.k[stage, 2], work.k[stage, 3], work.k[stage, 4] = coil_rates(p, s, (y[0], dx), u, w, y[4])


@inlined
def step_factor(error):
    """The factor from one step size to the next, given the error in units of the tolerance.

    The exponent of an elementary controller is 1/5 (Hairer II.4.13). 1/4 is as stable, since the error grows with the
    fifth power of the step (1 − 5/4 is well inside the unit circle), and two square roots are faster.
    """
    return 0.9 / math.sqrt(math.sqrt(error))


@inlined
def interpolate(work, h, j, theta):
    """State j at the fraction theta of a step of size h, from its dense output."""
    slopes = work.dense[j, 1] + theta * (work.dense[j, 2] + theta * work.dense[j, 3])
    return work.y[j] + h * theta * (work.dense[j, 0] + theta * slopes)


@inlined
def dense_slope(work, h, j, theta):
    """Derivative of state j with respect to time at the fraction theta of a step of size h, from its dense output."""
    slopes = 2.0 * work.dense[j, 1] + theta * (3.0 * work.dense[j, 2] + theta * 4.0 * work.dense[j, 3])
    return work.dense[j, 0] + theta * slopes


@inner
def coil_within(p, s, work, h, theta):
    """Give u and w at the fraction theta of a step."""
    t = s.time + theta * h
    if work.states == MECHANICAL_STATES:
        return coil_state(p, s, t, 0.0, 0.0, 0.0)
    if work.rests:
        return coil_state(p, s, t, resting_current(p, s, theta * h), 0.0, s.temperature)
    u, w = interpolate(work, h, CURRENT, theta), interpolate(work, h, PULLING_CURRENT, theta)
    return coil_state(p, s, t, u, w, interpolate(work, h, TEMPERATURE, theta))
