"""The pressures at a valve with gas: behind it before a stroke, and at its two ends, tank and demand, all along.

The model of a stroke starts from the one, and is given the others as they were heard: a tank that empties and a line
that fills change when the valve opens, and are no fault. Where they are not heard, the declared ones hold.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.monitoring.findings import Unusable
from valve_sim.model import Stepper, Valve
from valve_sim.model.gas import GAS
from valve_sim.recordings import Signal, Trace

MOST: Final = 5_000
"""Samples of each kind in memory."""
LONGEST: Final = 2.0
"""s before a stroke for which pressures are kept."""
SAME: Final = 1e-5
"""Share of a pressure at an end by which the next sample must differ to count."""
_SETTERS: Final[dict[str, Callable[[Stepper, float, float], None]]] = {
    "inlet_pressure": Stepper.supply,
    "demand_pressure": Stepper.set_demand_pressure,
}


def unknown_pressure(trace: Trace) -> Unusable | None:
    """Whether a stroke began before a pressure that it depends on was known, of a valve with gas; None if not.

    A monitor and a dispenser that start together hear the line's pressure first with the first stroke, and before that
    not even whether it was the declared one.
    """
    begun = float(trace.sample_times[0]) if len(trace.sample_times) else math.inf
    ends = [end for end in (trace.inlet_pressure, trace.demand_pressure) if end is not None]
    is_known = trace.drive.times[0] >= begun and all(end.times[0] <= begun for end in ends)
    return None if is_known else Unusable.PRESSURE_UNKNOWN


class LinePressure:
    """Pressures of the last seconds: as heard, where any is heard, else as the model has them."""

    def __init__(self) -> None:
        self._noted: deque[tuple[float, float]] = deque(maxlen=MOST)
        self._heard: deque[tuple[float, float]] = deque(maxlen=MOST)
        self._kept: list[tuple[float, float]] = []
        self._ends: dict[str, deque[tuple[float, float]]] = {name: deque(maxlen=MOST) for name in _SETTERS}
        self._due: deque[tuple[float, str, float]] = deque(maxlen=MOST)
        self._begun = self._since = -math.inf

    def note(self, time: float, pressure: float) -> None:
        """Time, s, and pressure of the model, Pa, at a sample."""
        self._add(self._noted, time, pressure)

    def hear(self, time: float, pressure: float) -> None:
        """What a sensor behind the valve shows; what is not later than the last is left out."""
        self._add(self._heard, time, pressure)

    def hear_end(self, name: str, time: float, pressure: float) -> None:
        """The pressure at an end, inlet_pressure or demand_pressure, likewise; what hardly changes is left out, too."""
        rule, samples = GAS[name], self._ends[name]
        if not (math.isfinite(time) and rule.lower <= pressure <= rule.upper):
            return
        if samples and (time <= samples[-1][0] or abs(pressure - samples[-1][1]) <= SAME * samples[-1][1]):
            return
        samples.append((time, pressure))
        self._due.append((time, name, pressure))

    def supplied(self, stepper: Stepper, until: float) -> Stepper:
        """The model, given what was heard of its ends up to a time, s."""
        if self._due and stepper.valve.gas is not None:
            while self._due and self._due[0][0] <= until:
                time, name, pressure = self._due.popleft()
                _SETTERS[name](stepper, time, pressure)
        return stepper

    def supplied_anew(self, stepper: Stepper, time: float) -> Stepper:
        """A model that begins now, or has become another valve, with the pressures that hold."""
        if stepper.valve.gas is not None:
            for name, samples in self._ends.items():
                past = [pressure for heard, pressure in samples if heard <= time]
                if past:
                    _SETTERS[name](stepper, time, past[-1])
        return stepper

    def exchange(self, stepper: Stepper, valve: Valve, time: float) -> None:
        """Continue the model as another valve."""
        stepper.set_valve(valve, time)
        self.supplied_anew(stepper, time)

    def keep(self, time: float) -> None:
        """A stroke begins, s: keep what there is for it."""
        latest = self._noted[-1][0] if self._noted else -math.inf
        is_heard = bool(self._heard) and self._heard[-1][0] > latest - LONGEST
        self._kept = list(self._heard if is_heard else self._noted)
        self._since, self._begun = min(self._begun, time - LONGEST), time

    def before(self, trace: Trace, opening: float) -> Trace:
        """A stroke's trace with the pressure at its beginning, given when its first command was, s.

        And with those at the ends of the valve, from the beginning of the stroke before it on.
        """
        began = opening - float(trace.drive.times[0])
        inlet, demand = (self._of(name, began) for name in ("inlet_pressure", "demand_pressure"))
        trace = replace(trace, inlet_pressure=inlet, demand_pressure=demand)
        if not self._kept:
            return trace
        times, pressures = np.array(self._kept).T
        return replace(trace, outlet_start=float(np.interp(began, times, pressures)))

    def _of(self, name: str, zero: float) -> Signal | None:
        """An end's pressure, by times since `zero`, s; None where nothing was heard."""
        samples = self._ends[name]
        if not samples:
            return None
        times, pressures = np.array(samples).T
        first = max(0, int(np.searchsorted(times, self._since, side="right")) - 1)
        return Signal(times[first:] - zero, pressures[first:])

    @staticmethod
    def _add(samples: deque[tuple[float, float]], time: float, pressure: float) -> None:
        if not (math.isfinite(time) and math.isfinite(pressure)) or (samples and time <= samples[-1][0]):
            return
        samples.append((time, pressure))
        while samples[0][0] < time - LONGEST:
            samples.popleft()
