"""Random valves whose dry friction falls with speed and whose forces jump, and the independent reference of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from model.derivatives import Case
from model.reference import ReferenceValve
from valve_sim.model import CATALOGUE, Drive, Effect, Parameter, Valve
from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, where

TIMES = np.arange(1, 300) * 1e-4 + 1.7e-6
"""s."""


def ledge(m: Motion, own: Own) -> Node:
    """A force that begins at a place, N."""
    return where(m.x > own.place, -own.level, 0.0)


def knock(m: Motion, own: Own) -> Node:
    """A force that begins at a time, N."""
    return where(m.t > own.moment, own.level, 0.0)


def assist(m: Motion, own: Own) -> Node:
    """A force that helps as long as the plungers open fast, N."""
    return where(m.v > own.speed, own.level, 0.0)


_LEVEL = Parameter("level", "N", "of the force", -1e3, 1e3, 0.5, 0.0)
EFFECTS = (
    Effect("ledge", "a ledge", (_LEVEL, Parameter("place", "m", "where", 0, 1e-2, 6e-4)), "a test", force=ledge),
    Effect("knock", "a knock", (_LEVEL, Parameter("moment", "s", "when", 0, 1.0, 1e-3)), "a test", force=knock),
    Effect("assist", "an assist", (_LEVEL, Parameter("speed", "m/s", "above it", 0, 1.0, 0.1)), "a test", force=assist),
)
"""What is compared, and whether it is above: by the effect's name, the parameter and the state's place."""
_COMPARED = {"ledge": ("place", 0), "assist": ("speed", 1), "knock": ("moment", None)}
_SIGN = {"ledge": -1.0, "knock": 1.0, "assist": 1.0}


@contextmanager
def registered() -> Iterator[None]:
    """The effects of this module are in the catalogue meanwhile."""
    for effect in EFFECTS:
        CATALOGUE.register(effect)
    try:
        yield
    finally:
        for effect in EFFECTS:
            CATALOGUE.unregister(effect.name)


def random_case(seed: int) -> Case:
    """A valve that rubs, with one force that jumps or two, under two pulses."""
    random = np.random.default_rng([seed, 51])
    base = Valve().with_values(
        a0=random.uniform(2, 4), coil_time_constant=random.uniform(2e-4, 1.5e-3), pilot_damping=random.uniform(0, 3),
        main_damping=random.uniform(0, 8), seat_load=random.uniform(0.05, 0.5), spring_preload=random.uniform(2, 3),
    )  # fmt: skip
    effects: dict[str, dict[str, float]] = {
        "stiction": {
            "force": random.uniform(0.02, 0.4), "breakaway": random.uniform(0.1, 1.0),
            "stribeck_velocity": 10.0 ** random.uniform(-3.5, -1.7),
        },
        "ledge": {"level": random.uniform(-0.5, 0.5), "place": random.uniform(5e-5, 1.1e-3)},
        "knock": {"level": random.uniform(-1.0, 1.0), "moment": random.uniform(2e-3, 25e-3)},
        "assist": {"level": random.uniform(0.05, 0.5), "speed": random.uniform(0.02, 0.3)},
    }  # fmt: skip
    kept = random.choice(["ledge", "knock", "assist"], int(random.integers(0, 3)), replace=False)
    chosen = {name: values for name, values in effects.items() if name == "stiction" or name in kept}
    times, volts = [1e-3, random.uniform(5e-3, 16e-3), 20e-3, 24e-3], [random.uniform(8, 14), random.uniform(-2, 5)]
    return Case(Valve(base.parameters, chosen), Drive.of(times, [*volts, random.uniform(6, 12), 0.0]), TIMES)


class JumpReference(ReferenceValve):
    """The reference with these forces: a piece ends where one jumps."""

    def __init__(self, *given: Any, **how: Any) -> None:
        super().__init__(*given, **how)
        self.above = {name: False for name in _COMPARED if name in self.e}

    def excess(self, name: str, t: float, y: Any) -> float:
        parameter, place = _COMPARED[name]
        return float((t if place is None else y[place]) - self.e[name][parameter])

    def net(self, phase_2: bool, direction: int, t: float, y: Any, v: float) -> float:
        more = sum(_SIGN[name] * self.e[name]["level"] for name, above in self.above.items() if above)
        return super().net(phase_2, direction, t, y, v) + more

    def guards(self) -> list[tuple[str, Callable[[float, Any], float]]]:
        found = []
        for name, above in self.above.items():
            sign = -1.0 if above else 1.0
            found.append((name, lambda t, y, name=name, sign=sign: sign * self.excess(name, t, y)))
        return [*found, *super().guards()]

    def handle(self, name: str) -> None:
        if name in self.above:
            self.above[name] = not self.above[name]
        else:
            super().handle(name)
            # What jumps at a contact or a stop may pass a comparison at once.
            for other in self.above:
                if other == "assist":
                    self.above[other] = self.excess(other, self.t, self.y) > 0.0


def events_of(case: Case) -> list[tuple[float, str]]:
    """(time, s, kind) of all events, by the reference at 1e-13; RuntimeError where it comes to no end."""
    valve = JumpReference(case.valve.declared(), case.valve.effects, 0.0)
    nothing = np.zeros(len(case.times))
    for moment, volts in zip(case.drive.times, case.drive.volts, strict=True):
        valve.go(moment, case.times, nothing, nothing)
        valve.command(volts)
    valve.go(case.times[-1], case.times, nothing, nothing)
    return valve.events
