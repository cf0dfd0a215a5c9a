"""`valve-sim fit-force`."""

from __future__ import annotations

from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, finite_number, folder_option, json_option, map_option, params_option
from valve_sim.cli.printing import print_report, provenance
from valve_sim.cli.reading import chosen_map_file, declared_valve
from valve_sim.files.json_text import json_text


@click.command("fit-force", cls=Command)
@click.argument("file", type=FILE)
@params_option
@map_option
@click.option("--degree", type=int, default=3, help="Degree of the polynomial, up to 3.")
@click.option(
    "--voltage", metavar="V", type=finite_number(), help="Voltage of the table. Default: valve.reference_voltage."
)
@click.option("--no-constant", is_flag=True, help="Leave a0 out, as the paper does; the report says what that means.")
@folder_option
@json_option
def fit_force(
    *,
    file: Path,
    params: Path | None,
    degree: int,
    voltage: float | None,
    no_constant: bool,
    output: Path,
    as_json: bool,
) -> None:
    r"""Fit the attraction to a static table.

    FILE is a CSV with the columns displacement (m) and force (N), measured at one voltage with load cell and stage:
      printf 'displacement,force\n0,1.6\n3e-4,4.4\n6e-4,6.8\n9e-4,9.5\n12e-4,17' \
          > force.csv
      valve-sim fit-force force.csv --output results

    Writes DIR/fit-force.json, DIR/fit-force.png (force and residuals) and DIR/attraction.yaml, which valve_node and
    all commands load: the polynomial and the covariance of its coefficients (tolerances.attraction_covariance).

    With --map it may be any table that the other commands read. The map of a column Weg in mm and a column Kraft in N:
      displacement: {column: Weg, unit: mm}
      force: {column: Kraft, unit: N}

    Another voltage than the declared one:
      valve-sim fit-force force_12V.csv --voltage 12 --params my_valve.yaml \
          --output results

    Read on: docs/how_to/tolerances.md
    """
    from valve_sim.files.parameter_files import save_valve
    from valve_sim.files.recording_map import load_force_map
    from valve_sim.files.whole_files import write_whole
    from valve_sim.identification.fit.static_force import fit_static_force
    from valve_sim.identification.reporting.figures import save_plots
    from valve_sim.identification.reporting.finding_sentences import remarks
    from valve_sim.identification.reporting.identification_document import static_force_document

    map_file = chosen_map_file()
    sources = None if map_file is None else load_force_map(map_file)
    valve = declared_valve(params)
    result = fit_static_force(file, valve, sources, degree=degree, voltage=voltage, constant=not no_constant)
    report, picture, parameters = (output / f for f in ("fit-force.json", "fit-force.png", "attraction.yaml"))
    document = static_force_document(result)
    write_whole(report, json_text(document.to_json()))
    save_plots(document, picture)
    notes = ["attraction_polynomial: fitted", *remarks(result.findings)]
    save_valve(parameters, result.valve, provenance(params, notes))
    print_report(document.to_json(), document.to_text(), (report, picture, parameters), as_json)
