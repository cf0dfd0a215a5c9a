"""A real servo axis through the same diagnosis: `python -m benchmarks.emps [FILE] [--predict SECOND]`.

EMPS is an electro-mechanical positioning system, measured for 24.8 s at 1 kHz: A. Janot, M. Gautier, M. Brunot, "Data
Set and Reference Models of EMPS", Workshop on Nonlinear System Identification Benchmarks, Eindhoven 2019. This page
reads its file (that is all it knows of EMPS), starts from mass and viscous friction, and lets `diagnose_plant` find
what is missing. It prints the published models beside what the diagnosis names, and what stays unexplained.

Published for this record, by ordinary least squares: mass 95.1 kg, viscous 203.5 N·s/m, Coulomb 20.39 N, offset
−3.16 N, force residual 4.08 % of the force's norm; 3.11 % with friction by direction.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.mat_files import read_variables
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.axis import AxisPlant, AxisRecord
from valve_sim.identification.reporting.summary import summarise
from valve_sim.model import ValveError

DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data" / "emps" / "DATA_EMPS.mat"
HOW_TO_GET_IT = "expected DATA_EMPS.mat of the EMPS data set from nonlinearbenchmark.org; give its path"
VARIABLES = ("t", "qm", "vir", "gtau")
PUBLISHED = {"mass": 95.1, "viscous_friction": 203.5, "coulomb_friction.force": 20.39, "constant_force.force": 3.16}
"""kg, N·s/m, N, N. Their offset stands on the other side of the equation: −3.16 N there is +3.16 N of force here."""
PUBLISHED_RESIDUAL = {("coulomb_friction", "constant_force"): 4.08, ("asymmetric_friction",): 3.11}
"""% of the force's norm."""


class Rung(NamedTuple):
    """A model that is fitted to the whole record.

    Attributes:
        effects: what was added, and added: how many parameters that are.
        values: of all freed parameters. residual: % of the force's norm. windows: m, position error over 1 s.
    """

    effects: tuple[str, ...]
    added: int
    values: Mapping[str, float]
    residual: float
    windows: float


def read_emps(path: Path) -> AxisRecord:
    """Position and drive force of an EMPS file; `vir` is in volts, whatever the data set's text says.

    Raises:
        ValveError: the file is missing or not such a file; one line that says how to get it.
    """
    times, position, volts, gain = (values.ravel() for values in read_variables(path, VARIABLES, HOW_TO_GET_IT))
    return AxisRecord(path.name, times, position, float(gain[0]) * volts)


def ladder(plant: AxisPlant, diagnosis: Diagnosis) -> list[Rung]:
    """Nothing, Coulomb friction, the published models, and what the diagnosis names or holds likeliest."""
    leading = tuple(diagnosis.verdict.effects)
    models = dict.fromkeys([(), ("coulomb_friction",), *PUBLISHED_RESIDUAL, *([leading] if leading else [])])
    found = {
        candidate.effects: {name: interval.value for name, interval in candidate.intervals.items()}
        for candidate in diagnosis.candidates
    }
    return [rung(plant, names, found.get(names)) for names in models]


def rung(plant: AxisPlant, effects: Sequence[str], start: Mapping[str, float] | None = None) -> Rung:
    """The base and these effects, fitted to the whole record from what was found in a part of it, or from 1 each."""
    added = [name for effect in effects for name in plant.effects[effect].free_names()]
    values = fit(Problem(plant), (*plant.base, *added), start or dict.fromkeys(added, 1.0)).values
    return Rung(tuple(effects), len(added), values, 100.0 * plant.residual_share(values), plant.window_rmse(values))


def table(rungs: Sequence[Rung], second: AxisPlant | None) -> list[str]:
    """One line a rung."""
    head = "added to mass and viscous friction      parameters   force residual   published   1 s windows"
    lines = [head + ("   second record" if second else "")]
    for entry in rungs:
        name = " + ".join(entry.effects) or "(nothing)"
        published = PUBLISHED_RESIDUAL.get(entry.effects)
        line = f"{name:<40}{entry.added:>10}{entry.residual:>14.2f} %"
        line += f"{published:>10.2f} %" if published else f"{'':>12}"
        line += f"{1e3 * entry.windows:>11.2f} mm"
        lines.append(line + (f"{100.0 * second.residual_share(entry.values):>14.2f} %" if second else ""))
    return lines


def parameter_lines(plant: AxisPlant, rungs: Sequence[Rung]) -> list[str]:
    """The values of each rung, beside the published ones where there are any."""
    lines = []
    for entry in rungs:
        lines.append(" + ".join(entry.effects) or "(nothing)")
        values = dict(entry.values)
        if "asymmetric_friction" in entry.effects:
            # Viscous friction and extra damping by direction add up; only their sums are determined.
            for direction in ("opening", "closing"):
                extra = values.pop(f"asymmetric_friction.damping_{direction}")
                values[f"viscous friction, {direction}"] = values["viscous_friction"] + extra
            del values["viscous_friction"]
        for name, value in values.items():
            is_published = entry.effects == ("coulomb_friction", "constant_force") and name in PUBLISHED
            unit = plant.parameter(name).unit if "," not in name else "N·s/m"
            beside = (
                f"   published {PUBLISHED[name]:g} ({100 * (value / PUBLISHED[name] - 1):+.2f} %)"
                if is_published
                else ""
            )
            lines.append(f"    {name:<36}{value:>10.3f} {unit}{beside}")
    return lines


def remainder_line(plant: AxisPlant, values: Mapping[str, float]) -> str:
    """Where what is left of the force acts: at steady speed, or while the axis accelerates and turns."""
    channel = plant.channels[0]
    squares = np.square(channel.data - plant.predict(values)[0])
    steady, moving = squares[channel.quiet], squares[~channel.quiet]
    share = moving.sum() / squares.sum()
    return (
        f"{np.sqrt(moving.mean()):.2f} N rms while the axis accelerates or turns ({share:.0%} of its power), "
        f"{np.sqrt(steady.mean()):.2f} N at steady speed"
    )


def report(path: Path, second: Path | None) -> str:
    """The whole page.

    Raises:
        ValveError: a file is unusable.
    """
    plant = AxisPlant(read_emps(path))
    other = AxisPlant(read_emps(second)) if second else None
    diagnosis = diagnose_plant(plant, None)
    rungs = ladder(plant, diagnosis)
    named = next(entry for entry in rungs if set(entry.effects) == set(diagnosis.verdict.effects))
    groups = 1 + int(plant.channels[0].group.max())
    lines = [
        f"{path.name}: {len(plant.channels[0].data)} force samples, {groups} repetitions",
        "",
        *table(rungs, other),
    ]
    lines += ["", *parameter_lines(plant, rungs[1:]), ""]
    held = next(c for c in diagnosis.candidates if set(c.effects) == set(diagnosis.verdict.effects))
    lines += [
        f"verdict: {diagnosis.verdict.kind!r}, {' and '.join(diagnosis.verdict.effects)}: {summarise(diagnosis)}",
        f"force error in N, fitted / held-out repetition: {diagnosis.before.train_rmse:.2f} / "
        f"{diagnosis.before.holdout_rmse:.2f} before, {held.train_rmse:.2f} / {held.holdout_rmse:.2f} after",
        f"unexplained: {remainder_line(plant, named.values)}",
    ]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the page; 2 where a file is missing."""
    parser = argparse.ArgumentParser(description="Diagnose the EMPS servo axis.")
    parser.add_argument("file", nargs="?", type=Path, default=DEFAULT, help="DATA_EMPS.mat")
    parser.add_argument("--predict", type=Path, metavar="SECOND", help="another record, predicted by the same models")
    chosen = parser.parse_args(arguments)
    try:
        print(report(chosen.file, chosen.predict))
    except ValveError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
