"""How much the current alone tells of a valve: `python -m benchmarks.coil_errors`.

Eight strokes of config/energy_consistent.yaml at 7.5 to 14 V, current and voltage measured, no position. A fit frees
both dampings and moves every value of the file within its tolerance; its Fisher information gives the standard errors.
They are those of a valve of exactly this form: an upper bound of what a real one allows.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from benchmarks.common import parser, show
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.identification.estimation.followed_positions import a_standard_error_apart, followed_positions
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.valve import DAMPINGS, ValvePlant
from valve_sim.model import Drive, Valve, published_times, simulate
from valve_sim.traces.synthetic import Sensor, record

LEVELS: Final = (9.0, 12.0, 7.5, 14.0, 10.3, 8.4, 13.0, 11.2)
"""V."""
PERIOD: Final = 0.060
ON: Final = 0.030
"""s."""
VOLTAGE_NOISE: Final = 5e-3
"""V."""


class Setting(NamedTuple):
    """One way to drive and record: V of the release (0: shorted), A of noise, Hz, and how many strokes."""

    release: float
    noise: float
    rate: float
    strokes: int = 8


SETTINGS: Final = (
    Setting(0.0, 1e-3, 20e3),
    Setting(0.0, 5e-3, 20e3),
    Setting(0.0, 1e-3, 5e3),
    Setting(0.0, 5e-3, 5e3),
    Setting(0.0, 1e-3, 1e3),
    Setting(0.0, 1e-3, 20e3, 1),
    Setting(24.0, 1e-3, 20e3),
    Setting(24.0, 5e-3, 20e3),
)


def fitted(setting: Setting, seed: int) -> Fit:
    """A fit to a recording, from the true values."""
    declared = load_valve(config_path("energy_consistent.yaml"))
    valve = Valve(
        declared.with_values(release_voltage=setting.release).parameters, declared.effects, declared.tolerances
    )
    starts = 0.010 + PERIOD * np.arange(setting.strokes)
    times = np.column_stack([starts, starts + ON]).ravel()
    volts = np.column_stack([LEVELS[: setting.strokes], np.zeros(setting.strokes)]).ravel()
    sensor = Sensor(current_noise=setting.noise, voltage_noise=VOLTAGE_NOISE, has_positions=False, seed=seed)
    trace = record(valve, Drive(times, volts), float(times[-1]) + 0.04, setting.rate, sensor).trace
    plant = ValvePlant([trace], valve)
    start = {name: plant.declared(name) for name in DAMPINGS}
    return fit(Problem(plant), DAMPINGS, start, nuisances=plant.nuisances)


def arrival_errors(found: Fit) -> tuple[float, float]:
    """Standard errors of t1 and t2 at 9 V, s."""
    plant = found.problem.plant
    assert isinstance(plant, ValvePlant)
    drive = Drive.of([0.0], [9.0])
    pairs = [
        [published_times(simulate(plant.with_values(values), drive, [0.0, 0.03])) for values in pair]
        for pair in a_standard_error_apart(found)
    ]
    half = 0.5 * (np.array(pairs)[:, 0] - np.array(pairs)[:, 1])
    t1, t2 = np.sqrt(np.sum(np.square(half), axis=0)).tolist()
    return t1, t2


def row(setting: Setting, found: Fit) -> tuple[str, ...]:
    """A line of the table."""
    (followed,) = followed_positions(found)
    moves = np.abs(np.gradient(followed.position, followed.trace.sample_times)) > 1e-3
    size = 1e6 * followed.stderr[moves]
    names = [*found.free, *(own.name for own in found.nuisances)]
    errors = dict(zip(names, np.sqrt(np.diag(found.covariance)), strict=True))
    plant = found.problem.plant
    shares = [100.0 * found.stderr(name) / plant.declared(name) for name in DAMPINGS]
    shares += [100.0 * errors[name] / plant.declared(name) for name in ("spring_preload", "spring_rate")]
    t1, t2 = (1e6 * error for error in arrival_errors(found))
    return (
        "shorted" if setting.release == 0.0 else f"{setting.release:g} V clamp",
        f"{1e3 * setting.noise:g}", f"{1e-3 * setting.rate:g}", f"{setting.strokes}",
        f"{np.median(size):.2g}", f"{np.quantile(size, 0.95):.2g}", f"{t1:.2g}", f"{t2:.2g}",
        *(f"{share:.2g}" for share in shares),
    )  # fmt: skip


def main() -> None:
    """Fit and print."""
    options = parser("coil_errors", __doc__)
    options.add_argument("--seed", type=int, default=1)
    seed = options.parse_args().seed
    headings = (
        "release", "noise, mA", "rate, kHz", "strokes", "x while moving, µm", "95 % of it below", "t1, µs", "t2, µs",
        "c1, %", "c2, %", "preload, %", "spring rate, %",
    )  # fmt: skip
    rows = [row(setting, fitted(setting, seed)) for setting in SETTINGS]
    show("Standard errors from the current alone", headings, rows)


if __name__ == "__main__":
    main()
