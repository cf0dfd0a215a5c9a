"""A valve that a master steps: what is shown does not depend on the steps, and kept states are returned to."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.files.resources import config_path
from valve_sim.fmu.cosimulation import CoSimulatedValve
from valve_sim.fmu.description import base_powers, unit_name
from valve_sim.fmu.variables import variables_of
from valve_sim.model import CATALOGUE, DECLARED, Drive, Stepper, Valve, ValveError, simulate
from valve_sim.model.gas.parameters import GAS

TIMES, VOLTS = (0.002, 0.03, 0.05, 0.08), (9.0, 0.0, 12.0, 0.0)
END = 0.1
MILLIMETRE = 1e-3
SHOWN = ("pilot_position", "main_position", "pilot_velocity", "coil_current", "phase")


def valves() -> dict[str, Valve]:
    base = default_valve()
    late = {"sensor_delay": {"delay": 8e-4}, "stop_bounce": {"restitution_stop": 0.3, "restitution_seat": 0.2}}
    return {
        "default": base,
        "late and bouncing": Valve(base.parameters, late),
        "rubbing": Valve(base.parameters, {"coulomb_friction": {"force": 0.3}}),
        "with gas": load_valve(config_path("hydrogen_35mpa.yaml")),
    }


def random_ends(random: np.random.Generator, scale: float) -> NDArray[np.float64]:
    """Ends of steps of random sizes, s, those at which the command changes among them."""
    ends = np.cumsum(random.exponential(scale, int(2 * END / scale)))
    return np.unique(np.concatenate([ends[ends < END], TIMES, [END]]))


def expected(valve: Valve, ends: NDArray[np.float64]) -> NDArray[np.float64]:
    whole = simulate(valve, Drive.of(TIMES, VOLTS), ends, start_time=0.0)
    return np.array([getattr(whole, name) for name in SHOWN]).T


def shown_by(get: Callable[[str], float]) -> list[float]:
    return [get(name) for name in SHOWN]


@pytest.mark.parametrize("name", valves())
def test_it_shows_what_simulate_shows_at_any_steps_however_often_a_master_steps_back(name: str) -> None:
    valve = valves()[name]
    random = np.random.default_rng(4)
    steps = CoSimulatedValve(valve)
    time, place, shown = 0.0, 0, []
    ends = random_ends(random, 3e-4)
    while place < len(ends):
        if time in TIMES:
            steps.set("coil_voltage", VOLTS[TIMES.index(time)])
        kept = steps.keep()
        for _ in range(int(random.integers(0, 3))):  # tries that are not kept, with other inputs
            steps.set("coil_voltage", float(random.uniform(-12.0, 12.0)))
            steps.step(time, float(random.exponential(5e-3)))
            steps.restore(kept)
        steps.step(time, ends[place] - time)
        time = float(ends[place])
        place += 1
        shown.append(shown_by(steps.get))
    np.testing.assert_allclose(shown, expected(valve, ends), rtol=0.0, atol=1e-12 * MILLIMETRE)


def test_parameters_by_name_count_from_the_start_and_from_the_next_step() -> None:
    before, after = default_valve(), default_valve().with_values(spring_rate=600.0, a3=25e9)
    steps = CoSimulatedValve(before)
    steps.set("valve.spring_rate", 600.0)
    steps.set("valve.attraction_polynomial[4]", 25e9)
    steps.set("coil_voltage", 9.0)
    steps.step(0.0, 8e-3)
    alone = simulate(after, Drive.of([0.0], [9.0]), [8e-3], start_time=0.0)
    assert steps.get("pilot_position") == pytest.approx(alone.pilot_position[0], abs=1e-15)
    steps.set("valve.spring_rate", before.parameters.spring_rate)
    steps.step(8e-3, 1e-3)
    stepper = Stepper(after, 0.0)
    stepper.command(0.0, 9.0)
    stepper.set_valve(after.with_values(spring_rate=before.parameters.spring_rate), 8e-3)
    assert steps.get("pilot_position") == pytest.approx(stepper.advance(9e-3).pilot_position, abs=1e-15)
    assert steps.get("valve.spring_rate") == before.parameters.spring_rate


def test_pressures_are_inputs_of_a_valve_with_gas_alone() -> None:
    valve = valves()["with gas"]
    steps = CoSimulatedValve(valve)
    assert valve.gas is not None
    assert steps.get("inlet_pressure") == valve.gas.inlet_pressure
    steps.set("inlet_pressure", 20e6)
    steps.set("coil_voltage", 9.0)
    steps.step(0.0, 0.05)
    stepper = Stepper(valve.__class__(valve.parameters, gas=valve.gas._replace(inlet_pressure=20e6)), 0.0)
    stepper.command(0.0, 9.0)
    half_way = stepper.advance(0.05)
    assert (steps.get("outlet_pressure"), steps.get("mass_flow")) == (half_way.outlet_pressure, half_way.mass_flow)
    steps.set("inlet_pressure", 30e6)
    stepper.supply(0.05, 30e6)
    steps.step(0.05, 0.05)
    assert steps.get("outlet_pressure") == stepper.advance(0.1).outlet_pressure > half_way.outlet_pressure
    names = {entry.name for entry in variables_of(default_valve())}
    assert not names & {"inlet_pressure", "demand_pressure", "outlet_pressure", "mass_flow"}


def test_errors_are_one_line() -> None:
    steps = CoSimulatedValve(default_valve())
    with pytest.raises(ValveError, match="phase: cannot be set"):
        steps.set("phase", 1.0)
    steps.set("valve.moving_mass", -1.0)
    with pytest.raises(ValveError, match=r"valve\.moving_mass: found -1"):
        steps.step(0.0, 1e-3)
    steps.set("valve.moving_mass", 0.134)
    steps.step(0.0, 1e-3)
    with pytest.raises(ValveError, match="first restore a state that was kept"):
        steps.step(0.0, 1e-3)


def test_every_unit_of_the_tables_is_one_of_fmi() -> None:
    effects = [entry for effect in CATALOGUE.values() for entry in effect.parameters]
    for entry in (*DECLARED.values(), *GAS.values(), *effects):
        name = unit_name(entry.unit)
        assert not name or base_powers(entry.unit) is not None, f"{entry.name}: {entry.unit}"
    assert unit_name("N·s²/m²") == "N.s2/m2"
    assert base_powers("N·s²/m²") == {"kg": 1, "m": -1}
