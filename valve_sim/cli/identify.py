"""`valve-sim identify`."""

from __future__ import annotations

from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import bags_argument, folder_option, json_option, map_option, params_option, valve_option
from valve_sim.cli.printing import print_report, progress_bar, provenance, refuse
from valve_sim.cli.reading import declared_valve, read_recordings
from valve_sim.files.json_text import json_text
from valve_sim.files.ledger import plan_files


@click.command(cls=Command)
@bags_argument
@params_option
@click.option(
    "--free",
    metavar="A,B",
    default="pilot_damping,main_damping",
    help="What to refit: declared parameters (a0 ... a3: the polynomial) and effects, e.g. coulomb_friction.force.",
)
@valve_option
@map_option
@folder_option
@json_option
def identify(
    *, bags: tuple[Path, ...], params: Path | None, free: str, name: str | None, output: Path, as_json: bool
) -> None:
    """Refit parameters to recordings.

    Reports each value with its 95 % interval, and which values the data do not determine. Writes DIR/identify.json and
    DIR/identified.yaml, which valve_node, simulate and validate load.

      valve-sim identify strokes.mcap --output results
      valve-sim identify day_1 day_2 --free pilot_damping,main_damping,a0 --params my_valve.yaml --output results
      valve-sim validate tomorrow.mcap --params results/identified.yaml
    """
    from valve_sim.files.parameter_files import save_valve
    from valve_sim.files.whole_files import refuse_unwritable, write_whole
    from valve_sim.identification.estimation.identify import identify as refit
    from valve_sim.identification.reporting.identification import identification_json, identification_text

    written = (output / "identify.json", output / "identified.yaml")
    plan_files(*written)
    refuse_unwritable(*written)
    valve = declared_valve(params)
    names = tuple(dict.fromkeys(part.strip() for part in free.split(",") if part.strip()))
    if not names:
        refuse(f"--free {free!r}: found no name, expected names separated by commas")
    traces = read_recordings(bags, name, valve)
    with progress_bar() as progress:
        result = refit(traces, valve, names, progress)
    report = identification_json(result)
    write_whole(output / "identify.json", json_text(report))
    values = [f"{key}: {interval.value:.6g} ± {interval.stderr:.2g}" for key, interval in result.intervals.items()]
    save_valve(output / "identified.yaml", result.valve, provenance(params, [f"identified: {', '.join(values)}"]))
    print_report(report, identification_text(result), written, as_json)
