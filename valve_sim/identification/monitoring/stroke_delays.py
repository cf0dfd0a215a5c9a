"""How late a measured stroke follows the simulated one: where a fit of its commands' errors starts from."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.recording_errors import CLOCK_SIGMA
from valve_sim.identification.plants.valve_sensors import as_it_began
from valve_sim.model import Drive, Valve, simulate
from valve_sim.recordings import Trace

SHIFT_ITERATIONS: Final = 4
"""Iterations that find the delays of the commands before a fit."""
SHIFT_TOLERANCE: Final = 1e-3
"""s: iterations end when the delays change by less."""
EARLY_CURRENT: Final = 0.25
"""Share of the largest current that it has before anything moves."""
LARGEST: Final = 0.99
"""Quantile of the current that stands for its largest value: noise does not reach it."""


def delays_of(trace: Trace, valve: Valve, lateness: float) -> tuple[float, float]:
    """Delays of the measured stroke behind the simulated one, opening and closing, s; nan if not seen.

    Taken at mid-travel (with gas within the gap, for what follows waits for the pressure) or, without positions, where
    the current has come to `EARLY_CURRENT` of its own largest value: there it follows the voltage, whatever the coil's
    resistance is.
    """
    times = trace.sample_times
    shown = simulate(as_it_began(valve, trace), trace.drive, times - lateness, start_time=start_before(trace, lateness))
    if trace.has_positions:
        level = 0.5 * (valve.parameters.stroke if valve.gas is None else valve.parameters.pilot_gap)
        pairs = [(trace.pilot_position, level), (shown.pilot_position, level)]
    else:
        assert trace.coil_current is not None
        currents = [np.abs(trace.coil_current.values), np.abs(shown.coil_current)]
        pairs = [(current, EARLY_CURRENT * float(np.quantile(current, LARGEST))) for current in currents]
    opening, closing = (
        crossing(times, *pairs[0], rises=rises) - crossing(times, *pairs[1], rises=rises) for rises in (True, False)
    )
    return opening, closing


def rough_shifts(trace: Trace, valve: Valve, lateness: float) -> list[float]:
    """(commands,) s: as `delays_of`, 0 where not seen and for the commands between.

    Iterated with the commands delayed: a valve that is held open for a shorter time closes sooner, and one that has
    just begun to open closes differently.
    """
    shifts = np.zeros(len(trace.drive.times))
    for _ in range(SHIFT_ITERATIONS):
        times = trace.drive.times + shifts
        if np.any(np.diff(times) <= 0.0):
            break
        opening, closing = delays_of(replace(trace, drive=Drive(times, trace.drive.volts)), valve, lateness)
        if len(shifts) > 1 and math.isfinite(closing):
            shifts[-1] += closing
        if math.isfinite(opening):
            shifts[0] += opening
        if not max(abs(opening), abs(closing)) > SHIFT_TOLERANCE:
            break
    return shifts.tolist()


def start_before(trace: Trace, lateness: float) -> float:
    """A time before the first command and the first sample, s."""
    return float(min(trace.drive.times[0], trace.sample_times[0] - lateness)) - CLOCK_SIGMA


def crossing(times: Array, values: Array, level: float, *, rises: bool) -> float:
    """When values first rise past a level, or last fall past it, by a straight line between samples, s; or nan."""
    beyond = values >= level if rises else values < level
    passed = np.flatnonzero(beyond[1:] & ~beyond[:-1])
    if len(passed) == 0:
        return math.nan
    at = int(passed[0 if rises else -1])
    share = (level - values[at]) / (values[at + 1] - values[at])
    return float(times[at] + share * (times[at + 1] - times[at]))
