"""The evidence of a fit, against integrals."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import numpy as np
import pytest

from identification.selection.linear_plant import (
    COLUMNS,
    SIGMA,
    LinearPlant,
    measured,
    problem_of,
)
from valve_sim.identification.fit.priors import Cauchy, Normal
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.model import Parameter


def by_brute_force(found: Fit, columns: Array) -> float:
    """Ln of the integral of exp(−χ²/2) times the priors, over a grid of all that was free; the model is linear."""
    data = found.problem.plant.channels[0].data / SIGMA
    white = columns / SIGMA
    sigmas = 1.0 / np.sqrt(np.diag(white.T @ white))
    axes, weights = [], []
    for at, sigma, (below, above) in zip(found.coordinates, sigmas, found.room, strict=True):
        ends = at - min(below, 9.0 * sigma), at + min(above, 9.0 * sigma)
        points, own = np.polynomial.legendre.leggauss(60)
        axes.append(0.5 * (ends[1] - ends[0]) * points + 0.5 * sum(ends))
        weights.append(0.5 * (ends[1] - ends[0]) * own)
    gram, pull, rest = white.T @ white, white.T @ data, float(data @ data)
    logs = []
    for place, weight in zip(itertools.product(*axes), itertools.product(*weights), strict=True):
        at = np.array(place)
        chi2 = rest - 2.0 * float(pull @ at) + float(at @ gram @ at)
        prior = sum(own.log_density(one) for own, one in zip(found.priors, place, strict=True))
        logs.append(-0.5 * chi2 + prior + math.log(math.prod(weight)))
    return float(np.logaddexp.reduce(logs))


@pytest.mark.parametrize(("size", "lower"), [(0.0, 0.0), (0.1, 0.0), (3.0, -1e6)])
def test_the_evidence_of_a_fit_is_its_integral(size: float, lower: float) -> None:
    """Of two values with Cauchy densities, one perhaps one-sided, or of one beside a value in a tolerance."""
    switch = Parameter("size", "N", "added", lower, 1e6, 0.2, 0.0)
    drift = Nuisance("drift", 0.02, "m")

    def shown(values: Mapping[str, float]) -> Array:
        return values.get("e.size", 0.0) * COLUMNS[:, 1] + values.get("drift", 0.0) * COLUMNS[:, 2]

    plant = LinearPlant(measured() + size * COLUMNS[:, 1], shown, effects=[EffectChoice("e", (switch,))])
    two = fit(problem_of(plant), ("level", "e.size"), {})
    assert isinstance(two.priors[1], Cauchy)
    assert two.log_evidence == pytest.approx(by_brute_force(two, COLUMNS[:, :2]), abs=0.01)
    one = fit(problem_of(plant), ("level",), {}, nuisances=[drift])
    assert one.priors[1] == Normal(0.0, 0.02)
    assert one.log_evidence == pytest.approx(by_brute_force(one, COLUMNS[:, [0, 2]]), abs=0.01)


def test_the_evidence_counts_the_prior_of_a_nuisance_once() -> None:
    """Of nothing but values with normal priors it is that of the data's covariance, in closed form."""
    spread = np.array([0.05, 0.02])
    own = [Nuisance("one", spread[0], "m"), Nuisance("other", spread[1], "m")]
    plant = LinearPlant(
        measured(), lambda values: values.get("one", 0.0) * COLUMNS[:, 1] + values.get("other", 0.0) * COLUMNS[:, 2]
    )
    found = fit(problem_of(plant), (), {}, nuisances=own)
    columns = COLUMNS[:, 1:3] / SIGMA * spread
    data = plant.channels[0].data / SIGMA
    covariance = np.eye(2) + columns.T @ columns
    pulled = columns.T @ data
    expected = (
        -0.5 * (data @ data - pulled @ np.linalg.solve(covariance, pulled)) - 0.5 * np.linalg.slogdet(covariance)[1]
    )
    assert found.log_evidence == pytest.approx(float(expected), abs=1e-6)


def test_an_effect_that_shows_nothing_is_nearly_as_probable_as_none() -> None:
    """A parabola about the middle of a Cauchy density has 0.56 of its mass: ln is −0.57, where the integral is 0."""
    nothing = EffectChoice("e", (Parameter("size", "N", "added", 0.0, 1e6, 0.2, 0.0),))
    plant = LinearPlant(measured(), effects=[nothing])
    without, with_it = (fit(problem_of(plant), free, {}) for free in (("level",), ("level", "e.size")))
    assert with_it.log_evidence == pytest.approx(without.log_evidence, abs=0.7)
