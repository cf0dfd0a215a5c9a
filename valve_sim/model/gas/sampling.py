"""What position sensors show within a step, compiled: their bandwidth and gain; and a row of output."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN
from valve_sim.model.gas.equations import attraction, coil_decay, pull_squared
from valve_sim.model.gas.flux import terminal_voltage
from valve_sim.model.gas.step import PRESSURE_COLUMN, sample_gas, sample_pressure
from valve_sim.model.gas.step_memory import MECHANICAL_STATES, POSITION, VELOCITY, coil_within, interpolate

ROW: Final = 7
"""Columns of a whole row of output: pilot and main plunger as shown, velocity, attraction, phase, the pilot itself, and
the voltage at the coil's terminals."""

LONGEST_CHAIN: Final = 64
"""Samples of the current whose decay follows from the one before, by rounding alone, and not from an exponential."""
ODD_INTERVAL: Final = 1e-5
"""Time constants by which the interval between two samples may be another: its third power is below rounding."""
DECAYED: Final = 1e-30
"""What is left of the start of a current and counts as nothing: below 1e-308 processors are slow."""


@inlined
def lag_moments(b):
    """M_1 to M_5 of a first-order sensor after b time constants: M_k = ∫ e^{−b(1−φ)} φ^k b dφ over φ from 0 to 1.

    They obey M_k = 1 − (k/b) M_{k−1}, which is used upwards where b is large, and from a power series downwards where
    it is small: so rounding errors shrink.
    """
    if b > 1.0:
        m1 = 1.0 + np.expm1(-b) / b
        m2 = 1.0 - 2.0 / b * m1
        m3 = 1.0 - 3.0 / b * m2
        m4 = 1.0 - 4.0 / b * m3
        return m1, m2, m3, m4, 1.0 - 5.0 / b * m4
    term = b / 6.0
    m5 = term
    for j in range(1, 16):
        term *= -b / (6.0 + j)
        m5 += term
    m4 = (1.0 - m5) * b / 5.0
    m3 = (1.0 - m4) * b / 4.0
    m2 = (1.0 - m3) * b / 3.0
    return (1.0 - m2) * b / 2.0, m2, m3, m4, m5


@inner
def _lagged(shown, a, value, work, theta):
    """A first-order sensor after a piece of a step: exact for the dense output's polynomial.

    Solves z' = (x − z) a/h over the fraction theta, x = value + Σ slopes_k θ^k, by the moments of b = a θ.
    """
    b = a * theta
    m1, m2, m3, m4, _ = lag_moments(b)
    slopes = work.slopes
    moved = theta * (slopes[0] * m1 + theta * (slopes[1] * m2 + theta * (slopes[2] * m3 + theta * slopes[3] * m4)))
    return shown * math.exp(-b) - value * np.expm1(-b) + moved


@inner
def show_pilot(p, s, work, h, theta):
    """What the sensor of the pilot plunger shows at the fraction theta of a step, m, without gain."""
    if p.sensor_time_constant == 0.0:
        return interpolate(work, h, POSITION, theta)
    a = h / p.sensor_time_constant
    if not s.moving:
        return work.y[0] + (s.shown_pilot - work.y[0]) * math.exp(-a * theta)
    for order in range(4):
        work.slopes[order] = h * work.dense[0, order]
    return _lagged(s.shown_pilot, a, work.y[0], work, theta)


@inner
def show_main(p, s, work, h, theta):
    """The same of the main plunger."""
    above = s.mode >= MAIN
    if p.sensor_time_constant == 0.0:
        return interpolate(work, h, POSITION, theta) - p.pilot_gap if above else 0.0
    value, a = work.y[0] - p.pilot_gap if above else 0.0, h / p.sensor_time_constant
    if not (above and s.moving):
        return value + (s.shown_main - value) * math.exp(-a * theta)
    for order in range(4):
        work.slopes[order] = h * work.dense[0, order]
    return _lagged(s.shown_main, a, value, work, theta)


@inner
def sample(p, s, work, h, theta, rows, i):
    """Fill row i of the output: the pilot as shown and, where there is room, the outlet pressure or all columns."""
    rows[i, 0] = p.sensor_gain * show_pilot(p, s, work, h, theta)
    if rows.shape[1] <= PRESSURE_COLUMN + 1:
        sample_pressure(p, s, work, h, theta, rows, i)
        return
    u, w = coil_within(p, s, work, h, theta)
    x = interpolate(work, h, POSITION, theta)
    rows[i, 1] = p.sensor_gain * show_main(p, s, work, h, theta)
    rows[i, 2] = interpolate(work, h, VELOCITY, theta)
    rows[i, 3] = attraction(p, x, pull_squared(p, w, max(s.peak_current, abs(u))))
    rows[i, 4] = s.mode
    rows[i, 5] = x
    rows[i, 6] = terminal_voltage(p, s, w)
    sample_gas(p, s, work, (h, theta, x), rows, i)


@inner
def _fill_positions(p, s, work, h, times, rows, which):
    """Write the pilot alone, as a sensor shows it that filters nothing: (first, end) of a step's samples.

    In loops of their own, because most samples of a recording are of plungers at rest, and a fit asks for nothing else.
    """
    first, end = which
    if not s.moving:
        shown = p.sensor_gain * work.y[0]
        for at in range(first, end):
            rows[at, 0] = shown
    else:
        for at in range(first, end):
            rows[at, 0] = p.sensor_gain * interpolate(work, h, POSITION, max(0.0, (times[at] - s.time) / h))


@inner
def _fill_currents(p, s, work, last, samples, at):
    """Write the currents before `last`, where (1) has a solution in closed form.

    Samples come at even intervals but for the rounding of their stamps: what is left of the start of (1) then falls by
    the same factor from one to the next, which takes a fraction of the time of an exponential.

    Returns:
        how many have been written now.
    """
    times, currents = samples
    target = s.seen / p.reference_voltage
    start = s.segment_u - target
    while at < len(times) and times[at] <= last:
        elapsed = max(times[at], s.time) - s.segment_time
        interval = elapsed - work.decayed_at
        odd = (work.interval - interval) / p.coil_time_constant
        if work.chained > 0 and abs(odd) < ODD_INTERVAL:
            work.decay *= work.factor * (1.0 + odd * (1.0 + 0.5 * odd))
            work.chained -= 1
        else:
            work.decay, work.factor = coil_decay(p, elapsed), coil_decay(p, interval)
            work.interval, work.chained = interval, LONGEST_CHAIN
        if work.decay < DECAYED:
            work.decay = 0.0
        work.decayed_at = elapsed
        currents[at] = target + start * work.decay
        at += 1
    return at


@inlined
def fill_until(p, s, work, h, last, samples, done):
    """Write the samples of a step of size h that lie before `last`.

    Args:
        samples: see `run`. done: how many positions and currents have been written.

    Returns:
        how many have been written now.
    """
    times, rows, current_times, currents = samples
    at, at_current = done
    first = at
    while at < len(times) and times[at] <= last:
        at += 1
    if rows.shape[1] == 1 and p.sensor_time_constant == 0.0:
        _fill_positions(p, s, work, h, times, rows, (first, at))
    else:
        for i in range(first, at):
            sample(p, s, work, h, max(0.0, (times[i] - s.time) / h), rows, i)
    if work.states == MECHANICAL_STATES and p.eddy_time_constant == 0.0:
        at_current = _fill_currents(p, s, work, last, (current_times, currents), at_current)
    while at_current < len(current_times) and current_times[at_current] <= last:
        theta = max(0.0, (current_times[at_current] - s.time) / h)
        currents[at_current], _ = coil_within(p, s, work, h, theta)
        at_current += 1
    return at, at_current


@inlined
def is_filled(time, samples, done):
    """Whether every sample up to now has been written."""
    times, _, current_times, _ = samples
    at, at_current = done
    is_done = at == len(times) or times[at] > time
    return is_done and (at_current == len(current_times) or current_times[at_current] > time)
