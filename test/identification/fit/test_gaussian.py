"""Everything after one linearisation beside closed forms: evidence, sizes, spreads, process."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from identification.fit.linear_plant import COLUMNS, SAMPLES, SIGMA, TIMES, LinearPlant, measured, problem_of
from identification.freed import fit, unknowns
from valve_sim.identification.fit import result
from valve_sim.identification.fit.columns import Columns
from valve_sim.identification.fit.gaussian import Gaussian, MachineKnowledge
from valve_sim.identification.fit.priors import Cauchy, Normal
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.unknown import Group, Unknown
from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.model import Parameter

# -- within ranges -----------------------------------------------------------------------------------------------------


def by_brute_force(found: Fit, columns: Array) -> float:
    """Ln of the integral of exp(−χ²/2) times the priors, over a grid of all that was free; the model is linear."""
    data = found.problem.plant.channels[0].data / SIGMA
    white = columns / SIGMA
    sigmas = 1.0 / np.sqrt(np.diag(white.T @ white))
    axes, weights = [], []
    for at, sigma, own in zip(found.coordinates, sigmas, found.model.moving, strict=True):
        ends = max(own.lower, at - 9.0 * sigma), min(own.upper, at + 9.0 * sigma)
        points, weight = np.polynomial.legendre.leggauss(60)
        axes.append(0.5 * (ends[1] - ends[0]) * points + 0.5 * sum(ends))
        weights.append(0.5 * (ends[1] - ends[0]) * weight)
    gram, pull, rest = white.T @ white, white.T @ data, float(data @ data)
    logs = []
    for place, weight in zip(itertools.product(*axes), itertools.product(*weights), strict=True):
        at = np.array(place)
        chi2 = rest - 2.0 * float(pull @ at) + float(at @ gram @ at)
        prior = sum(own.log_density(one) for own, one in zip(found.gaussian.priors, place, strict=True))
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
    assert isinstance(two.gaussian.priors[1], Cauchy)
    assert two.log_evidence == pytest.approx(by_brute_force(two, COLUMNS[:, :2]), abs=0.01)
    one = fit(problem_of(plant), ("level",), {}, nuisances=[drift])
    assert one.gaussian.priors[1] == Normal(0.0, 0.02)
    assert one.log_evidence == pytest.approx(by_brute_force(one, COLUMNS[:, [0, 2]]), abs=0.01)


def test_an_effect_that_shows_nothing_is_nearly_as_probable_as_none() -> None:
    """A parabola about the middle of a Cauchy density has 0.56 of its mass: ln is −0.57, where the integral is 0."""
    nothing = EffectChoice("e", (Parameter("size", "N", "added", 0.0, 1e6, 0.2, 0.0),))
    plant = LinearPlant(measured(), effects=[nothing])
    without, with_it = (fit(problem_of(plant), free, {}) for free in (("level",), ("level", "e.size")))
    assert with_it.log_evidence == pytest.approx(without.log_evidence, abs=0.7)


# -- normal numbers: what moves a run, and coefficients of columns -----------------------------------------------------

KNOWN = Nuisance("known", 0.05, "m")
FIRST, SECOND = Group(0, "first", 0.1), Group(0, "second", 0.3, "normal")
ERRORS = {FIRST: 20, SECOND: 5}
"""Columns of each group."""


def of_group(group: Group) -> Array:
    """(n, q) smooth columns, which depend on each other, and a little on what moves a run."""
    count, phase = ERRORS[group], 0.0 if group is FIRST else 1.0
    waves = np.sin(2.0 * math.pi * np.outer(TIMES, 1.0 + 0.7 * np.arange(count)) + phase)
    return np.asarray(waves + 0.3 * COLUMNS[:, [1]])


def fitted(first: float, second: float, seed: int = 1) -> Fit:
    """A fit to data with errors of these sizes, at half of the scales of their priors."""
    random = np.random.default_rng(seed)
    columns = [of_group(group) for group in ERRORS]
    errors = sum(
        own @ random.normal(0.0, size, own.shape[1]) for own, size in zip(columns, (first, second), strict=True)
    )
    data = SIGMA * random.standard_normal(SAMPLES) + random.normal(0.0, 0.05) * COLUMNS[:, 1] + errors
    problem = problem_of(LinearPlant(data, lambda values: values.get("known", 0.0) * COLUMNS[:, 1]))
    groups = [group for group, count in ERRORS.items() for _ in range(count)]
    of_columns = tuple(
        Unknown(f"{group.name}.{place}", Normal(0.0, group.scale), 0.0, column=place, group=group, of_machine=False)
        for place, group in enumerate(groups)
    )
    problem = problem.with_columns(Columns(of_columns, samples={0: np.hstack(columns)}, first={0: 0}))
    sizes = {group.name: 0.5 * group.scale for group in ERRORS}
    return result.fit(problem, [*unknowns(problem, (), [KNOWN]), *of_columns], {}, sizes=sizes)


class Exact:
    """The same with the covariance of the data written out: mean and variance of what is known, and ln p."""

    def __init__(self, found: Fit, sizes: Mapping[str, float]) -> None:
        data, own = found.problem.plant.channels[0].data / SIGMA, KNOWN.sigma * COLUMNS[:, 1] / SIGMA
        columns = np.hstack([own[:, None], *(sizes[group.name] * of_group(group) / SIGMA for group in ERRORS)])
        # In an orthonormal basis of all of them: beyond it the covariance is 1 and the data are 0.
        basis = np.linalg.qr(np.column_stack([data, COLUMNS[:, 1], *(of_group(group) for group in ERRORS)]))[0]
        data, own, columns = basis.T @ data, basis.T @ own, basis.T @ columns
        covariance = np.eye(len(data)) + columns @ columns.T
        solved = np.linalg.solve(covariance, np.column_stack([data, own]))
        self.mean = KNOWN.sigma * float(own @ solved[:, 0])
        self.variance = KNOWN.sigma**2 * (1.0 - float(own @ solved[:, 1]))
        self.log_evidence = -0.5 * float(data @ solved[:, 0]) - 0.5 * float(np.linalg.slogdet(covariance)[1])


@pytest.fixture(scope="module")
def found() -> Fit:
    return fitted(0.15, 0.2)


@pytest.mark.parametrize("shares", [(0.5, 0.5), (3.0, 0.01), (1e-3, 1e-3)])
def test_the_evidence_beside_errors_is_that_of_the_covariance_of_the_data(
    found: Fit, shares: tuple[float, float]
) -> None:
    sizes = {group.name: share * group.scale for group, share in zip(ERRORS, shares, strict=True)}
    own, exact = found.gaussian.resized(sizes), Exact(found, sizes)
    assert own.log_evidence == pytest.approx(exact.log_evidence, abs=1e-6)
    assert own.z[0] + own.best[0] == pytest.approx(exact.mean, abs=1e-7)
    assert own.covariance[0, 0] == pytest.approx(exact.variance, rel=1e-6)
    assert own.inverse[0, 0] == pytest.approx(exact.variance, rel=1e-6)


def test_other_data_that_say_nothing_of_the_machine_change_nothing() -> None:
    empty = MachineKnowledge((), np.empty(0), np.empty((0, 0)))
    alone = fit(problem_of(LinearPlant(COLUMNS[:, 0])), ("level",), {}).gaussian
    told = Gaussian(alone.model, alone.z, alone.sums, alone.sizes, empty)
    assert told.log_evidence == pytest.approx(alone.log_evidence)


@pytest.mark.parametrize("group", ERRORS, ids=lambda group: group.error)
def test_what_the_data_say_of_a_size_is_what_each_size_gives(found: Fit, group: Group) -> None:
    logs = found.gaussian.by_size(*found.gaussian.groups[group.name])

    def exact(size: float) -> float:
        return Exact(found, {**found.gaussian.sizes, group.name: size}).log_evidence

    for place in range(0, len(group.grid), 10):
        direct = exact(float(group.grid[place])) - exact(0.0)
        assert logs.likelihood[place] == pytest.approx(direct, abs=1e-5)

    def density(share: float) -> float:
        prior = float(np.exp(group.log_prior(np.array(share * group.scale))))
        return prior * math.exp(exact(share * group.scale) - found.log_evidence)

    integral = sum(quad(density, low, high, epsrel=1e-4)[0] for low, high in itertools.pairwise([0.0, 1.0, 4.0, 20.0]))
    # On a grid of 71 sizes.
    assert found.gaussian.log_integral([group.name]) == pytest.approx(math.log(integral), abs=0.05)


def test_the_most_probable_sizes_are_those_behind_the_data() -> None:
    """Of 20 coefficients the size is known to 16 %, of 5 to 32 %; and the prior pulls."""
    logs = []
    for seed in range(30):
        sizes = fitted(0.15, 0.2, seed).gaussian.with_best_sizes().sizes
        logs.append([math.log(sizes[FIRST.name] / 0.15), math.log(sizes[SECOND.name] / 0.2)])
    low, middle, high = np.quantile(logs, [0.16, 0.5, 0.84], axis=0)
    assert np.all(np.abs(middle) < [0.15, 0.3])
    assert 0.5 * (high - low) == pytest.approx([1.0 / math.sqrt(40.0), 1.0 / math.sqrt(10.0)], rel=0.5)
    nothing = fitted(0.0, 0.0).gaussian
    assert max(nothing.with_best_sizes().sizes.values()) < 0.1
    assert max(nothing.probabilities().values()) < 0.5
    assert min(fitted(0.15, 0.4).gaussian.probabilities().values()) > 0.999


def test_covariances_allow_for_sizes_as_a_mixture_over_them_does(found: Fit) -> None:
    """One group at a time, the other held: the exact mixture of what each size gives."""
    for group in ERRORS:
        columns = replace(found.problem.columns, unknowns=tuple(
            replace(own, group=own.group if own.group is group else replace(own.group, is_held=True))
            for own in found.problem.columns.unknowns if own.group
        ))  # fmt: skip
        held = found.problem.with_columns(columns)
        model = type(found.model)(held, [*found.model.moving, *columns.unknowns])
        gaussian = Gaussian(model, found.coordinates, model.linearise(found.coordinates), found.gaussian.sizes)
        assert [*gaussian.groups] == [group.name]
        logs = gaussian.by_size(group, gaussian.groups[group.name][1])
        weights = np.exp(logs.likelihood + logs.prior + np.log(group.grid))
        weights /= weights.sum()
        each = [Exact(found, {**found.gaussian.sizes, group.name: size}) for size in group.grid.tolist()]
        here = Exact(found, found.gaussian.sizes)
        mixed = sum(w * (own.variance + (own.mean - here.mean) ** 2) for w, own in zip(weights, each, strict=True))
        assert gaussian.covariance[0, 0] + gaussian.spread_of_sizes[0, 0] == pytest.approx(mixed, rel=1e-6)
