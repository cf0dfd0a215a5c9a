"""Check a machine of a plant file against its recordings: nothing of the machine is estimated.

Starts that are free, and errors of the recordings that their maps declare, are. A recording is judged in the parts that
a hold-out takes, each of its signals by itself.
"""

from __future__ import annotations

import itertools

import numpy as np

from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit, fit
from valve_sim.identification.fit.unknown import known
from valve_sim.identification.plants.protocol import Array, Channel, Direction, Plant, finite_prediction
from valve_sim.identification.validation.replay import Allowed, Compared, Replay, Validation
from valve_sim.recordings import Signal


def validate_plant(plant: Plant, tolerance: float | None = None) -> Validation:
    """Check a declared machine against its recordings.

    The tolerances of declared values widen what is allowed, each by what it leaves once starts and errors of the
    recordings are estimated.

    Args:
        plant: with its recordings. tolerance: largest rms error of the first output, SI; default three times what noise
            and tolerances let expect.

    Raises:
        SimulationError: the declared machine cannot be simulated.
    """
    finite_prediction(plant, {})
    problem = Problem(plant)
    own = [*plant.nuisances, *plant.timing_errors]
    found = fit(problem, [known(one) for one in own if not one.is_of_machine], {})
    replays = []
    for index, (channel, shown, left) in enumerate(
        zip(plant.channels, plant.predict(found.values), _left_by_tolerances(found), strict=True)
    ):
        noise = problem.noise_of(index).sigma
        allowed: Allowed | float = Allowed(noise**2 + np.sum(np.square(left), axis=1), 0.0)
        if tolerance is not None and channel.kind == plant.channels[0].kind:
            allowed = tolerance
        replays.append(_replayed(channel, shown, allowed, noise))
    return Validation(tuple(replays))


def _replayed(channel: Channel, shown: Array, allowed: Allowed | float, noise: float) -> Replay:
    """One signal of one recording, part by part."""
    measured, unknown = Signal(channel.times, channel.data), np.zeros(len(shown), dtype=bool)
    compared = Compared(measured, shown, unknown, allowed, channel.left_out)
    edges = [0, *(np.flatnonzero(np.diff(channel.group)) + 1).tolist(), len(shown)]
    parts = ((f"part {channel.group[own[0]] + 1}", slice(*own), ()) for own in itertools.pairwise(edges))
    return Replay(
        channel.name, channel.kind, channel.unit, measured, shown, noise, compared.errors(), compared.checks(parts)
    )  # fmt: skip


def _left_by_tolerances(found: Fit) -> list[Array]:
    """(n, k) of each channel: what each declared value, off by its tolerance, would leave of it.

    Starts and errors of a recording are estimated from that recording, and take up what they can of a wrong value: to
    count the whole of it would allow far more than such a value can leave.
    """
    problem, plant = found.problem, found.problem.plant
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
