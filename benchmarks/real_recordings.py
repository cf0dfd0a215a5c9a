"""Machines that others have measured, by files alone: `python -m benchmarks.real_recordings [DATA]`.

DATA holds the published files as docs/examples/own_plants/make_csv.py says; its plants and maps are those that a reader
of the documentation has. Printed are, for each machine, values and errors of models that are fitted to all of its
recordings, beside what its owners published, and what a diagnosis says. It is the table of docs/results/earlier.md.
"""

from __future__ import annotations

import math
import runpy
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks.common import parser
from valve_sim.files.plant_files import load_plant
from valve_sim.identification.diagnosis.identify import Identification, identify_plant
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.identification.reporting.summary import summarise
from valve_sim.identification.reporting.units import measured, quantity
from valve_sim.model import ValveError
from valve_sim.traces.columns import read

EXAMPLES: Final = Path(__file__).resolve().parents[1] / "docs" / "examples" / "own_plants"
DATA: Final = Path(__file__).resolve().parents[2] / "shared" / "data"


class Rung(NamedTuple):
    """A model that is fitted to all recordings.

    Attributes:
        effects: that are added to the declared machine. published: values and errors, as its owners have them.
    """

    effects: tuple[str, ...]
    published: Mapping[str, str] = {}


class RealMachine(NamedTuple):
    """A machine of the examples.

    Attributes:
        plant: begins the names of its two files. tables: begins those of its tables. rungs: models, in this order.
    """

    plant: str
    tables: str
    rungs: tuple[Rung, ...]


MACHINES: Final = (
    RealMachine(
        "emps",
        "emps",
        (
            Rung(()),
            Rung(("coulomb_friction",)),
            Rung(
                ("coulomb_friction", "load"),
                {"mass": "95.1 kg", "viscous": "203.5 N·s/m", "coulomb_friction.level": "20.39 N",
                 "load.load": "3.16 N", "share": "4.08 %"},
            ),
            Rung(("asymmetric_friction",), {"share": "3.11 %"}),
        ),
    ),
    RealMachine("knob", "knob", (Rung(()), Rung(("coulomb_friction",)), Rung(("coulomb_friction", "load")))),
    RealMachine(
        "kicker", "empty", (Rung((), {"resistance": "0.387 to 0.396 Ω", "inductance": "284 to 295 µH"}),)
    ),
    RealMachine("maglev", "force", (Rung(()), Rung(("inductance_of_distance",)))),
)  # fmt: skip
"""EMPS: Janot, Gautier, Brunot 2019. Kicker: read off by its owners, with its wiring."""


def machine(data: Path, name: str, tables: Sequence[Path]) -> OwnPlant:
    """A machine of the examples with its recordings.

    Raises:
        ValveError: there are none.
    """
    own = next(one for one in MACHINES if one.plant == name)
    logs = [path for path in tables if path.name.startswith(own.tables)]
    if not logs:
        raise ValveError(f"{data}: holds no measurements of {name}; get them as {EXAMPLES / 'make_csv.py'} says")
    recordings = [read(log, EXAMPLES / f"{name}_map.yaml") for log in logs]
    return OwnPlant(load_plant(EXAMPLES / f"{name}.yaml"), recordings)


def fitted(plant: OwnPlant, effects: Sequence[str]) -> Identification:
    """The machine with some effects, fitted to all recordings."""
    added = [f"{effect}.{own}" for effect in effects for own in plant.file.effects[effect].parameters]
    return identify_plant(plant, (*plant.base, *added))


def share_left(found: Identification) -> float:
    """Norm of what is left over the norm of what was measured: the figure that Janot et al. publish."""
    plant = found.plant
    channels, shown = plant.channels, plant.predict(found.fit.values)
    left = math.hypot(*(root_mean_square(own.kept(own.data - one)) for own, one in zip(channels, shown, strict=True)))
    return left / math.hypot(*(root_mean_square(own.kept(own.data)) for own in channels))


def lines_of(rung: Rung, found: Identification) -> list[str]:
    """What one model comes to."""
    errors = [own.after for own in found.errors]
    unit = found.errors[0].unit
    share = f"   published {rung.published['share']}" if "share" in rung.published else ""
    lines = [
        f"  {' + '.join(rung.effects) or '(as declared, refitted)'}: rms error {quantity(min(errors), unit)} to "
        f"{quantity(max(errors), unit)} by recording, {100.0 * share_left(found):.2f} % of the signal{share}"
    ]
    for name, own in found.intervals.items():
        published = f"   published {rung.published[name]}" if name in rung.published else ""
        lines.append(f"    {name:<36}{measured(own, found.plant.parameter(name).unit)}{published}")
    return lines


def lines_of_diagnosis(found: Diagnosis) -> list[str]:
    """The verdict, and the errors fitted and held out of the declared model and of the names."""
    channel = found.plant.channels[0]
    held = next((one for one in found.candidates if set(one.effects) == set(found.verdict.effects)), None)
    pairs = [(found.before.train_rmse, found.before.holdout_rmse)]
    pairs += [] if held is None else [(held.train_rmse, held.holdout_rmse)]
    errors = ", ".join(" / ".join(quantity(one, channel.unit) for one in pair) for pair in pairs)
    return [
        f"  {found.verdict.kind} ({found.verdict.probability:.2f}): {summarise(found)}",
        f"  fitted / held out, as declared, then with the names: {errors}",
    ]


def report(data: Path, names: Sequence[str]) -> list[str]:
    """The lines of all machines whose measurements are there.

    Raises:
        ValveError: those of none are.
    """
    lines: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        tables = runpy.run_path(str(EXAMPLES / "make_csv.py"))["make"](data, Path(folder))
        for own in MACHINES:
            if own.plant not in names:
                continue
            try:
                plant = machine(data, own.plant, tables)
            except ValveError as error:
                print(error, file=sys.stderr)
                continue
            count = sum(int(np.sum(~one.left_out)) if one.left_out is not None else one.count for one in plant.channels)
            lines.append(f"{own.plant}: {len(plant.recordings)} recordings, {count} samples")
            for rung in own.rungs:
                lines += lines_of(rung, fitted(plant, rung.effects))
            lines += [*lines_of_diagnosis(diagnose_plant(plant, None)), ""]
    if not lines:
        raise ValveError(f"{data}: holds no measurements of {', '.join(names)}")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the lines; 2 where all data are missing."""
    known = parser("real_recordings", __doc__)
    known.add_argument("data", nargs="?", type=Path, default=DATA, help="the folder of published measurements")
    known.add_argument("--only", default=",".join(own.plant for own in MACHINES), metavar="NAMES", help="emps,knob")
    chosen = known.parse_args(arguments)
    try:
        print("\n".join(report(chosen.data, chosen.only.split(","))))
    except ValveError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
