"""An independent reference: the theory's model once more, eqs. (1) to (15), for SciPy's DOP853.

No line is shared with the core.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = range(5)
_X, _V, _U, _W, _T, _SHOWN_PILOT, _SHOWN_MAIN = range(7)
_LONGEST_STEP: Final = 1e-4
_MOST_PIECES: Final = 1000
"""Between two commands: SciPy finds the event with which a piece begins again and again where a velocity is 0 to the
last bit."""


class Reference(NamedTuple):
    """Positions as shown, (n,) m, and (time, kind) of every event, the kinds by the core's names."""

    pilot: Any
    main: Any
    events: list[tuple[float, str]]


class ReferenceValve:
    """One valve at rest and without current at `start`."""

    def __init__(
        self, declared: Mapping[str, float], effects: Mapping[str, Mapping[str, float]], start: float,
        method: str = "DOP853", rtol: float = 1e-13,
    ) -> None:  # fmt: skip
        self.d, self.e = dict(declared), effects
        self.method, self.rtol = method, rtol
        self.d["stroke"] += self.of("stroke_offset", "offset", 0.0)
        self.d["pilot_gap"] += self.of("gap_offset", "offset", 0.0)
        self.lag = self.d["coil_time_constant"] + self.of("coil_lag", "time_constant", 0.0)
        self.eddy = self.of("eddy_lag", "time_constant", 0.0)
        self.cutoff = self.of("sensor_bandwidth", "cutoff_frequency", 0.0)
        self.t, self.y = start, np.zeros(7)
        self.mode, self.moving, self.direction = CLOSED, False, 1
        self.volts, self.peak, self.unseated, self.held = 0.0, 0.0, start, False
        self.events: list[tuple[float, str]] = []

    def of(self, effect: str, parameter: str, off: float) -> float:
        return self.e[effect][parameter] if effect in self.e else off

    def coil(self, y: Any) -> tuple[float, float]:
        target = self.volts / self.d["reference_voltage"] * self.of("drive_gain", "gain", 1.0)
        u = y[_U] if self.lag > 0 else target / (1 + 0.00393 * y[_T])
        return u, y[_W] if self.eddy > 0 else u

    def strength(self, y: Any) -> float:
        """Of the current that pulls."""
        return abs(self.coil(y)[1])

    def floor(self, u: float) -> float:
        return self.of("residual_magnetism", "current", 0.0) * min(1.0, max(self.peak, abs(u)))

    def net(self, phase_2: bool, direction: int, t: float, y: Any, v: float) -> float:
        """Force without dry friction, N."""
        d, x = self.d, y[_X]
        u, w = self.coil(y)
        pull = self.floor(u) if self.held else abs(w)
        square = pull**2
        if "magnetic_saturation" in self.e:
            knee = self.e["magnetic_saturation"]["current"]
            square *= (1 + 1 / knee**2) / (1 + square / knee**2)
        a0 = d["a0"] + self.of("rest_attraction", "force", 0.0)
        force = square * (a0 + d["a1"] * x + d["a2"] * x**2 + d["a3"] * x**3) + self.of("constant_force", "force", 0.0)
        if phase_2:
            force -= d["spring_preload"] + d["spring_rate"] * x + d["main_damping"] * v
            force -= self.of("spring_hardening", "coefficient", 0.0) * x**3
            if "pressure_force" in self.e:
                pressure = self.e["pressure_force"]
                force -= pressure["force"] * math.exp(-(t - self.unseated) / pressure["equalisation_time"])
        else:
            force -= d["seat_load"] + d["pilot_damping"] * v
        side = "opening" if direction > 0 else "closing"
        force -= self.of("asymmetric_friction", f"damping_{side}", 0.0) * v
        force -= self.of("quadratic_drag", "coefficient", 0.0) * v * abs(v)
        if "squeeze_film" in self.e:
            h = self.e["squeeze_film"]["film_thickness"]
            film = (h / (x + h)) ** 3 + (h / (d["stroke"] - x + h)) ** 3
            force -= self.e["squeeze_film"]["coefficient"] * v * film
        return force

    def friction(self, direction: int, v: float) -> float:
        level = self.of("coulomb_friction", "force", 0.0) + self.of("stiction", "force", 0.0)
        level += self.of("asymmetric_friction", "force_opening" if direction > 0 else "force_closing", 0.0)
        if "stiction" in self.e:
            stiction = self.e["stiction"]
            level += stiction["breakaway"] * math.exp(-((v / stiction["stribeck_velocity"]) ** 2))
        return level

    def rates(self, t: float, y: Any) -> Any:
        rate = np.zeros(7)
        u, w = self.coil(y)
        target = self.volts / self.d["reference_voltage"] * self.of("drive_gain", "gain", 1.0)
        if self.lag > 0:
            rate[_U] = (target - u * (1 + 0.00393 * y[_T])) / self.lag
        if self.eddy > 0:
            rate[_W] = (u - w) / self.eddy
        if "coil_heating" in self.e:
            heating = self.e["coil_heating"]
            rate[_T] = heating["temperature_rate"] * u**2 - y[_T] / heating["cooling_time_constant"]
        if self.moving:
            phase_2 = self.mode == MAIN
            force = self.net(phase_2, self.direction, t, y, y[_V]) - self.direction * self.friction(
                self.direction, y[_V]
            )
            rate[_X] = y[_V]
            rate[_V] = force / self.d["moving_mass" if phase_2 else "pilot_mass"]
        omega = 2 * math.pi * self.cutoff
        rate[_SHOWN_PILOT] = omega * (y[_X] - y[_SHOWN_PILOT])
        main = y[_X] - self.d["pilot_gap"] if self.mode >= MAIN else 0.0
        rate[_SHOWN_MAIN] = omega * (main - y[_SHOWN_MAIN])
        return rate

    def lift(self, t: float, y: Any) -> float:
        held = self.friction(1, 0.0)
        # Nor does less than 1 nN lift the pilot off its seat.
        return self.net(self.mode >= GAP_HOLD, 1, t, y, 0.0) - (max(held, 1e-9) if self.mode == CLOSED else held)

    def fall(self, t: float, y: Any) -> float:
        return -self.net(self.mode >= MAIN, -1, t, y, 0.0) - self.friction(-1, 0.0)

    def push(self) -> int:
        if self.mode != OPEN and self.lift(self.t, self.y) > 0:
            return 1
        return -1 if self.mode != CLOSED and self.fall(self.t, self.y) > 0 else 0

    def guards(self) -> list[tuple[str, Callable[[float, Any], float]]]:
        """What ends a piece: functions that rise through zero."""
        found: list[tuple[str, Callable[[float, Any], float]]] = []
        # Before the first command the current and its floor are both 0, and would cross for ever.
        if "residual_magnetism" in self.e and (self.peak > 0 or self.volts != 0):
            sign = -1.0 if self.held else 1.0
            found.append(("magnet", lambda t, y: sign * (self.floor(self.coil(y)[0]) - self.strength(y))))
        if not self.moving:
            if self.mode != OPEN:
                found.append(("lift", self.lift))
            if self.mode != CLOSED:
                found.append(("fall", self.fall))
            return found
        above, below = (self.d["stroke"], self.d["pilot_gap"]) if self.mode == MAIN else (self.d["pilot_gap"], 0.0)
        contact = above if self.direction > 0 else below
        way = self.direction
        found.append(("contact", lambda t, y: way * (y[_X] - contact)))
        found.append(("turn", lambda t, y: -way * y[_V]))
        return found

    def log(self, kind: str) -> None:
        self.events.append((self.t, kind))

    def rest(self, mode: int) -> None:
        self.mode, self.moving, self.y[_V] = mode, False, 0.0

    def move(self, push: int) -> None:
        kinds = {CLOSED: "UNSEATED", OPEN: "RELEASED", GAP_HOLD: "LIFTED" if push > 0 else "DROPPED"}
        self.log(kinds.get(self.mode, "BROKE_AWAY"))
        if self.mode == CLOSED:
            self.unseated = self.t
        after = {CLOSED: PILOT, OPEN: MAIN, GAP_HOLD: MAIN if push > 0 else PILOT}
        self.mode, self.moving, self.direction = after.get(self.mode, self.mode), True, push

    def touch(self) -> None:
        up, v = self.direction > 0, self.y[_V]
        if (self.mode == MAIN) == up:
            bounce = self.of("stop_bounce", "restitution_stop" if up else "restitution_seat", 0.0)
            self.y[_X] = self.d["stroke"] if up else 0.0
            if self.mode == MAIN or not up:
                self.end_stop(up, bounce, v)
                return
        self.y[_X] = self.d["pilot_gap"]
        one, two = (self.net(phase_2, self.direction, self.t, self.y, 0.0) for phase_2 in (False, True))
        if abs(v) < 1e-3 and one > 0 >= two:
            self.rest(GAP_HOLD)
            self.log("HELD_AT_GAP")
        elif not up:
            self.mode = PILOT
            self.log("MAIN_SEATED")
        else:
            self.mode = MAIN
            self.y[_V] = v * self.of("pickup_impact", "velocity_ratio", self.d["pickup_velocity_ratio"])
            self.log("PICKED_UP")
            if self.y[_V] == 0:
                self.rest(GAP_HOLD)

    def end_stop(self, up: bool, bounce: float, v: float) -> None:
        if bounce > 0 and abs(v) >= 5e-3:
            self.y[_V], self.direction = -bounce * v, -self.direction
            self.log("BOUNCED_AT_STOP" if up else "BOUNCED_AT_SEAT")
            if not up:
                self.unseated = self.t
            return
        self.rest(OPEN if up else CLOSED)
        if not up and self.lift(self.t, self.y) > 0:
            # It touches and is pulled off again at the same time.
            self.mode, self.moving, self.direction, self.unseated = PILOT, True, 1, self.t
            self.log("BOUNCED_AT_SEAT")
        else:
            self.log("REACHED_STOP" if up else "SEATED")

    def handle(self, name: str) -> None:
        if name == "magnet":
            self.held = not self.held
        elif name in ("lift", "fall"):
            self.move(1 if name == "lift" else -1)
        elif name == "contact":
            self.touch()
        else:
            self.y[_V], self.moving = 0.0, False
            push = self.push()
            if push:
                self.moving, self.direction = True, push
            else:
                self.log("STUCK")

    def go(self, end: float, times: Any, pilot: Any, main: Any) -> None:
        """Up to `end`, filling in the samples on the way; an error where it comes no further."""
        pieces = 0
        while self.t < end:
            pieces += 1
            if pieces > _MOST_PIECES:
                raise RuntimeError(f"the reference comes no further than {self.t} s")
            if not self.moving and (push := self.push()):
                self.move(push)
            names, functions = zip(*self.guards(), strict=True)
            events = []
            for function in functions:
                event: Any = lambda t, y, function=function: function(t, y)  # noqa: E731 - takes attributes
                event.terminal, event.direction = True, 1.0
                events.append(event)
            solution = solve_ivp(
                self.rates, (self.t, end), self.y, method=self.method, rtol=self.rtol, max_step=_LONGEST_STEP,
                atol=self.rtol * np.array([1e-3, 1e-1, 1, 1, 1, 1e-3, 1e-3]), events=events, dense_output=True,
            )  # fmt: skip
            inside = (times > self.t) & (times <= solution.t[-1])
            if inside.any():
                y = solution.sol(times[inside])
                above = y[_X] - self.d["pilot_gap"] if self.mode >= MAIN else np.zeros(y.shape[1])
                pilot[inside] = y[_SHOWN_PILOT] if self.cutoff else y[_X]
                main[inside] = y[_SHOWN_MAIN] if self.cutoff else above
                self.note(inside, y)
            if "residual_magnetism" in self.e:  # a coil that heats has its largest current on the way
                near = int(np.argmax([abs(self.coil(y)[0]) for y in solution.y.T]))
                first, last = solution.t[max(near - 1, 0)], solution.t[min(near + 1, len(solution.t) - 1)]
                close = solution.sol(np.linspace(first, last, 1001))
                self.peak = max(self.peak, *(abs(self.coil(y)[0]) for y in close.T))
            self.t, self.y = float(solution.t[-1]), solution.y[:, -1].copy()
            if solution.status == 1:
                fired = [name for name, hits in zip(names, solution.t_events, strict=True) if len(hits)]
                self.handle(fired[0])

    def note(self, inside: Any, y: Any) -> None:
        """What else is kept of the samples of a piece."""

    def command(self, volts: float) -> None:
        self.volts = volts
        u, w = self.coil(self.y)
        self.peak = max(self.peak, abs(u))
        self.held = "residual_magnetism" in self.e and abs(w) < self.floor(u)


def reference(
    declared: Mapping[str, float], effects: Mapping[str, Mapping[str, float]], drive: Any, times: Any, **how: Any
) -> Reference:
    """The whole run, from the first command (s) or sample on, as the sensors show it."""
    shifted = np.asarray(times) - (effects["sensor_delay"]["delay"] if "sensor_delay" in effects else 0.0)
    valve = ReferenceValve(declared, effects, float(min(drive.times[0], times[0])), **how)
    pilot, main = np.zeros(len(times)), np.zeros(len(times))
    for moment, volts in zip(drive.times, drive.volts, strict=True):
        valve.go(moment, shifted, pilot, main)
        valve.command(volts)
    valve.go(times[-1], shifted, pilot, main)
    gain = valve.of("sensor_gain", "gain", 1.0)
    return Reference(gain * pilot, gain * main, valve.events)
