"""Held-out strokes only judge: they are opened when the choice is made, and can refute it.

No hypothesis is chosen, ordered or dropped by what it predicts of them, so that what they say of the choice is worth as
much as if they had been recorded afterwards. Every opening is counted, and the report says how many there were.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, effective_rmse, is_relief, rmse
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Nuisance, Plant
from valve_sim.identification.selection.predictive_density import Prediction, knowledge_for, predict_held_out
from valve_sim.identification.selection.residual_tests import adequacy, whiteness
from valve_sim.identification.selection.table import DECISIVE
from valve_sim.model import SimulationError

FAILS_HELD_OUT: Final = 1.2
"""Held-out error over noise beyond which a model is refuted; errors of its parameters add less."""
SAME: Final = 1e-9
"""Relative difference up to which two errors are equal but for rounding."""

DRAWS: Final = 32
"""Errors of the stamps that are drawn to start a fit from."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which these are compared, so that one impact at another time does not decide."""
REDRAWN: Final = 3
"""How often they are drawn, at most."""
ALIKE: Final = 0.01
"""Likewise of models that explain the same motion, one by values that their tolerances make incredible."""


class Judgement(NamedTuple):
    """What held-out data say of a model, beside the refitted declared model.

    Attributes:
        is_white: whether its residual there is noise. ratio: its error over the declared model's, root mean squares.
        predicts_better: whether it makes the held-out data decisively more probable; of a model that only brings
            declared values back within their tolerances, the training and the held-out data together.
        slack: by how much the ratio may exceed 1.
    """

    is_white: bool
    ratio: float
    predicts_better: bool
    slack: float = SAME

    @property
    def is_larger(self) -> bool:
        """Whether its error is larger than the refitted declared model's, but for rounding."""
        return self.ratio > 1.0 + self.slack

    @property
    def is_gain(self) -> bool:
        """Whether it is better than the refitted declared model, as far as held-out data can tell."""
        return self.predicts_better and not self.is_larger

    @property
    def refutes_names(self) -> bool:
        """Whether it speaks against a model with named effects."""
        return not self.is_white or not self.is_gain


NOT_HELD_OUT: Final = Judgement(is_white=True, ratio=math.nan, predicts_better=True)
"""Where there is nothing to judge by."""


class HeldOut:
    """Held-out data of a plant, and what they say of fits to its training data.

    Clock offsets are of a recording, and are estimated anew. Declared values with a tolerance are of the machine: with
    the freed parameters they stay within what the training data leave open, theory, eq. (83). What this costs is in χ²,
    so that no form is excused that the training data rule out. Without tolerances the parameters stay as they are: the
    training data leave nothing open then that matters.

    Args:
        plant: with the training data.
        problem: the same machine with other data, or with other strokes taking part; None where nothing is held out.

    Attributes:
        looks: how often they were opened to judge a choice.
    """

    def __init__(self, plant: Plant, problem: Problem | None) -> None:
        self.plant, self.problem = plant, problem
        self.looks = 0
        self._fits: dict[tuple[Fit, bool], Fit | None] = {}

    def fit(self, result: Fit, *, timing: bool) -> Fit | None:
        """The same machine on held-out data: only its recordings' errors are estimated.

        None if it cannot be simulated there.
        """
        if self.problem is None:
            return None
        key = (result, timing)
        if key not in self._fits:
            plant = self.problem.plant
            of_recording = (nuisance for nuisance in plant.nuisances if not nuisance.is_of_machine)
            nuisances: tuple[Nuisance, ...] = (*of_recording, *(plant.timing_errors if timing else ()))
            errors = (*self.plant.nuisances, *self.plant.timing_errors)
            own = {nuisance.name for nuisance in errors if not nuisance.is_of_machine}
            machine = {name: value for name, value in result.values.items() if name not in own}
            try:
                found = self._fitted(result, machine, nuisances, {})
                is_credible = timing and adequacy(result).is_white
                self._fits[key] = self._redrawn(result, machine, nuisances, found) if is_credible else found
            except SimulationError:
                self._fits[key] = None
        return self._fits[key]

    def _fitted(
        self,
        result: Fit,
        machine: Mapping[str, float],
        of_recording: Sequence[Nuisance],
        start: Mapping[str, float],
    ) -> Fit:
        """The fit to held-out data, from these errors of the recording, within what training data leave open.

        Where all declared values are exact, the machine stays as it is.
        """
        assert self.problem is not None
        tolerated = [nuisance for nuisance in result.nuisances if nuisance.is_of_machine]
        if not tolerated:
            return fit(self.problem, (), start, nuisances=of_recording, fixed=machine)
        known = knowledge_for(result)
        fixed = {name: value for name, value in machine.items() if name not in known.names}
        nuisances = (*tolerated, *of_recording)
        return fit(self.problem, result.free, {**machine, **start}, nuisances=nuisances, fixed=fixed, prior=known)

    def _redrawn(self, result: Fit, machine: Mapping[str, float], of_recording: Sequence[Nuisance], found: Fit) -> Fit:
        """The fit, again from other errors of the stamps where it may have ended in a local minimum.

        A plunger that turns beside a contact touches it or does not, by some microseconds of a stamp; a model that
        explains the training data would be refuted by where the search began.
        """
        assert self.problem is not None
        stamps = [nuisance for nuisance in of_recording if nuisance in self.problem.plant.timing_errors]
        for seed in range(REDRAWN):
            if self._is_white(found, predict_held_out(result, found)):
                break
            start = likely_stamps(self.problem, stamps, machine, seed)
            found = min(found, self._fitted(result, machine, of_recording, start), key=lambda one: one.chi2)
        return found

    def needs_timing(self, result: Fit) -> bool:
        """Whether held-out data are compared with errors of their stamps estimated.

        They are where the training data needed them, and where the model is known to be wrong, by training or by
        held-out data: there a single stroke that barely lifts the valve, or barely does not, would otherwise decide
        everything.

        Raises:
            OutOfTimeError: the time is used up.
        """
        return self.is_in_doubt(result) or (bool(self.plant.timing_errors) and self._is_missed(result))

    def is_in_doubt(self, result: Fit) -> bool:
        """Whether training data alone ask for errors of the held-out stamps; it takes no further fit to say so."""
        timed = any(nuisance in self.plant.timing_errors for nuisance in result.nuisances)
        return bool(self.plant.timing_errors) and (timed or not adequacy(result).is_white)

    def _is_missed(self, result: Fit) -> bool:
        """Whether held-out data with stamps that are true are not what a model predicts."""
        here = self.fit(result, timing=False)
        return here is not None and not self._is_white(here, predict_held_out(result, here))

    def open(self, base: Fit, *chosen: Fit) -> tuple[Judgement, ...]:
        """Judge the refitted declared model, then what was chosen, all at once: one look.

        Raises:
            OutOfTimeError: the time is used up.
        """
        if self.problem is None:
            return (NOT_HELD_OUT,) * (1 + len(chosen))
        self.looks += 1
        return tuple(self._judge(result, base) for result in (base, *chosen))

    def _judge(self, result: Fit, base: Fit) -> Judgement:
        timing = self.needs_timing(result)
        # Errors are compared with the stamps' errors estimated, but no stamps excuse what training data have not shown.
        is_missed = timing and not self.is_in_doubt(result)
        here, there = self.fit(result, timing=timing), self.fit(base, timing=timing)
        if here is None:
            return Judgement(is_white=False, ratio=1.0 if there is None else math.inf, predicts_better=False)
        prediction = predict_held_out(result, here)
        only_credible = is_relief(base, result)
        known = base.score - result.score if only_credible else 0.0
        predicts_better = there is None or (
            prediction.neg2_log_density < predict_held_out(base, there).neg2_log_density - DECISIVE + known
        )
        error, reference = effective_rmse(here), 0.0 if there is None else effective_rmse(there)
        ratio = error / reference if reference > 0.0 else 1.0 if there is not None and error == 0.0 else math.inf
        if there is None:
            ratio = 0.0
        slack = ALIKE if only_credible else SAME
        return Judgement(not is_missed and self._is_white(here, prediction), ratio, predicts_better, slack)

    @staticmethod
    def _is_white(held: Fit, prediction: Prediction) -> bool:
        # The plain error too: for coloured noise, whitening removes most of the slow part of any residual.
        is_large = rmse(held) > FAILS_HELD_OUT * held.problem.noise.sigma
        return not is_large and whiteness(held.problem, prediction.residuals, 0).is_white


def likely_stamps(
    problem: Problem, stamps: Sequence[Nuisance], machine: Mapping[str, float], seed: int
) -> dict[str, float]:
    """Errors of the stamps, drawn from their priors: of several draws the best for what each of them acts on."""
    random = np.random.default_rng(seed)
    costs: list[Array] = []
    draws = [
        {own.name: own.sigma * z for own, z in zip(stamps, random.standard_normal(len(stamps)).tolist(), strict=True)}
        for _ in range(DRAWS)
    ]
    for draw in draws:
        try:
            residuals = problem.residuals({**machine, **draw})
        except SimulationError:
            residuals = np.full(sum(len(channel.data) for channel in problem.plant.channels), math.inf)
        costs.append(np.log1p(np.square(residuals / ROBUST)))
    reaches = {own.name: problem.reach(own) for own in stamps}
    best = {name: int(np.argmin([cost[reach].sum() for cost in costs])) for name, reach in reaches.items()}
    return {name: draws[index][name] for name, index in best.items()}
