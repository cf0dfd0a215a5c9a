"""Machines that others have measured, by files alone: `python -m benchmarks.real_recordings [DATA]`.

DATA holds the published files as docs/examples/own_plants/make_csv.py says; its plants and maps are those that a reader
of the documentation has. For each machine `valve-sim identify` fits models to all of its recordings, and `valve-sim
diagnose` says what it lacks: printed are the commands with their answers, beside what the machine's owners published.
"""

from __future__ import annotations

import json
import math
import runpy
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from click.testing import CliRunner

from benchmarks.common import parser
from valve_sim.cli import main as valve_sim
from valve_sim.files.plant_files import load_plant
from valve_sim.identification.estimation.gram import root_mean_square
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.traces.columns import read

EXAMPLES: Final = Path(__file__).resolve().parents[1] / "docs" / "examples" / "own_plants"
DATA: Final = Path(__file__).resolve().parents[2] / "shared" / "data"


class Model(NamedTuple):
    """Effects that are added to a machine and fitted to all recordings, and what its owners have published."""

    effects: tuple[str, ...] = ()
    published: str = ""


MACHINES: Final[dict[str, tuple[str, tuple[Model, ...]]]] = {
    "emps": ("emps", (
        Model(),
        Model(("coulomb_friction",)),
        Model(("coulomb_friction", "load"), "95.1 kg, 203.5 N·s/m, 20.39 N, 3.16 N, and 4.08 % of the signal left"),
        Model(("asymmetric_friction",), "3.11 % of the signal left"),
    )),
    "knob": ("knob", (Model(), Model(("coulomb_friction",)), Model(("coulomb_friction", "load")))),
    "kicker": ("empty", (Model((), "0.387 to 0.396 Ω, 284 to 295 µH"),)),
    "maglev": ("force", (Model(), Model(("inductance_of_distance",)))),
}  # fmt: skip
"""By the names of the files of each, the beginning of the names of its tables, and models in this order.

EMPS: Janot, Gautier, Brunot 2019. Kicker: read off by its owners, with its wiring.
"""


def answer(*words: str) -> str:
    """What a command says on stdout; SystemExit with its words where it fails."""
    print("$ valve-sim", *(word.rpartition("/")[2] for word in words), flush=True)
    found = CliRunner().invoke(valve_sim, words)
    if found.exit_code:
        raise SystemExit(found.output)
    return found.stdout


def examine(name: str, logs: Sequence[Path], models: Sequence[Model]) -> None:
    """Fit the models of a machine to these tables, and diagnose it."""
    files = EXAMPLES / f"{name}.yaml", EXAMPLES / f"{name}_map.yaml"
    plant = OwnPlant(load_plant(files[0]), [read(log, files[1]) for log in logs])
    signal = math.hypot(*(root_mean_square(own.kept(own.data)) for own in plant.channels))
    given = [*map(str, logs), "--plant", str(files[0]), "--map", str(files[1])]
    with tempfile.TemporaryDirectory() as folder:
        for model in models:
            added = [f"{effect}.{own}" for effect in model.effects for own in plant.file.effects[effect].parameters]
            print(answer("identify", *given, "--free", ",".join((*plant.base, *added)), "--output", folder), end="")
            errors = json.loads(Path(folder, "identify.json").read_text(encoding="utf-8"))["signals"]
            left = math.hypot(*(own["after"] for own in errors)) / signal
            published = f"; published: {model.published}" if model.published else ""
            print(f"{100.0 * left:.2f} % of the signal are left{published}\n", flush=True)
        print(answer("diagnose", *given, "--output", folder), flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all answers; 2 where no measurements are there."""
    known = parser("real_recordings", __doc__)
    known.add_argument("data", nargs="?", type=Path, default=DATA, help="the folder of published measurements")
    known.add_argument("--only", default=",".join(MACHINES), metavar="NAMES", help="emps,knob")
    chosen = known.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        tables = runpy.run_path(str(EXAMPLES / "make_csv.py"))["make"](chosen.data, Path(folder))
        found = {
            name: logs
            for name, (start, _) in MACHINES.items()
            if name in chosen.only.split(",") and (logs := [one for one in tables if one.name.startswith(start)])
        }
        for name, logs in found.items():
            examine(name, logs, MACHINES[name][1])
    if not found:
        print(f"{chosen.data}: holds no measurements; get them as {EXAMPLES / 'make_csv.py'} says", file=sys.stderr)
    return 0 if found else 2


if __name__ == "__main__":
    sys.exit(main())
