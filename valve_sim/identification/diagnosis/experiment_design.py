"""What to record next: of the possible experiments, the one that separates the candidates best.

A recording is simulated as if one hypothesis were the truth, and the other is refitted to it: the root of the minimal
χ² is the number of standard deviations by which they differ there, theory, eq. (59). (Linear differences will not do:
where a pulse barely lifts the valve they promise ten times what a refit leaves.) Existing recordings would constrain
the refit, so two hypotheses differ by at least that. A recording is rated by its least separated pair.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from valve_sim.identification.fit.held_out import machine_values
from valve_sim.identification.fit.priors import Normal
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit, fit
from valve_sim.identification.fit.unknown import unknowns_of
from valve_sim.identification.plants.protocol import Experiment
from valve_sim.model import SimulationError

TELLS_APART: Final = 5.0
"""Standard deviations by which a pair must be separated."""
FEWEST_REPEATS, MOST_REPEATS = 4, 25
"""Repeats of an experiment: every fourth stroke is held out; one that needs more than 25 is not recommended."""


@dataclass(frozen=True)
class Recommendation:
    """An experiment, and by how many standard deviations it separates each pair of candidates."""

    experiment: Experiment
    separations: Mapping[tuple[str, str], float]

    @property
    def pair(self) -> tuple[str, str]:
        """The least separated pair."""
        return min(self.separations, key=self.separations.__getitem__)

    @property
    def separation(self) -> float:
        """Separation of the least separated pair by one such experiment, standard deviations."""
        return self.separations[self.pair]

    @property
    def repeats(self) -> int:
        """How many such experiments separate every pair by `TELLS_APART`: their χ² add up."""
        if self.separation <= TELLS_APART / math.sqrt(MOST_REPEATS + 1):
            return MOST_REPEATS + 1
        return max(FEWEST_REPEATS, math.ceil((TELLS_APART / self.separation) ** 2))

    @property
    def together(self) -> tuple[tuple[tuple[str, str], float], ...]:
        """Each pair, and by how many standard deviations all repeats together separate it; the least first."""
        found = ((pair, separation * math.sqrt(self.repeats)) for pair, separation in self.separations.items())
        return tuple(sorted(found, key=lambda item: item[1]))


def recommend(candidates: Mapping[str, Fit], experiments: Sequence[Experiment]) -> Recommendation | None:
    """The experiment whose least separated pair of candidates is the most separated.

    Returns:
        None where no experiment separates them, or there are fewer than two candidates.
    """
    best = None
    for experiment in experiments:
        best = _judge(candidates, experiment, 0.0 if best is None else best.separation) or best
    return best if best is not None and best.repeats <= MOST_REPEATS else None


def _judge(candidates: Mapping[str, Fit], experiment: Experiment, least: float) -> Recommendation | None:
    """How well an experiment separates the candidates.

    None where one of them cannot be simulated, or as soon as two are not separated by more than the `least`.
    """
    apart: dict[tuple[str, str], float] = {}
    for one, other in itertools.combinations(candidates, 2):
        for truth, rival in ((one, other), (other, one)):
            try:
                found = _left_of(experiment, candidates[truth], candidates[rival])
            except SimulationError:
                return None
            if found <= least:
                return None
            apart[one, other] = min(found, apart.get((one, other), math.inf))
    return Recommendation(experiment, apart) if apart else None


def _left_of(experiment: Experiment, truth: Fit, rival: Fit) -> float:
    """Standard deviations by which a recording of `truth` differs from the refit of `rival`."""
    plant = experiment.simulated(machine_values(truth))
    problem = Problem(plant, noises=truth.problem.noises, budget=truth.problem.budget)
    # A declared value with a tolerance may move again, from where the data at hand have left it.
    known = [
        replace(own, prior=Normal(rival.values.get(own.name, own.prior.mean), own.prior.sigma))
        if own.of_machine and isinstance(own.prior, Normal)
        else own
        for own in unknowns_of(plant).known
    ]
    freed = [own for own in rival.model.moving if own.is_freed]
    movable = {own.name for own in (*freed, *known)}
    held = {name: value for name, value in machine_values(rival).items() if name not in movable}
    return math.sqrt(fit(problem, [*freed, *known], rival.values, held=held).chi2)
