"""`valve-sim diagnose`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import (
    FILE,
    bags_argument,
    finite_number,
    folder_option,
    json_option,
    map_option,
    params_option,
    plant_option,
    valve_option,
)
from valve_sim.cli.printing import print_report, progress_bar, provenance
from valve_sim.cli.reading import (
    chosen_params,
    declared_valve,
    is_own,
    read_plant,
    read_recordings,
    recorded_name,
    typed_options,
)


@click.command(cls=Command)
@bags_argument
@click.option(
    "--holdout",
    metavar="BAG",
    type=FILE,
    multiple=True,
    help="Held-out recording, which judges the result and takes no part in the fit. Repeatable.",
)
@click.option(
    "--budget",
    metavar="SECONDS",
    type=finite_number(1.0),
    default=120.0,
    help="Work that the search may do: 4,000 simulated strokes for each second, on any machine.",
)
@click.option("--plot", metavar="PNG", type=FILE, help="Draw the plots of report.html as a picture, too.")
@params_option
@plant_option
@valve_option
@map_option
@folder_option
@json_option
def diagnose(
    *,
    bags: tuple[Path, ...],
    holdout: tuple[Path, ...],
    budget: float,
    plot: Path | None,
    params: Path | None,
    plant: Path | None,
    name: str | None,
    output: Path,
    as_json: bool,
) -> None:
    r"""Find the effect that the model lacks.

    Refits the declared model, and fits sets of effects together with it. The report gives the probability of each set,
    and the errors before and after on the fitted strokes and on held-out ones. Without --holdout, about a quarter of
    the strokes are held out. If the budget ends the search, the verdict is less certain.
      valve-sim diagnose bags/friction --output results

    Writes DIR/report.json, report.html for people, corrected.yaml, which valve_node, simulate and validate load, and,
    if a further recording would tell candidates apart, record_next.yaml, a profile for simulate and command_profile.

    Other recordings held out; a machine of your own:
      valve-sim diagnose day_1 day_2 --holdout day_3 --params my_valve.yaml \
          --output results
      valve-sim diagnose log.csv --plant my_axis.yaml --map map.yaml \
          --output results

    Read on: docs/how_to/diagnosis.md, docs/theory/selection.md
    """
    params = chosen_params(plant, params)
    from valve_sim.files.whole_files import refuse_unwritable
    from valve_sim.identification.diagnosis.run import diagnose as diagnose_valve
    from valve_sim.identification.diagnosis.run import diagnose_plant
    from valve_sim.identification.fit.budget import Budget
    from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
    from valve_sim.identification.reporting.files import FILES, write_diagnosis

    planned = [*(output / file for file in FILES), *([] if plot is None else [plot])]
    refuse_unwritable(*planned)
    if plant is not None and is_own(plant):
        machine, other = read_plant(plant, bags), read_plant(plant, holdout) if holdout else None
        work = partial(diagnose_plant, machine, other)
    else:
        valve = declared_valve(params, recorded_name(bags, name) if params else None)
        traces, held_out = read_recordings(bags, name, valve), read_recordings(holdout, name, valve)
        work = partial(diagnose_valve, traces, held_out, valve)
    with progress_bar() as progress:
        result = work(progress, Budget.of_seconds(budget))
    document = diagnosis_document(result)
    report = document.to_json()
    origin = provenance(params, [report["verdict"]["summary"]])
    written = write_diagnosis(result, output, origin, plot, report=report, options=typed_options(params, name))
    print_report(report, document.to_text(), written, as_json)
