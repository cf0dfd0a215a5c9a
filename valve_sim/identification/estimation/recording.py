"""Errors of a recording on a machine that stays as it is: clocks and stamps, and nothing of the machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from valve_sim.identification.estimation.findings import leaves_more_than_noise
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.estimation.state_of_recording import with_learned_errors
from valve_sim.identification.estimation.structured_noise import StructuredNoise
from valve_sim.identification.plants.protocol import Nuisance
from valve_sim.model import SimulationError

DRAWS: Final = 32
"""Errors of the stamps that are drawn to start a fit from."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which these are compared, so that one impact at another time does not decide."""
REDRAWN: Final = 3
"""Largest number of draws."""


def fit_recording(problem: Problem, machine: Mapping[str, float], known: StructuredNoise | None = None) -> Fit:
    """What a machine of known values shows of a recording, once the errors of the recording are estimated.

    Errors of the commands' stamps are among them where the evidence is for it: most recorders stamp commands well, and
    a few stamp them when they happen to receive them. A plunger that turns beside a contact touches it or does not, by
    some microseconds of a stamp: where more than noise is left, the fit begins again from other stamps.

    Errors of its sensors are as large as the problem has them; where it has none, they are learned beside the machine.

    Args:
        problem: the recording. machine: values of the machine by name; what is missing is as declared.
        known: errors of other recordings of the same machine by the same sensors.

    Raises:
        SimulationError: the machine cannot be simulated.
    """
    if problem.errors is not None:
        return _fitted(problem, machine, None)
    return with_learned_errors(problem, lambda one, begun: _fitted(one, machine, begun), known=known)[1]


def _fitted(problem: Problem, machine: Mapping[str, float], begun: Fit | None) -> Fit:
    """The best fit of clocks and stamps for given errors of the sensors, begun where another has ended, if any."""
    plant = problem.plant
    clocks = tuple(own for own in problem.nuisances if not own.is_of_machine)
    plain = fit(problem, (), {} if begun is None else begun.values, nuisances=clocks, fixed=machine)
    if not plant.timing_errors:
        return plain
    nuisances = (*clocks, *plant.timing_errors)
    stamped = fit(problem, (), plain.values, nuisances=nuisances, fixed=machine)
    best = max(plain, stamped, key=lambda found: found.log_evidence)
    for seed in range(REDRAWN):
        if not leaves_more_than_noise(best):
            break
        start = likely_stamps(problem, plant.timing_errors, {**machine, **plain.values}, seed)
        again = fit(problem, (), {**plain.values, **start}, nuisances=nuisances, fixed=machine)
        best = max(best, again, key=lambda found: found.log_evidence)
    return best


def likely_stamps(
    problem: Problem, stamps: Sequence[Nuisance], values: Mapping[str, float], seed: int
) -> dict[str, float]:
    """Errors of the stamps, drawn from their priors: of several draws the best for what each of them acts on.

    Args:
        problem: the recording. stamps: their errors. values: of all else. seed: of the draws.
    """
    random = np.random.default_rng(seed)
    costs = []
    draws = [
        {own.name: own.sigma * z for own, z in zip(stamps, random.standard_normal(len(stamps)).tolist(), strict=True)}
        for _ in range(DRAWS)
    ]
    count = sum(len(channel.data) for channel in problem.plant.channels)
    for draw in draws:
        try:
            residuals = problem.residuals({**values, **draw})
        except SimulationError:
            residuals = np.full(count, np.inf)
        costs.append(np.log1p(np.square(residuals / ROBUST)))
    reaches = {own.name: problem.every_row.reach(own) for own in stamps}
    best = {name: int(np.argmin([cost[reach].sum() for cost in costs])) for name, reach in reaches.items()}
    return {name: draws[index][name] for name, index in best.items()}
