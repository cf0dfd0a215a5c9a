"""Voltages that drive a valve; the usual ones: step, peak and hold, pulse-width modulation by its mean or its edges.

After each the command is 0: the coil is then shorted, or with `valve.release_voltage` freewheels into that voltage.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valve_sim.model.errors import ParameterError

Array = NDArray[np.float64]


class Drive(NamedTuple):
    """The commanded coil voltage: held between commands, 0 before the first.

    Attributes:
        times: (k,) s, ascending.
        volts: (k,) V.
    """

    times: Array
    volts: Array

    @classmethod
    def of(cls, times: ArrayLike, volts: ArrayLike) -> Drive:
        """A drive from anything that NumPy converts to two arrays of one length."""
        return cls(
            np.atleast_1d(np.asarray(times, dtype=np.float64)), np.atleast_1d(np.asarray(volts, dtype=np.float64))
        )

    def at(self, times: ArrayLike) -> Array:
        """The voltage in force at each time (a command acts from its own time on), V."""
        index = np.searchsorted(self.times, np.asarray(times, dtype=np.float64), side="right")
        return np.concatenate([[0.0], self.volts])[index]


_NO_SAMPLES: Final = np.empty(0)


class Supply(NamedTuple):
    """The pressures at both ends of a valve with gas. Where there are no samples the declared one holds.

    The tank's is linear between its samples, as a tank empties; that of the demand holds until its next sample, as
    valve_node holds it. Before its first sample each is as it is there.

    Attributes:
        times: (k,) s, ascending. pressures: (k,) Pa, above 0: the tank's.
        demand_times: (m,) s, ascending. demand_pressures: (m,) Pa, above 0: behind the demand's orifice.
    """

    times: Array
    pressures: Array
    demand_times: Array = _NO_SAMPLES
    demand_pressures: Array = _NO_SAMPLES

    def changes(self, start: float) -> Array:
        """(n, 4) s, Pa of the tank, Pa/s at which it goes on, Pa behind the demand, NaN where that does not change.

        What holds at the start, s, stands at −∞.
        """
        rows = []
        if len(self.times):
            rates = np.append(np.diff(self.pressures) / np.diff(self.times), 0.0)
            index = int(np.searchsorted(self.times, start, side="right")) - 1
            first = float(np.interp(start, self.times, self.pressures)), float(rates[index]) if index >= 0 else 0.0
            rows.append(np.array([[-math.inf, *first, math.nan]]))
            later = self.times > start
            nothing = np.full(np.count_nonzero(later), math.nan)
            rows.append(np.column_stack([self.times[later], self.pressures[later], rates[later], nothing]))
        if len(self.demand_times):
            index = int(np.searchsorted(self.demand_times, start, side="right")) - 1
            rows.append(np.array([[-math.inf, math.nan, math.nan, float(self.demand_pressures[max(index, 0)])]]))
            later = self.demand_times > start
            nothing = np.full((np.count_nonzero(later), 2), math.nan)
            rows.append(np.column_stack([self.demand_times[later], nothing, self.demand_pressures[later]]))
        return np.concatenate([np.empty((0, 4)), *rows])


def step(volts: float, start: float = 0.0, end: float = math.inf) -> Drive:
    """A voltage from `start` to `end`, s; without end by default.

    Raises:
        ParameterError: it ends before it begins.
    """
    _check_order(start, end)
    return Drive.of([start], [volts]) if math.isinf(end) else Drive.of([start, end], [volts, 0.0])


def peak_and_hold(levels: tuple[float, float], start: float, durations: tuple[float, float]) -> Drive:
    """A high voltage to open, then a low one to hold.

    Args:
        levels: the two voltages, V. start: of the first, s. durations: of the two, s.

    Raises:
        ParameterError: a duration is negative.
    """
    times = start + np.cumsum([0.0, *durations])
    _check_order(start, times[1])
    _check_order(times[1], times[2])
    return Drive.of(times, [*levels, 0.0])


def pulse_width_modulated(
    supply: float, duty: float, frequency: float, start: float, end: float, off_voltage: float = 0.0
) -> Drive:
    """A pulse-width modulated voltage by its edges: two commands a period, for short records.

    Args:
        supply: V, while on. duty: share of a period that it is on, 0 to 1. frequency: 1/s. start, end: s.
        off_voltage: V, between the pulses; 0 is a command of 0, so that a freewheeling coil sees `release_voltage`.

    Raises:
        ParameterError: a duty outside 0 to 1, a frequency that is not above 0, or an end before the start.
    """
    _check_duty(duty)
    _check_order(start, end)
    if not frequency > 0.0:
        raise ParameterError(f"frequency: found {frequency:g} 1/s, expected above 0")
    periods = np.arange(math.ceil((end - start) * frequency))
    on = start + periods / frequency
    edges = np.column_stack([on, on + duty / frequency]).ravel()
    volts = np.tile([supply, off_voltage], len(periods))
    if duty in (0.0, 1.0):
        edges, volts = np.array([start]), np.array([supply if duty else off_voltage])
    kept = edges < end
    return Drive.of([*edges[kept], end], [*volts[kept], 0.0])


def pulse_width_mean(supply: float, duty: float, start: float, end: float, off_voltage: float = 0.0) -> Drive:
    """A pulse-width modulated drive by its mean voltage, for records of any length; without the ripple of the current.

    The mean is valid if current flows throughout the period. With a freewheeling path give −`release_voltage` as the
    `off_voltage`. The theory, "Release and drives", has the size of the ripple and the error of leaving it out.

    Raises:
        ParameterError: a duty outside 0 to 1, or an end before the start.
    """
    _check_duty(duty)
    return step(duty * supply + (1.0 - duty) * off_voltage, start, end)


def _check_duty(duty: float) -> None:
    if not 0.0 <= duty <= 1.0:
        raise ParameterError(f"duty: found {duty:g}, expected a share from 0 to 1")


def _check_order(start: float, end: float) -> None:
    if not start <= end:
        raise ParameterError(f"drive: found an end at {end:g} s before its start at {start:g} s")
