"""A valve of which only the coil is measured: an electromagnet by its flux linkage, in SI units, with its driver.

Independent of the package: the flux linkage in Wb is integrated with a fixed step, the current is solved from it.

    λ = L i + 2 i W(x)/i_r²,   W(x) = ∫₀ˣ F_r dξ        F = F_r(x) (i/i_r)² f(i), f and λ with a knee where it saturates
    dλ/dt = V − R i_t,   i_t = i + (dλ/dt)/R_e          i pulls, i_t is at the terminals; R_e stands for eddy currents
    V = V_c − R_s i_t                                   the supply droops
    V = −V_z while the command is 0 and i_t > 0, then i_t = 0: dλ/dt = −R_e i

With a knee the co-energy is F_r(x) s(i), s = r² (1 + 1/k²)/(1 + (r/k)²), r = i/i_r.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .common import FloatArray

STEP = 2e-5
"""s; a hundredth of what changes here takes longer."""
COPPER = 0.00393
"""1/K."""
HALVINGS = 40
"""Of a step, that locate what ends it."""


class Build(NamedTuple):
    """What is built; what no data sheet says is 0 where it is not there."""

    pilot_mass: float = 0.109
    main_mass: float = 0.025
    pilot_damping: float = 1.3
    main_damping: float = 4.6
    spring_rate: float = 428.0
    spring_preload: float = 2.524
    seat_load: float = 0.3
    pilot_gap: float = 0.26e-3
    stroke: float = 1.23e-3
    a0: float = 5.2
    a1: float = 17.096e3
    a2: float = -30.931e6
    a3: float = 24.026e9
    reference_voltage: float = 9.0
    resistance: float = 8.0
    """Ω, cold."""
    inductance: float = 16e-3
    """H, at the largest gap."""
    clamp_voltage: float = 0.0
    """V; 0: the coil is shorted while the command is 0."""
    supply_resistance: float = 0.0
    eddy_resistance: float = 0.0
    """Ω; 0: no eddy currents."""
    knee: float = 0.0
    """Of the current over the rated one; 0: nothing saturates."""
    heating: float = 0.0
    """K/s at the rated current."""
    cooling_time: float = 60.0
    friction: float = 0.0
    """N, dry."""
    extra_force: float = 0.0
    """N, towards the core."""
    pressure: float = 0.0
    """N, on the main plunger until it has equalised."""
    equalisation_time: float = 5e-3
    drag: float = 0.0
    """N s²/m²."""


class Course(NamedTuple):
    """What it did: s, A, V, m, and when the pilot plunger reached the gap and the stop."""

    times: FloatArray
    current: FloatArray
    voltage: FloatArray
    position: FloatArray
    reached_gap: FloatArray
    reached_stop: FloatArray


State = tuple[float, float, float, float]
"""Position m, velocity m/s, flux linkage Wb, temperature above the start K."""
DRIVEN, CLAMPED, BLOCKED = range(3)


def simulate(build: Build, command_times: FloatArray, volts: FloatArray, times: FloatArray) -> Course:
    """Run from rest; commands act from their times on. Times ascend and are not negative."""
    plant = _Plant(build)
    commands = list(zip(command_times.tolist(), volts.tolist(), strict=True))
    shown = []
    for time in times.tolist():
        while commands and commands[0][0] <= time:
            plant.go(commands[0][0])
            plant.command(commands.pop(0)[1])
        plant.go(time)
        shown.append((*plant.terminals(plant.y)[:2], plant.y[0]))
    current, voltage, position = np.array(shown).T.copy()
    return Course(times, current, voltage, position, np.array(plant.reached_gap), np.array(plant.reached_stop))


class _Plant:
    """The valve and its driver at one time."""

    def __init__(self, build: Build) -> None:
        self.b = build
        self.rated = build.reference_voltage / build.resistance
        self.t = 0.0
        self.y: State = (0.0, 0.0, 0.0, 0.0)
        self.volts = 0.0
        self.circuit = DRIVEN
        self.lifted = False
        self.way = 0
        self.opened = 0.0
        self.reached_gap: list[float] = []
        self.reached_stop: list[float] = []
        self._last = 0.0

    def command(self, volts: float) -> None:
        self.volts = volts
        self.circuit = DRIVEN
        if volts == 0.0 and self.b.clamp_voltage > 0.0:
            self.circuit = CLAMPED
            if self.terminals(self.y)[0] <= 0.0:
                self.circuit = BLOCKED

    def current(self, x: float, flux: float) -> float:
        """The i that makes a flux linkage, by Newton's method from the last one."""
        b, work, i = self.b, self.work(x), self._last
        for _ in range(30):
            slope, bend = self.shape(i / self.rated)[1:]
            step = (flux - b.inductance * i - work * slope / self.rated) / (b.inductance + work * bend / self.rated**2)
            i += step
            if abs(step) < 1e-14:
                break
        self._last = i
        return i

    def shape(self, r: float) -> tuple[float, float, float]:
        """s(r), s'(r) and s''(r)."""
        if self.b.knee == 0.0:
            return r * r, 2.0 * r, 2.0
        k = self.b.knee**-2
        d = 1.0 + k * r * r
        return r * r * (1.0 + k) / d, 2.0 * r * (1.0 + k) / d**2, 2.0 * (1.0 + k) * (1.0 - 3.0 * k * r * r) / d**3

    def work(self, x: float) -> float:
        b = self.b
        return x * (b.a0 + x * (b.a1 / 2 + x * (b.a2 / 3 + x * b.a3 / 4)))

    def terminals(self, y: State) -> tuple[float, float, float]:
        """Current and voltage at the terminals, and dλ/dt."""
        b, i = self.b, self.current(y[0], y[2])
        if self.circuit == BLOCKED:
            return 0.0, -b.eddy_resistance * i, -b.eddy_resistance * i
        ohms = b.resistance * (1.0 + COPPER * y[3])
        source, inner = (self.volts, b.supply_resistance) if self.circuit == DRIVEN else (-b.clamp_voltage, 0.0)
        current = i
        if b.eddy_resistance > 0.0:
            current = (i * b.eddy_resistance + source) / (b.eddy_resistance + ohms + inner)
        voltage = source - inner * current
        return current, voltage, voltage - ohms * current

    def force(self, x: float, v: float, i: float, t: float, lifted: bool, way: int) -> float:
        """Net force with dry friction against `way`, N."""
        b = self.b
        pull = b.a0 + x * (b.a1 + x * (b.a2 + x * b.a3))
        force = pull * self.shape(i / self.rated)[0] + b.extra_force - b.drag * v * abs(v) - way * b.friction
        if not lifted:
            return force - b.seat_load - b.pilot_damping * v
        pressure = b.pressure * math.exp(-(t - self.opened) / b.equalisation_time)
        return force - b.spring_preload - b.spring_rate * x - b.main_damping * v - pressure

    def rates(self, y: State, t: float) -> State:
        x, v, flux, kelvin = y
        b, i = self.b, self.current(x, flux)
        current, _, induced = self.terminals(y)
        heats = b.heating * (current / self.rated) ** 2 - kelvin / b.cooling_time
        if self.way == 0:
            return 0.0, 0.0, induced, heats
        mass = b.pilot_mass + (b.main_mass if self.lifted else 0.0)
        return v, self.force(x, v, i, t, self.lifted, self.way) / mass, induced, heats

    def step(self, h: float) -> State:
        """Where a step of Runge and Kutta's fourth order leads."""
        k1 = self.rates(self.y, self.t)
        k2 = self.rates(self._moved(k1, h / 2), self.t + h / 2)
        k3 = self.rates(self._moved(k2, h / 2), self.t + h / 2)
        k4 = self.rates(self._moved(k3, h), self.t + h)
        mean = [(a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)]
        return self._moved((mean[0], mean[1], mean[2], mean[3]), h)

    def _moved(self, rate: State, h: float) -> State:
        y = self.y
        return y[0] + h * rate[0], y[1] + h * rate[1], y[2] + h * rate[2], y[3] + h * rate[3]

    def go(self, end: float) -> None:
        """On to a time."""
        while self.t < end:
            if self.way == 0:
                self._move_off()
            h = min(STEP, end - self.t)
            new, ends = self.step(h), ""
            guard = self._guard()
            # Of several that a step passes, the first is found by halving for any of them.
            over: dict[str, Callable[[State], bool]] = {
                "contact": lambda y, guard=guard: self.way != 0 and (y[0] - guard) * self.way >= 0.0,  # type: ignore[misc]
                "turn": lambda y: self.way != 0 and y[1] * self.way < 0.0,
                "gone": lambda y: self.circuit == CLAMPED and self.terminals(y)[0] <= 0.0,
            }
            if any(test(new) for test in over.values()):
                low, high = 0.0, h
                for _ in range(HALVINGS):
                    middle = 0.5 * (low + high)
                    is_over = any(test(self.step(middle)) for test in over.values())
                    low, high = (low, middle) if is_over else (middle, high)
                h, new = high, self.step(high)
                ends = next(name for name, test in over.items() if test(new))
            self.t = end if h == end - self.t else self.t + h
            self.y = new
            self._end(ends, guard)

    def _guard(self) -> float:
        if self.way > 0:
            return self.b.stroke if self.lifted else self.b.pilot_gap
        return self.b.pilot_gap if self.lifted else 0.0

    def _move_off(self) -> None:
        """Plungers at rest are moved where the forces are larger than friction."""
        b, x = self.b, self.y[0]
        i = self.current(x, self.y[2])
        for way, lifted, can in (
            (1, False, x < b.pilot_gap), (1, True, b.pilot_gap <= x < b.stroke),
            (-1, True, x > b.pilot_gap), (-1, False, 0.0 < x <= b.pilot_gap),
        ):  # fmt: skip
            if can and self.force(x, 0.0, i, self.t, lifted, way) * way > 1e-9:
                self.way, self.lifted = way, lifted
                if x == 0.0:
                    self.opened = self.t
                return

    def _end(self, ends: str, guard: float) -> None:
        x, v, flux, kelvin = self.y
        if ends == "gone":
            self.circuit = BLOCKED
            self.y = (x, v, flux if self.b.eddy_resistance > 0.0 else 0.0, kelvin)
            self._last = self._last if self.b.eddy_resistance > 0.0 else 0.0
        elif ends == "turn":
            self.y, self.way = (x, 0.0, flux, kelvin), 0
        elif ends == "contact":
            self.y = (guard, v, flux, kelvin)
            if self.way > 0 and not self.lifted:
                self.lifted = True
                self.reached_gap.append(self.t)
            elif self.way < 0 and self.lifted:
                self.lifted = False
            else:
                if self.way > 0:
                    self.reached_stop.append(self.t)
                self.y, self.way = (guard, 0.0, flux, kelvin), 0
