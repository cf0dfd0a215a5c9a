"""What could be named of the ready machines, and what looks alike: `python -m benchmarks.plant_limits`.

Each machine is simulated as declared, driven as below, and its sensor has noise of a thousandth of its range. Of such a
recording, which lacks nothing, the table of docs/how_to/your_own_machine.md says for each effect how large it would
have to be to be named in half of such recordings, and which other
effects it would be taken for: those whose change of the signal is the same within `ALIKE` once everything that is
refitted anyway is taken off.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.plant_files import PlantFile, plant_from
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.plants.effect_titles import title_of
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.own_simulation import simulate_plant
from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.reporting.wording import limit_rows
from valve_sim.model.core.own.units import parse_unit
from valve_sim.traces.columns import Column, Columns

Array = NDArray[np.float64]

NOISE: Final = 1e-3
"""Of the range of the signal."""
ALIKE: Final = 0.9
"""Cosine between two changes of a signal from which on their effects are look-alikes."""


class Reference(NamedTuple):
    """A ready machine and how it is driven.

    Attributes:
        plant: its file. input: name, unit, and amplitude of the sum of its sines. duration: s. rate, frequencies: Hz.
        says: the machine and its recording, in a line.
    """

    plant: dict[str, Any]
    input: tuple[str, str, float]
    duration: float
    rate: float
    frequencies: tuple[float, ...]
    says: str


REFERENCES: Final = (
    Reference(
        {"plant": "axis", "parameters": {"mass": 4.0, "viscous": 20.0}},
        ("force", "N", 20.0), 5.0, 400.0, (0.3, 0.9, 2.3),
        "axis of 4 kg and 20 N·s/m, a force of 20 N at 0.3, 0.9 and 2.3 Hz, 5 s at 400 Hz",
    ),
    Reference(
        {"plant": "axis", "rotary": True, "parameters": {"inertia": 1e-3, "viscous": 5e-3}},
        ("torque", "N*m", 0.05), 5.0, 400.0, (0.3, 0.9, 2.3),
        "rotary axis of 1e-3 kg·m² and 5e-3 N·m·s/rad, a torque of 0.05 N·m at 0.3, 0.9 and 2.3 Hz, 5 s at 400 Hz",
    ),
    Reference(
        {"plant": "coil", "parameters": {"resistance": 6.0, "inductance": 0.03}},
        ("voltage", "V", 12.0), 2.0, 2000.0, (1.0, 7.0, 40.0),
        "coil of 6 Ω and 30 mH, a voltage of 12 V at 1, 7 and 40 Hz, 2 s at 2 kHz",
    ),
)  # fmt: skip


def machine(reference: Reference, seed: int = 1) -> OwnPlant:
    """The machine with a recording that lacks nothing."""
    file: PlantFile = plant_from(reference.plant, reference.plant["plant"])
    name, unit, amplitude = reference.input
    times = np.arange(0.0, reference.duration, 1.0 / reference.rate)
    drive = np.mean([np.sin(2.0 * np.pi * own * times) for own in reference.frequencies], axis=0)
    drive *= amplitude / float(np.max(np.abs(drive)))
    driven = Column(name, "made up", times, drive, parse_unit(unit), np.ones(len(times), dtype=bool))
    shown = simulate_plant(file, Columns("made up", {name: driven}))
    output = next(iter(file.outputs))
    signal = shown[output]
    sigma = NOISE * float(np.ptp(signal))
    noisy = signal + np.random.default_rng(seed).normal(0.0, sigma, len(times))
    entry = {**reference.plant, "outputs": {output: {"noise": sigma}}}
    column = Column(output, "made up", times, noisy, file.outputs[output].unit, np.ones(len(times), dtype=bool))
    return OwnPlant(plant_from(entry, "made up"), [Columns("made up", {name: driven, output: column})])


def look_alikes(plant: OwnPlant) -> dict[str, list[str]]:
    """By effect the others whose change of the signal is about the same, whatever is refitted."""
    values = {name: plant.declared(name) for name in plant.base}
    beside = [Direction({name: 1.0}, 1e-3) for name in plant.base]
    beside += [Direction({own.name: own.sigma}, 1e-3) for own in plant.nuisances]
    basis = np.linalg.qr(plant.sensitivities(values, beside).columns[0])[0]
    changes: dict[str, Array] = {}
    for name, effect in plant.effects.items():
        on = {f"{name}.{own.name}": plant.declared(f"{name}.{own.name}") for own in effect.parameters}
        switches = [own for own in effect.parameters if own.off is not None]
        columns = []
        for own in switches:
            sign = 1.0 if own.upper > (own.off or 0.0) else -1.0
            step = 1e-3 * sign * own.prior_scale
            moved = {**values, **on, f"{name}.{own.name}": (own.off or 0.0) + step}
            columns.append((plant.predict(moved)[0] - plant.predict(values)[0]) / step * own.prior_scale)
        table = np.column_stack(columns)
        table -= basis @ (basis.T @ table)
        changes[name] = np.linalg.qr(table)[0]
    return {
        name: [other for other, its in changes.items() if other != name and _cosine(own, its) > ALIKE]
        for name, own in changes.items()
    }


def _cosine(a: Array, b: Array) -> float:
    """Of the smallest angle between a change of one effect and the changes of another."""
    return float(np.linalg.svd(a.T @ b, compute_uv=False)[0])


def table(reference: Reference) -> list[str]:
    """The rows of one machine in Markdown."""
    plant = machine(reference)
    found = diagnose_plant(plant, None)
    limits = dict(limit_rows(found))
    lines = [f"**{reference.says[0].upper()}{reference.says[1:]}** (`{found.verdict.kind}`):", ""]
    lines += ["| effect | named in half of such recordings from | would be taken for |", "|---|---|---|"]
    for name, others in look_alikes(plant).items():
        alike = ", ".join(f"`{other}`" for other in others) or "–"
        lines.append(f"| `{name}` | {limits.get(title_of(name), 'not within its range')} | {alike} |")
    return [*lines, ""]


def main(arguments: Sequence[str]) -> int:
    """Print the tables of all machines, or of those whose kinds are named."""
    chosen = [one for one in REFERENCES if not arguments or one.plant["plant"] in arguments]
    print("\n".join(line for one in chosen for line in table(one)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
