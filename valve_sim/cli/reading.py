"""What commands read: parameters, maps, recordings."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from valve_sim.cli.options import MAP_KEY
from valve_sim.cli.printing import refuse, shown

if TYPE_CHECKING:
    from valve_sim.files.recording_map import RecordingMap
    from valve_sim.identification.plants.own import OwnPlant
    from valve_sim.model import Valve, ValveParameters
    from valve_sim.recordings import Trace


def declared_valve(params: Path | None, recorded: str | None = None) -> Valve:
    """The valve of a parameter file, for a recording of the valve of this name; or the shipped one."""
    from valve_sim.files.parameter_files import default_valve, load_recorded_valve

    return default_valve() if params is None else load_recorded_valve(params, recorded)


def recorded_name(bags: Sequence[Path], name: str | None) -> str | None:
    """The name of the valve in recordings, as it was chosen or as the only one that the first holds."""
    from valve_sim.recordings import list_valves

    valves = [name] if name or not bags else list_valves(bags[0], chosen_map())
    return valves[0] if len(valves) == 1 else None


def declared_parameters(params: Path | None, recorded: str | None = None) -> ValveParameters:
    """The declared parameters alone of a parameter file, or of the shipped one, which needs no compiled code."""
    from valve_sim.files.parameter_sections import default_parameters

    return default_parameters() if params is None else declared_valve(params, recorded).parameters


def chosen_map_file() -> Path | None:
    """The file given as --map."""
    path: Path | None = click.get_current_context().meta.get(MAP_KEY)
    return path


def chosen_map() -> RecordingMap | None:
    """The map of a recording given as --map."""
    from valve_sim.files.recording_map import load_map

    path = chosen_map_file()
    return None if path is None else load_map(path)


def typed_options(params: Path | None, name: str | None) -> str:
    """The options that say which valve is meant and where its signals are, as they were typed."""
    given = {"--params": params, "--map": chosen_map_file(), "--valve": name}
    return shlex.join([str(word) for option, value in given.items() if value is not None for word in (option, value)])


def read_recordings(bags: Sequence[Path], name: str | None, valve: Valve) -> list[Trace]:
    """Read recordings. What was dropped or repaired is reported on stderr; numbers in another unit are refused."""
    from valve_sim.recordings import another_valve, left_out_finding, read_trace, refuse_doubtful_units

    traces, recording_map = [], chosen_map()
    for bag in bags:
        # No fit or check asks for the main plunger, and of a long recording it is large.
        trace = replace(read_trace(bag, name, recording_map), main_position=None)
        refuse_doubtful_units(trace, valve.parameters)
        for finding in (*trace.findings, *left_out_finding(trace), *another_valve(trace, valve.parameters)):
            click.echo(shown(f"valve-sim: {bag}: {finding}"), err=True)
        traces.append(trace)
    return traces


# --- machines of a user's own, with --plant ---


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
    """A plant with its recordings; stderr has what reading dropped, and how inputs are joined."""
    import numpy as np

    from valve_sim.files.plant_files import load_plant
    from valve_sim.identification.plants.own import OwnPlant
    from valve_sim.recordings.columns import Columns, read

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
