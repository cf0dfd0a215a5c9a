"""What a plant of a user's own equations would show, without anything being measured."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from valve_sim.files.plant_entries import PlantFileError
from valve_sim.files.plant_files import PlantFile
from valve_sim.files.recording_map import MapError
from valve_sim.identification.plants.own import Run, delayed, inputs_of, late
from valve_sim.identification.plants.protocol import Array
from valve_sim.model.core.hybrid.system import EquationsError
from valve_sim.model.core.own.simulation import Event, Machine, level_at, without_straight
from valve_sim.model.errors import SimulationError
from valve_sim.recordings.columns import Columns


class Simulated(NamedTuple):
    """Inputs and outputs over time, in the units of the file, by name; and the events with a name."""

    columns: dict[str, Array]
    events: tuple[Event, ...]


def simulate_plant(
    file: PlantFile, recording: Columns | None, duration: float | None = None, rate: float = 1000.0
) -> Simulated:
    """What a plant would show.

    Args:
        file: the plant; states that start free start at 0. recording: of its inputs; None: it has none.
        duration: s; default as long as the recording. rate: samples a second where there is no recording.

    Raises:
        MapError: the recording lacks an input. SimulationError: the plant cannot be simulated.
    """
    if recording is None:
        times = np.arange(round((duration or 0.0) * rate) + 1) / rate
    else:
        for name in file.inputs:
            if name not in recording.columns:
                raise MapError(
                    f"{recording.source}: holds no column for the input {name}; add {name}: {{column: ...}} to the map"
                )
        times = np.unique(np.concatenate([column.times for column in recording.columns.values()]))
        if duration is not None:
            times = times[times <= times[0] + duration]
    try:
        machine = Machine(file.equations(), ())
    except EquationsError as error:
        raise PlantFileError(f"{file.path}: {error}") from error
    inputs = inputs_of(file, recording)
    acting = delayed(without_straight(inputs), [own.delay for own in file.inputs.values()])
    numbers = {name: own.value for name, own in file.parameters.items()}
    start = {name: own.start or 0.0 for name, own in file.states.items()}
    try:
        begins = float(min(times[0], inputs.times[0]) if len(inputs.times) else times[0])
        run = Run(0, 0, begins, acting, times, {name: np.arange(len(times)) for name in file.outputs})
        samples, rows = late(run, {name: own.delay for name, own in file.outputs.items()})
        shown, _, events, _ = machine.run(numbers, start, acting, samples, start_time=begins)
    except SimulationError as error:
        raise SimulationError(f"{file.path}: {error}") from error
    found = {"time": times}
    for place, (name, entry) in enumerate(file.inputs.items()):
        levels = level_at(times, inputs.times, inputs.levels[:, place], is_held=inputs.held[place])
        found[name] = levels / entry.unit.factor
    for place, (name, output) in enumerate(file.outputs.items()):
        found[name] = shown[rows[name], place] / output.unit.factor
    return Simulated(found, events)
