"""Every effect of the catalogue as an independent plant has it: other code, other integration scheme."""

import numpy as np
import pytest
from plants.declared import DeclaredPlant
from plants.recording import Profile, holdout_profile, train_profile

from valve_sim.model import CATALOGUE, Drive, Valve, simulate

CALIBRATED = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3, coil_resistance=10.0)
EFFECTS = {
    "coulomb_friction": {"force": 0.1},
    "stiction": {"force": 0.05, "breakaway": 0.1, "stribeck_velocity": 0.02},
    "asymmetric_friction": {
        "force_opening": 0.05,
        "force_closing": 0.1,
        "damping_opening": 0.5,
        "damping_closing": 1.0,
    },
    "constant_force": {"force": 0.1},
    "rest_attraction": {"force": 0.2},
    "drive_gain": {"gain": 0.98},
    "coil_lag": {"time_constant": 2e-4},
    "eddy_lag": {"time_constant": 3e-4},
    "coil_heating": {"temperature_rate": 100.0, "cooling_time_constant": 5.0},
    "magnetic_saturation": {"current": 4.0},
    "residual_magnetism": {"current": 0.12},
    "pressure_force": {"force": 0.5, "equalisation_time": 6e-3},
    "quadratic_drag": {"coefficient": 3.0},
    "squeeze_film": {"coefficient": 4.0, "film_thickness": 1e-4},
    "stop_bounce": {"restitution_stop": 0.3, "restitution_seat": 0.2},
    "pickup_impact": {"velocity_ratio": 0.9},
    "spring_hardening": {"coefficient": 3e8},
    "stroke_offset": {"offset": 5e-6},
    "gap_offset": {"offset": 5e-6},
    "sensor_delay": {"delay": 3e-4},
    "sensor_bandwidth": {"cutoff_frequency": 1500.0},
    "sensor_gain": {"gain": 1.004},
}


def test_every_effect_is_compared() -> None:
    """Here, or where a flux is integrated (test_flux), with gas (gas/test_effects), or in core/test_physics."""
    elsewhere = {"motional_emf", "seat_leak", "pilot_clogging", "stop_compliance"}
    assert {*EFFECTS, *elsewhere} == {name for name, effect in CATALOGUE.items() if effect.named}


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("profile", [train_profile(), holdout_profile()], ids=["train", "holdout"])
def test_an_effect_is_what_the_plant_says(name: str, profile: Profile) -> None:
    times = np.arange(3000) * 1e-4
    valve = Valve(CALIBRATED.parameters, {name: EFFECTS[name]})
    ours = simulate(valve, Drive(profile.times, profile.volts), times, start_time=0.0)
    truth = DeclaredPlant(effects={name: EFFECTS[name]}).simulate(profile.times, profile.volts, times)
    assert np.max(np.abs(ours.pilot_position - truth.pilot_position)) < 1e-9
    assert np.max(np.abs(ours.main_position - truth.main_position)) < 1e-9
    assert np.max(np.abs(ours.coil_current - truth.coil_current)) < 1e-8
