"""`valve-sim identify`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import (
    bags_argument,
    folder_option,
    json_option,
    map_option,
    params_option,
    plant_option,
    valve_option,
)
from valve_sim.cli.printing import print_report, progress_bar, provenance, refuse
from valve_sim.cli.reading import chosen_params, declared_valve, is_own, read_plant, read_recordings, recorded_name


@click.command(cls=Command)
@bags_argument
@params_option
@plant_option
@click.option(
    "--free",
    "freed",
    metavar="A,B",
    multiple=True,
    help="What to refit: declared parameters (a0 ... a3: the polynomial), of effects, e.g. coulomb_friction.force, and "
    "of gas, e.g. gas.outlet_volume.  [default: pilot_damping,main_damping; for a valve with one plunger main_damping]",
)
@valve_option
@map_option
@folder_option
@json_option
def identify(
    *,
    bags: tuple[Path, ...],
    params: Path | None,
    plant: Path | None,
    freed: tuple[str, ...],
    name: str | None,
    output: Path,
    as_json: bool,
) -> None:
    r"""Refit parameters to recordings.

    Prints each value with its 95 % interval, and says which values the data do not determine. Writes DIR/identify.json
    and DIR/identified.yaml, which valve_node, simulate and validate load.
      valve-sim identify bags/eight_strokes.mcap --output results

    Several recordings, which share the valve, with other parameters than the dampings:
      valve-sim identify day_1 day_2 --params my_valve.yaml \
          --free pilot_damping,main_damping,a0 --output results
    A machine of your own:
      valve-sim identify log.csv --plant my_axis.yaml --map map.yaml \
          --output results

    Read on: docs/tutorials/first_diagnosis.md, docs/theory/estimation.md
    """
    from valve_sim.files.whole_files import refuse_unwritable
    from valve_sim.identification.diagnosis.identify import identify as identify_valve
    from valve_sim.identification.diagnosis.identify import identify_plant
    from valve_sim.identification.reporting.files import IDENTIFIED, write_identification
    from valve_sim.identification.reporting.identification_document import identification_document

    free = ",".join(freed) if freed else None
    params = chosen_params(plant, params)
    names = None if free is None else tuple(dict.fromkeys(part.strip() for part in free.split(",") if part.strip()))
    if names == ():
        refuse(f"--free {free!r}: found no name, expected names separated by commas")
    planned = [output / file for file in IDENTIFIED]
    refuse_unwritable(*planned)
    if plant is not None and is_own(plant):
        work = partial(identify_plant, read_plant(plant, bags), names)
    else:
        valve = declared_valve(params, recorded_name(bags, name) if params else None)
        work = partial(identify_valve, read_recordings(bags, name, valve), valve, names)
    with progress_bar() as progress:
        result = work(progress)
    document = identification_document(result)
    report = document.to_json()
    written = write_identification(result, output, provenance(params, []), report=report)
    print_report(report, document.to_text(), written, as_json)
