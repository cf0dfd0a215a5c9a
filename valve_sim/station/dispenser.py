"""A dispenser before a station's line, without ROS: which tank's valve is open, and what line, tanks and vehicle hold.

Cascade filling, as hydrogen stations do it: an empty vehicle is filled from the tank of the lowest pressure first, and
from the next one once the pressure behind the open valve is near the line's, or too little flows. At the target
pressure the dispenser shuts itself and all valves and vents the line to the pressure of an empty vehicle, which comes
after a pause. What a tank gives is what has come through its restrictor: the gas in the pipe between counts as the
tank's.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from valve_sim.model.gas.line import Gas, Line
from valve_sim.model.gas.parameters import orifice_area
from valve_sim.station.tables import DispenserSettings

LONGEST_STEP: Final = 0.01
"""s. Shorter ones change no pressure by more than 0.2 %, since those of the pipes are held between messages anyway."""
_MEGA: Final = 1e-6


class Dispensed(NamedTuple):
    """What holds after a step.

    Attributes:
        volts: of each valve, V. line_pressure, vehicle_pressure: Pa. tank_pressures: Pa, of each tank.
        words: what has happened, in sentences for the log.
    """

    volts: tuple[float, ...]
    line_pressure: float
    vehicle_pressure: float
    tank_pressures: tuple[float, ...]
    words: tuple[str, ...]


class Dispenser:
    """The line, the vehicle and the tanks, and which valve is open.

    Args:
        settings: checked.

    Attributes:
        filled: how many vehicles have come to the target pressure.
        brought: kg that empty vehicles held when they came. taken: kg that they held when they left.
        vented: kg that the line lost between vehicles. drawn: kg that has come out of tanks of constant pressure.
    """

    def __init__(self, settings: DispenserSettings) -> None:
        self._settings = settings
        self.gas = gas = Gas(settings.fluid, settings.temperature)
        coefficient = settings.discharge_coefficient
        areas = (coefficient * orifice_area(settings.restrictor_diameter),) * len(settings.valves)
        nozzle = coefficient * orifice_area(settings.nozzle_diameter)
        self._line = Line(gas, areas, nozzle, settings.line_volume, settings.vehicle_volume)
        self._empty = gas.mass(settings.vehicle_pressure, settings.vehicle_volume)
        self._vented_line = gas.mass(settings.vehicle_pressure, settings.line_volume)
        self._masses = self._vented_line, self._empty
        tanks = zip(settings.tank_pressures, settings.tank_volumes, strict=True)
        self._tanks = [gas.mass(pressure, volume) for pressure, volume in tanks]
        self._outlets: list[float | None] = [None] * len(settings.valves)
        self._came = [0.0] * len(settings.valves)
        self._time = math.nan
        self._waiting: list[int] = []
        self._open: int | None = None
        self._since = -math.inf
        self._is_filling = False
        self.filled = 0
        self.brought, self.taken, self.vented, self.drawn = self._empty, 0.0, 0.0, 0.0

    def hear(self, valve: int, pressure: float) -> bool:
        """The pressure behind a valve, Pa; False, and nothing else, if no gas can have it."""
        if not 0.0 < pressure < math.inf:
            return False
        self._outlets[valve] = pressure
        return True

    @property
    def unheard(self) -> list[str]:
        """Valves whose outlet pressure has not been heard: nothing is opened before."""
        return [name for name, outlet in zip(self._settings.valves, self._outlets, strict=True) if outlet is None]

    @property
    def is_filling(self) -> bool:
        """Whether gas can get from the line to a vehicle."""
        return self._is_filling

    @property
    def mass(self) -> float:
        """What line, vehicle and tanks of a declared volume hold, kg."""
        return sum(self._masses) + sum(self._tanks)

    @property
    def line_pressure(self) -> float:
        """Pa."""
        return self.gas.pressure(self._masses[0], self._settings.line_volume)

    @property
    def vehicle_pressure(self) -> float:
        """Pa."""
        return self.gas.pressure(self._masses[1], self._settings.vehicle_volume)

    @property
    def tank_pressures(self) -> tuple[float, ...]:
        """Pa; one without a volume keeps its pressure."""
        settings = self._settings
        return tuple(
            self.gas.pressure(mass, volume) if volume else pressure
            for mass, volume, pressure in zip(self._tanks, settings.tank_volumes, settings.tank_pressures, strict=True)
        )

    def prepare(self) -> None:
        """Load or compile what flows; nothing changes."""
        self._line.step(self._masses, [self._settings.vehicle_pressure] * len(self._outlets), LONGEST_STEP)

    def restart(self) -> None:
        """The clock begins anew: all valves closed, and the next step only says what time it is."""
        self._time, self._since = math.nan, -math.inf
        self._open, self._waiting, self._is_filling = None, [], False

    def step(self, time: float) -> Dispensed:
        """Go on to a time, s, not before that of the last step."""
        words: list[str] = []
        outlets = [outlet for outlet in self._outlets if outlet is not None]
        if len(outlets) == len(self._outlets):
            if not math.isnan(self._time):
                self._flow(outlets, time - self._time)
            self._sequence(outlets, time, words)
            self._time = time
        volts = tuple(self._settings.voltage if self._open == k else 0.0 for k in range(len(self._outlets)))
        return Dispensed(volts, self.line_pressure, self.vehicle_pressure, self.tank_pressures, tuple(words))

    def _flow(self, outlets: list[float], seconds: float) -> None:
        """Let gas flow for so long, from and to these pressures behind the valves."""
        steps = max(1, math.ceil(seconds / LONGEST_STEP - 1e-9))
        if seconds <= 0.0:
            return
        self._came = [0.0] * len(outlets)
        for _ in range(steps):
            self._masses, came = self._line.step(self._masses, outlets, seconds / steps, is_open=self._is_filling)
            for k, mass in enumerate(came):
                self._came[k] += mass / seconds
                if self._settings.tank_volumes[k]:
                    self._tanks[k] -= mass
                else:
                    self.drawn += mass
            if not self._is_filling:
                self._vent()

    def _vent(self) -> None:
        """Let out what the line holds beyond the pressure of an empty vehicle."""
        line, vehicle = self._masses
        excess = max(0.0, line - self._vented_line)
        self._masses = line - excess, vehicle
        self.vented += excess

    def _sequence(self, outlets: list[float], time: float, words: list[str]) -> None:
        """Close, open, and let vehicles come and go."""
        settings = self._settings
        if not self._is_filling:
            if time - self._since >= settings.pause:
                self._begin(time, words)
            return
        if self.vehicle_pressure >= settings.target_pressure:
            self.filled += 1
            self._end(time, f"vehicle {self.filled} is full: {_MEGA * self.vehicle_pressure:.1f} MPa", words)
            return
        if self._open is not None and (time - self._since < settings.least_open or not self._is_spent(outlets)):
            return
        if self._waiting:
            self._next(time, words)
        else:
            short = f"no tank gives any more, at {_MEGA * self.vehicle_pressure:.1f} MPa in the vehicle"
            self._end(time, f"{short} of {_MEGA * settings.target_pressure:.1f} wanted", words)

    def _is_spent(self, outlets: list[float]) -> bool:
        """Whether the open valve gives too little."""
        assert self._open is not None
        difference = outlets[self._open] - self.line_pressure
        return difference < self._settings.least_difference or self._came[self._open] < self._settings.least_flow

    def _begin(self, time: float, words: list[str]) -> None:
        if not math.isinf(self._since):
            self.taken += self._masses[1]
            self.brought += self._empty
            self._masses = self._masses[0], self._empty
        pressures = self.tank_pressures
        self._waiting = sorted(range(len(pressures)), key=lambda k: pressures[k])
        self._is_filling = True
        self._next(time, words)

    def _next(self, time: float, words: list[str]) -> None:
        """Open the valve of the next tank; its predecessor closes."""
        self._open, self._since = self._waiting.pop(0), time
        pressure = _MEGA * self.tank_pressures[self._open]
        words.append(
            f"opens {self._settings.valves[self._open]}, its tank at {pressure:.1f} MPa, the vehicle at "
            f"{_MEGA * self.vehicle_pressure:.1f} MPa"
        )

    def _end(self, time: float, reason: str, words: list[str]) -> None:
        """Shut the dispenser and all valves."""
        self._open, self._waiting, self._is_filling, self._since = None, [], False, time
        self._vent()
        words.append(f"{reason}; all valves close")
