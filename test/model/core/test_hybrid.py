"""Machines with modes, as somebody writes them in YAML: against closed forms, another integrator, and differences."""

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from valve_sim.files.plant_files import PlantFile, plant_from
from valve_sim.model.core.own.simulation import Inputs, Machine, Shown
from valve_sim.model.errors import SimulationError

Array = NDArray[np.float64]
NO_INPUTS = Inputs(np.empty(0), np.empty((0, 0)), np.empty(0, dtype=bool))
FINE = 1e-13
"""Tolerance of runs that are compared to 1e-9: the default is for fits."""

PLUNGER = """
plant: equations
states: {x: {unit: m, start: 2.0e-3}, v: {unit: m/s}}
inputs: {force: {unit: N, between: held}}
parameters: {mass: {value: 0.1, unit: kg}, g: {value: 9.81, unit: m/s^2}, e: {value: 0.6},
             preload: {value: 0.2, unit: N}}
derivatives: {x: v, v: (force - preload)/mass - g}
outputs: {position: {value: x, unit: m}, phase: {value: mode, unit: 1}, bounces: {value: n, unit: 1}}
modes: {flying: {}, resting: {x: 0, v: 0}}
held: {n: 0}
transitions:
  - from: flying
    when: x < 0
    cases: [{if: -v > 5.0e-3, set: {x: 0, v: -e*v, n: n + 1}, event: bounced}, {to: resting, set: {x: 0, v: 0}}]
    event: seated
  - {from: resting, when: force > preload + mass*g, cases: [{to: flying}], event: lifted}
"""
RELAY = """
plant: equations
states: {T: {unit: K, start: 20}}
parameters: {tau: {value: 100, unit: s}, power: {value: 60, unit: K}, ambient: {value: 10, unit: K},
             low: {value: 18, unit: K}, high: {value: 22, unit: K}}
derivatives: {T: (ambient - T)/tau}
modes: {idle: {}, heating: {T: (ambient + power - T)/tau}}
transitions:
  - {from: heating, when: T > high, cases: [{to: idle}], event: idles}
  - {from: idle, when: T < low, cases: [{to: heating}], event: heats}
outputs: {temperature: {value: T, unit: K}}
"""
BESIDE = """
plant: equations
states: {T: {unit: K, start: 20}}
parameters: {tau: {value: 100, unit: s}, power: {value: 60, unit: K}, ambient: {value: 10, unit: K},
             low: {value: 18, unit: K}, high: {value: 22, unit: K}, margin: {value: 1, unit: K}}
derivatives: {T: '(ambient + where(heater == heating, power, 0) - T)/tau'}
regions: {heater: {idle: {}, heating: {}}, lamp: {dark: {}, lit: {}}}
held: {hottest: {unit: K, start: 0}}
transitions:
  - {from: heating, when: T > high, cases: [{to: [idle, lit], set: {hottest: T}}], event: idles}
  - {from: idle, when: T < low, cases: [{to: heating}], event: heats}
  - from: [lit]
    when: T < low + margin
    cases: [{if: heater == heating, to: dark, event: never}, {to: dark, event: darkens}]
outputs: {temperature: {value: T, unit: K}, lamp_is: {value: lamp, unit: 1}, seen: {value: hottest, unit: K}}
"""
BELT = """
plant: equations
states: {x: {unit: m}, v: {unit: m/s}}
parameters: {mass: {value: 1, unit: kg}, k: {value: 100, unit: N/m}, friction: {value: 2, unit: N},
             stick: {value: 1, unit: N}, falls: {value: 0.2, unit: m/s}, belt: {value: 0.1, unit: m/s}}
derivatives: {x: v, v: (-k*x - (friction + stick*exp(-abs(v - belt)/falls))*sign(v - belt))/mass}
outputs: {position: {value: x, unit: m}, speed: {value: v, unit: m/s}, slip: {value: v - belt, unit: m/s}}
"""
BODIES = """
plant: equations
states: {x: {unit: m}, v: {unit: m/s}, y: {unit: m}, w: {unit: m/s}}
inputs: {force: {unit: N, between: straight}}
parameters: {m1: {value: 1, unit: kg}, m2: {value: 0.5, unit: kg}, f1: {value: 1, unit: N}, f2: {value: 2, unit: N}}
derivatives: {x: v, v: (force - f1*sign(v) - f2*sign(v - w))/m1, y: w, w: f2*sign(v - w)/m2}
outputs: {position: {value: x, unit: m}, other: {value: y, unit: m}, rub: {value: f2*sign(v - w), unit: N}}
"""
FLOOR = """
plant: equations
states: {x: {unit: m}, v: {unit: m/s}, y: {unit: m}, w: {unit: m/s}}
inputs: {force: {unit: N, between: straight}}
parameters: {m: {value: 1, unit: kg}, f1: {value: 1, unit: N}, f2: {value: 2, unit: N}, rub: {value: 3, unit: N}}
derivatives: {x: v, v: (force - f1*sign(v) - rub*sign(v - w))/m, y: w, w: (rub*sign(v - w) - f2*sign(w))/m}
outputs: {position: {value: x, unit: m}, other: {value: y, unit: m}}
"""
PENDULUM = """
plant: equations
states: {q: {unit: rad, start: 1}, w: {unit: rad/s}}
parameters: {a: {value: 9, unit: 1/s^2}, stop: {value: 0.3, unit: rad}, e: {value: 0.7}}
derivatives: {q: w, w: -a*sin(q)}
transitions: [{when: q < -stop, cases: [{set: {q: -stop, w: -e*w}}], event: struck}]
outputs: {angle: {value: q, unit: rad}}
"""
VALVE = """
plant: equations
states: {i: {unit: A}, x: {unit: m}, v: {unit: m/s}}
inputs: {voltage: {unit: V, between: held}}
parameters:
  {R: {value: 4, unit: Ohm}, L: {value: 0.01, unit: H}, kf: {value: 12, unit: N/A^2}, spring: {value: 2000, unit: N/m},
   preload: {value: 20, unit: N}, pilot: {value: 0.005, unit: kg}, main: {value: 0.02, unit: kg},
   held_shut: {value: 25, unit: N}, gap: {value: 2.0e-4, unit: m}, stroke: {value: 8.0e-4, unit: m}, e: {value: 0.3}}
derivatives: {i: (voltage - R*i)/L, x: v, v: net/pilot}
outputs:
  net: {value: kf*i**2 - preload - spring*x, unit: N}
  position: {value: x, unit: m}
modes: {shut: {x: 0, v: 0}, piloting: {}, at_gap: {x: 0, v: 0}, opening: {v: net/(pilot + main)}, open: {x: 0, v: 0}}
transitions:
  - {from: shut, when: net > 0, cases: [{to: piloting}], event: unseated}
  - from: piloting
    when: x > gap
    event: at_gap
    cases:
      - {if: net < held_shut, to: at_gap, set: {x: gap, v: 0}}
      - {to: opening, set: {x: gap, v: v*pilot/(pilot + main)}}
  - {from: at_gap, when: net > held_shut, cases: [{to: opening}], event: picked_up}
  - from: opening
    when: x > stroke
    event: stopped
    cases: [{if: v > 0.05, set: {x: stroke, v: -e*v}}, {to: open, set: {x: stroke, v: 0}}]
  - {from: open, when: net < 0, cases: [{to: opening}], event: released}
  - {from: [piloting, opening], when: x < 0, cases: [{to: shut, set: {x: 0, v: 0}}], event: seated}
"""


def file_of(text: str) -> PlantFile:
    return plant_from(yaml.safe_load(text), "own.yaml")


def machine_of(file: PlantFile) -> Machine:
    return Machine(file.equations(), list(file.parameters))


def numbers_of(file: PlantFile) -> tuple[dict[str, float], dict[str, float]]:
    return {n: own.value for n, own in file.parameters.items()}, {n: own.start or 0.0 for n, own in file.states.items()}


def run(text: str, inputs: Inputs, times: Array, **how: float) -> Shown:
    file = file_of(text)
    return machine_of(file).run(*numbers_of(file), inputs, times, tolerance=FINE, **how)


def held(times: Sequence[float], levels: Sequence[float]) -> Inputs:
    return Inputs(np.array(times), np.array(levels)[:, None], np.array([True]))


def followed(
    flow: Callable[[float, Array], list[float]], falls: Callable[[float, Array], float], time: float,
    state: Sequence[float], times: Array, shown: Array, end: float = math.inf,
) -> tuple[float, list[float]]:  # fmt: skip
    """Another integrator: one flow up to where a function falls through 0; states at some times are filled in."""
    end = min(end, times[-1])

    def event(t: float, y: Array) -> float:
        return falls(t, y)

    event.terminal, event.direction = True, -1  # type: ignore[attr-defined]
    found = solve_ivp(
        flow, (time, end), state, method="DOP853", rtol=1e-13, atol=1e-15, events=event, dense_output=True,
        max_step=0.02,
    )  # fmt: skip
    here = (times >= time) & (times <= found.t[-1])
    shown[here] = found.sol(times[here]).T
    return float(found.t[-1]), [float(own) for own in found.y[:, -1]]


def impacts(mass: float, g: float, e: float, preload: float) -> list[float]:
    """When the plunger is at its seat: dropped from 2 mm, and again after 4 ms of 3 N from 0.3 s on."""
    fall = preload / mass + g
    time = math.sqrt(2.0 * 2e-3 / fall)
    speed, found = fall * time, [time]

    def bounce(time: float, speed: float) -> None:
        while speed > 5e-3:
            speed *= e
            time += 2.0 * speed / fall
            found.append(time)

    bounce(time, speed)
    rise = (3.0 - preload) / mass - g
    height, speed = 0.5 * rise * 4e-3**2, rise * 4e-3
    arrival = math.sqrt(speed**2 + 2.0 * fall * height)
    found += [0.3, 0.304 + (speed + arrival) / fall]
    bounce(found[-1], arrival)
    return found


def test_a_plunger_that_bounces_on_its_seat_is_that_of_its_closed_form() -> None:
    times = np.array([0.01, 0.29, 0.3, 0.301, 0.6])
    shown = run(PLUNGER, held([0.0, 0.3, 0.304], [0.0, 3.0, 0.0]), times)
    expected = impacts(0.1, 9.81, 0.6, 0.2)
    assert [event.time for event in shown.events] == pytest.approx(expected, abs=1e-15)
    names = [event.name for event in shown.events]
    assert names[names.index("seated") :][:2] == ["seated", "lifted"]
    assert shown.outputs[:, 1].tolist() == [0.0, 1.0, 0.0, 0.0, 1.0]
    assert shown.outputs[-1, 2] == names.count("bounced")
    assert shown.outputs[[1, 4], 0].tolist() == [0.0, 0.0]


def test_a_relay_with_hysteresis_switches_when_its_exponentials_say() -> None:
    shown = run(RELAY, NO_INPUTS, np.array([0.0, 400.0]))
    heats, idles = 100.0 * math.log(52.0 / 48.0), 100.0 * math.log(12.0 / 8.0)
    begins = 100.0 * math.log(10.0 / 8.0)
    expected = [begins, *(begins + np.cumsum([heats, idles] * 10))]
    found = [event.time for event in shown.events]
    assert found == pytest.approx([time for time in expected if time < 400.0], abs=1e-9)


def test_regions_side_by_side_know_each_others_modes() -> None:
    """The relay once more, with a lamp that is lit when the heater ends, until the room is nearly at its lower end."""
    shown, alone = run(BESIDE, NO_INPUTS, np.array([0.0, 35.0, 400.0])), run(RELAY, NO_INPUTS, np.array([0.0, 400.0]))
    relay = [event for event in shown.events if event.name in ("idles", "heats")]
    assert [event.time for event in relay] == pytest.approx([event.time for event in alone.events], abs=1e-9)
    idles, darkens = (np.array([e.time for e in shown.events if e.name == name]) for name in ("idles", "darkens"))
    assert darkens == pytest.approx(idles[: len(darkens)] + 100.0 * math.log(12.0 / 9.0), abs=1e-9)
    assert [event.name for event in shown.events].count("never") == 0
    assert shown.outputs[1, 1:].tolist() == [1.0, pytest.approx(22.0, abs=1e-12)]


def test_a_block_on_a_belt_sticks_and_slips() -> None:
    """It sticks until the spring pulls with the whole stiction, and slips until it has the belt's speed again."""
    times = np.linspace(0.0, 3.0, 301)
    shown = run(BELT, NO_INPUTS, times)

    def slips(_: float, y: Array) -> list[float]:
        return [y[1], -100.0 * y[0] + 2.0 + math.exp(-(0.1 - y[1]) / 0.2)]

    def caught(_: float, y: Array) -> float:
        return 0.1 - y[1]

    def sticks(time: float, y: Array) -> list[float]:
        return [0.1, 0.0]

    expected, time, state = np.empty((len(times), 2)), 0.0, [0.0, 0.0]
    while time < 3.0:
        time, state = followed(slips, caught, time, state, times, expected)
        state[1] = 0.1
        time, state = followed(sticks, lambda _, y: 0.03 - y[0], time, state, times, expected)
        state[0] = 0.03
    assert np.max(np.abs(shown.outputs[:, :2] - expected)) < 1e-9
    at_rest = expected[:, 1] == 0.1
    assert 0.1 < np.mean(at_rest) < 0.9
    assert np.max(np.abs(shown.outputs[at_rest, 2])) < 1e-15


@pytest.mark.parametrize("push", [2.5, 9.0])
def test_two_bodies_that_rub_on_each_other_and_on_the_floor(push: float) -> None:
    """A force of 2.5 N moves both as one; 9 N leaves the second body behind, which catches up."""
    times = np.linspace(0.0, 4.0, 401)
    shown = run(BODIES, Inputs(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [push], [0.0]]), np.array([False])), times)

    def force(t: float) -> float:
        return push * max(0.0, min(t, 2.0 - t))

    def together(t: float, y: Array) -> list[float]:
        return [y[1], (force(t) - 1.0) / 1.5, y[3], (force(t) - 1.0) / 1.5]

    def apart(t: float, y: Array) -> list[float]:
        return [y[1], force(t) - 3.0, y[3], 4.0]

    expected, state = np.zeros((len(times), 4)), [0.0] * 4
    time = 1.0 / push
    if push < 7.0:
        followed(together, lambda _, y: y[1], time, state, times, expected)
    else:
        time, state = followed(together, lambda t, _: 7.0 - force(t), time, state, times, expected)
        time, state = followed(apart, lambda _, y: y[1] - y[3], time, state, times, expected)
    time, state = followed(together, lambda _, y: y[1], time, state, times, expected)
    expected[times > time] = [state[0], 0.0, state[2], 0.0]
    assert np.max(np.abs(shown.outputs[:, :2] - expected[:, [0, 2]])) < 1e-9
    rubs = 0.5 * np.array([together(t, y)[3] for t, y in zip(times, expected, strict=True)])
    rubs[expected[:, 1] - expected[:, 3] > 1e-9] = 2.0
    moves = (expected[:, 1] > 0.0) & (np.abs(times - 1.0) > 1e-9)
    assert np.max(np.abs(shown.outputs - rubs[:, None])[moves, 2]) < 1e-9


@pytest.mark.parametrize("between", [3.0, 1.5])
def test_of_three_frictions_at_once_two_hold_what_the_third_would(between: float) -> None:
    """Two bodies rub on each other and both on the floor; a force pulls one of them for 1 s, 10 N more each second.

    At rest two frictions decide, and which two depends on the forces. With 3 N between them both start as one, and come
    apart; with 1.5 N the second body stays where it is, for the floor holds it with 2 N.
    """
    pull = Inputs(np.array([0.0, 1.0, 1.0 + 1e-12]), np.array([[0.0], [10.0], [0.0]]), np.array([False]))
    shown = run(FLOOR.replace("value: 3", f"value: {between:g}"), pull, np.array([0.2, 0.5, 1.0, 3.0, 9.0]))
    if between == 3.0:
        start, apart = 5.0 * 0.2**3 / 6.0, 0.1 * 0.5 + 0.125
        first, second = start + apart + 5.0 / 24.0, start + apart
        met = 1.85 * 0.25 - 2.0 * 0.25**2, 0.6 * 0.25 + 0.5 * 0.25**2
        both = 0.85**2 / 3.0
        ends = first + met[0] + both, second + met[1] + both
        expected = [(0.0, 0.0), (start, start), (first, second), ends, ends]
    else:
        speed = 5.0 * 0.75**2
        first = 10.0 / 6.0 * 0.75**3
        end = first + speed**2 / 5.0
        expected = [(0.0, 0.0), (10.0 / 6.0 * 0.25**3, 0.0), (first, 0.0), (end, 0.0), (end, 0.0)]
    assert shown.outputs[:, :2] == pytest.approx(np.array(expected), abs=1e-9)


def test_bodies_that_three_frictions_bring_to_rest_rest() -> None:
    """Two springs, and friction on each other and on the floor: as another integrator says up to where both rest."""
    text = (
        FLOOR.replace("(force -", "(force - k*x -")
        .replace("(rub*", "(-k*y + rub*")
        .replace("m: {", "k: {value: 32, unit: N/m}, m: {")
    )
    file, times = file_of(text), np.linspace(0.0, 1.0, 201)
    numbers = {"k": 32.0, "m": 1.0, "f1": 1.16, "f2": 1.74, "rub": 1.92}
    start = {"x": -0.1, "v": 0.0, "y": 0.0, "w": 0.1}
    nothing = Inputs(np.array([0.0]), np.zeros((1, 1)), np.array([True]))
    shown = machine_of(file).run(numbers, start, nothing, times)
    smooth = solve_ivp(
        lambda _, s: [
            s[1], -32.0 * s[0] - 1.16 * np.tanh(s[1] / 1e-7) - 1.92 * np.tanh((s[1] - s[3]) / 1e-7),
            s[3], -32.0 * s[2] - 1.74 * np.tanh(s[3] / 1e-7) + 1.92 * np.tanh((s[1] - s[3]) / 1e-7),
        ],
        (0.0, 1.0), list(start.values()), method="Radau", rtol=1e-9, atol=1e-12, t_eval=times,
    )  # fmt: skip
    assert shown.outputs == pytest.approx(smooth.y[[0, 2]].T, abs=1e-6)
    assert np.all(shown.outputs[times > 0.4] == shown.outputs[-1])


def test_a_pendulum_with_a_stop_is_that_of_another_integrator() -> None:
    times = np.linspace(0.0, 5.0, 101)
    shown = run(PENDULUM, NO_INPUTS, times)
    expected, time, state = np.empty((len(times), 2)), 0.0, [1.0, 0.0]
    struck = []
    while time < 5.0:
        time, state = followed(
            lambda _, y: [y[1], -9.0 * math.sin(y[0])], lambda _, y: y[0] + 0.3, time, state, times, expected
        )
        struck.append(time)
        state = [-0.3, -0.7 * state[1]]
    assert np.max(np.abs(shown.outputs[:, 0] - expected[:, 0])) < 1e-9
    assert [event.time for event in shown.events] == pytest.approx(struck[:-1], abs=1e-10)


def two_stages(times: Array, off: float) -> tuple[Array, list[tuple[float, str]]]:
    """The two-stage valve by another integrator: (n, 3) states, and its events."""
    shown, events = np.zeros((len(times), 3)), []
    time, state, mode = 0.0, [0.0, 0.0, 0.0], "shut"
    mass = {"piloting": 0.005, "opening": 0.025}

    def net(y: Sequence[float]) -> float:
        return float(12.0 * y[0] ** 2 - 20.0 - 2000.0 * y[1])

    def flow(t: float, y: Array) -> list[float]:
        current = ((12.0 if t < off else 0.0) - 4.0 * y[0]) / 0.01
        return [current, y[2], net(y) / mass[mode]] if mode in mass else [current, 0.0, 0.0]

    watched: dict[str, Callable[[float, Array], float]] = {
        "shut": lambda _, y: -net(y), "piloting": lambda _, y: min(2e-4 - y[1], y[1] + (y[2] >= 0.0)),
        "at_gap": lambda _, y: 25.0 - net(y), "opening": lambda _, y: 8e-4 - y[1] if y[2] > 0.0 else y[1],
        "open": lambda _, y: net(y),
    }  # fmt: skip
    while time < times[-1]:
        time, state = followed(flow, watched[mode], time, state, times, shown, off if time < off else math.inf)
        if time >= times[-1]:
            break
        if time == off:
            continue
        current, x, v = state
        if mode == "shut":
            event, mode = "unseated", "piloting"
        elif mode == "piloting" and v > 0.0:
            event, mode, state = "at_gap", "opening", [current, 2e-4, v * 0.2]
            if net([current, x]) < 25.0:
                mode, state = "at_gap", [current, 2e-4, 0.0]
        elif mode == "at_gap":
            event, mode = "picked_up", "opening"
        elif mode == "opening" and v > 0.0:
            event, state = "stopped", [current, 8e-4, -0.3 * v]
            if v <= 0.05:
                mode, state = "open", [current, 8e-4, 0.0]
        elif mode == "open":
            event, mode = "released", "opening"
        else:
            event, mode, state = "seated", "shut", [current, 0.0, 0.0]
        events.append((time, event))
    return shown, events


def test_a_two_stage_valve_is_that_of_another_integrator() -> None:
    times, off = np.linspace(0.0, 0.04, 401), 0.02
    shown = run(VALVE, held([0.0, off], [12.0, 0.0]), times)
    expected, events = two_stages(times, off)
    assert [event.name for event in shown.events] == [name for _, name in events]
    assert [event.time for event in shown.events] == pytest.approx([time for time, _ in events], abs=1e-9)
    assert np.max(np.abs(shown.outputs[:, 1] - expected[:, 1])) < 1e-9


PUSHED = held([0.0, 0.3, 0.304], [0.0, 3.0, 0.0])
RAMP = Inputs(np.array([0.0, 1.0, 2.0]), np.array([[0.0], [9.0], [0.0]]), np.array([False]))


@pytest.mark.parametrize(
    ("text", "inputs", "end"),
    [
        (PLUNGER, PUSHED, 0.6), (RELAY, NO_INPUTS, 400.0), (BELT, NO_INPUTS, 3.0), (BODIES, RAMP, 4.0),
        (PENDULUM, NO_INPUTS, 5.0), (VALVE, held([0.0, 0.02], [12.0, 0.0]), 0.04),
    ],
    ids=["plunger", "relay", "belt", "bodies", "pendulum", "valve"],
)  # fmt: skip
def test_derivatives_go_through_events_as_differences_do(text: str, inputs: Inputs, end: float) -> None:
    file = file_of(text)
    machine, (numbers, start) = machine_of(file), numbers_of(file)
    times = np.linspace(0.0, end, 997)
    names = [*numbers, *(name for name in start if start[name])]
    shown = machine.run(numbers, start, inputs, times, [{name: 1.0} for name in names], tolerance=FINE)
    for column, name in enumerate(names):
        step = 1e-4 * (abs((numbers | start)[name]) or 1.0)
        ends = []
        for by in (-2.0, -1.0, 1.0, 2.0):
            moved = {key: own + by * step * (key == name) for key, own in (numbers | start).items()}
            run_there = machine.run(moved, moved, inputs, times, tolerance=FINE)
            assert len(run_there.events) == len(shown.events)
            ends.append(run_there.outputs[:, 0])
        narrow, broad = (ends[2] - ends[1]) / (2.0 * step), (ends[3] - ends[0]) / (4.0 * step)
        size = np.max(np.abs(narrow))
        # Beside an event, which side a sample is on changes with the step; there is no difference there.
        calm = np.abs(narrow - broad) < 1e-6 * size
        calm[2:-2] &= calm[:-4] & calm[1:-3] & calm[3:-1] & calm[4:]
        off = np.abs(shown.slopes[:, 0, column] - (4.0 * narrow - broad) / 3.0)[calm]
        assert np.mean(calm) > 0.8, name
        assert np.max(off) < 1e-7 * size + 1e-12, name


@pytest.mark.parametrize(
    ("text", "commands", "end"),
    [(PLUNGER, PUSHED, 0.6), (VALVE, held([0.0, 0.02], [12.0, 0.0]), 0.04), (BELT, NO_INPUTS, 3.0)],
    ids=["plunger", "valve", "belt"],
)
def test_a_run_that_is_cut_anywhere_is_the_same_run_to_the_bit(text: str, commands: Inputs, end: float) -> None:
    file = file_of(text)
    machine, (numbers, start) = machine_of(file), numbers_of(file)
    looks = np.sort(np.random.default_rng(0).uniform(0.0, end, 500))
    whole = machine.run(numbers, start, commands, looks, start_time=0.0)
    live = machine.stepped(numbers, start, commands.levels[0] if len(commands.levels) else [])
    events, changes = [], list(zip(commands.times, commands.levels, strict=True))[1:]
    for look, row in zip(looks, whole.outputs, strict=True):
        while changes and changes[0][0] <= look:
            events += live.change(*changes.pop(0)).events
        piece = live.advance(look)
        events += piece.events
        assert np.array_equal(piece.outputs, row)
    assert events == [event for event in whole.events if event.time <= looks[-1]]


def test_time_that_stands_still_is_said_with_the_mend() -> None:
    ball = PENDULUM.replace("-a*sin(q)", "-a").replace("e: {value: 0.7}", "e: {value: 0.5}")
    with pytest.raises(SimulationError, match=r"time stands still at .* transitions 1 of .* add a mode"):
        run(ball, NO_INPUTS, np.array([0.0, 10.0]))


def test_a_block_whose_speed_drifted_by_rounding_while_it_stuck_slips_on() -> None:
    file = file_of(BELT)
    numbers = {"mass": 0.6556788763407367, "k": 97.03651411481773, "friction": 2.5752541591892433,
               "stick": 1.3336996094625946, "falls": 0.2513980648203717, "belt": 0.07018844572727007}  # fmt: skip
    times = np.linspace(0.0, 3.0, 301)
    shown = machine_of(file).run(numbers, {"x": 0.0, "v": 0.0}, NO_INPUTS, times)
    assert np.min(shown.outputs[times > 0.6, 2]) < -1e-3  # it sticks until 0.580 s
    assert np.max(shown.outputs[:, 2]) < 1e-12


def test_what_sticks_comes_apart_where_one_of_both_jumps() -> None:
    """A body that carries another one rebounds from a wall: the other one slides on, until both are as fast again."""
    text = """
plant: equations
states: {x: {unit: m}, v: {unit: m/s, start: 1}, w: {unit: m/s, start: 1}}
parameters: {wall: {value: 0.1, unit: m}, e: {value: 0.5}, rub: {value: 1, unit: m/s^2}}
derivatives: {x: v, v: -rub*sign(v - w), w: rub*sign(v - w)}
transitions: [{when: x > wall, cases: [{set: {x: wall, v: -e*v}}]}]
outputs: {lower: {value: v, unit: m/s}, upper: {value: w, unit: m/s}}
"""
    shown = run(text, NO_INPUTS, np.array([0.0, 0.09, 0.5, 0.95]))
    assert shown.outputs == pytest.approx(np.array([[1.0, 1.0], [1.0, 1.0], [-0.1, 0.6], [0.25, 0.25]]), abs=1e-12)


def test_what_sticks_to_a_belt_slips_where_the_belt_becomes_faster() -> None:
    text = """
plant: equations
states: {v: {unit: m/s}}
inputs: {belt: {unit: m/s, between: held}}
parameters: {rub: {value: 2, unit: m/s^2}}
derivatives: {v: -rub*sign(v - belt)}
outputs: {speed: {value: v, unit: m/s}}
"""
    shown = run(text, held([0.0, 1.0], [0.1, 0.3]), np.array([0.02, 0.9, 1.05, 1.2]))
    assert shown.outputs[:, 0] == pytest.approx([0.04, 0.1, 0.2, 0.3], abs=1e-12)


def test_three_bodies_in_a_row_stick_to_each_other_and_to_the_floor() -> None:
    """Five frictions: a pull of 3 N moves the first body and the second one on it; the third rests."""
    text = """
plant: equations
states: {v: {unit: m/s}, w: {unit: m/s}, u: {unit: m/s}}
inputs: {force: {unit: N, between: held}}
parameters:
  {m: {value: 1, unit: kg}, floor: {value: 1, unit: N}, rub: {value: 1.5, unit: N}, slip: {value: 0.5, unit: N}}
derivatives:
  v: (force - floor*sign(v) - rub*sign(v - w))/m
  w: (rub*sign(v - w) - 0.2*floor*sign(w) - slip*sign(w - u))/m
  u: (slip*sign(w - u) - floor*sign(u))/m
outputs: {first: {value: v, unit: m/s}, second: {value: w, unit: m/s}, third: {value: u, unit: m/s}}
"""
    shown = run(text, held([0.0, 1.0, 2.0], [0.0, 3.0, 0.0]), np.array([1.0, 2.0, 5.0]))
    rate = 0.5 * (3.0 - 1.0 - 0.2 - 0.5)
    assert shown.outputs == pytest.approx(np.array([[0.0, 0.0, 0.0], [rate, rate, 0.0], [0.0, 0.0, 0.0]]), abs=1e-9)


def test_derivatives_by_when_an_input_changes_and_by_its_level() -> None:
    """The plunger is lifted from its seat by a pulse, falls back and bounces: each edge moves all of it."""
    edges, times = np.array([0.0, 0.2001, 0.2057]), np.arange(0.0, 0.4, 1.7e-3)
    file = file_of(PLUNGER)

    def shown(at: Array, pulse: float = 30.0, moves: Array | None = None) -> Shown:
        inputs = held(at.tolist(), [0.0, pulse, 0.0])
        directions = [] if moves is None else [{}] * moves.shape[2]
        return machine_of(file).run(*numbers_of(file), inputs, times, directions, tolerance=FINE, moves=moves)

    moves = np.zeros((3, 2, 3))
    moves[1, 0, 0] = moves[2, 0, 1] = moves[1, 1, 2] = 1.0
    found = shown(edges, moves=moves)
    assert [own.name for own in found.events].count("lifted") == 1
    for place in range(3):
        by, more = (1e-7 * np.eye(3)[place + 1], 0.0) if place < 2 else (np.zeros(3), 1e-4)
        above, below = (shown(edges + sign * by, 30.0 + sign * more).outputs[:, 0] for sign in (1.0, -1.0))
        expected = (above - below) / (2.0 * (more or 1e-7))
        assert np.max(np.abs(expected)) > 1e-3
        np.testing.assert_allclose(found.slopes[:, 0, place], expected, atol=1e-6 * np.max(np.abs(expected)))


TRAIN = """
plant: equations
states: {a: {unit: rad}, va: {unit: rad/s}, b: {unit: rad}, vb: {unit: rad/s}}
inputs: {torque: {unit: N*m, between: held}}
parameters: {ja: {value: 2.0e-3, unit: kg*m^2}, jb: {value: 4.0e-3, unit: kg*m^2}, shaft: {value: 8, unit: N*m/rad},
             drag: {value: 8.0e-4, unit: N*m*s^2/rad^2}, hardening: {value: 900, unit: N*m/rad^3}}
derivatives:
  a: va
  va: (torque - shaft*(a - b) - hardening*(a - b)**3)/ja
  b: vb
  vb: (shaft*(a - b) + hardening*(a - b)**3 - drag*vb*abs(vb))/jb
outputs: {angle: {value: b, unit: rad}}
"""


@pytest.mark.parametrize("name", ["drag", "hardening"])
def test_a_derivative_that_begins_with_a_high_power_of_time(name: str) -> None:
    """Two inertias from rest: the shaft twists by t², the second one turns by t³, and what brakes it grows by t⁶."""
    file, times = file_of(TRAIN), np.linspace(0.0, 0.5, 101)
    inputs, (numbers, start) = held([0.0, 0.2], [0.5, -0.3]), numbers_of(file)

    def angle(by: float) -> Array:
        changed = {**numbers, name: numbers[name] * (1.0 + by)}
        return machine_of(file).run(changed, start, inputs, times, tolerance=FINE).outputs[:, 0]

    found = machine_of(file).run(numbers, start, inputs, times, [{name: numbers[name]}], tolerance=FINE).slopes[:, 0, 0]
    expected = (angle(1e-4) - angle(-1e-4)) / 2e-4
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.max(np.abs(expected)))
