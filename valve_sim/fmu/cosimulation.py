"""A valve that a master steps: values in by name, steps of any size, values out by name, and back to a kept state.

Nothing here knows FMI, so that what a unit does is tested without one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from valve_sim.files.parameter_files import valve_from_flat
from valve_sim.fmu.variables import (
    COIL_VOLTAGE,
    DEMAND_PRESSURE,
    INLET_PRESSURE,
    flat_values,
    parameter_values,
    variables_of,
)
from valve_sim.model import Phase, Reading, SimulationError, Stepper, Valve

_SOURCE: Final = "the unit's parameters"


@dataclass(frozen=True)
class KeptState:
    """The whole state of a stepped valve at one time; opaque to its holder."""

    stepper: Stepper | None
    valve: Valve
    reading: Reading | None
    end: float
    values: dict[str, float]
    in_force: dict[str, float]
    stale: bool


class CoSimulatedValve:
    """A valve between a master's communication points.

    Inputs and parameters that are set count from the beginning of the next step, where the run is cut exactly; within
    a step all events are located as in a whole run, so that what is shown does not depend on the size of the steps.

    Args:
        valve: as declared.
    """

    def __init__(self, valve: Valve) -> None:
        self.variables: Final = variables_of(valve)
        self._valve = valve
        self._parameters: Final = tuple(parameter_values(valve))
        self._values = {COIL_VOLTAGE.name: 0.0, **parameter_values(valve)}
        if valve.gas is not None:
            self._values[INLET_PRESSURE.name] = valve.gas.inlet_pressure
            self._values[DEMAND_PRESSURE.name] = valve.gas.demand_pressure
        self._in_force: dict[str, float] = {}
        self._stepper: Stepper | None = None
        self._reading: Reading | None = None
        self._end = 0.0
        self._stale = True  # the parameters as set are not those of the valve that is stepped

    def set(self, name: str, value: float) -> None:
        """Set an input or a parameter, in SI; it counts from the beginning of the next step.

        Raises:
            SimulationError: the variable is an output.
        """
        if name not in self._values:
            raise SimulationError(f"{name}: cannot be set; set one of {', '.join(self._values)}")
        self._stale = self._stale or (name in self._parameters and value != self._values[name])
        self._values[name] = float(value)

    def get(self, name: str) -> float:
        """An input or parameter as set last, or an output at the end of the last step, in SI."""
        if name in self._values:
            return self._values[name]
        reading = self._reading
        if reading is None:
            return 0.0
        if name == "phase":
            return float(reading.phase)
        if name == "is_open":
            return float(reading.phase is Phase.OPEN)
        return float(getattr(reading, name))

    def start(self, time: float) -> None:
        """Begin at rest, closed and without current, at a time in s, with all that has been set so far.

        Raises:
            ParameterError: a parameter is out of its range, or they do not go together.
            SimulationError: the valve could not be stepped.
        """
        declared = self._declared()
        if declared.gas is not None:
            inlet, demand = self._values[INLET_PRESSURE.name], self._values[DEMAND_PRESSURE.name]
            declared = replace(declared, gas=declared.gas._replace(inlet_pressure=inlet, demand_pressure=demand))
        stepper = Stepper(declared, time)
        self._valve, self._stepper, self._stale = declared, stepper, False
        inputs = (entry.name for entry in self.variables if entry.causality == "input")
        self._in_force = {**{name: self._values[name] for name in inputs}, COIL_VOLTAGE.name: 0.0}
        self._end = time
        self._apply(stepper, time)
        self._reading = stepper.advance(time)

    def step(self, time: float, size: float) -> None:
        """Step from a time on by a size, both in s.

        Raises:
            ParameterError: a parameter that was set is out of its range, or they do not go together.
            SimulationError: the step begins before the end of the last one, or could not be carried to its end.
        """
        if self._stepper is None:
            self.start(time)
        stepper = self._stepper
        assert stepper is not None
        if time < self._end - 1e-9 * max(1.0, abs(self._end)):
            raise SimulationError(
                f"a step from {time:.9g} s follows one that ended at {self._end:.9g} s; to step back, first restore "
                "a state that was kept at that time"
            )
        time = max(time, self._end)
        self._apply(stepper, time)
        self._end = time + max(0.0, size)
        self._reading = stepper.advance(self._end)

    def keep(self) -> KeptState:
        """The whole state, which later steps leave as it is."""
        stepper = None if self._stepper is None else self._stepper.copy()
        return KeptState(
            stepper, self._valve, self._reading, self._end, dict(self._values), dict(self._in_force), self._stale
        )

    def restore(self, kept: KeptState) -> None:
        """Return to a state that was kept, as often as is wanted."""
        self._stepper = None if kept.stepper is None else kept.stepper.copy()
        self._valve, self._reading, self._end, self._stale = kept.valve, kept.reading, kept.end, kept.stale
        self._values, self._in_force = dict(kept.values), dict(kept.in_force)

    def _declared(self) -> Valve:
        """The valve of the parameters as they are set."""
        parameters = {name: self._values[name] for name in self._parameters}
        return valve_from_flat(flat_values(parameters), _SOURCE, self._valve)

    def _apply(self, stepper: Stepper, time: float) -> None:
        """Put in force what was set since the last step, at a time in s."""
        if self._stale:
            self._valve = self._declared()
            stepper.set_valve(self._valve, time)
            self._stale = False
        for name, act in (
            (INLET_PRESSURE.name, stepper.supply),
            (DEMAND_PRESSURE.name, stepper.set_demand_pressure),
            (COIL_VOLTAGE.name, stepper.command),
        ):
            if name in self._in_force and self._values[name] != self._in_force[name]:
                self._in_force[name] = self._values[name]
                act(time, self._values[name])
