"""A valve with one plunger, independently: one right-hand side a mode, SciPy's DOP853, its own event location.

Nothing here comes from the package. From the seat at x = 0 the plunger leaves when

    F_a − spring_preload − pressure − seat_load − friction > 1 nN,

moves by m v' = F_a − spring_preload − k x − c v − pressure − friction·sign(v), and comes to rest, or rebounds, at the
stop and at the seat, or to rest between where friction holds it. The pressure is whole on the seat and falls from when
the plunger leaves it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import exp

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from .common import FloatArray, PlantEvent, PlantRun

SEAT_HOLDS = 1e-9  # N
SLOWEST_REBOUND = 5e-3  # m/s
GRID = 1e-4  # s: how often a plunger at rest is looked at
SINGLE_VALVE: dict[str, float | tuple[float, float, float, float]] = {
    "moving_mass": 0.012,
    "main_damping": 1.0,
    "spring_rate": 300.0,
    "spring_preload": 2.0,
    "attraction_polynomial": (7.0, 10.1e3, -8.5e6, 21.4e9),
    "stroke": 1.0e-3,
    "reference_voltage": 24.0,
    "coil_time_constant": 5.0e-3,
    "coil_resistance": 72.0,
    "seat_load": 2.9,
}
SEAT, MOVING, STOP, STUCK = range(4)
WAYS = {SEAT: (1.0,), STOP: (-1.0,), STUCK: (1.0, -1.0)}
FREED = {SEAT: "unseated", STOP: "released", STUCK: "freed"}
EFFECTS = ("coulomb_friction", "pressure_force", "stop_bounce")


@dataclass(frozen=True)
class SinglePlungerPlant:
    """`parameters` replaces entries of SINGLE_VALVE; `effects` holds names of EFFECTS, as the catalogue has them."""

    parameters: Mapping[str, float | tuple[float, float, float, float]] = field(default_factory=dict)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def simulate(self, command_times: FloatArray, volts: FloatArray, sample_times: FloatArray) -> PlantRun:
        """Drive from rest at time 0: command times (k,) s, volts (k,), sample times (n,) s, both ascending."""
        if unknown := set(self.effects) - set(EFFECTS):
            raise ValueError(f"effects {sorted(unknown)}: known are {EFFECTS}")
        run = _Run(SINGLE_VALVE | dict(self.parameters), self.effects, np.asarray(sample_times, dtype=np.float64))
        edges = [*(float(time) for time in command_times), float(sample_times[-1])]
        run.advance(edges[0], 0.0)
        for start, volt in zip(edges[1:], volts, strict=True):
            run.advance(start, float(volt))
        return PlantRun(run.times, run.x, run.x.copy(), run.v, run.current, tuple(run.events))


class _Run:
    """One run: the state at `t`, and what was sampled up to there."""

    def __init__(
        self,
        valve: Mapping[str, float | tuple[float, float, float, float]],
        effects: Mapping[str, Mapping[str, float]],
        times: FloatArray,
    ) -> None:
        number: Callable[[str], float] = lambda name: float(np.asarray(valve[name]))  # noqa: E731
        self.mass, self.damping = number("moving_mass"), number("main_damping")
        self.rate, self.preload, self.seat_load = number("spring_rate"), number("spring_preload"), number("seat_load")
        self.stroke, self.tau = number("stroke"), number("coil_time_constant")
        self.reference, self.resistance = number("reference_voltage"), number("coil_resistance")
        self.polynomial = np.polynomial.Polynomial(np.asarray(valve["attraction_polynomial"]))
        self.friction = effects.get("coulomb_friction", {}).get("force", 0.0)
        self.pressure = effects.get("pressure_force", {"force": 0.0, "equalisation_time": 1.0})
        self.bounce = effects.get("stop_bounce", {"restitution_stop": 0.0, "restitution_seat": 0.0})
        self.times, self.x, self.v, self.current = times, *(np.zeros_like(times) for _ in range(3))
        self.t = self.at_x = self.at_v = self.u0 = self.since = self.left_seat = 0.0
        self.direction, self.target, self.mode, self.events = 1.0, 0.0, SEAT, list[PlantEvent]()

    def advance(self, end: float, volts: float) -> None:
        """Hold a voltage until `end`."""
        self.u0, self.since, self.target = self.u(self.t), self.t, volts / self.reference
        while self.t < end:
            if self.mode == MOVING:
                self.move(end)
            else:
                self.rest(end)

    def u(self, t: float) -> float:
        """Normalised current."""
        return self.target + (self.u0 - self.target) * exp(-(t - self.since) / self.tau)

    def net(self, t: float, x: float, v: float) -> float:
        """Phase 2 net force without dry friction, N."""
        held = 0.0 if self.mode == SEAT else t - self.left_seat
        pressure = self.pressure["force"] * exp(-held / self.pressure["equalisation_time"])
        pull = self.u(t) ** 2 * float(self.polynomial(x))
        return pull - self.preload - self.rate * x - self.damping * v - pressure

    def rest(self, end: float) -> None:
        """Rest until the forces move the plunger, or until `end`."""
        ways, x = WAYS[self.mode], self.at_x
        held = max(self.friction, SEAT_HOLDS) + self.seat_load if self.mode == SEAT else self.friction

        def excess(t: float) -> float:
            return max(way * self.net(t, x, 0.0) for way in ways) - held

        grid = np.append(np.arange(self.t, end, GRID), end)
        freed = next((index for index, t in enumerate(grid) if excess(t) > 0.0), None)
        if freed is None:
            self.show(end, lambda t: np.array([np.full_like(t, x), np.zeros_like(t)]))
            return
        when = self.t if freed == 0 else float(brentq(excess, grid[freed - 1], grid[freed], xtol=1e-15))
        self.show(when, lambda t: np.array([np.full_like(t, x), np.zeros_like(t)]))
        self.events.append(PlantEvent(when, FREED[self.mode], x, 0.0))
        self.direction = max(ways, key=lambda way: way * self.net(when, x, 0.0))
        if self.mode == SEAT:
            self.left_seat = when
        self.at_v, self.mode = 0.0, MOVING

    def move(self, end: float) -> None:
        """Move until a contact, a turn, or `end`; friction opposes the direction of motion."""

        def rates(t: float, y: FloatArray) -> list[float]:
            return [y[1], (self.net(t, y[0], y[1]) - self.direction * self.friction) / self.mass]

        def contact(t: float, y: FloatArray) -> float:
            return float(y[0] - (self.stroke if self.direction > 0 else 0.0))

        def turned(t: float, y: FloatArray) -> float:
            return float(y[1])

        contact.terminal, contact.direction = True, self.direction  # type: ignore[attr-defined]
        turned.terminal, turned.direction = True, -self.direction  # type: ignore[attr-defined]
        found = solve_ivp(
            rates, (self.t, end), [self.at_x, self.at_v], "DOP853", events=(contact, turned), dense_output=True,
            rtol=1e-13, atol=1e-16, max_step=2e-4,
        )  # fmt: skip
        self.show(float(found.t[-1]), found.sol)
        self.at_x, self.at_v = (float(value) for value in found.y[:, -1])
        if found.status == 1 and len(found.t_events[0]):
            self.touch()
        elif found.status == 1:
            self.turn()

    def touch(self) -> None:
        """Rest or rebound at the stop or the seat."""
        at_stop, v = self.direction > 0, self.at_v
        x, name = (self.stroke, "stop") if at_stop else (0.0, "seat")
        restitution = self.bounce[f"restitution_{name}"]
        bounces = restitution > 0.0 and abs(v) >= SLOWEST_REBOUND
        kind = f"{name}_rebound" if bounces else "opened" if at_stop else "seated"
        self.events.append(PlantEvent(self.t, kind, x, v))
        self.at_x, self.at_v = x, -restitution * v if bounces else 0.0
        self.mode, self.direction = (MOVING, -self.direction) if bounces else (STOP if at_stop else SEAT, 1.0)
        if bounces and not at_stop:
            self.left_seat = self.t

    def turn(self) -> None:
        """Go back, or stay where friction holds."""
        net, self.at_v = self.net(self.t, self.at_x, 0.0), 0.0
        if abs(net) > self.friction:
            self.direction = 1.0 if net > 0.0 else -1.0
        else:
            self.mode = STUCK
            self.events.append(PlantEvent(self.t, "stuck", self.at_x, 0.0))

    def show(self, until: float, state: Callable[[FloatArray], FloatArray]) -> None:
        """Sample up to `until`, and go there."""
        own = slice(*np.searchsorted(self.times, [self.t, until], side="left"))
        if until == self.times[-1]:
            own = slice(own.start, len(self.times))
        if own.start < own.stop:
            self.x[own], self.v[own] = state(self.times[own])
            self.current[own] = [self.u(t) * self.reference / self.resistance for t in self.times[own]]
        self.t = until
