"""The truth plants of other forms, against SciPy, their energy and other steps; recordings are what was asked for.

Plant (a) is held against the core, which shares no code with it, in model/test_against_plants.py.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from model.random_valves import RANGES
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from scipy.integrate import solve_ivp

from .common import FloatArray, Plant, PlantRun
from .declared import DeclaredPlant
from .mismatched import MismatchedPlant
from .recording import Recorder, holdout_profile, record, single_opening, train_profile, write_bag
from .reluctance import Build, ReluctancePlant
from .tolerances import SHEET_VALVE, declared_tolerances, deviated, drawn_deviations

pytestmark = pytest.mark.long

Effects = Mapping[str, Mapping[str, float]]
STROKE_END = 0.060
SAMPLES: FloatArray = np.arange(0.0, STROKE_END, 50e-6)


def one_stroke(plant: Plant, volts: float = 9.0, samples: FloatArray = SAMPLES) -> PlantRun:
    """A command at 0, a release at 25 ms."""
    return plant.simulate(np.array([0.0, 0.025]), np.array([volts, 0.0]), samples)


# --- plant (a) within the tolerances of a data sheet -----------------------------------------------------------------


def test_declared_tolerances_are_those_of_what_is_drawn() -> None:
    random = np.random.default_rng(1)
    drawn = [deviated(SHEET_VALVE, drawn_deviations(random)) for _ in range(4000)]
    declared = declared_tolerances(SHEET_VALVE)
    for name in ("pilot_mass", "spring_rate", "spring_preload", "coil_time_constant", "seat_load", "stroke"):
        values = np.array([float(np.asarray(valve[name])) for valve in drawn])
        assert values.std() == pytest.approx(declared[name], rel=0.05)
        assert values.mean() == pytest.approx(SHEET_VALVE[name], abs=0.1 * values.std())
    pilot = np.array([float(np.asarray(valve["pilot_mass"])) for valve in drawn])
    main = np.array([float(np.asarray(valve["moving_mass"])) for valve in drawn]) - pilot
    assert main.std() == pytest.approx(declared["moving_mass"], rel=0.05) == pytest.approx(0.005 * 0.025, rel=0.05)
    assert abs(np.corrcoef(pilot, main)[0, 1]) < 0.05
    powers = np.linspace(0.0, 1.23e-3, 5)[:, np.newaxis] ** np.arange(4)
    forces = np.array([powers @ np.asarray(valve["attraction_polynomial"]) for valve in drawn])
    covariance = np.reshape(declared["attraction_covariance"], (4, 4))
    np.testing.assert_allclose(
        np.cov(forces.T), powers @ covariance @ powers.T, atol=0.06 * np.var(forces, axis=0).max()
    )
    # 1.5 % of the force, and three shapes of 1 % of the mean force, which all end at 1 at the stop.
    force = powers @ np.asarray(SHEET_VALVE["attraction_polynomial"])
    mean = np.mean(
        np.linspace(0.0, 1.23e-3, 10001)[:, np.newaxis] ** np.arange(4) @ SHEET_VALVE["attraction_polynomial"]
    )
    np.testing.assert_allclose(forces.std(axis=0)[-1], np.hypot(0.015 * force[-1], 0.01 * mean * 3**0.5), rtol=0.05)


# --- plant (b) -------------------------------------------------------------------------------------------------------


def test_mismatched_plant_opens_like_the_paper() -> None:
    run = one_stroke(MismatchedPlant())
    assert run.first("picked_up") == pytest.approx(5.3e-3, abs=2e-6)
    assert run.first("opened") == pytest.approx(9.9e-3, abs=2e-6)
    assert run.pilot_position.max() == pytest.approx(1.23e-3, abs=5e-6)
    assert run.main_position.max() == pytest.approx(0.97e-3, abs=5e-6)
    assert run.pilot_position[-1] == pytest.approx(0.0, abs=2e-6)


EVENTFUL = {
    "stiction": {"force": 0.1, "breakaway": 0.1, "stribeck_velocity": 0.02},
    "squeeze_film": {"coefficient": 20.0, "film_thickness": 20e-6},
    "stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.3},
    "pressure_force": {"force": 0.8, "equalisation_time": 4e-3},
}


@pytest.mark.parametrize("effects", [{}, EVENTFUL])
@pytest.mark.parametrize("plant", [MismatchedPlant, ReluctancePlant])
def test_halving_the_step_of_a_plant_of_another_form_changes_nothing(
    plant: Callable[..., Plant], effects: Effects
) -> None:
    profile, times = holdout_profile(), np.arange(6600) / 20e3
    coarse = plant(effects).simulate(profile.times, profile.volts, times)
    fine = plant(effects, step=0.5e-6).simulate(profile.times, profile.volts, times)
    np.testing.assert_allclose(coarse.pilot_position, fine.pilot_position, rtol=0.0, atol=5e-9)
    for kind in ("picked_up", "opened", "main_seated", "seated"):
        assert coarse.first(kind) == pytest.approx(fine.first(kind), abs=1e-8)


# --- plant (c) -------------------------------------------------------------------------------------------------------

WITHOUT_FRICTION = Build(friction=0.0, breakaway=0.0, pressure=0.0)
IDEAL = WITHOUT_FRICTION._replace(eddy_time_constant=0.0, sensor_cutoff=0.0)


def test_the_reluctance_plant_agrees_with_scipy_up_to_the_pick_up() -> None:
    build = IDEAL

    def rates(t: float, y: NDArray[np.float64]) -> list[float]:
        pull = (1.0 - np.exp(-t / 1.2e-3)) ** 2 * build.reluctance_force / (build.reluctance_gap - y[0]) ** 2
        return [y[1], (pull - build.return_force - build.pilot_damping * y[1]) / build.pilot_mass]

    def at_gap(t: float, y: NDArray[np.float64]) -> float:
        return float(y[0] - build.pilot_gap)

    at_gap.terminal = True  # type: ignore[attr-defined]
    share = np.sqrt(build.return_force * build.reluctance_gap**2 / build.reluctance_force)
    start = -1.2e-3 * np.log(1.0 - share)
    found: Any = solve_ivp(rates, (start, 0.02), [0.0, 0.0], "DOP853", events=at_gap, rtol=1e-12, atol=1e-15)
    run = one_stroke(ReluctancePlant(build=build))
    assert run.first("unseated") == pytest.approx(start, abs=1e-9)
    assert run.first("picked_up") == pytest.approx(found.t[-1], abs=1e-9)


def test_the_reluctance_plant_loses_no_energy_but_in_its_dampers() -> None:
    build = WITHOUT_FRICTION._replace(sensor_cutoff=0.0)
    fine: FloatArray = np.arange(0.0, 0.012, 1e-6)
    run = one_stroke(ReluctancePlant(build=build), samples=fine)
    flux = np.zeros(fine.size)
    current = run.coil_current / 0.9
    for k in range(
        fine.size - 1
    ):  # the eddy-current pole once more, exact for a pole that is constant in a microsecond
        pole = build.eddy_time_constant * build.reluctance_gap / (build.reluctance_gap - run.pilot_position[k])
        middle = 0.5 * (current[k] + current[k + 1])
        flux[k + 1] = middle + (flux[k] - middle) * np.exp(-1e-6 / pole)
    x, v = run.pilot_position, run.pilot_velocity
    picked_up, opened = run.first("picked_up"), run.first("opened")
    pull = flux**2 * build.reluctance_force / (build.reluctance_gap - x) ** 2
    spring = build.spring_preload + build.spring_rate * x
    for since, until, mass, force in (
        (0.0, picked_up, build.pilot_mass, pull - build.return_force - build.pilot_damping * v),
        (
            picked_up,
            opened,
            build.pilot_mass + build.main_mass,
            pull - build.return_force - spring - (build.pilot_damping + build.main_damping) * v,
        ),
    ):
        inside = np.flatnonzero((fine > since) & (fine < until))
        kinetic = 0.5 * mass * (v[inside[-1]] ** 2 - v[inside[0]] ** 2)
        work = np.sum(0.5 * (force[inside[1:]] * v[inside[1:]] + force[inside[:-1]] * v[inside[:-1]])) * 1e-6
        assert work == pytest.approx(kinetic, rel=1e-5)


def test_pick_up_keeps_the_momentum_of_the_reluctance_plant() -> None:
    build = IDEAL
    fine: FloatArray = np.arange(0.0, 0.01, 1e-7)
    run = one_stroke(ReluctancePlant(build=build), samples=fine)
    met = next(event for event in run.events if event.kind == "picked_up")
    after = run.pilot_velocity[np.searchsorted(fine, met.time)]
    together = build.pilot_mass + build.main_mass
    assert together * after == pytest.approx(build.pilot_mass * met.velocity, rel=1e-4)


@pytest.mark.parametrize("plant", [MismatchedPlant, ReluctancePlant])
def test_every_effect_of_a_plant_of_another_form_shows(plant: Callable[..., Plant]) -> None:
    values = {name: {key: 0.4 * low + 0.6 * high for key, (low, high) in own.items()} for name, own in RANGES.items()}
    plain = one_stroke(plant()).pilot_position
    moved = {
        name: np.abs(one_stroke(plant({name: own})).pilot_position - plain).max()
        for name, own in values.items()
        if name != "pickup_impact"
    }
    assert {name: size for name, size in moved.items() if size <= 0.5e-6} == {}


# --- recordings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "plant",
    [
        pytest.param(DeclaredPlant(), id="declared"),
        pytest.param(MismatchedPlant(), id="mismatched"),
        pytest.param(ReluctancePlant(), id="reluctance"),
    ],
)
def test_profiles_are_what_they_say(plant: Plant) -> None:
    train = record(plant, train_profile(), Recorder(), 1).truth
    opened = [event.time for event in train.events if event.kind == "opened"]
    assert np.count_nonzero(np.diff(opened, prepend=-1.0) > 0.03) == 8
    assert train.pilot_position[-1] == pytest.approx(0.0, abs=1e-6)
    holdout = record(plant, holdout_profile(), Recorder(), 1).truth
    lifts = np.split(holdout.main_position, np.searchsorted(holdout.time, [0.06, 0.125, 0.165, 0.22, 0.255]))
    partial = [0.05e-3 < lift.max() < 0.9e-3 for lift in lifts]
    assert partial == [False, False, True, False, True, False]
    assert record(plant, single_opening(), Recorder(), 1).truth.pilot_position[-1] == pytest.approx(1.23e-3, abs=5e-6)


def test_noise_is_what_was_asked_for() -> None:
    recorder = Recorder(position_noise=2e-6, colour=0.7, command_jitter=50e-6, clock_offset=1e-3, with_current=True)
    made, again = (record(DeclaredPlant(), train_profile(), recorder, 3) for _ in range(2))
    np.testing.assert_array_equal(made.pilot_position, again.pilot_position)
    noise = made.pilot_position - made.truth.pilot_position
    assert noise.std() == pytest.approx(2e-6, rel=0.1)
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] == pytest.approx(0.7, abs=0.05)
    shift = made.command_times - made.true_command_times - 1e-3
    assert 20e-6 < shift.std() < 90e-6
    assert made.coil_current is not None
    assert (made.coil_current - made.truth.coil_current).std() == pytest.approx(1e-3, rel=0.05)
    other = record(DeclaredPlant(), train_profile(), recorder, 4)
    assert np.abs(other.pilot_position - made.pilot_position).max() > 1e-6


def test_the_bag_holds_what_was_measured(tmp_path: Path) -> None:
    recorder = Recorder(command_jitter=50e-6, with_current=True)
    made = record(DeclaredPlant(), single_opening(), recorder, 5)
    bag = write_bag(made, tmp_path / "bag", "/tank_1/valve")
    read: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([bag]) as reader:
        for connection, stamp, raw in reader.messages():
            read.setdefault(connection.topic, []).append((stamp, reader.deserialize(raw, connection.msgtype)))
    start = read["/tank_1/valve/measured/joint_states"][0][0]
    [(stamp, message)] = read["/tank_1/valve/coil_voltage"]
    assert message.data == 9.0
    assert (stamp - start) * 1e-9 == pytest.approx(made.command_times[0], abs=1e-9)
    states = read["/tank_1/valve/measured/joint_states"]
    positions = np.array([state.position for _, state in states])
    np.testing.assert_array_equal(positions, np.column_stack((made.pilot_position, made.main_position)))
    assert states[7][1].name == ["pilot_plunger", "main_plunger"]
    header = states[7][1].header.stamp
    assert header.sec * 10**9 + header.nanosec == states[7][0] == start + 7 * 50_000
    currents = np.array([current.data for _, current in read["/tank_1/valve/measured/coil_current"]])
    np.testing.assert_array_equal(currents, made.coil_current)
