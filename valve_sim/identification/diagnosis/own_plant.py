"""Check a plant of a user's own equations, and how its inputs are joined between samples."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from valve_sim.identification.estimation.descent import SolverOptions
from valve_sim.identification.estimation.gram import gram, sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.check import check_plant
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.protocol import Array, Direction, primary_channels
from valve_sim.identification.plants.root_mean_square import root_mean_square
from valve_sim.model.errors import SimulationError
from valve_sim.traces.columns import Columns

DECISIVE: Final = 0.5
"""Of the squared error, below which another convention between samples is said to fit better."""
TIMES_PREDICTED: Final = 3.0
"""Standard deviations that are predicted, within which a recording is by default."""


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


@dataclass(frozen=True)
class PartChecked:
    """One part of a recording: its rms error and what was allowed, SI."""

    channel: str
    unit: str
    group: int
    rmse: float
    allowed: float

    @property
    def passed(self) -> bool:
        """Whether it is within what was allowed."""
        return self.rmse <= self.allowed


@dataclass(frozen=True)
class PlantValidation:
    """A declared plant beside recordings, part by part."""

    plant: OwnPlant
    parts: tuple[PartChecked, ...]

    @property
    def passed(self) -> bool:
        """Whether all parts are within what was allowed."""
        return all(part.passed for part in self.parts)


def _left_by_tolerances(found: Fit) -> list[Array]:
    """(n, k) of each channel: what each declared value, off by its tolerance, would leave of it.

    Starts and errors of a recording are estimated from that recording, and take up what they can of a wrong value: to
    count the whole of it would allow far more than such a value can leave.
    """
    problem, plant = found.problem, found.problem.plant
    assert isinstance(plant, OwnPlant)
    known = [nuisance for nuisance in plant.nuisances if nuisance.is_of_machine]
    if not known:
        return [np.zeros((len(channel.data), 0)) for channel in plant.channels]
    own, count = found.nuisances, len(known)
    directions = [Direction({nuisance.name: nuisance.sigma}, 1e-3) for nuisance in (*known, *own)]
    values = {**found.values, **{nuisance.name: nuisance.mean for nuisance in known}}
    columns = plant.sensitivities(values, directions).columns
    weights = [
        (1.0 if channel.left_out is None else ~channel.left_out) / problem.noise_of(index).sigma
        for index, channel in enumerate(plant.channels)
    ]
    rows = np.concatenate([each * np.reshape(weight, (-1, 1)) for each, weight in zip(columns, weights, strict=True)])
    declared, estimated = rows[:, :count], rows[:, count:]
    taken = np.linalg.solve(gram(estimated, estimated) + np.eye(len(own)), gram(estimated, declared))
    return [each[:, :count] - each[:, count:] @ taken for each in columns]


def validate_plant(plant: OwnPlant, tolerance: float | None = None) -> PlantValidation:
    """Check a declared plant against recordings: nothing of the machine is estimated.

    Starts that are free, and errors of each recording that its map declares, are estimated. The tolerances of declared
    values widen what is allowed, each by what it leaves once these are estimated.

    Args:
        plant: with its recordings. tolerance: largest rms error of the first output, SI; default three times what noise
            and tolerances let expect.

    Raises:
        SimulationError: the declared plant cannot be simulated.
    """
    check_plant(plant)
    own = [nuisance for nuisance in plant.nuisances if not nuisance.is_of_machine]
    problem = Problem(plant)
    found = fit(problem, (), {}, nuisances=own)
    shown = plant.predict(found.values)
    columns = _left_by_tolerances(found)
    first = plant.channels[0].kind
    parts = []
    for index, channel in enumerate(plant.channels):
        noise = problem.noise_of(index).sigma
        for group in np.unique(channel.group):
            chosen = (channel.group == group) & (True if channel.left_out is None else ~channel.left_out)
            if not chosen.any():
                continue
            spread = float(np.mean(np.sum(np.square(columns[index][chosen]), axis=1)))
            allowed = TIMES_PREDICTED * math.sqrt(noise**2 + spread)
            if tolerance is not None and channel.kind == first:
                allowed = tolerance
            error = root_mean_square((channel.data - shown[index])[chosen])
            parts.append(PartChecked(channel.name, channel.unit, int(group), error, allowed))
    return PlantValidation(plant, tuple(parts))
