"""How the inputs of a machine of a plant file are joined between samples: held, or straight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from valve_sim.identification.estimation.descent import SolverOptions
from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.protocol import Array, primary_channels
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.model.errors import SimulationError
from valve_sim.traces.columns import Columns

DECISIVE: Final = 0.5
"""Of the squared error, below which another convention between samples is said to fit better."""


@dataclass(frozen=True)
class OtherConvention:
    """An input that is held between samples, or straight, where the other would explain far more.

    Attributes:
        name: the input. held: whether it was taken to be held. before, after: rms error of the primary signal as it was
            taken, and by the other convention, everything refitted, in `unit`.
    """

    name: str
    held: bool
    before: float
    after: float
    unit: str


def better_conventions(found: Fit) -> tuple[OtherConvention, ...]:
    """Inputs whose convention between samples, held or straight, the data of a fit contradict.

    A level that is held acts half a sample later than a straight line does. Each input is taken the other way, and what
    was fitted is fitted once more from where it ended.
    """
    plant = found.problem.plant
    if not isinstance(plant, OwnPlant) or not plant.file.states:
        return ()
    better, before = [], _squared(found.problem, plant.predict(found.values))
    first = primary_channels(plant)[0]
    for name, entry in plant.file.inputs.items():
        held = [entry.held if own[name].held is None else bool(own[name].held) for own in plant.recordings]
        recordings = [
            Columns(own.source, {**own.columns, name: replace(own[name], held=not was)}, own.findings)
            for own, was in zip(plant.recordings, held, strict=True)
        ]
        other = OwnPlant(plant.file, recordings)
        problem = Problem(other, noises=found.problem.noises)
        try:
            again = fit(
                problem, found.free, found.values, nuisances=found.nuisances, effort=SolverOptions(is_near=True)
            )
        except SimulationError:
            continue
        shown = other.predict(again.values)
        if _squared(problem, shown) < DECISIVE * before:
            channel, was = plant.channels[first], plant.predict(found.values)[first]
            errors = [root_mean_square(channel.kept(channel.data - one)) for one in (was, shown[first])]
            better.append(OtherConvention(name, held[0], errors[0], errors[1], channel.unit))
    return tuple(better)


def _squared(problem: Problem, shown: Sequence[Array]) -> float:
    """Squared errors of all channels, each in its noise."""
    channels = enumerate(problem.plant.channels)
    return math.fsum(
        sum_squares(own.kept(own.data - shown[index])) / problem.noise_of(index).sigma ** 2 for index, own in channels
    )
