"""What a fit is worth on strokes that it was not fitted to."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, rmse
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Nuisance, Plant
from valve_sim.identification.selection.predictive_density import neg2_log_predictive
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.model import SimulationError

FAILS_HELD_OUT: Final = 1.2
"""Held-out error over noise beyond which a name is not believed; what errors of its parameters add stays below."""


class HeldOut:
    """Held-out data of a plant, and what fits to its training data make of them.

    Args:
        plant: with the training data.
        problem: the same machine with other data, or with other strokes taking part; None where nothing is held out.
    """

    def __init__(self, plant: Plant, problem: Problem | None) -> None:
        self.plant, self.problem = plant, problem
        self._fits: dict[tuple[Fit, bool], Fit | None] = {}
        self._scores: dict[tuple[Fit, bool, bool], float] = {}

    def fit(self, result: Fit, *, timing: bool) -> Fit | None:
        """The same machine on held-out data: only the nuisances are estimated. None if it cannot be simulated there."""
        if self.problem is None:
            return None
        key = (result, timing)
        if key not in self._fits:
            plant = self.problem.plant
            nuisances: tuple[Nuisance, ...] = (*plant.nuisances, *(plant.timing_errors if timing else ()))
            own = {nuisance.name for nuisance in (*self.plant.nuisances, *self.plant.timing_errors)}
            machine = {name: value for name, value in result.values.items() if name not in own}
            try:
                self._fits[key] = fit(self.problem, (), {}, nuisances=nuisances, fixed=machine)
            except SimulationError:
                self._fits[key] = None
        return self._fits[key]

    def needs_timing(self, result: Fit) -> bool:
        """Whether held-out data are compared with errors of their stamps estimated.

        They are where training needed them, and where the model is known to be wrong anyway: there a stroke that just
        lifts the valve, or just does not, would else decide everything.
        """
        timed = any(nuisance in self.plant.timing_errors for nuisance in result.nuisances)
        return bool(self.plant.timing_errors) and (timed or not adequacy(result).is_white)

    def improves_holdout(self, simple: Fit, rich: Fit) -> bool:
        """Whether the richer model predicts held-out data better by more than 2 standard errors."""
        timing = self.needs_timing(rich)
        held_simple, held_rich = self.fit(simple, timing=timing), self.fit(rich, timing=timing)
        if held_simple is None or held_rich is None:
            return self.problem is None or held_rich is not None
        gain = held_simple.chi2 - held_rich.chi2
        apart = float(np.sum(np.square(held_simple.residuals - held_rich.residuals)))
        # The gain of the truth is `apart` on average, with standard error 2 √apart.
        return gain > 4.0 * math.sqrt(apart)

    def fails(self, result: Fit) -> bool:
        """Whether a fit leaves more than noise of held-out data."""
        held = self.fit(result, timing=self.needs_timing(result))
        if held is None:
            return self.problem is not None
        # Plainly too: where noise is coloured, whitening takes most of what is slow out of a residual, wrong or right.
        is_large = rmse(held) > FAILS_HELD_OUT * held.problem.noise.sigma
        return is_large or held.chi2 > FAILS_HELD_OUT**2 * held.problem.effective_samples

    def hints_at_more(self, result: Fit) -> bool:
        """Whether what a fit leaves of held-out data is anything but noise."""
        held = self.fit(result, timing=self.needs_timing(result))
        return self.problem is not None and (held is None or not adequacy(held).is_white)

    def score(self, result: Fit, *, timing: bool, residual_is_white: bool) -> float:
        """S of the training data, and how surprising held-out data are to what was fitted.

        Where the form is wrong, no covariance says how far off it is, and plain χ² has to do.
        """
        if self.problem is None:
            return result.score
        key = (result, timing, residual_is_white)
        if key not in self._scores:
            held = self.fit(result, timing=timing)
            if held is None:
                self._scores[key] = math.inf
            else:
                self._scores[key] = result.score + (
                    neg2_log_predictive(result, held) if residual_is_white else held.score
                )
        return self._scores[key]

    def error(self, result: Fit) -> float:
        """Plain held-out error; where no form is right, whitening would hide what is slow in it. Else the score."""
        if self.problem is None:
            return result.score
        held = self.fit(result, timing=self.needs_timing(result))
        return math.inf if held is None else rmse(held)
