"""`valve-sim`, the group of all commands."""

from __future__ import annotations

import click

from valve_sim import __version__
from valve_sim.cli.command_line import CommandLine
from valve_sim.cli.diagnose import diagnose
from valve_sim.cli.draft import draft
from valve_sim.cli.export_fmu import export_fmu
from valve_sim.cli.fit_force import fit_force
from valve_sim.cli.fleet import fleet
from valve_sim.cli.history import history
from valve_sim.cli.identify import identify
from valve_sim.cli.info import info
from valve_sim.cli.simulate import simulate
from valve_sim.cli.validate import validate


@click.group(
    cls=CommandLine,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True},
    no_args_is_help=False,
)
@click.version_option(__version__, prog_name="valve-sim")
def main() -> None:
    r"""Simulate, identify, diagnose and validate a pilot-operated solenoid valve.

    From nothing to an identified valve in four lines:
      echo '[[0.01, 9], [0.04, 0], [0.07, 12], [0.10, 0]]' > strokes.yaml
      valve-sim simulate --profile strokes.yaml --duration 0.14 \
          --noise-um 1 --output strokes.mcap
      valve-sim info strokes.mcap
      valve-sim identify strokes.mcap --output results

    A recording is a rosbag2 folder or a bare .mcap file with the topics ~/coil_voltage and ~/measured/joint_states;
    with a map (valve-sim map), any other bag or table. A parameter file is a ROS 2 parameter file, the one that
    valve_node takes; without --params the shipped config/valve.yaml is used.

    Each command has a --help with an example. Examples that begin with bags/ or config/ work in a checkout; pip puts
    these folders into share/valve_sim of the Python environment.

    Read on: docs/tutorials/first_diagnosis.md
    """


for _command in (
    simulate,
    info,
    draft,
    identify,
    diagnose,
    validate,
    fit_force,
    fleet,
    export_fmu,
    history,
):
    main.add_command(_command)
