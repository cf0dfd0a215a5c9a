"""What `simulate --plant` shows of the commands that a node obeyed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from valve_sim.files.plant_files import load_plant
from valve_sim.identification.plants.own_simulation import simulate_plant
from valve_sim.recordings.columns import read

PLANT = Path(__file__).parents[2] / "docs" / "examples" / "own_plants" / "single_plunger.yaml"
SECOND = 1_000_000_000
MICROMETRE = load_plant(PLANT).outputs["position"].unit.factor
"""m: the unit of its position."""


def simulated(plant: Path, folder: Path, commands: Sequence[tuple[int, float]], looks: Sequence[int]) -> list[float]:
    """The position, in its file's unit, at some times; these and those of the commands, V, are ns after the start."""
    moments = sorted({0, *looks, *(at for at, _ in commands)})
    held = [next((volts for at, volts in reversed(commands) if at <= moment), 0.0) for moment in moments]
    rows = [f"{moment / SECOND!r},{volts}" for moment, volts in zip(moments, held, strict=True)]
    (folder / "log.csv").write_text("\n".join(["time,voltage", *rows, ""]))
    (folder / "map.yaml").write_text("time: {column: time, unit: s}\nvoltage: {column: voltage, unit: V}\n")
    shown = simulate_plant(load_plant(plant), read(folder / "log.csv", folder / "map.yaml"))
    found: list[float] = shown.columns["position"][np.isin(moments, looks)].tolist()
    return found
