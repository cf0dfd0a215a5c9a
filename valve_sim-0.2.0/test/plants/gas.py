"""An independent valve with gas: the pilot's bleed and the two plungers, integrated implicitly by SciPy.

It shares no line with the package and is built the other way round: the outlet's pressure is the state, not its
density; all states are stepped together by Radau IIA of order 5; the sonic pressure is the root of v = a, tabulated
once for a fluid and a temperature; and the square root at equal pressures is replaced by a straight line below 1 Pa.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

Array = NDArray[np.float64]
CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = range(5)
STRAIGHT: Final = 1.0
"""Pa, below which the flow is proportional to the pressure difference."""


@dataclass(frozen=True)
class NobleAbel:
    """A gas of hard molecules at one temperature: p (1/ρ − b) = R T."""

    constant: float = 4124.5
    covolume: float = 7.691e-3
    gamma: float = 1.41
    temperature: float = 288.15

    def density(self, pressure: Any, temperature: float | None = None) -> Any:
        return 1.0 / (self.constant * (temperature or self.temperature) / pressure + self.covolume)

    def expanded(self, upstream: float, pressure: float) -> tuple[float, float, float]:
        """Speed, density and speed of sound after an isentropic expansion: m/s, kg/m³, m/s."""
        gamma, r = self.gamma, self.constant
        cold = self.temperature * (pressure / upstream) ** ((gamma - 1.0) / gamma)
        heat = gamma * r / (gamma - 1.0) * (self.temperature - cold) + self.covolume * (upstream - pressure)
        rho = self.density(pressure, cold)
        return math.sqrt(2.0 * max(heat, 0.0)), rho, math.sqrt(gamma * pressure / rho / (1.0 - self.covolume * rho))

    def sonic_pressure(self, upstream: float) -> float:
        """Where the expansion reaches the speed of sound, Pa."""

        def excess(pressure: float) -> float:
            speed, _, sound = self.expanded(upstream, pressure)
            return speed - sound

        return float(brentq(excess, 0.2 * upstream, 0.9 * upstream, xtol=1e-9 * upstream, rtol=1e-14))


class Flux:
    """Mass flux from one side to the other, kg/(m² s), negative the other way."""

    def __init__(self, gas: NobleAbel) -> None:
        self.gas = gas
        pressures = np.geomspace(1e3, 2e8, 300)
        self._sonic = CubicSpline(np.log(pressures), [gas.sonic_pressure(p) / p for p in pressures])

    def is_choked(self, upstream: float, downstream: float) -> bool:
        return bool(downstream < upstream * self._sonic(math.log(upstream)))

    def __call__(self, here: float, there: float) -> float:
        if there > here:
            return -self(there, here)
        difference = here - there
        if difference < STRAIGHT:
            return self._forward(here, here - STRAIGHT) * difference / STRAIGHT
        return self._forward(here, there)

    def _forward(self, up: float, down: float) -> float:
        if down < 0.7 * up:
            down = max(down, up * float(self._sonic(math.log(up))))
        speed, rho, _ = self.gas.expanded(up, down)
        return rho * speed


@dataclass
class GasValve:
    """The valve of the theory's equations, without effects but those of gas and dry friction.

    Attributes:
        valve: declared names to values, `attraction_polynomial` as four numbers. gas: names of the group `gas`.
        leak: m². clogging: ratio of the pilot orifice's area. friction: N, of Coulomb's.
    """

    valve: Mapping[str, Any]
    gas: Mapping[str, float]
    leak: float = 0.0
    clogging: float = 1.0
    friction: float = 0.0
    fluid: NobleAbel | None = None
    rtol: float = 1e-9
    events: list[tuple[float, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.fluid = self.fluid or NobleAbel(temperature=self.gas["inlet_temperature"])
        self.flux = Flux(self.fluid)
        self.t, self.x, self.v, self.u = 0.0, 0.0, 0.0, 0.0
        self.p = self.gas["outlet_pressure"]
        self.inlet = self.gas["inlet_pressure"]
        self.volts, self.mode, self.way = 0.0, CLOSED, 1
        self.moving = False
        self.regime = self._regime(self.p)

    # --- forces and flows -----------------------------------------------------------------------------------------

    def pull(self, x: float, u: float) -> float:
        a0, a1, a2, a3 = self.valve["attraction_polynomial"]
        return u * u * (a0 + a1 * x + a2 * x**2 + a3 * x**3)

    def gas_force(self, main: bool, x: float, p: float) -> float:
        over, g = max(0.0, self.inlet - p), self.gas
        if main:
            lift, d = max(0.0, x - self.valve["pilot_gap"]), g["seat_diameter"]
        else:
            lift, d = x, g["pilot_orifice_diameter"]
        return over * math.pi / 4.0 * d**2 * max(0.0, 1.0 - 4.0 * lift / d)

    def net(self, main: bool, x: float, v: float, u: float, p: float, gas: bool = True) -> float:
        d = self.valve
        force = self.pull(x, u) - (self.gas_force(main, x, p) if gas else 0.0)
        if main:
            return force - d["spring_preload"] - d["spring_rate"] * x - d["main_damping"] * v
        return force - d["seat_load"] - d["pilot_damping"] * v

    def area(self, x: float) -> float:
        g = self.gas
        dp, dm, ds = g["pilot_orifice_diameter"], g["main_orifice_diameter"], g["seat_diameter"]
        pilot = min(math.pi * dp * max(x, 0.0), self.clogging * math.pi / 4.0 * dp**2)
        main = min(math.pi * ds * max(0.0, x - self.valve["pilot_gap"]), math.pi / 4.0 * dm**2)
        return pilot + main + self.leak

    def flow_in(self, x: float, p: float) -> float:
        """Through the valve, kg/s."""
        return self.gas["discharge_coefficient"] * self.area(x) * self.flux(self.inlet, p)

    def flow_out(self, p: float) -> float:
        g = self.gas
        if g["demand_orifice_diameter"] == 0.0:
            return 0.0
        area = math.pi / 4.0 * g["demand_orifice_diameter"] ** 2
        return g["discharge_coefficient"] * area * self.flux(p, g["demand_pressure"])

    def rates(self, t: float, y: Array) -> list[float]:
        x, v, u, p = float(y[0]), float(y[1]), float(y[2]), 1e5 * float(y[3])
        tau = self.valve["coil_time_constant"]
        target = self.volts / self.valve["reference_voltage"]
        du = (target - u) / tau if tau > 0.0 else 0.0
        dv = 0.0
        if self.moving:
            main = self.mode == MAIN
            dv = (self.net(main, x, v, u, p) - self.way * self.friction) / self.valve[
                "moving_mass" if main else "pilot_mass"
            ]
        assert self.fluid is not None
        rt = self.fluid.constant * self.fluid.temperature
        per_density = (rt + self.fluid.covolume * p) ** 2 / rt
        dp = (self.flow_in(x, p) - self.flow_out(p)) / self.gas["outlet_volume"] * per_density
        return [v if self.moving else 0.0, dv, du, 1e-5 * dp]

    # --- the automaton --------------------------------------------------------------------------------------------

    def _regime(self, p: float) -> int:
        up, down = max(self.inlet, p), min(self.inlet, p)
        way = 1 if self.inlet >= p else -1
        return way * (2 if self.flux.is_choked(up, down) else 1)

    def _lift(self, y: Array) -> float:
        main = self.mode >= GAP_HOLD
        least = self.friction + (1e-9 if self.mode == CLOSED else 0.0)
        return self.net(main, y[0], 0.0, y[2], 1e5 * y[3]) - least

    def _fall(self, y: Array) -> float:
        return -self.net(self.mode >= MAIN, y[0], 0.0, y[2], 1e5 * y[3]) - self.friction

    def _guards(self) -> dict[str, Any]:
        if not self.moving:
            found: dict[str, Any] = {}
            if self.mode != OPEN:
                found["lift"] = lambda t, y: self._lift(y)
            if self.mode != CLOSED:
                found["fall"] = lambda t, y: self._fall(y)
            return found
        above, below = (self.valve["stroke"], self.valve["pilot_gap"])
        if self.mode != MAIN:
            above, below = below, 0.0
        contact = above if self.way > 0 else below
        return {
            "contact": lambda t, y: self.way * (y[0] - contact) * 1e3,
            "turn": lambda t, y: -self.way * y[1],
        }

    def _log(self, kind: str) -> None:
        self.events.append((self.t, kind))

    def _state(self) -> Array:
        return np.array([self.x, self.v, self.u, 1e-5 * self.p])

    def _push(self) -> int:
        y = self._state()
        if self.mode != OPEN and self._lift(y) > 0.0:
            return 1
        return -1 if self.mode != CLOSED and self._fall(y) > 0.0 else 0

    def _leave_rest(self, push: int) -> None:
        kinds = {CLOSED: "UNSEATED", OPEN: "RELEASED", GAP_HOLD: "LIFTED" if push > 0 else "DROPPED"}
        if self.mode in kinds:  # else it was stuck on its way
            self._log(kinds[self.mode])
        if self.mode == CLOSED:
            self.mode = PILOT
        elif self.mode == GAP_HOLD:
            self.mode = MAIN if push > 0 else PILOT
        elif self.mode == OPEN:
            self.mode = MAIN
        self.moving, self.way, self.v = True, push, 0.0

    def _rest(self, mode: int, kind: str) -> None:
        self.mode, self.moving, self.v = mode, False, 0.0
        self._log(kind)

    def _touch(self) -> None:
        d = self.valve
        if self.mode == MAIN and self.way > 0:
            self.x = d["stroke"]
            self._rest(OPEN, "REACHED_STOP")
        elif self.mode == PILOT and self.way < 0:
            self.x = 0.0
            self._rest(CLOSED, "SEATED")
            if self._lift(self._state()) > 0.0:
                self.events.pop()
                self._log("BOUNCED_AT_SEAT")
                self.mode, self.moving, self.way = PILOT, True, 1
        else:
            self.x = d["pilot_gap"]
            one, two = (self.net(main, self.x, 0.0, self.u, self.p) for main in (False, True))
            alone = self.net(True, self.x, 0.0, self.u, self.p, gas=False)
            if (abs(self.v) < 1e-3 and one > 0.0 >= two) or (self.way < 0 and two <= 0.0 < alone):
                self._rest(GAP_HOLD, "HELD_AT_GAP")
            elif self.way < 0:
                self.mode = PILOT
                self._log("MAIN_SEATED")
            else:
                self.mode = MAIN
                self.v *= d["pickup_velocity_ratio"]
                self._log("PICKED_UP")

    def _handle(self, name: str) -> None:
        if name in ("lift", "fall"):
            self._leave_rest(1 if name == "lift" else -1)
            return
        if name == "contact":
            self._touch()
            return
        main = self.mode == MAIN
        self.v = 0.0
        net = self.net(main, self.x, 0.0, self.u, self.p)
        self.moving, self.way = abs(net) > self.friction, 1 if net > 0.0 else -1

    def run(
        self,
        drive: Sequence[tuple[float, float]],
        times: Array,
        inlet: Sequence[tuple[float, float]] = (),
        demand: Sequence[tuple[float, float]] = (),
    ) -> Any:
        """Go through commands (s, V), inlet and demand pressures (s, Pa; held) up to the last of the times.

        Returns:
            (n,) positions of the pilot plunger, m; outlet pressures, Pa; mass flows, kg/s.
        """
        shown = np.zeros((3, len(times)))
        shown[1, times <= 0.0] = self.p
        courses = {"volts": drive, "inlet": inlet, "demand_pressure": demand}
        changes = sorted((t, name, value) for name, course in courses.items() for t, value in course)
        for t, name, value in changes:
            self._go(min(t, float(times[-1])), times, shown)
            if name == "demand_pressure":
                self.gas = {**self.gas, name: value}
            else:
                setattr(self, name, value)
            if name == "volts" and self.valve["coil_time_constant"] == 0.0:
                self.u = value / self.valve["reference_voltage"]
            if name == "inlet":
                self.regime = self._regime(self.p)
        self._go(float(times[-1]), times, shown)
        return shown

    def _go(self, end: float, times: Array, shown: Array) -> None:
        while self.t < end:
            if not self.moving and (push := self._push()):
                self._leave_rest(push)
            guards = self._guards()
            events = []
            for guard in guards.values():
                event: Any = lambda t, y, guard=guard: guard(t, y)  # noqa: E731 - takes attributes
                event.terminal, event.direction = True, 1.0
                events.append(event)
            solution = solve_ivp(
                self.rates, (self.t, end), self._state(), method="Radau", rtol=self.rtol, dense_output=True,
                max_step=2e-4 if self.moving else 5e-3, atol=self.rtol * np.array([1e-4, 1e-2, 1e-1, 1e-1]),
                events=events, first_step=min(1e-7, end - self.t),
            )  # fmt: skip
            assert solution.success, solution.message
            self._switches(solution)
            inside = (times > self.t) & (times <= solution.t[-1])
            if inside.any():
                y = solution.sol(times[inside])
                shown[0, inside], shown[1, inside] = y[0], 1e5 * y[3]
                shown[2, inside] = [self.flow_in(x, p) for x, p in zip(y[0], 1e5 * y[3], strict=True)]
            self.t = float(solution.t[-1])
            self.x, self.v, self.u, p = (float(value) for value in solution.y[:, -1])
            self.p = 1e5 * p
            if solution.status == 1:
                fired = [name for name, hits in zip(guards, solution.t_events, strict=True) if len(hits)]
                self._handle(fired[0])

    def _switches(self, solution: Any) -> None:
        """Note where the flow became choked or subsonic, or turned by more than 1 Pa, along a piece."""
        names = {2: "FLOW_CHOKED", 1: "FLOW_SUBSONIC"}
        for left, right, p_right in zip(solution.t[:-1], solution.t[1:], 1e5 * solution.y[3, 1:], strict=True):
            regime = self._regime(p_right)
            if regime == self.regime or abs(self.inlet - p_right) < STRAIGHT:
                continue
            low, high = left, right
            for _ in range(50):
                middle = 0.5 * (low + high)
                if self._regime(1e5 * float(solution.sol(middle)[3])) == self.regime:
                    low = middle
                else:
                    high = middle
            turned = regime * self.regime < 0
            self.events.append((float(high), "FLOW_REVERSED" if turned else names[abs(regime)]))
            self.regime = regime
