"""Prediction of held-out strokes: the proof of a corrected model, and how far off it may be.

Everything that training estimated is kept; only the errors of the held-out recording are estimated anew. What the
training data leave open of the machine, and the held-out data of the errors of their recording, widens what is
predicted:

    Var(y_held) = noise² (1 + τ²) + Σ_k (∂y/∂a_k)²

along the principal axes a_k of both posteriors, one standard deviation each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.linearised import Linearised, bounded_steps
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, rmse
from valve_sim.identification.estimation.state_of_recording import fit_recording
from valve_sim.identification.plants.covariance_root import covariance_root
from valve_sim.identification.plants.protocol import Array, primary_channels, varying_of
from valve_sim.identification.selection.discrepancy import Discrepancy, lengths_of
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
    """The values of a fit that are the machine's, not its recordings'."""
    plant = result.problem.plant
    errors = {own.name for own in (*plant.nuisances, *varying_of(plant), *plant.timing_errors) if not own.is_of_machine}
    return {name: value for name, value in result.values.items() if name not in errors}


def axes_of(result: Fit) -> list[dict[str, float]]:
    """The machine's values moved by one standard deviation along each principal axis of their posterior."""
    own = result.of_machine
    return _axes(result, own, machine_values(result), result.covariance[np.ix_(own, own)])


def recording_axes_of(result: Fit) -> list[dict[str, float]]:
    """The errors of a recording, moved in the same way, all that is the machine's held."""
    own = result.of_recordings
    values = {result.names[at]: result.values[result.names[at]] for at in own}
    information = result.information[np.ix_(own, own)]
    scale = 1.0 / np.sqrt(np.diag(information))
    # A path that runs away from its start shows one direction so sharply that rounding hides the others.
    inverse = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return _axes(result, own, values, inverse)


def _axes(result: Fit, own: list[int], values: Mapping[str, float], covariance: Array) -> list[dict[str, float]]:
    """Values moved along the principal axes of the covariance of some coordinates, by their indices."""
    found = []
    for axis in covariance_root(covariance).T:
        at = result.coordinates.copy()
        at[own] += axis
        there = result.values_at(at)
        found.append({**values, **{result.names[index]: there[result.names[index]] for index in own}})
    return found


class _Following:
    """How the errors of a recording follow where values of the machine are others."""

    def __init__(self, there: Fit) -> None:
        self._fit, self._own = there, there.of_recordings
        self._whitened = there.problem.without_errors(there.derivatives.condensed()[:, self._own])
        self._information = there.information[np.ix_(self._own, self._own)]

    def values(self, change: Array) -> dict[str, float]:
        """The errors of the recording, by name, for a change of the (r,) residuals."""
        if not self._own:
            return {}
        left = self._fit.problem.without_errors(change[:, None])[:, 0]
        room = self._fit.room[self._own]
        pull = gram(self._whitened, left)
        steps = bounded_steps(self._information[None], pull[None], room)[0].tolist()
        names = [self._fit.names[at] for at in self._own]
        return {name: self._fit.values[name] + step for name, step in zip(names, steps, strict=True)}


def predicted(result: Fit, there: Fit, size: float = 0.0) -> Predicted:
    """The prediction of data by a fit; the data may be those that were fitted.

    Args:
        result: of the training data. there: its machine's values on the data, with the errors of the recording.
        size: τ, of a discrepancy without a name.

    Raises:
        SimulationError: the machine cannot be simulated with its own values.
    """
    problem, plant = there.problem, there.problem.plant
    shown = plant.predict(there.values)
    spread = there.variance_of_errors()
    rows, left, follow = problem.rows, there.left.condensed(), _Following(there)
    of_machine = [(moved, True) for moved in axes_of(result)]
    for moved, is_followed in [*of_machine, *((moved, False) for moved in recording_axes_of(there))]:
        try:
            values = {**there.values, **moved}
            if is_followed:
                values |= follow.values(rows.residuals(values) - left)
            changed, change = plant.predict(values), rows.residuals(values) - left
        except SimulationError:
            continue
        # What the sensors' errors follow is predicted as well as before.
        for index, (prediction, own) in enumerate(zip(changed, there.errors_of(change), strict=True)):
            spread[index] += np.square(prediction - shown[index] + own)
    bands = {}
    for index, channel in enumerate(plant.channels):
        noise = problem.noise_of(index).sigma ** 2 * (1.0 + size**2 * ~channel.quiet)
        bands[index] = np.sqrt(spread[index] + noise)
    squares, count = 0.0, 0.0
    for index in primary_channels(plant):
        weights = problem.weight(index) > 0.0
        squares += float(np.sum(np.square(bands[index])[weights]))
        count += float(np.count_nonzero(weights))
    return Predicted(there, rmse(there), math.sqrt(squares / count) if count else math.nan, bands)


class HeldOut:
    """Held-out data of a machine, and what fits to its training data predict of them."""

    def __init__(self, problem: Problem | None) -> None:
        self.problem = problem
        self._fits: dict[Fit, Fit | None] = {}
        self._discrepancy: Discrepancy | None = None

    def fit(self, result: Fit) -> Fit | None:
        """A fit's machine on the held-out data; None where nothing is held out or it cannot be simulated there."""
        if self.problem is None:
            return None
        if result not in self._fits:
            try:
                self._fits[result] = fit_recording(self.problem, machine_values(result), result.problem.errors)
            except SimulationError:
                self._fits[result] = None
        return self._fits[result]

    def learn_errors(self, result: Fit) -> None:
        """Take errors of the held-out recordings to be as large as they are beside a fit, whatever is fitted after it.

        Until then they are learned beside each fit.
        """
        there = self.fit(result)
        if there is not None:
            self.problem = there.problem

    def predicted(self, result: Fit, size: float = 0.0) -> Predicted | None:
        """The predicted error of held-out strokes."""
        there = self.fit(result)
        return None if there is None else predicted(result, there, size)

    @property
    def discrepancy(self) -> Discrepancy:
        """The discrepancy on the held-out data."""
        assert self.problem is not None
        if self._discrepancy is None:
            places = self.problem.rows.places
            self._discrepancy = Discrepancy(places, lengths_of(self.problem.plant, places))
        return self._discrepancy

    def log_odds_of_unnamed(self, result: Fit) -> float:
        """Ln of the factor by which held-out data raise the odds that something unnamed acts; never below 0.

        What the training data leave open of the machine is no discrepancy: it may move along the axes of its posterior.
        A model of another form fails in one of two ways: it leaves a discrepancy, or its values do not carry over, and
        lie many of their standard deviations elsewhere.
        """
        there = self.fit(result)
        if there is None:
            return 0.0
        left, rows = there.left.condensed(), there.problem.rows
        columns = []
        for moved in axes_of(result):
            try:
                columns.append(rows.residuals({**there.values, **moved}) - left)
            except SimulationError:
                continue
        within = np.column_stack(columns) if columns else None
        model = Linearised(there, within)
        plain = model.integrated
        failures = [self.discrepancy.spread(model).log_evidence]
        if within is not None:
            elsewhere = Linearised(there, ELSEWHERE * within)
            failures += [elsewhere.integrated, self.discrepancy.spread(elsewhere).log_evidence]
        return max(0.0, float(np.logaddexp.reduce(failures)) - math.log(len(failures)) - plain)

    def log_density(self, result: Fit) -> float | None:
        """Ln p of held-out data beside a discrepancy, the machine kept; None where nothing is held out."""
        there = self.fit(result)
        return None if there is None else self.discrepancy.spread(Linearised(there)).log_evidence
