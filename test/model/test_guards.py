"""Located switches: forces that jump, friction that falls with speed, forces that change while the valve rests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from model import jumps
from model.derivatives import ACCURACY, Case, errors_of
from valve_sim.model import CATALOGUE, Drive, Effect, EventKind, Parameter, Valve, simulate
from valve_sim.model.core.tracer import sin, where
from valve_sim.model.effects import basis

OPENING = Valve().with_values(a0=3.0336, coil_time_constant=0.99e-3, seat_load=0.1).parameters
LATE = 1e-11
"""s, that an event may be off."""
FEW = (16, 32, 40, 70, 160, 192)
"""Seeds of valves whose friction falls fastest where a step ends."""


@pytest.fixture(autouse=True)
def effects() -> Iterator[None]:
    """What this module adds to the catalogue."""
    beat = Effect(
        "beat", "a force that is on for a third of each period",
        (Parameter("level", "N", "of the force", -10, 10, 0.1, 0.0), Parameter("rate", "1/s", "of it", 0, 1e5, 1e3)),
        "a test", force=lambda m, own: where(sin(own.rate * m.t) > 0.5, own.level, 0.0),
    )  # fmt: skip
    CATALOGUE.register(beat)
    with jumps.registered():
        yield
    CATALOGUE.unregister("beat")


@pytest.mark.parametrize(
    ("effect", "parameter", "value"),
    [
        ("ledge", "place", 1e-4), ("ledge", "place", 6e-4), ("ledge", "place", 1.1e-3), ("knock", "moment", 4e-3),
        ("knock", "moment", 6e-3), ("assist", "speed", 0.1), ("assist", "speed", 0.3),
    ],
)  # fmt: skip
@pytest.mark.parametrize("level", [0.4, -0.3])
def test_derivatives_pass_where_a_force_jumps(effect: str, parameter: str, value: float, level: float) -> None:
    if effect == "assist":
        level = abs(level)  # a force that brakes above a speed would hold the plungers at it
    valve = Valve(OPENING, {effect: {"level": level, parameter: value}})
    names = [f"{effect}.{parameter}", f"{effect}.level", "a0", "moving_mass", "pilot_damping", "command.0"]
    for name, errors in errors_of(Case(valve, Drive.of([1e-3, 20e-3], [9.0, 0.0]), jumps.TIMES), names).items():
        assert min(errors) < ACCURACY, f"{name}: {errors}"


def test_a_force_that_jumps_lifts_a_valve_when_it_does() -> None:
    """The derivative of the time at which a valve leaves its seat by such a force is that of the jump: 1."""
    valve, times = Valve(OPENING, {"knock": {"level": 0.5, "moment": 2e-3}}), np.arange(2.1e-3, 4e-3, 1e-4)
    case = Case(valve, Drive.of([0.0], [0.0]), times)
    assert simulate(valve, case.drive, times).first(EventKind.UNSEATED) == 2e-3
    assert min(errors_of(case, ["knock.moment"])["knock.moment"]) < ACCURACY


def agrees(seed: int) -> bool:
    """Whether events are those of DOP853 at 1e-13."""
    case = jumps.random_case(seed)
    found = simulate(case.valve, case.drive, case.times, start_time=0.0).events
    expected = jumps.events_of(case)
    assert [event.kind.name for event in found] == [kind for _, kind in expected], seed
    return max(abs(event.time - time) for event, (time, _) in zip(found, expected, strict=True)) < LATE


def test_events_are_located_where_friction_falls_with_speed_and_forces_jump() -> None:
    assert [seed for seed in FEW if not agrees(seed)] == []


@pytest.mark.long
def test_random_valves_whose_forces_jump() -> None:
    """`python -m benchmarks.accuracy jumps` compares 2,000."""
    assert [seed for seed in range(1000, 1150) if not agrees(seed)] == []
    for seed in range(1000, 1150):
        case = jumps.random_case(seed)
        for name, errors in errors_of(case, case.names()).items():
            assert min(errors, default=0.0) < ACCURACY, f"seed {seed}, {name}: {errors}"


@pytest.mark.parametrize("seed", [274, 289, 298])
def test_a_force_map_over_time_lifts_a_valve_at_rest(seed: int) -> None:
    """Where the curve passes what holds the plunger: the seat load and a nanonewton."""
    random = np.random.default_rng(seed)
    count = int(random.integers(5, 14))
    coefficients, low = random.uniform(-0.3, 0.3, count), random.uniform(0.0, 5e-3)
    high = low + random.uniform(1e-3, 20e-3)
    given = {"variable": 2.0, "low": low, "high": high, "coefficients": coefficients.tolist()}
    valve = Valve(OPENING, {"force_map": CATALOGUE["force_map"].unpacked(given, "here")})  # type: ignore[dict-item]

    def excess(times: Any) -> Any:
        return basis(np.atleast_1d(times), low, high, count) @ coefficients - OPENING.seat_load - 1e-9

    times = np.linspace(0.0, high, 20_001)
    first = int(np.flatnonzero(excess(times) > 0.0)[0])
    expected = brentq(lambda time: excess(time)[0], times[first - 1], times[first], xtol=1e-16)
    found = simulate(valve, Drive.of([0.9], [9.0]), [0.8], start_time=0.0)
    assert found.first(EventKind.UNSEATED) == pytest.approx(expected, abs=LATE)


@pytest.mark.parametrize("rate", [10.0, 1000.0, 5000.0])
def test_what_is_compared_may_be_any_function(rate: float) -> None:
    lifted = simulate(Valve(OPENING, {"beat": {"level": 0.2, "rate": rate}}), Drive.of([0.9], [9.0]), [0.0, 0.8])
    assert lifted.first(EventKind.UNSEATED) == pytest.approx(np.arcsin(0.5) / rate, abs=1e-15)
    braked = Valve(OPENING, {"beat": {"level": -0.2, "rate": rate}})
    found, exact = (
        simulate(braked, Drive.of([0.0], [9.0]), [0.02], tolerance=tolerance).events for tolerance in (1e-10, 1e-13)
    )
    assert [event.kind for event in found] == [event.kind for event in exact]
    assert [event.time for event in found] == pytest.approx([event.time for event in exact], abs=1e-13)
