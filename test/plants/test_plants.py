"""The truth plants against the paper's numbers, against scipy at 1e-12, and against themselves with other steps."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from scipy.integrate import solve_ivp

from . import declared, mismatched, reluctance
from .common import CATALOGUE, FloatArray, Plant, PlantRun
from .declared import DeclaredPlant
from .mismatched import MismatchedPlant
from .recording import Recorder, holdout_profile, record, single_opening, train_bags, train_profile, write_bag
from .reluctance import Build, ReluctancePlant
from .tolerances import NAMES, SHEET_VALVE, declared_tolerances, deviated, drawn_deviations

Effects = Mapping[str, Mapping[str, float]]
LOW_POLYNOMIAL = (1.5, 17.096e3, -30.931e6, 24.026e9)
STROKE_END = 0.060
SAMPLES: FloatArray = np.arange(0.0, STROKE_END, 50e-6)

EFFECT_VALUES: dict[str, dict[str, float]] = {
    "coulomb_friction": {"force": 0.1},
    "stiction": {"force": 0.1, "breakaway": 0.1, "stribeck_velocity": 0.02},
    "asymmetric_friction": {
        "force_opening": 0.1,
        "force_closing": 0.2,
        "damping_opening": 0.5,
        "damping_closing": 1.0,
    },
    "constant_force": {"force": -0.1},
    "rest_attraction": {"force": 0.1},
    "drive_gain": {"gain": 1.03},
    "coil_lag": {"time_constant": 0.2e-3},
    "eddy_lag": {"time_constant": 0.3e-3},
    "coil_heating": {"temperature_rate": 400.0, "cooling_time_constant": 0.5},
    "magnetic_saturation": {"current": 1.5},
    "residual_magnetism": {"current": 0.2},
    "pressure_force": {"force": 0.8, "equalisation_time": 4e-3},
    "quadratic_drag": {"coefficient": 8.0},
    "squeeze_film": {"coefficient": 20.0, "film_thickness": 20e-6},
    "stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.3},
    "pickup_impact": {"velocity_ratio": 0.85},
    "spring_hardening": {"coefficient": 3e8},
    "stroke_offset": {"offset": 5e-6},
    "gap_offset": {"offset": -5e-6},
    "sensor_delay": {"delay": 70e-6},
    "sensor_bandwidth": {"cutoff_frequency": 2000.0},
    "sensor_gain": {"gain": 1.001},
    "force_bump": {"amplitude": 0.4, "centre": 0.7e-3, "width": 0.1e-3},
    "force_ripple": {"amplitude": 0.3, "wavelength": 0.2e-3, "phase": 0.4},
    "vibration": {"amplitude": 0.1, "frequency": 180.0, "phase": 0.3},
    "damping_drift": {"rate": 30.0},
    "damping_bump": {"amplitude": 4.0, "centre": 0.6e-3, "width": 0.2e-3},
}


def chosen(*names: str) -> dict[str, dict[str, float]]:
    return {name: EFFECT_VALUES[name] for name in names}


def one_stroke(plant: Plant, volts: float = 9.0, samples: FloatArray = SAMPLES) -> PlantRun:
    """A command at 0, a release at 25 ms."""
    return plant.simulate(np.array([0.0, 0.025]), np.array([volts, 0.0]), samples)


# --- plant (a): published numbers ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "picked_up", "opened"),
    [
        ({}, 5.300e-3, 9.900e-3),
        ({"attraction_polynomial": LOW_POLYNOMIAL, "coil_time_constant": 0.0}, 5.3205e-3, 10.9214e-3),
        (
            {"attraction_polynomial": LOW_POLYNOMIAL, "coil_time_constant": 0.0, "main_damping": 0.0},
            5.3205e-3,
            10.6537e-3,
        ),
    ],
)
def test_event_times_at_9_volts(parameters: Mapping[str, float], picked_up: float, opened: float) -> None:
    run = one_stroke(DeclaredPlant(parameters=parameters))
    assert run.first("picked_up") == pytest.approx(picked_up, abs=1e-7)
    assert run.first("opened") == pytest.approx(opened, abs=1e-7)


def test_the_valve_as_printed_never_opens() -> None:
    polynomial = (0.0, *LOW_POLYNOMIAL[1:])
    run = one_stroke(DeclaredPlant(parameters={"attraction_polynomial": polynomial, "coil_time_constant": 0.0}))
    assert run.events == ()
    assert not run.pilot_position.any()


# --- plant (a) against scipy -----------------------------------------------------------------------------------------


class Reference:
    """One opening and one closing without rebounds or sticking, phase after phase by DOP853 with terminal events."""

    def __init__(self, effects: Effects) -> None:
        self.effects = effects
        self.gap = 0.26e-3 + self.of("gap_offset", "offset")
        self.stroke = 1.23e-3 + self.of("stroke_offset", "offset")
        self.time, self.state = 0.0, np.zeros(5)  # x, v, u, u behind the eddy currents, temperature
        self.opened_at = 0.0
        self.events: list[float] = []
        self.times: list[NDArray[np.float64]] = []
        self.positions: list[NDArray[np.float64]] = []

    def of(self, effect: str, parameter: str, off: float = 0.0) -> float:
        return self.effects.get(effect, {}).get(parameter, off)

    def volts(self, t: float) -> float:
        return 9.0 if t < 0.025 else 0.0

    def pull(self, y: NDArray[np.float64]) -> float:
        u = abs(y[3] if "eddy_lag" in self.effects else y[2])
        if self.time >= 0.025:  # released with u = 1; while u rises the floor is below it
            u = max(u, self.of("residual_magnetism", "current"))
        saturated = 1.0
        if knee := self.of("magnetic_saturation", "current"):
            saturated = (1 + 1 / knee**2) / (1 + (u / knee) ** 2)
        polynomial = np.array([3.0336 + self.of("rest_attraction", "force"), *LOW_POLYNOMIAL[1:]])
        return float(u**2 * saturated * polynomial @ y[0] ** np.arange(4))

    def others(self, t: float, x: float, v: float) -> float:
        force = self.of("constant_force", "force") - self.of("quadratic_drag", "coefficient") * v * abs(v)
        film = self.of("squeeze_film", "film_thickness", 1.0)
        squeezed = (film / (x + film)) ** 3 + (film / (self.stroke - x + film)) ** 3
        force -= self.of("squeeze_film", "coefficient") * v * squeezed
        bump, ripple, shake = "force_bump", "force_ripple", "vibration"
        width = self.of(bump, "width", 1.0)
        force += self.of(bump, "amplitude") * np.exp(-(((x - self.of(bump, "centre")) / width) ** 2))
        turns = x / self.of(ripple, "wavelength", 1.0)
        force += self.of(ripple, "amplitude") * np.sin(2 * np.pi * turns + self.of(ripple, "phase"))
        turns = t * self.of(shake, "frequency")
        force += self.of(shake, "amplitude") * np.sin(2 * np.pi * turns + self.of(shake, "phase"))
        bump, width = "damping_bump", self.of("damping_bump", "width", 1.0)
        local = self.of(bump, "amplitude") * np.exp(-(((x - self.of(bump, "centre")) / width) ** 2))
        return float(force - v * (local + self.of("damping_drift", "rate") * t))

    def net(self, phase: int, t: float, y: NDArray[np.float64]) -> float:
        x, v = y[0], y[1]
        force = self.pull(y) + self.others(t, x, v)
        if phase == 1:
            return float(force - 1.0 * v)
        decay = np.exp(-(t - self.opened_at) / self.of("pressure_force", "equalisation_time", 1.0))
        spring = 2.524 + 428.0 * x + self.of("spring_hardening", "coefficient") * x**3
        return float(force - spring - 4.0 * v - self.of("pressure_force", "force") * decay)

    def friction(self, v: float, direction: int) -> float:
        way = "opening" if direction > 0 else "closing"
        level = self.of("coulomb_friction", "force") + self.of("stiction", "force")
        speed = self.of("stiction", "stribeck_velocity", 1.0)
        level += self.of("stiction", "breakaway") * np.exp(-((v / speed) ** 2))
        level += self.of("asymmetric_friction", f"force_{way}")
        return float(-direction * level - self.of("asymmetric_friction", f"damping_{way}") * v)

    def magnetics(self, t: float, y: NDArray[np.float64]) -> list[float]:
        ratio = 1 + 0.00393 * y[4]
        target = self.of("drive_gain", "gain", 1.0) * self.volts(t) / 9.0 / ratio
        lag = (0.9934e-3 + self.of("coil_lag", "time_constant")) / ratio
        cooling = self.of("coil_heating", "cooling_time_constant", np.inf)
        heat = self.of("coil_heating", "temperature_rate") * y[2] ** 2 - y[4] / cooling
        return [(target - y[2]) / lag, (y[2] - y[3]) / self.of("eddy_lag", "time_constant", 1.0), heat]

    def integrate(self, phase: int, direction: int, until: Callable[..., float], latest: float = STROKE_END) -> bool:
        """Move (direction 1 or -1) or rest (0) until the event; whether it came before `latest`."""
        mass = 0.109 if phase == 1 else 0.134

        def rates(t: float, y: NDArray[np.float64]) -> list[float]:
            if direction == 0:
                return [0.0, 0.0, *self.magnetics(t, y)]
            return [y[1], (self.net(phase, t, y) + self.friction(y[1], direction)) / mass, *self.magnetics(t, y)]

        until.terminal = True  # type: ignore[attr-defined]
        found: Any = solve_ivp(
            rates, (self.time, latest), self.state, "DOP853", events=until, dense_output=True, rtol=1e-12, atol=1e-15
        )
        inside = (self.time <= SAMPLES) & (found.t[-1] > SAMPLES)
        self.times.append(SAMPLES[inside])
        if inside.any():
            self.positions.append(found.sol(SAMPLES[inside])[0])
        self.time, self.state = found.t[-1], found.y[:, -1].copy()
        return bool(found.status == 1)

    def rest_at(self, x: float) -> None:
        self.state[:2] = x, 0.0

    def wait(self, phase: int, direction: int) -> None:
        """Rest until the net force exceeds what friction holds, in this direction."""
        held = abs(self.friction(0.0, direction))
        if direction > 0 and self.state[0] == 0.0:
            held = max(held, 1e-9)  # N, which do not lift the pilot off its seat
        if direction * self.net(phase, self.time, self.state) <= held:
            assert self.integrate(0, 0, lambda t, y: direction * self.net(phase, t, y) - held)
        self.events.append(self.time)

    def run(self) -> None:
        self.wait(1, 1)
        self.opened_at = self.time
        assert self.integrate(1, 1, lambda t, y: y[0] - self.gap)
        self.events.append(self.time)
        self.state[1] *= self.of("pickup_impact", "velocity_ratio", 1.0)
        assert self.integrate(2, 1, lambda t, y: y[0] - self.stroke)
        self.events.append(self.time)
        self.rest_at(self.stroke)
        self.integrate(0, 0, lambda t, y: 1.0, 0.025)
        self.wait(2, -1)
        assert self.integrate(2, -1, lambda t, y: y[0] - self.gap)
        self.events.append(self.time)
        if self.integrate(1, -1, lambda t, y: y[0]):
            self.events.append(self.time)


@pytest.mark.parametrize(
    "effects",
    [
        {},
        chosen("drive_gain", "coil_lag", "eddy_lag", "coil_heating", "magnetic_saturation"),
        chosen("residual_magnetism", "pickup_impact"),
        chosen("constant_force", "rest_attraction", "pressure_force", "spring_hardening"),
        chosen("quadratic_drag", "squeeze_film", "stroke_offset", "gap_offset"),
        chosen("coulomb_friction", "stiction", "asymmetric_friction"),
        chosen("force_bump", "force_ripple", "vibration", "damping_drift", "damping_bump"),
    ],
    ids=lambda effects: "+".join(effects) or "none",
)
def test_declared_plant_agrees_with_scipy(effects: Effects) -> None:
    reference = Reference(effects)
    reference.run()
    run = one_stroke(DeclaredPlant(effects))
    kinds = ("unseated", "picked_up", "opened", "released", "main_seated", "seated")
    times = [run.first(kind) for kind in kinds[: len(reference.events)]]
    np.testing.assert_allclose(times, reference.events, rtol=0.0, atol=1e-10)
    compared = np.searchsorted(SAMPLES, np.concatenate(reference.times))
    assert compared.size > 0.5 * SAMPLES.size
    np.testing.assert_allclose(run.pilot_position[compared], np.concatenate(reference.positions), rtol=0.0, atol=1e-11)


# --- plant (a): one convention a test --------------------------------------------------------------------------------


def test_halving_the_step_of_the_declared_plant_changes_nothing() -> None:
    effects = chosen(
        "stiction",
        "stop_bounce",
        "pressure_force",
        "coil_heating",
        "residual_magnetism",
        "eddy_lag",
        "sensor_bandwidth",
    )
    profile, times = train_profile(), np.arange(10000) / 20e3
    coarse = DeclaredPlant(effects).simulate(profile.times, profile.volts, times)
    fine = DeclaredPlant(effects, step=1e-6).simulate(profile.times, profile.volts, times)
    assert [event.kind for event in coarse.events] == [event.kind for event in fine.events]
    assert len(coarse.events) > 60
    np.testing.assert_allclose(
        [event.time for event in coarse.events], [event.time for event in fine.events], rtol=0.0, atol=1e-9
    )
    np.testing.assert_allclose(coarse.pilot_position, fine.pilot_position, rtol=0.0, atol=1e-10)


PLANTS: dict[type[Plant], tuple[str, ...]] = {
    DeclaredPlant: (*CATALOGUE, *declared.UNCATALOGUED),
    MismatchedPlant: tuple(mismatched.EFFECTS),
    ReluctancePlant: tuple(reluctance.EFFECTS),
}
"""Each with the effects that it has."""


@pytest.mark.parametrize(
    "plant", [plant if plant is DeclaredPlant else pytest.param(plant, marks=pytest.mark.long) for plant in PLANTS]
)
def test_every_effect_of_a_plant_shows(plant: Callable[..., Plant]) -> None:
    plain = one_stroke(plant()).pilot_position
    moved = {name: np.abs(one_stroke(plant(chosen(name))).pilot_position - plain).max() for name in PLANTS[plant]}  # type: ignore[index]
    assert {name: size for name, size in moved.items() if size <= 0.5e-6} == {}


def test_friction_holds_the_pilot_in_mid_gap_until_the_pull_exceeds_it() -> None:
    plant = DeclaredPlant({"coulomb_friction": {"force": 0.8}})
    command_times, volts = np.array([0.0, 0.0025, 0.0300]), np.array([9.0, 0.0, 9.0])
    run = plant.simulate(command_times, volts, SAMPLES)
    stuck = next(event for event in run.events if event.kind == "stuck")
    assert 0.0 < stuck.position < 0.26e-3
    assert run.pilot_position[(run.time > stuck.time) & (run.time < 0.030)] == pytest.approx(stuck.position, abs=1e-15)
    pull = np.polynomial.polynomial.polyval(stuck.position, (3.0336, *LOW_POLYNOMIAL[1:]))
    freed = 0.030 - 0.9934e-3 * np.log(1.0 - np.sqrt(0.8 / pull))
    assert run.first("freed") == pytest.approx(freed, abs=1e-10)


def test_a_low_voltage_holds_the_pilot_at_the_gap() -> None:
    plant = DeclaredPlant(parameters={"seat_load": 0.3, "pickup_velocity_ratio": 0.5})
    run = plant.simulate(np.array([0.0, 0.5]), np.array([4.5, 9.0]), np.array([0.49, 0.59]))
    held = next(event for event in run.events if event.kind == "held_at_gap")
    assert abs(held.velocity) < 1e-3
    assert run.pilot_position[0] == 0.26e-3
    lifting = np.sqrt((2.524 + 428.0 * 0.26e-3) / _pull_at_gap())
    lifted = 0.5 - 0.9934e-3 * np.log((1.0 - lifting) / (1.0 - 0.5))
    assert run.first("lifted_from_gap") == pytest.approx(lifted, abs=1e-10)
    assert run.pilot_position[1] == 1.23e-3
    run = plant.simulate(np.array([0.0, 0.5]), np.array([4.5, 0.0]), np.array([0.6]))
    dropped = 0.5 - 0.9934e-3 * np.log(np.sqrt(0.3 / _pull_at_gap()) / 0.5)
    assert run.first("dropped_from_gap") == pytest.approx(dropped, abs=1e-10)
    assert run.events[-1].kind == "seated"


def _pull_at_gap() -> float:
    return float(np.polynomial.polynomial.polyval(0.26e-3, (3.0336, *LOW_POLYNOMIAL[1:])))


def test_rebounds_scale_the_speed_and_end_below_5_mm_per_s() -> None:
    plant = DeclaredPlant({"stop_bounce": {"restitution_stop": 0.4, "restitution_seat": 0.0}})
    events = one_stroke(plant).events
    speeds = [event.velocity for event in events if event.kind == "stop_rebound"]
    assert len(speeds) > 2
    assert min(speeds) >= 5e-3
    assert next(event for event in events if event.kind == "opened").velocity < 5e-3
    first = next(event.time for event in events if event.kind == "stop_rebound")
    shortly = one_stroke(plant, samples=np.array([first + 1e-9]))
    assert shortly.pilot_velocity[0] == pytest.approx(-0.4 * speeds[0], abs=1e-6)


def test_pressure_is_whole_again_after_reseating_on_a_loaded_seat() -> None:
    plant = DeclaredPlant(chosen("pressure_force"), {"seat_load": 0.2})
    run = plant.simulate(np.array([0.0, 0.025, 0.1]), np.array([9.0, 0.0, 9.0]), np.array([0.13]))
    opened = [event.time for event in run.events if event.kind == "opened"]
    assert opened[1] - opened[0] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize(("coil_time_constant", "is_lifted"), [(0.9934e-3, False), (2e-3, True)])
def test_without_seat_load_a_current_that_is_left_lifts_the_pilot_at_once_and_the_pressure_is_gone(
    coil_time_constant: float, is_lifted: bool
) -> None:
    plant = DeclaredPlant(chosen("pressure_force"), {"coil_time_constant": coil_time_constant})
    run = plant.simulate(np.array([0.0, 0.025, 0.1]), np.array([9.0, 0.0, 9.0]), np.array([0.13]))
    opened = [event.time for event in run.events if event.kind == "opened"]
    unseated = [event.time for event in run.events if event.kind == "unseated"]
    assert (opened[1] - opened[0] < 0.1 - 10e-6) is is_lifted
    assert (run.first("seated") == unseated[1]) is is_lifted


def test_heating_without_lag_has_its_closed_form() -> None:
    plant = DeclaredPlant(
        {"coil_heating": {"temperature_rate": 400.0, "cooling_time_constant": 1e12}}, {"coil_time_constant": 0.0}
    )
    run = one_stroke(plant)
    hot = (1.0 + 3.0 * 0.00393 * 400.0 * SAMPLES) ** (1.0 / 3.0)
    np.testing.assert_allclose(run.coil_current[SAMPLES < 0.025], 0.9 / hot[SAMPLES < 0.025], rtol=1e-9)
    assert run.coil_current[SAMPLES >= 0.025].max() == 0.0


def test_eddy_currents_and_the_position_sensor_leave_the_current_alone() -> None:
    plain = one_stroke(DeclaredPlant())
    changed = one_stroke(DeclaredPlant(chosen("eddy_lag", "residual_magnetism", "sensor_delay", "sensor_bandwidth")))
    np.testing.assert_allclose(plain.coil_current, changed.coil_current, rtol=0.0, atol=1e-13)


def test_sensor_delay_shifts_both_joints() -> None:
    delay = EFFECT_VALUES["sensor_delay"]["delay"]
    late = one_stroke(DeclaredPlant(chosen("sensor_delay")), samples=SAMPLES + delay)
    plain = one_stroke(DeclaredPlant())
    np.testing.assert_allclose(late.pilot_position, plain.pilot_position, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(late.main_position, plain.main_position, rtol=0.0, atol=1e-12)


def test_sensor_bandwidth_is_a_first_order_lag_of_both_joints() -> None:
    samples: FloatArray = np.arange(0.0, 0.012, 1e-6)
    plain = one_stroke(DeclaredPlant(), samples=samples)
    slow = one_stroke(DeclaredPlant(chosen("sensor_bandwidth")), samples=samples)
    rate = 2.0 * np.pi * 2000.0
    for true, seen in (
        (plain.pilot_position, slow.pilot_position),
        (plain.main_position, slow.main_position),
    ):
        expected, decay = np.zeros(samples.size), np.exp(-rate * 1e-6)
        for k in range(1, samples.size):  # exact for a straight line between samples
            slope = (true[k] - true[k - 1]) / 1e-6
            start = true[k - 1] - slope / rate
            expected[k] = start + slope * 1e-6 + decay * (expected[k - 1] - start)
        np.testing.assert_allclose(seen, expected, rtol=0.0, atol=1e-10)


def test_a_negative_voltage_pulls_as_a_positive_one() -> None:
    np.testing.assert_allclose(
        one_stroke(DeclaredPlant(), -9.0).pilot_position, one_stroke(DeclaredPlant(), 9.0).pilot_position, atol=1e-15
    )


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="coulomb"):
        DeclaredPlant({"coulomb": {"force": 1.0}})
    with pytest.raises(ValueError, match="mass"):
        DeclaredPlant(parameters={"mass": 1.0})
    with pytest.raises(ValueError, match="pickup_impact"):
        MismatchedPlant(chosen("pickup_impact"))
    with pytest.raises(ValueError, match="pickup_impact"):
        ReluctancePlant(chosen("pickup_impact"))


# --- plant (a) within the tolerances of a data sheet -----------------------------------------------------------------


def test_a_plant_without_deviations_is_as_declared() -> None:
    assert deviated(SHEET_VALVE, {}) == SHEET_VALVE


@pytest.mark.long
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


@pytest.mark.parametrize("name", NAMES)
def test_every_deviation_shows_and_no_other_name_is_taken(name: str) -> None:
    plain = one_stroke(DeclaredPlant(parameters=SHEET_VALVE))
    changed = one_stroke(DeclaredPlant(parameters=deviated(SHEET_VALVE, {name: 1.0})))
    assert np.abs(plain.pilot_position - changed.pilot_position).max() > 0.5e-6
    with pytest.raises(ValueError, match="colour"):
        deviated(SHEET_VALVE, {"colour": 1.0})


# --- plant (b) -------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_mismatched_plant_opens_like_the_paper() -> None:
    run = one_stroke(MismatchedPlant())
    assert run.first("picked_up") == pytest.approx(5.3e-3, abs=2e-6)
    assert run.first("opened") == pytest.approx(9.9e-3, abs=2e-6)
    assert run.pilot_position.max() == pytest.approx(1.23e-3, abs=5e-6)
    assert run.main_position.max() == pytest.approx(0.97e-3, abs=5e-6)
    assert run.pilot_position[-1] == pytest.approx(0.0, abs=2e-6)


@pytest.mark.long
def test_the_bench_valve_is_nearer_to_the_mismatched_plant_than_the_published_one() -> None:
    true = one_stroke(MismatchedPlant()).pilot_position
    bench = one_stroke(DeclaredPlant(parameters=mismatched.BENCH_VALVE)).pilot_position
    published = one_stroke(DeclaredPlant()).pilot_position
    assert 5e-6 < np.std(bench - true) < 0.9 * np.std(published - true)


def test_back_emf_dents_the_current_while_the_plunger_moves() -> None:
    run = one_stroke(MismatchedPlant())
    moving = (run.time > 7e-3) & (run.time < 11e-3)
    steps = np.diff(run.coil_current[moving])
    assert steps.min() < -1e-4
    assert run.coil_current[run.time < 0.025].max() == pytest.approx(0.9, rel=1e-3)


def test_the_pull_is_stronger_on_the_way_back() -> None:
    """Hysteresis alone: without it the valve lets go of the stop earlier."""
    with_loop, without = one_stroke(MismatchedPlant()), one_stroke(MismatchedPlant(hysteresis=0.0))
    assert with_loop.first("released") > without.first("released") + 10e-6
    assert with_loop.first("opened") > without.first("opened") + 10e-6


@pytest.mark.parametrize("effects", [{}, chosen("stiction", "squeeze_film", "stop_bounce", "pressure_force")])
@pytest.mark.parametrize("plant", [MismatchedPlant, pytest.param(ReluctancePlant, marks=pytest.mark.long)])
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


@pytest.mark.long
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


def test_the_reluctance_plant_opens_only_where_the_pull_exceeds_the_return_force() -> None:
    build = IDEAL
    share = np.sqrt(build.return_force * build.reluctance_gap**2 / build.reluctance_force)
    assert one_stroke(ReluctancePlant(build=build), 9.0 * share * 0.999).events == ()
    assert one_stroke(ReluctancePlant(build=build), 9.0 * share * 1.001).events[0].kind == "unseated"


def test_the_pressure_of_the_reluctance_plant_leaks_away_and_returns() -> None:
    """A later start finds it still lower than at time 0; one soon after a stroke finds it drawn down again."""

    def opening_time(commands: list[tuple[float, float]]) -> float:
        times, volts = np.array(commands).T.copy()
        run = ReluctancePlant(build=build).simulate(times, volts, np.array([times[-1] + 0.02]))
        return max(event.time for event in run.events if event.kind == "opened") - float(times[-1])

    build = WITHOUT_FRICTION._replace(pressure=0.5, pressure_at_rest=1.0)
    at_once, later = opening_time([(0.0, 9.0)]), opening_time([(0.5, 9.0)])
    again = opening_time([(0.0, 9.0), (0.025, 0.0), (0.075, 9.0)])
    much_later = opening_time([(0.0, 9.0), (0.025, 0.0), (0.925, 9.0)])
    assert later < at_once - 20e-6
    assert again > much_later + 5e-6


def test_the_data_sheet_is_of_the_reluctance_plant_and_its_table_of_its_pull() -> None:
    build = reluctance.built(reluctance.DATA_SHEET)
    np.testing.assert_allclose(build, Build(), rtol=1e-12)
    plant = ReluctancePlant()
    displacement, force = plant.static_table(np.random.default_rng(1))
    error = force - plant.static_pull(displacement)
    assert 0.03 < error.std() < 0.08
    assert displacement[-1] == pytest.approx(1.2e-3)


# --- recordings ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "plant", [DeclaredPlant(), MismatchedPlant(), ReluctancePlant()], ids=["declared", "mismatched", "reluctance"]
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


def test_bags_hold_the_strokes_of_the_whole() -> None:
    whole = record(DeclaredPlant(), train_profile(), Recorder(), 1).truth
    opened = [event.time for event in whole.events if event.kind == "opened"]
    found = []
    for bag, profile in enumerate(train_bags(4)):
        run = record(DeclaredPlant(), profile, Recorder(), 1).truth
        assert run.pilot_position[-1] == 0.0
        found += [event.time + 0.120 * bag for event in run.events if event.kind == "opened"]
    np.testing.assert_allclose(found, opened, rtol=0.0, atol=1e-9)


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


def test_quantisation_rounds_the_noisy_position() -> None:
    made = record(DeclaredPlant(), single_opening(), Recorder(quantisation=5e-6), 3)
    steps = made.pilot_position / 5e-6
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert np.abs(made.pilot_position - made.truth.pilot_position).max() < 8e-6


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
