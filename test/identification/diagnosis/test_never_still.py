"""Machines that are never still, so that nothing but a fit shows their sensor's noise; their truth is SciPy's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from valve_sim.files.plant_files import load_plant
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.recordings.columns import read

PENDULUM = """
plant: equations
states: {q: {unit: rad, start: free}, w: {unit: rad/s, start: free}}
inputs: {torque: {unit: N*m, between: straight}}
parameters:
  J: {value: 4.2e-3, unit: kg*m^2, tolerance: 3.0e-4}
  mgl: {value: 0.32, unit: N*m, tolerance: 0.02}
  b: {value: 1.0e-3, unit: N*m*s/rad, free: true, range: [0, 1]}
derivatives: {q: w, w: (torque - mgl*sin(q) - b*w)/J}
outputs: {angle: {value: q, unit: rad}}
effects:
  coulomb: {add: {w: -level*sign(w)/J}, parameters: {level: {unit: N*m, neutral: 0, scale: 0.01, range: [0, 1]}}}
  drag: {add: {w: -c*w*abs(w)/J}, parameters: {c: {unit: N*m*s^2, neutral: 0, scale: 0.001, range: [0, 1]}}}
  offset: {add: {w: load/J}, parameters: {load: {unit: N*m, neutral: 0, scale: 0.01}}}
"""

TANKS = """
plant: equations
states: {x1: {unit: m, start: free}, x2: {unit: m, start: free}}
inputs: {pump: {unit: V, between: held}}
parameters:
  k1: {value: 0.04, unit: m^0.5/s, free: true, range: [0, 1]}
  k2: {value: 0.04, unit: m^0.5/s, free: true, range: [0, 1]}
  k3: {value: 0.04, unit: m^0.5/s, free: true, range: [0, 1]}
  k4: {value: 0.04, unit: m/s/V, free: true, range: [0, 1]}
derivatives:
  x1: -k1*sqrt(max(0, x1)) + k4*pump
  x2: k2*sqrt(max(0, x1)) - k3*sqrt(max(0, x2))
outputs: {level: {value: x2, unit: m}}
effects:
  overflow:
    add: {x1: "-rate*max(0, x1 - limit)", x2: "0.5*rate*max(0, x1 - limit)"}
    parameters: {rate: {unit: 1/s, neutral: 0, scale: 0.1, range: [0, 10]}, limit: {unit: m, range: [0, 12]}}
  evaporation: {add: {x2: -loss}, parameters: {loss: {unit: m/s, neutral: 0, scale: 0.01, range: [-1, 1]}}}
"""


def diagnosed(folder: Path, plant: str, header: str, columns: np.ndarray, columns_of: dict[str, object]) -> Diagnosis:
    (folder / "plant.yaml").write_text(plant)
    np.savetxt(folder / "log.csv", columns, delimiter=",", header=header, comments="", fmt="%.8g")
    machine = OwnPlant(load_plant(folder / "plant.yaml"), [read(folder / "log.csv", columns_of)])
    return diagnose_plant(machine, None)


@pytest.mark.long
def test_the_noise_is_what_the_best_model_leaves_and_so_a_weak_force_is_told_from_its_rival(tmp_path: Path) -> None:
    """All effects fitted at once leave a radian, for the phase slips; drag alone leaves the noise of 0.9 mrad."""
    rng, times = np.random.default_rng(7), np.arange(0.0, 15.0, 0.01)

    def torque(time: float | np.ndarray) -> float | np.ndarray:
        return 0.12 * np.sin(2 * np.pi * 0.6 * time) + 0.08 * np.sin(2 * np.pi * 1.3 * time + 1)

    def slope(time: float, state: np.ndarray) -> list[float]:
        angle, speed = state
        return [speed, (torque(time) - 0.3237 * np.sin(angle) - 2e-3 * speed - 4e-4 * speed * abs(speed)) / 4e-3]

    run = solve_ivp(slope, (0.0, 15.0), [0.5, 0.0], t_eval=times, rtol=1e-9, atol=1e-10, max_step=0.01)
    noisy = np.degrees(run.y[0]) + rng.normal(0.0, 0.05, len(times))
    found = diagnosed(
        tmp_path, PENDULUM, "ms,torque,angle", np.c_[1e3 * times, torque(times), noisy],
        {
            "time": {"column": "ms", "unit": "ms"},
            "torque": {"column": "torque", "unit": "N*m"},
            "angle": {"column": "angle", "unit": "deg"},
        },
    )  # fmt: skip
    assert (found.verdict.kind, found.verdict.effects) == ("effects", ("drag",))
    drag = found.after.intervals["drag.c"]
    assert abs(drag.value - 4e-4) < 4.0 * drag.stderr < 1e-5
    assert found.after.holdout_rmse == pytest.approx(np.radians(0.05), rel=0.1)


@pytest.mark.long
def test_a_threshold_of_a_state_that_no_sensor_shows_is_found(tmp_path: Path) -> None:
    """Two tanks: only the lower one's level is measured, and the upper one spills over half way into it."""
    rng, interval = np.random.default_rng(4), 4.0
    pump = np.repeat(rng.uniform(1.0, 5.5, 80), 10)

    def slope(volts: float, levels: np.ndarray) -> list[float]:
        upper, lower = np.maximum(levels, 0.0)
        spilt = 0.2 * max(0.0, upper - 8.0)
        return [
            -0.05 * np.sqrt(upper) + 0.04 * volts - spilt,
            0.05 * np.sqrt(upper) - 0.045 * np.sqrt(lower) + 0.5 * spilt,
        ]

    state, levels = np.array([7.0, 7.0]), []
    for volts in pump:
        levels.append(state[1])
        state = solve_ivp(lambda _, x, u=volts: slope(u, x), (0.0, interval), state, rtol=1e-8, max_step=0.5).y[:, -1]
    times = interval * np.arange(len(pump))
    noisy = np.array(levels) + rng.normal(0.0, 0.02, len(times))
    found = diagnosed(
        tmp_path, TANKS, "time,pump,level", np.c_[times, pump, noisy],
        {
            "time": {"column": "time", "unit": "s"},
            "pump": {"column": "pump", "unit": "V"},
            "level": {"column": "level", "unit": "m"},
        },
    )  # fmt: skip
    assert (found.verdict.kind, found.verdict.effects) == ("effects", ("overflow",))
    limit = found.after.intervals["overflow.limit"]
    assert abs(limit.value - 8.0) < 4.0 * limit.stderr
    assert found.after.train_rmse == pytest.approx(0.02, rel=0.1)
