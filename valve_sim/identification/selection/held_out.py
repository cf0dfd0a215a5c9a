"""What a fit is worth on strokes that it was not fitted to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, rmse
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Nuisance, Plant
from valve_sim.identification.selection.predictive_density import knowledge_for, neg2_log_predictive
from valve_sim.identification.selection.residual_tests import adequacy
from valve_sim.model import SimulationError

FAILS_HELD_OUT: Final = 1.2
"""Held-out error over noise beyond which an effect is rejected; errors of its parameters add less."""


class HeldOut:
    """Held-out data of a plant, and how fits to its training data predict them.

    Clock offsets are of a recording, and are estimated anew. Declared values with a tolerance are of the machine: with
    the freed parameters they stay within what the training data leave open, theory, eq. (83). What this costs is in χ²,
    so that no form is excused that the training data rule out. Without tolerances the parameters stay as they are: the
    training data leave nothing open then that matters.

    Args:
        plant: with the training data.
        problem: the same machine with other data, or with other strokes taking part; None where nothing is held out.
    """

    def __init__(self, plant: Plant, problem: Problem | None) -> None:
        self.plant, self.problem = plant, problem
        self._fits: dict[tuple[Fit, bool], Fit | None] = {}
        self._scores: dict[tuple[Fit, bool, bool], float] = {}

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
                self._fits[key] = self._updated(result, machine, nuisances) or fit(
                    self.problem, (), {}, nuisances=nuisances, fixed=machine
                )
            except SimulationError:
                self._fits[key] = None
        return self._fits[key]

    def _updated(self, result: Fit, machine: Mapping[str, float], of_recording: Sequence[Nuisance]) -> Fit | None:
        """The fit to held-out data within what training data leave open; None where all declared values are exact."""
        assert self.problem is not None
        tolerated = [nuisance for nuisance in result.nuisances if nuisance.is_of_machine]
        if not tolerated:
            return None
        known = knowledge_for(result)
        fixed = {name: value for name, value in machine.items() if name not in known.names}
        nuisances = (*tolerated, *of_recording)
        return fit(self.problem, result.free, machine, nuisances=nuisances, fixed=fixed, known=known)

    def needs_timing(self, result: Fit) -> bool:
        """Whether held-out data are compared with errors of their stamps estimated.

        They are where the training data needed them, and where the model is known to be wrong: there a single stroke
        that barely lifts the valve, or barely does not, would otherwise decide everything.
        """
        timed = any(nuisance in self.plant.timing_errors for nuisance in result.nuisances)
        return bool(self.plant.timing_errors) and (timed or not adequacy(result).is_white)

    def improves_holdout(self, smaller: Fit, larger: Fit) -> bool:
        """Whether the larger model predicts held-out data better by more than 2 standard errors: theory, eq. (47)."""
        timing = self.needs_timing(larger)
        held_smaller, held_larger = self.fit(smaller, timing=timing), self.fit(larger, timing=timing)
        if held_smaller is None or held_larger is None:
            return self.problem is None or held_larger is not None
        gain = held_smaller.chi2 - held_larger.chi2
        apart = float(np.sum(np.square(held_smaller.residuals - held_larger.residuals)))
        # If the larger model is true, the gain is `apart` on average, with standard deviation 2 √apart.
        return gain > 4.0 * math.sqrt(apart)

    def fails(self, result: Fit) -> bool:
        """Whether the residual of a fit on held-out data is larger than the noise."""
        held = self.fit(result, timing=self.needs_timing(result))
        if held is None:
            return self.problem is not None
        # The plain error too: for coloured noise, whitening removes most of the slow part of any residual.
        is_large = rmse(held) > FAILS_HELD_OUT * held.problem.noise.sigma
        return is_large or held.chi2 > FAILS_HELD_OUT**2 * held.problem.effective_samples

    def hints_at_more(self, result: Fit) -> bool:
        """Whether the residual of a fit on held-out data is not white."""
        held = self.fit(result, timing=self.needs_timing(result))
        return self.problem is not None and (held is None or not adequacy(held).is_white)

    def score(self, result: Fit, *, timing: bool, residual_is_white: bool) -> float:
        """The selection criterion, theory, eq. (46): S of the training data plus −2 ln of the predictive density.

        Where the form is wrong, no covariance says how far off it is, and S of the held-out data takes its place.
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
        """Held-out RMSE, for whitening would hide a slow residual; S of the training data if nothing is held out."""
        if self.problem is None:
            return result.score
        held = self.fit(result, timing=self.needs_timing(result))
        return math.inf if held is None else rmse(held)
