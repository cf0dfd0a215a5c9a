"""Made-up actuators of ten kinds, each described by a file as users write it, and lacking one effect or none.

The truth is test/plants/actuators.py. Declared values are off as their tolerances allow. A round is two hundred; one in
five lacks nothing.
"""

from __future__ import annotations

import copy
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
from plants.actuators import KINDS, march

from benchmarks.campaign.bench import Bench
from valve_sim.files.plant_files import plant_from
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.recordings.columns import read

ROUND: Final = 200
"""Actuators."""
SECONDS: Final = 120.0
"""That stand for the work of a diagnosis."""
NOISE: Final = 2e-3
"""Of the range of what is shown."""


def missing(seed: int) -> str:
    """The effect that the file of this seed's actuator lacks; empty for one that lacks nothing."""
    turn, number = divmod(seed, ROUND)
    if number // len(KINDS) % 5 == 4:
        return ""
    return str(np.random.default_rng((turn, number)).choice(list(KINDS[kind_of(seed)].sizes)))


def kind_of(seed: int) -> str:
    """One after the other."""
    return list(KINDS)[seed % ROUND % len(KINDS)]


def bench(seed: int, effect: str) -> Bench:
    """The actuator of a seed, whose file lacks this effect, or nothing."""
    turn, number = divmod(seed, ROUND)
    with tempfile.TemporaryDirectory() as folder:
        plant = recorded(kind_of(seed), effect, 100_003 * turn + number, Path(folder))
    return Bench(
        kind_of(seed), lambda: diagnose_plant(plant, None, budget=Budget.of_seconds(SECONDS)), lambda found: {}
    )


def recorded(name: str, effect: str, seed: int, folder: Path) -> OwnPlant:
    """A plant as it is declared, with a recording of the true one, read from a file as a user's is."""
    kind, random = KINDS[name], np.random.default_rng(seed)
    content = {"plant": "equations", **copy.deepcopy(kind.plant)}
    names = [key for key in content["parameters"] if key not in ("root", "one")]
    values = np.array(kind.values)
    for place, key in enumerate(names):
        own = content["parameters"][key]
        if "tolerance" in own:
            values[place] += own["tolerance"] * (values[place] / own["value"]) * random.standard_normal()
        else:
            values[place] *= random.uniform(0.7, 1.4)
    sizes = np.zeros(4)
    if effect:
        sizes[list(kind.sizes).index(effect)] = kind.sizes[effect] * random.uniform(0.5, 1.5)
    times = np.arange(0.0, kind.drive["duration"], 1.0 / kind.drive["rate"])
    amplitude, share = kind.drive["amplitude"], times / kind.drive["duration"]
    if kind.drive["form"] == "sines":
        inputs = sum(
            size * np.sin(2.0 * np.pi * (rate * share + random.uniform()))
            for size, rate in ((0.6, 4.0 + random.uniform(0, 2)), (0.4, 11.0 + random.uniform(0, 3)))
        )
        inputs = amplitude * inputs * np.where((share > 0.45) & (share < 0.55), 0.0, 1.0)
    else:
        levels = random.uniform(0.15, 1.0, 16) * (1.0 if name != "coil" else random.choice([-1.0, 1.0], 16))
        inputs = amplitude * levels[np.minimum((16 * share).astype(int), 15)]
    start = np.array([float(own.get("start", 0.0)) for own in content["states"].values()])
    states = march(kind.rates, kind.slides, kind.inertia, start, times, inputs, values, sizes)
    (driven,) = content["inputs"]
    columns = {"t": times, driven: inputs}
    order = list(content["states"])
    for key, own in content["outputs"].items():
        shown = states[:, order.index(own["value"])] * (1e3 if own["unit"] == "mm" else 1.0)
        sigma = NOISE * float(np.ptp(shown))
        own["noise"] = float(f"{sigma:.6g}")
        columns[key] = shown + sigma * random.standard_normal(len(times))
    path = folder / f"{name}_{seed}.csv"
    np.savetxt(
        path, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="", fmt="%.10g"
    )
    read_map = {"time": {"column": "t"}, driven: {"column": driven}}
    read_map |= {key: {"column": key} for key in content["outputs"]}
    return OwnPlant(plant_from(content, f"{name}.yaml"), [read(path, read_map)])
