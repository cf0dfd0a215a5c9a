"""Steps of a live valve that only an image shows, against the readings of all steps, whatever is asked and whenever."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

from valve_sim.files.parameter_files import default_valve, load_valve  # noqa: E402
from valve_sim.model import Valve  # noqa: E402
from valve_sim.nodes.live_valve import LiveValve, Step  # noqa: E402
from valve_sim.nodes.messages import ReadingMessages  # noqa: E402
from valve_sim.nodes.realtime import LAST_STAMP, Schedule  # noqa: E402

MILLISECOND = 1_000_000
STEPS = 400
CONFIG = Path(__file__).parents[2] / "config"
VALVES = {
    "without effects": default_valve,
    "with bounces": lambda: dataclasses.replace(
        default_valve(),
        effects={
            "stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.3},
            "sensor_bandwidth": {"cutoff_frequency": 200.0},
        },
    ),
    "late sensor": lambda: dataclasses.replace(default_valve(), effects={"sensor_delay": {"delay": 3.3e-3}}),
    "with gas": lambda: load_valve(CONFIG / "gas_tank_1.yaml"),
}
Request = Callable[[LiveValve, int], object]


def random_requests(valve: Valve, seed: int) -> list[tuple[int, int, Request]]:
    """After which step, at which clock time, and what is asked then; in the order of asking."""
    random = np.random.default_rng(seed)
    other = valve.with_values(spring_rate=1.1 * valve.parameters.spring_rate)
    kinds: list[Callable[[], Request]] = [
        lambda: lambda live, clock: live.command(clock, 9.0),
        lambda: lambda live, clock: live.command(clock, 0.0),
        lambda: lambda live, clock: live.set_valve(clock, other),
        lambda: lambda live, clock: live.set_valve(clock, valve),
        lambda: lambda live, clock: live.set_scale(clock, 0.5),
        lambda: lambda live, clock: live.set_scale(clock, 1.0),
        lambda: lambda live, clock: live.supply(clock, 20e6),
        lambda: lambda live, clock: live.limit(clock, 9.0),
        lambda: lambda live, clock: live.reset(clock),
        lambda: lambda live, clock: live.command(clock, 1e160),  # which fails
    ]
    weights = np.array([8, 8, 1, 1, 1, 1, 1, 1, 0.5, 0.5])
    asked, step = [], 0
    while (step := step + int(random.choice([1, 1, 3, 10, 25, 40]))) < STEPS:
        # Within the period that follows, at a step, or behind the next.
        after = int(random.choice([random.integers(1, MILLISECOND), MILLISECOND, random.integers(1, 3 * MILLISECOND)]))
        kind = kinds[random.choice(len(kinds), p=weights / weights.sum())]()
        asked.append((step, step * MILLISECOND + after, kind))
    return asked


Sample = tuple[bytes, bytes, bytes]


def of_step(messages: ReadingMessages, step: Step) -> Sample:
    shown, stamp = step.reading, step.stamp
    coil = messages.coil(stamp, shown.coil_current, shown.coil_voltage)
    return messages.joint_states(stamp, shown), coil, messages.coil_current(shown)


def run(valve: Valve, messages: ReadingMessages, seed: int, *, by_image: bool) -> tuple[list[Sample], list[Step], int]:
    """All samples as messages, what steps told beside them, and how many steps only the image showed."""
    live = LiveValve(valve, command_timeout=0.06)
    schedule = Schedule(1000.0, 0)
    image, *shown = messages.image()
    live.restart(0, 1_700_000_000_000_000_007)
    asked, samples, eventful, passed = random_requests(valve, seed), [], [], 0
    for index in range(STEPS):
        clock = schedule.take()
        if index % 97 == 50:  # one that is given up, as when the machine is too busy
            clock = schedule.take()
        if by_image and live.step_if_no_event(image, clock):
            passed += 1
            samples.append(tuple(part.tobytes() for part in shown))
        else:
            step = live.step(clock)
            samples.append(of_step(messages, step))
            if step.phases or step.reading.events or step.switches or step.obeyed or step.failure:
                eventful.append(step)
        while asked and asked[0][0] <= index:
            _, at, request = asked.pop(0)
            request(live, at)
    return samples, eventful, passed


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", VALVES)
def test_an_image_shows_what_a_step_would_and_nothing_else_is_left_untold(name: str, seed: int) -> None:
    valve, messages = VALVES[name](), ReadingMessages("valve")
    samples, eventful, _ = run(valve, messages, seed, by_image=False)
    by_image, told, passed = run(valve, messages, seed, by_image=True)
    assert by_image == samples
    assert told == eventful
    assert len(told) > 10, "something happened"
    assert passed == 0 if name == "late sensor" else passed > 0.6 * STEPS


def test_of_a_valve_that_nobody_has_read_an_image_shows_nothing() -> None:
    live, (image, *_) = LiveValve(default_valve()), ReadingMessages("").image()
    assert not live.step_if_no_event(image, 0)
    live.restart(0, 0)
    assert not live.step_if_no_event(image, 0)
    live.step(0)
    assert live.step_if_no_event(image, MILLISECOND)
    live.restart(5 * MILLISECOND, 0)
    assert not live.step_if_no_event(image, 5 * MILLISECOND)


def test_stamps_in_an_image_end_where_those_of_messages_do() -> None:
    messages, late = ReadingMessages(""), LAST_STAMP - MILLISECOND // 2
    live, (image, *shown) = LiveValve(default_valve()), messages.image()
    live.restart(0, late)
    live.step(0)
    assert live.step_if_no_event(image, MILLISECOND)
    step = live.step(MILLISECOND)
    assert step.stamp > LAST_STAMP
    assert tuple(part.tobytes() for part in shown) == of_step(messages, step)
