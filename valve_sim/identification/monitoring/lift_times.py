"""Where fits of a valve with gas start from: the effect's size by which the main plunger lifts when it was seen to.

The main plunger lifts once the pressure has equalised, up to seconds after the command, and within milliseconds. The
residual of a position shows that two such steps lie apart, but hardly how far. The times themselves change smoothly
with a leak, with what is left of a clogged orifice, and with the pressure before the first stroke.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.monitoring.stroke_delays import crossing
from valve_sim.identification.plants.commissioned import START, START_SHARE
from valve_sim.identification.plants.protocol import Array, EffectChoice, from_internal, internal_bounds, to_internal
from valve_sim.identification.plants.tolerances import of_gas
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.valve_sensors import as_it_began
from valve_sim.model import CATALOGUE, SimulationError, Valve
from valve_sim.recordings import Trace
from valve_sim.recordings.strokes import begins_stroke

SIZES: Final = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
"""Of an effect, in its prior scales, of which the best is refined."""
PRESSURES: Final = (-1.0, 0.0, 1.0)
"""Before the first stroke, in standard deviations of what it may be beside what the model has."""
NEAREST: Final = 2
"""Of these, that are refined."""
EXACT: Final = 1e-3
"""s: to which a time is known here."""
INTERVAL: Final = 1e-3
"""s between the positions of the model."""
LATEST: Final = 10.0
"""s after the command of a stroke that was not seen to open."""
DIFFERENCE: Final = 1e-4
"""Step of a difference quotient, in an effect's prior scales."""


def starts_by_lift(trace: Trace, valve: Valve) -> dict[str, Mapping[str, float]]:
    """A starting point of each effect that exists with gas alone, by its name; none without gas or positions."""
    if valve.gas is None or not trace.has_positions:
        return {}
    lift = _LiftTimes(trace, valve)
    plant = ValvePlant([trace], valve)
    chosen = [effect for name, effect in plant.effects.items() if name in CATALOGUE and _is_of_gas(name)]
    return {effect.name: start for effect in chosen if (start := lift.start(effect))}


def _is_of_gas(name: str) -> bool:
    return not CATALOGUE[name].is_of(has_gas=False)


class _LiftTimes:
    """When the main plunger is half open, stroke by stroke, s after the command."""

    def __init__(self, trace: Trace, valve: Valve) -> None:
        assert valve.gas is not None
        parameters = valve.parameters
        self._level = 0.5 * (parameters.pilot_gap + parameters.stroke)
        volts = trace.drive.volts
        before = [0.0, *volts[:-1]]
        edges = [*trace.drive.times[1:], max(trace.times[-1], trace.drive.times[-1])]
        self._strokes = [
            (float(start), float(stop))
            for start, stop, last, now in zip(trace.drive.times, edges, before, volts, strict=True)
            if begins_stroke(last, now)
        ]
        seen = [np.any((trace.times > start) & (trace.times <= stop)) for start, stop in self._strokes]
        self._strokes = list(itertools.compress(self._strokes, seen))
        self._measured = self._times_of(trace.times, trace.pilot_position)
        grid = np.arange(min(trace.times[0], trace.drive.times[0]), trace.drive.times[-1], INTERVAL)
        model = replace(trace, times=grid, pilot_position=np.zeros(len(grid)), coil_current=None, outlet_start=None)
        self._grid, self._plant = grid, ValvePlant([model], as_it_began(valve, trace))
        self._began = as_it_began(valve, trace).gas.outlet_pressure  # type: ignore[union-attr] # it has gas
        self._sigma = START_SHARE * valve.gas.inlet_pressure

    def start(self, effect: EffectChoice) -> Mapping[str, float]:
        """The effect and the pressure before the first stroke that explain the times best; empty where none does."""
        (parameter,) = effect.parameters
        name = effect.free_name(parameter)
        lower, upper = internal_bounds(parameter)
        off = to_internal(parameter, parameter.neutral)
        sign = 1.0 if off < upper else -1.0

        from scipy.optimize import least_squares

        def values(at: Array) -> dict[str, float]:
            inside = min(max(off + sign * parameter.prior_scale * abs(float(at[0])), lower), upper)
            pressure = max(self._began + self._sigma * float(at[1]), 1.0)
            return {name: from_internal(parameter, inside), of_gas(START): pressure}

        def left(at: Array) -> Array:
            try:
                (position,) = self._plant.predict(values(at))
            except SimulationError:
                return np.full(len(self._measured) + 1, LATEST / EXACT)
            return np.append((self._times_of(self._grid, position) - self._measured) / EXACT, at[1])

        # The first stroke alone tells little but the pressure before it.
        grid = [np.array(at) for at in itertools.product(SIZES, PRESSURES)]
        nearest = sorted(grid, key=lambda at: float(np.sum(np.abs(left(at)))))[:NEAREST]
        fits = []
        for at in nearest:
            fits.append(least_squares(left, at, diff_step=[DIFFERENCE, DIFFERENCE], x_scale=[0.1, 0.1], max_nfev=20))
            if np.max(np.abs(fits[-1].fun)) < 1.0:
                break
        found = min(fits, key=lambda one: float(one.cost))
        return values(found.x)

    def _times_of(self, times: Array, positions: Array) -> Array:
        """(strokes,) s after the command; of one that is not seen to lift, the whole time that it had."""
        found = []
        for start, stop in self._strokes:
            inside = (times > start) & (times <= stop)
            at = crossing(times[inside], positions[inside], self._level, rises=True)
            found.append(min(at, stop) - start if math.isfinite(at) else stop - start)
        return np.array(found)
