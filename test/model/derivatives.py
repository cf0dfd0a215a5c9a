"""Derivatives of a trace by variational equations, and by central differences of tightly integrated traces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from model.random_valves import random_valve
from valve_sim.model import Drive, Event, Valve, simulate
from valve_sim.model.runs import Directions, Run
from valve_sim.model.simulation import commands_of

TIGHT, TIGHTEST = 1e-11, 1e-13
"""Of a step: of the derivatives, whose steps are those of the plain trace, and of what they are held against."""
ACCURACY = 1e-6
"""Of a derivative, of its largest value in the trace."""
ROUNDING = 1e-14
"""Of a millimetre, and of the rated current: what a quotient divides by its step."""
TIMES = np.arange(1.0, 600.0) * 1e-4
"""s: a stroke up, and down to the seat."""
PULSE = Drive.of([1e-3, 26e-3], [11.0, 0.0])
BY_QUOTIENT = {"release_voltage"}
"""Declared values that are off, and whose derivatives are not known."""
SIZES = {"a0": 1.0, "coil_time_constant": 1e-4, "seat_load": 0.1, "pilot_damping": 0.1, "main_damping": 0.1}
"""Of numbers that may be 0."""


class Case(NamedTuple):
    """A valve under a drive, sampled."""

    valve: Valve
    drive: Drive
    times: np.ndarray = TIMES

    def moved(self, name: str, by: float) -> Case:
        """The same with one of its numbers changed."""
        valve, (times, volts) = self.valve, self.drive
        kind, _, which = name.partition(".")
        if name == "clock":
            return self._replace(times=self.times - by)
        if kind == "command":
            return self._replace(drive=Drive(times + by * (np.arange(len(times)) == int(which)), volts))
        if kind == "volts":
            return self._replace(drive=Drive(times, volts + by * (np.arange(len(times)) == int(which))))
        if kind == "gas":
            assert valve.gas is not None
            return self._replace(
                valve=replace(valve, gas=valve.gas._replace(**{which: getattr(valve.gas, which) + by}))
            )
        if not which:
            return self._replace(valve=valve.with_values(**{name: valve.declared()[name] + by}))
        changed = {**valve.effects[kind], which: valve.effects[kind][which] + by}
        return self._replace(valve=replace(valve, effects={**valve.effects, kind: changed}))

    def size(self, name: str) -> float:
        """How large a number is, or would be."""
        kind, _, which = name.partition(".")
        if kind in ("clock", "command", "volts"):
            return 10.0 if kind == "volts" else 1e-3
        if kind == "gas":
            return float(getattr(self.valve.gas, which))
        value = self.valve.effects[kind][which] if which else self.valve.declared()[name]
        return max(abs(value), SIZES.get(name, 0.0))

    def names(self) -> list[str]:
        """Everything that the trace depends on, and whose derivative is known."""
        effects = [f"{name}.{parameter}" for name, values in self.valve.effects.items() for parameter in values]
        commands = [f"{kind}.{index}" for kind in ("command", "volts") for index in range(len(self.drive.times))]
        return [*(name for name in self.valve.declared() if name not in BY_QUOTIENT), *effects, *commands, "clock"]

    def shown(self) -> tuple[np.ndarray, np.ndarray, tuple[Event, ...]]:
        """Pilot position, normalised current, events."""
        response = simulate(self.valve, self.drive, self.times, tolerance=TIGHTEST, start_time=0.0)
        rated = self.valve.parameters.reference_voltage / self.valve.parameters.coil_resistance
        return response.pilot_position, response.coil_current / rated, response.events

    def directions(self, names: list[str]) -> Directions:
        steps = [1e-6 * self.size(name) for name in names]
        above = [self.moved(name, step) for name, step in zip(names, steps, strict=True)]
        below = [self.moved(name, -step) for name, step in zip(names, steps, strict=True)]
        width = 2.0 * np.array(steps)[:, None]

        def slopes(of: Callable[[Case], np.ndarray]) -> np.ndarray:
            return (np.array([of(case) for case in above]) - np.array([of(case) for case in below])) / width

        return Directions(
            slopes(lambda case: case.valve.numbers()),
            slopes(lambda case: case.drive.times),
            slopes(lambda case: case.drive.volts),
            slopes(lambda case: case.times[:1])[:, 0],
        )

    def derivatives(self, names: list[str]) -> tuple[np.ndarray, np.ndarray]:
        """Of positions and of normalised currents, by variational equations."""
        along = self.directions(names).among(commands_of(self.drive))
        run = Run(self.valve, 0.0, tolerance=TIGHT, directions=along)
        shown = run.piece(commands_of(self.drive), float(self.times[-1]), self.times, self.times)
        return shown.of_positions, shown.of_currents


def quotient(case: Case, name: str, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Central differences of fourth order, and which samples no event passes; None where other events happen."""
    shown = {by: case.moved(name, by * step).shown() for by in (-2, -1, 1, 2)}
    kinds = [[event.kind for event in events] for _, _, events in shown.values()]
    if any(found != kinds[0] for found in kinds):
        return None
    position, current = (
        (8.0 * (shown[1][of] - shown[-1][of]) - (shown[2][of] - shown[-2][of])) / (12.0 * step) for of in (0, 1)
    )
    (delay,) = case.valve.after_effects("sensor_delay")
    first, last = ([event.time for event in shown[by][2]] + list(case.drive.times) for by in (-2, 2))
    is_clear = np.ones(len(case.times), dtype=bool)
    reach = 1e-9 + 4.0 * step * (name.startswith(("clock", "command")) or name.endswith("delay"))
    for one, other in zip(first, last, strict=True):
        for at in (case.times, case.times - delay):
            is_clear &= (at < min(one, other) - reach) | (at > max(one, other) + reach)
    return position, current, is_clear


def errors_of(case: Case, names: list[str]) -> dict[str, list[float]]:
    """How far each derivative is off central differences of one step or more, over its largest value; the last is best.

    Of those during whose steps other events happen there is none.
    """
    positions, currents = case.derivatives(names)
    errors: dict[str, list[float]] = {name: [] for name in names}
    for index, name in enumerate(names):
        best = [np.inf, np.inf]
        # Rounding asks for a long step; curvature, and events that nearly coincide, for a short one.
        for relative in (1e-4, 1e-5, 1e-3, 3e-6, 1e-6, 3e-7, 1e-7):
            found = quotient(case, name, relative * case.size(name))
            if found is None:
                continue
            position, current, is_clear = found
            assert is_clear.sum() > 0.8 * len(is_clear)
            step = relative * case.size(name)
            channels = ((positions, position, 1e-7, 1e-3), (currents, current, 1e-3, 1.0))
            for of, (own, there, least, unit) in enumerate(channels):
                size = max(np.abs(there).max(), least / case.size(name))
                off = np.abs(own[is_clear, index] - there[is_clear]).max() - ROUNDING * unit / step
                best[of] = min(best[of], max(off, 0.0) / size)
            errors[name].append(max(best))
            if errors[name][-1] < ACCURACY:
                break
    return errors


def random_case(seed: int) -> tuple[Case, list[str]] | None:
    """A random valve and what its trace depends on; None where derivatives of its effects are not known."""
    valve, drive = random_valve(seed)
    if BY_QUOTIENT & set(valve.effects):
        return None
    case = Case(valve, drive)
    names = case.names()
    if valve.parameters.coil_time_constant == 0.0 and "coil_lag" not in valve.effects:
        names.remove("coil_time_constant")
    return case, names
