"""The commands with `--plant`: a machine of a user's own equations in the place of the valve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from valve_sim.cli.printing import print_json, refuse, shown
from valve_sim.cli.reading import chosen_map_file

if TYPE_CHECKING:
    from valve_sim.identification.plants.own import OwnPlant


def is_own(plant: Path | None) -> bool:
    """Whether --plant names a machine that is no valve."""
    if plant is None:
        return False
    from valve_sim.files.plant_files import is_own_plant

    return is_own_plant(plant)


def chosen_params(plant: Path | None, params: Path | None) -> Path | None:
    """The parameter file of a valve, which --plant may name, too."""
    if plant is not None and params is not None:
        refuse("--plant and --params: both name what is declared; give one of them")
    return plant if params is None else params


def read_plant(plant: Path, logs: Sequence[Path]) -> OwnPlant:
    """A plant with its recordings; what was dropped on reading, and how inputs are joined, is said on stderr."""
    import numpy as np

    from valve_sim.files.plant_files import load_plant
    from valve_sim.identification.plants.own import OwnPlant
    from valve_sim.traces.columns import Columns, read

    file = load_plant(plant)
    recordings = []
    for log in logs:
        recording = read(log, chosen_map_file())
        if chosen_map_file() is None:  # a table whose columns have the plant's names, and perhaps others beside them
            own = {name: own for name, own in recording.columns.items() if name in {**file.inputs, **file.outputs}}
            recording = Columns(recording.source, own, recording.findings)
        for finding in recording.findings:
            click.echo(shown(f"valve-sim: {log}: {finding}"), err=True)
        recordings.append(recording)
    plant_with_data = OwnPlant(file, recordings)
    for finding in plant_with_data.findings:
        click.echo(shown(f"valve-sim: {finding}"), err=True)
    for name in file.inputs if file.states else ():
        column = recordings[0][name]
        held = file.inputs[name].held if column.held is None else column.held
        half = 500.0 * float(np.median(np.diff(column.times))) if len(column.times) > 1 else 0.0
        taken = (
            "held between samples; straight lines would act earlier"
            if held
            else ("straight between samples; held levels would act later")
        )
        click.echo(f"valve-sim: {name} is {taken} by half of one, {half:.3g} ms", err=True)
    return plant_with_data


def simulate_own(
    plant: Path,
    log: Path | None,
    span: tuple[float | None, float],
    noise_seed: int | None,
    output: Path,
    *,
    as_json: bool,
) -> None:
    """`simulate --plant`: what its sensors would show, as a table in the units of its file."""
    import numpy as np

    from valve_sim.files.plant_files import load_plant
    from valve_sim.files.whole_files import write_whole
    from valve_sim.identification.plants.own_simulation import simulate_plant
    from valve_sim.traces.columns import read

    if output.suffix != ".csv":
        refuse(f"--output {output}: expected x.csv, a table, with --plant")
    file = load_plant(plant)
    recording = None if log is None else read(log, chosen_map_file())
    if recording is None and file.inputs:
        refuse(f"--plant {plant}: has inputs ({', '.join(file.inputs)}); give a LOG that holds them, with --map")
    duration, rate = span
    if recording is None and duration is None:
        refuse("--duration: is missing; give it, or a LOG")
    columns = simulate_plant(file, recording, duration, rate)
    if noise_seed is not None:
        random = np.random.default_rng(noise_seed)
        for name, own in file.outputs.items():
            columns[name] = columns[name] + random.normal(0.0, (own.noise or 0.0) / own.unit.factor, len(columns[name]))
    header, rows = ",".join(columns), np.column_stack(list(columns.values()))
    lines = [header, *(",".join(f"{value:.12g}" for value in row) for row in rows.tolist())]
    write_whole(output, "\n".join(lines) + "\n")
    if as_json:
        print_json({"output": output, "samples": len(columns["time"]), "columns": list(columns)})
        return
    click.echo(f"wrote {output} ({len(columns['time'])} samples: {', '.join(columns)})")
