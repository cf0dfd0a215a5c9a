"""Prediction of held-out strokes: the proof of a corrected model, and how far off it may be.

Everything of the machine that training has estimated is kept; only the errors of the held-out recording are estimated
again. What the training data leave open of the machine, and the held-out data of the errors of their recording, widens
what is predicted:

    Var(y_held) = noise² (1 + τ²) + Σ_k (∂y/∂a_k)²

along the principal axes a_k of both posteriors, one standard deviation each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.descent import descend
from valve_sim.identification.fit.gaussian import Gaussian, MachineKnowledge, Sizes
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.model import Model
from valve_sim.identification.fit.problem import Problem, weigh_outliers
from valve_sim.identification.fit.process import Process
from valve_sim.identification.fit.recordings import columns_like, fit_recording, free_of_prior, sizes_like
from valve_sim.identification.fit.result import Fit, rmse
from valve_sim.identification.plants.covariance_root import covariance_root
from valve_sim.identification.plants.protocol import Array, primary_channels
from valve_sim.model import SimulationError

ELSEWHERE: Final = 10.0
"""Standard deviations within which values lie that do not carry over to other strokes."""


class Predicted(NamedTuple):
    """The prediction of data by a model, with its standard deviation.

    Attributes:
        fit: of the errors of the recording, the machine's values kept.
        rmse: measured less predicted, in the response's unit. deviation: what the posterior predicts of that.
        bands: of each channel, (n,) standard deviation of what is predicted, noise included.
    """

    fit: Fit
    rmse: float
    deviation: float
    bands: Mapping[int, Array]


def machine_values(result: Fit) -> dict[str, float]:
    """The values of a fit that are the machine's, not its recordings', as a run takes them."""
    errors = {own.name for own in result.model.moving if not own.of_machine}
    return {name: value for name, value in result.values.items() if name not in errors}


def predicted(result: Fit, there: Fit, tau: float = 0.0) -> Predicted:
    """The prediction of data by a fit; the data may be those that were fitted.

    Args:
        result: of the training data. there: its machine's values on the data, with the errors of the recording.
        tau: τ, of something unnamed.

    Raises:
        SimulationError: the machine cannot be simulated with its own values.
    """
    problem, plant = there.problem, there.problem.plant
    values = there.values
    shown, left = plant.predict(values), problem.rows.residuals(values)
    spread = there.variance_of_errors()
    following = _Following(there)
    moves = [(moved, True) for moved in _axes_of_machine(result)]
    for moved, is_followed in [*moves, *((moved, False) for moved in _axes_of_recording(there))]:
        try:
            at = {**values, **moved}
            if is_followed:
                at |= following.values(problem.rows.residuals(at) - left)
            changed, change = plant.predict(at), problem.rows.residuals(at) - left
        except SimulationError:
            continue
        # What the sensors' errors follow is predicted as well as before.
        for index, (prediction, own) in enumerate(zip(changed, there.errors_following(change), strict=True)):
            spread[index] += np.square(prediction - shown[index] + own)
    bands = {}
    for index, channel in enumerate(plant.channels):
        noise = problem.noise_of(index).sigma ** 2 * (1.0 + tau**2 * ~channel.quiet)
        bands[index] = np.sqrt(spread[index] + noise)
    squares, count = 0.0, 0.0
    for index in primary_channels(plant):
        weights = problem.weight(index) > 0.0
        squares += float(np.sum(np.square(bands[index])[weights]))
        count += float(np.count_nonzero(weights))
    return Predicted(there, rmse(there), math.sqrt(squares / count) if count else math.nan, bands)


def _axes_of_machine(result: Fit) -> list[dict[str, float]]:
    """The machine's values moved by one standard deviation along each principal axis of their posterior."""
    own = result.of_machine
    errors = {result.names[place] for place in result.of_recordings}
    found = []
    for axis in covariance_root(result.covariance[np.ix_(own, own)]).T:
        at = result.coordinates.copy()
        at[own] += axis
        found.append({name: value for name, value in result.values_at(at).items() if name not in errors})
    return found


def _axes_of_recording(there: Fit) -> list[dict[str, float]]:
    """The errors of a recording, moved in the same way, all that is the machine's held."""
    own = there.of_recordings
    information = there.information[np.ix_(own, own)]
    scale = 1.0 / np.sqrt(np.diag(information))
    # A path that runs away from its start shows one direction so sharply that rounding hides the others.
    inverse = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    found = []
    for axis in covariance_root(inverse).T:
        at = there.coordinates.copy()
        at[own] += axis
        moved = there.values_at(at)
        found.append({there.names[place]: moved[there.names[place]] for place in own})
    return found


class _Following:
    """How the errors of a recording follow where values of the machine are others."""

    def __init__(self, there: Fit) -> None:
        self._fit, gaussian = there, there.gaussian
        k, size = gaussian.count, len(gaussian.M)
        self._own = [*there.of_recordings, *range(k, size)]
        self._moving = there.of_recordings
        self._inverse = np.linalg.pinv(gaussian.M[np.ix_(self._own, self._own)], hermitian=True)

    def values(self, change: Array) -> dict[str, float]:
        """The errors of the recording, by name, for a change of the (r,) residuals."""
        fit, sums = self._fit, self._fit.gaussian.sums
        if not self._moving:
            return {}
        along = np.concatenate([gram(sums.moved[:, self._moving], change), sums.fixed.onto(change)])
        steps = -self._inverse @ along
        at = fit.coordinates.copy()
        at[self._moving] += steps[: len(self._moving)]
        moved = fit.values_at(at)
        return {fit.names[place]: moved[fit.names[place]] for place in self._moving}


class HeldOut:
    """Held-out data of a machine, and what fits to its training data predict of them.

    Args:
        problem: the held-out data; None where nothing is held out.
    """

    def __init__(self, problem: Problem | None) -> None:
        self.problem = problem
        self._sizes: Sizes | None = None
        self._fits: dict[Fit, Fit | None] = {}
        self._process: Process | None = None

    def fit(self, result: Fit) -> Fit | None:
        """A fit's machine on the held-out data; None where nothing is held out or it cannot be simulated there."""
        if self.problem is None:
            return None
        if result not in self._fits:
            try:
                self._fits[result] = self._fitted(result)
            except (SimulationError, np.linalg.LinAlgError):
                self._fits[result] = None
        return self._fits[result]

    def _fitted(self, result: Fit) -> Fit:
        assert self.problem is not None
        machine = machine_values(result)
        if self._sizes is None:
            columns = columns_like(result, self.problem, machine)
            return fit_recording(self.problem.with_columns(columns), machine, sizes_like(result, columns), learns=True)
        return fit_recording(self.problem, machine, self._sizes)

    def learn_errors(self, result: Fit) -> None:
        """Take errors of the held-out recordings to be as large as they are beside a fit, whatever is fitted after it.

        Until then they are learned beside each fit.
        """
        there = self.fit(result)
        if there is None:
            return

        def again(robust: Problem) -> Mapping[str, float]:
            nonlocal there
            self.problem = robust
            self._fits.clear()
            there = self.fit(result) or there
            return {} if there is None else there.values

        weigh_outliers(there.problem, there.values, again)
        self.problem, self._sizes = there.problem, there.gaussian.sizes

    def predicted(self, result: Fit, tau: float = 0.0) -> Predicted | None:
        """The predicted error of held-out strokes."""
        there = self.fit(result)
        return None if there is None else predicted(result, there, tau)

    @property
    def process(self) -> Process:
        """Something unnamed in the held-out data."""
        assert self.problem is not None
        if self._process is None:
            self._process = Process(self.problem)
        return self._process

    def log_odds_of_unnamed(self, result: Fit) -> float:
        """Ln of the factor by which held-out data raise the odds that something unnamed acts; never below 0.

        What the training data leave open of the machine is nothing unnamed: it may move within its posterior. A model
        of another form fails in one of two ways: it leaves something, or its values do not carry over, and lie many of
        their standard deviations elsewhere.
        """
        there = self.fit(result)
        if there is None:
            return 0.0
        within, elsewhere = (self._about(result, there, spread) for spread in (1.0, ELSEWHERE))
        if within is None or elsewhere is None:
            return 0.0
        failures = [
            within.spread(self.process).log_evidence,
            elsewhere.log_evidence,
            elsewhere.spread(self.process).log_evidence,
        ]
        return max(0.0, float(np.logaddexp.reduce(failures)) - math.log(len(failures)) - within.log_evidence)

    def _about(self, result: Fit, there: Fit, spread: float) -> Gaussian | None:
        """The held-out data with the machine within so many standard deviations of what training says of it."""
        known = result.machine
        errors = [own for own in there.model.unknowns if not own.of_machine]
        moving = [own for own in result.model.moving if own.name in known.names]
        model = Model(there.problem, [*(free_of_prior(own) for own in moving), *errors], result.model.held)
        covariance = result.covariance[np.ix_(result.of_machine, result.of_machine)]
        if not np.isfinite(covariance).all():
            return None
        scale = 1.0 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        information = np.linalg.pinv(covariance * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
        knowledge = MachineKnowledge(known.names, known.coordinates, information / spread**2)
        start = model.at({**there.values, **result.values})
        try:
            return descend(model, start, there.gaussian.sizes, known=knowledge).gaussian
        except (SimulationError, np.linalg.LinAlgError):
            return None

    def log_density(self, result: Fit) -> float | None:
        """Ln p of held-out data beside something unnamed, the machine kept; None where nothing is held out."""
        there = self.fit(result)
        return None if there is None else there.gaussian.spread(self.process).log_evidence
