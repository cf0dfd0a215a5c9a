"""`valve-sim map`."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, params_option
from valve_sim.cli.printing import refuse, shown
from valve_sim.cli.reading import declared_valve


@click.command("map", cls=Command)
@click.argument("recording", type=FILE)
@params_option
@click.option("--output", metavar="FILE", type=FILE, show_default="the terminal", help="Where to write the map.")
def draft(*, recording: Path, params: Path | None, output: Path | None) -> None:
    """Draft the map of a recording with names of its own.

    RECORDING is a bag with any topics, or a table of a data logger: CSV, Parquet or MATLAB. The map says which topic
    or column is position, voltage and current, in which unit. Lines marked CHECK are guesses: compare them with what
    you know of the bench, and mend them.
      valve-sim map bags/oscilloscope.csv --output scope.yaml

    With the parameter file of the valve the guesses are better; the other commands take the map as --map:
      valve-sim map scope.csv --params my_valve.yaml --output scope.yaml
      valve-sim info scope.csv --map scope.yaml --params my_valve.yaml

    Read on: docs/how_to/your_own_recordings.md
    """
    from valve_sim.files.whole_files import write_whole
    from valve_sim.recordings.map_draft import draft_map

    if output is not None and output.exists():
        refuse(f"--output {output}: exists and may have been edited by hand; choose another name or remove it")
    text = shown(draft_map(recording, declared_valve(params).parameters, shlex.join(["valve-sim", *sys.argv[1:]])))
    if output is None:
        click.echo(text, nl=False)
        return
    write_whole(output, text)
    checks = text.count("CHECK") - 1  # one is in the heading
    declared = [] if params is None else ["--params", str(params)]
    then = shlex.join(["valve-sim", "info", str(recording), "--map", str(output), *declared])
    click.echo(shown(f"wrote {output}; read it, {checks} guesses are marked CHECK; then: {then}"))
