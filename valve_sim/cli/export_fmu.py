"""`valve-sim export-fmu`."""

from __future__ import annotations

from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, json_option, params_option
from valve_sim.cli.printing import print_json
from valve_sim.cli.reading import declared_valve


@click.command("export-fmu", cls=Command)
@params_option
@click.option("--output", metavar="FILE", type=FILE, required=True, help="The unit to write, x.fmu.")
@json_option
def export_fmu(*, params: Path | None, output: Path, as_json: bool) -> None:
    """Write the valve as an FMU for other simulation tools.

    The unit is for co-simulation (FMI 2.0):
      valve-sim export-fmu --params config/valve.yaml --output valve.fmu

    Inputs are coil_voltage and, of a valve with gas, inlet_pressure and demand_pressure; outputs are pilot_position,
    main_position, pilot_velocity, coil_current, phase, is_open and, with gas, outlet_pressure and mass_flow. Parameters
    have the names of the parameter file, such as valve.spring_rate. Events are located exactly inside a step, so that
    the motion does not depend on the step size, and the state can be kept and set, so that a master can step back.

    The unit runs this package, so the tool that loads it needs a Python with valve_sim, on Linux. The command needs
    the extra fmi:
      pip install '.[fmi]'

    Read on: docs/how_to/fmu.md
    """
    from valve_sim.fmu.export import NEEDED, export_unit
    from valve_sim.fmu.variables import variables_of

    valve = declared_valve(params)
    export_unit(output, valve)
    variables = variables_of(valve)
    if as_json:
        print_json({"output": output, "fmi": "2.0", "variables": [entry._asdict() for entry in variables]})
        return
    click.echo(f"wrote {output} (FMI 2.0, {len(variables)} variables)")
    click.echo(NEEDED)
