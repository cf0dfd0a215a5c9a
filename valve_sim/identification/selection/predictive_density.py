"""The predictive density of held-out data, given a fit to the training data: theory, eq. (47).

Held-out data are predicted by all parameter values that the training data allow, not by the best fit alone: it is off
by its standard errors, and held-out strokes may be sensitive to just that direction. About the best fit, to second
order (Laplace; MacKay 2003, chapter 28),

    −2 ln p(held-out | training) = χ² − gᵀ (C⁻¹ + H)⁻¹ g + ln det(1 + C H) + constant

with χ² and half its gradient g and information H = JᵀJ at the best fit, and C the covariance that the training data
leave (of nuisances: their priors). A model is worth what it predicts: Dawid, J. R. Stat. Soc. A 147, 1984, p. 278.
Where declared values have tolerances, the training data leave so much open that held-out data are fitted within it:
theory, eq. (83). About that optimum g is 0, and with the information T that the training data have of the machine
1 + C H is T⁻¹ (T + H). Held-out data only judge: they are predicted when the choice is made (`held_out`).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.descent import DIFFERENCE, STANDING, along
from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.result import Fit, MachineKnowledge
from valve_sim.identification.plants.protocol import Array, from_internal, internal_bounds, internal_scale
from valve_sim.model import Parameter, SimulationError

FARTHEST: Final = 10.0
"""Prior scales: the standard deviation of a parameter that the training data do not determine."""


class Prediction(NamedTuple):
    """What held-out data are, given a fit to the training data.

    Attributes:
        neg2_log_density: −2 ln p(held-out | training), but for a constant of the held-out data; smaller is better.
        residuals: (n,) whitened, of the values that are most probable of those that the training data allow: an error
            of the training fit is no fault of its form.
    """

    neg2_log_density: float
    residuals: Array


def neg2_log_predictive(training: Fit, held_out: Fit) -> float:
    """−2 ln p(held-out | training): `predict_held_out`."""
    return predict_held_out(training, held_out).neg2_log_density


def predict_held_out(training: Fit, held_out: Fit) -> Prediction:
    """Predict held-out data.

    Args:
        training: the fit to training data.
        held_out: the same values on held-out data, their nuisances fitted.
    """
    variance_inflation = held_out.problem.variance_inflation
    if held_out.free or any(nuisance.is_of_machine for nuisance in held_out.nuisances):
        return Prediction(held_out.chi2 / variance_inflation + _volume(training, held_out), held_out.residuals)
    jacobian = np.hstack([_sensitivities(training, held_out), held_out.jacobian])
    gradient = gram(jacobian, held_out.residuals)
    gradient[len(training.free) :] += [
        held_out.values[nuisance.name] / nuisance.sigma**2 for nuisance in held_out.nuisances
    ]
    information = gram(jacobian, jacobian)
    spread = _spread(training, held_out)
    within = np.eye(len(spread)) + spread.T @ information @ spread / variance_inflation
    gained = spread.T @ gradient / variance_inflation
    move = np.linalg.solve(within, gained)
    _, volume = np.linalg.slogdet(within)
    density = float(held_out.chi2 / variance_inflation - gained @ move + volume)
    return Prediction(density, held_out.residuals - jacobian @ (spread @ move))


def knowledge_for(training: Fit) -> MachineKnowledge:
    """What a fit says of the machine, where no parameter is more uncertain than it can be for good reasons."""
    machine, plant = training.machine, training.problem.plant
    farthest = [FARTHEST * internal_scale(plant.parameter(name)) for name in training.free]
    least = np.zeros(len(machine.names))
    least[: len(farthest)] = 1.0 / np.square(farthest)
    return machine._replace(information=machine.information + np.diag(least))


def _volume(training: Fit, held_out: Fit) -> float:
    """Ln det(1 + C H) of a fit to held-out data within what the training data leave open."""
    machine = knowledge_for(training)
    names = [*held_out.free, *(nuisance.name for nuisance in held_out.nuisances)]
    order = [names.index(name) for name in machine.names]
    prior = np.diag([0.0] * len(held_out.free) + [1.0 / nuisance.sigma**2 for nuisance in held_out.nuisances])
    prior[np.ix_(order, order)] = machine.information
    scale = 1.0 / np.sqrt(np.diag(held_out.information))
    (_, after), (_, before) = (
        np.linalg.slogdet(matrix * np.outer(scale, scale)) for matrix in (held_out.information, prior)
    )
    return float(after - before)


def _sensitivities(training: Fit, held_out: Fit) -> Array:
    """(n, k) d(held-out residuals)/d(internal coordinate) of the freed parameters, as far as they are known there."""
    plant = training.problem.plant
    at = [(name, plant.parameter(name), float(c)) for name, c in zip(training.free, training.coordinates, strict=False)]
    directions = [along(*parameter) for parameter in at]
    try:
        found, known = held_out.problem.sensitivities(held_out.values, directions)
    except SimulationError:
        return np.zeros((len(held_out.residuals), len(at)))
    columns = np.empty((len(held_out.residuals), len(at)))
    for place, parameter in enumerate(at):
        is_known = known[place] and directions[place] is not STANDING
        columns[:, place] = found[:, place] if is_known else _quotient(held_out, *parameter)
    return columns


def _quotient(held_out: Fit, name: str, parameter: Parameter, at: float) -> Array:
    """(n,) the same of one of them, by a difference quotient; 0 where the machine cannot be simulated."""
    step = DIFFERENCE * internal_scale(parameter)
    moved = at + step if at + step <= internal_bounds(parameter)[1] else at - step
    try:
        there = held_out.problem.residuals({**held_out.values, name: from_internal(parameter, moved)})
    except SimulationError:
        return np.zeros(len(held_out.residuals))
    return np.asarray((there - held_out.residuals) / (moved - at))


def _spread(training: Fit, held_out: Fit) -> Array:
    """A square root of the covariance before the held-out data are seen: parameters, then nuisances."""
    k = len(training.free)
    farthest = [FARTHEST * internal_scale(training.problem.plant.parameter(name)) for name in training.free]
    covariance = training.covariance[:k, :k]
    shrink = np.minimum(1.0, np.array(farthest) / np.sqrt(np.diag(covariance)))
    # A parameter of infinite variance has no correlation; others are scaled alike, which keeps correlations.
    covariance = np.where(np.isfinite(covariance), covariance, 0.0) * np.outer(shrink, shrink)
    covariance[np.diag_indices(k)] = np.minimum(np.diag(training.covariance)[:k], np.square(farthest))
    sizes, directions = np.linalg.eigh(covariance)
    root = directions * np.sqrt(np.maximum(sizes, 0.0))
    spread = np.zeros((k + len(held_out.nuisances),) * 2)
    spread[:k, :k] = root
    spread[range(k, len(spread)), range(k, len(spread))] = [nuisance.sigma for nuisance in held_out.nuisances]
    return spread
