"""Errors of a recording: their columns, what whitens a fit's rows for them, and the sizes that are learned."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from valve_sim.identification.estimation.errors import ERRORS, Seen
from valve_sim.identification.estimation.errors.bend import BEND
from valve_sim.identification.estimation.errors.drift import DRIFT, RAMPS
from valve_sim.identification.estimation.errors.error import Mode
from valve_sim.identification.estimation.errors.hum import HUM
from valve_sim.identification.estimation.errors.ringing import RINGING, RINGING_SCATTER
from valve_sim.identification.estimation.errors.stroke_variation import STROKE_VARIATION
from valve_sim.identification.estimation.linearised import BySizes
from valve_sim.identification.estimation.structured_noise import ChannelColumns, ErrorRows, Group, StructuredNoise
from valve_sim.identification.plants.protocol import Array, Contacts

SPAN = 1.2e-3
TIMES = np.arange(4000) / 20e3
CONTACTS = Contacts(np.array([0.02, 0.05, 0.12]), np.array([1.0, 0.5, 1.0]), np.array([1, 0, 1]))


def seen(shown: Array | None = None, modes: tuple[Mode, ...] = ()) -> Seen:
    """A channel of 0.2 s at 20 kHz with four commands."""
    return Seen(
        TIMES,
        np.zeros_like(TIMES) if shown is None else shown,
        SPAN,
        np.array([0.01, 0.06, 0.1, 0.15]),
        CONTACTS,
        modes,
    )


def rows_of(columns: Array, owners: Array, sizes: Array) -> ErrorRows:
    """Errors whose columns are rows of unit noise already."""
    groups = tuple(Group(0, error, 1.0) for error in (DRIFT, HUM)[: len(sizes)])
    noise = StructuredNoise(groups, sizes, {0: ChannelColumns(columns, owners.astype(np.intp))}, {})
    return ErrorRows(noise, {0: (slice(0, len(columns)), columns)})


def test_whitened_rows_have_the_information_that_the_covariance_leaves() -> None:
    random = np.random.default_rng(1)
    columns, owners, sizes = random.standard_normal((300, 5)), np.array([0, 0, 1, 1, 1]), np.array([0.7, 2.0])
    others = random.standard_normal((300, 4))
    covariance = np.eye(300) + (columns * np.square(sizes[owners])) @ columns.T
    errors = rows_of(columns, owners, sizes)
    white = errors.whiten(others)
    np.testing.assert_allclose(white.T @ white, others.T @ np.linalg.solve(covariance, others), rtol=1e-9)
    priors = sum(own.error.log_prior(size, 1.0) for own, size in zip(errors.noise.groups, sizes.tolist(), strict=True))
    assert errors.log_constant == pytest.approx(priors - 0.5 * np.linalg.slogdet(covariance)[1])


def test_coefficients_are_those_of_the_posterior() -> None:
    random = np.random.default_rng(2)
    columns, owners, sizes = random.standard_normal((300, 5)), np.array([0, 0, 1, 1, 1]), np.array([0.7, 2.0])
    left = random.standard_normal(300)
    errors = rows_of(columns, owners, sizes)
    information = columns.T @ columns + np.diag(sizes[owners] ** -2.0)
    np.testing.assert_allclose(errors.estimates(left)[0], np.linalg.solve(information, columns.T @ left), rtol=1e-9)
    np.testing.assert_allclose(errors.covariances[0], np.linalg.inv(information), rtol=1e-8)


def by_sizes(columns: Array, owners: Array, left: Array, free: Array) -> BySizes:
    """A linear model with one free parameter of the prior N(0, 1) beside errors of two kinds."""
    whole = np.column_stack([free, columns])
    information = whole.T @ whole
    information[0, 0] += 1.0
    groups = (Group(0, DRIFT, 1.0), Group(0, HUM, 1.0))
    return BySizes(groups, np.concatenate([[-1], owners]).astype(np.intp), information, whole.T @ left)


@pytest.mark.parametrize("number", [0, 1])
def test_costs_at_sizes_of_one_error_are_those_of_all_sizes(number: int) -> None:
    random = np.random.default_rng(4)
    columns, owners = random.standard_normal((60, 5)), np.array([0, 0, 1, 1, 1])
    model = by_sizes(columns, owners, random.standard_normal(60), random.standard_normal(60))
    sizes, at = np.array([0.3, 2.0]), np.geomspace(1e-3, 1e3, 7)
    each = []
    for size in at.tolist():
        changed = sizes.copy()
        changed[number] = size
        each.append(model.cost(changed))
    np.testing.assert_allclose(model.costs_of(sizes, number, at), each, rtol=1e-8, atol=1e-8)


def test_a_size_that_is_held_is_neither_read_nor_reset() -> None:
    groups = (Group(0, DRIFT, 1.0), Group(0, HUM, 1.0), Group("damping[2]", STROKE_VARIATION, 0.05))
    noise = StructuredNoise(groups, np.array([1.0, 2.0, 0.1]), {}, {})
    assert noise.known_sizes == {"drift": 1.0, "hum": 2.0, "stroke_variation damping": 0.1}
    held = noise.held_at({"drift": 5.0, "stroke_variation damping": 0.2})
    assert [own.is_learned for own in held.groups] == [False, True, False]
    again = held.with_read(np.array([7.0, 8.0, 9.0])).without_varying().unlearned()
    assert again.known_sizes == {"drift": 5.0, "hum": 8.0, "stroke_variation damping": 0.2}


def test_the_cost_of_sizes_is_the_marginal_likelihood_with_their_prior() -> None:
    random = np.random.default_rng(3)
    columns, owners = random.standard_normal((60, 5)), np.array([0, 0, 1, 1, 1])
    free, left = random.standard_normal(60), random.standard_normal(60)
    model = by_sizes(columns, owners, left, free)

    def expected(sizes: Array) -> float:
        covariance = np.eye(60) + np.outer(free, free) + (columns * np.square(sizes[owners])) @ columns.T
        priors = DRIFT.log_prior(float(sizes[0]), 1.0) + HUM.log_prior(float(sizes[1]), 1.0)
        return float(multivariate_normal.logpdf(left, cov=covariance)) + priors

    first, second = np.array([0.5, 2.0]), np.array([3.0, 0.01])
    assert model.cost(second) - model.cost(first) == pytest.approx(expected(first) - expected(second), abs=1e-6)


def test_most_probable_sizes_are_a_minimum_and_near_the_truth() -> None:
    random = np.random.default_rng(4)
    owners = np.repeat([0, 1], [40, 40])
    columns, free = random.standard_normal((4000, 80)), random.standard_normal(4000)
    truth = np.array([0.8, 0.0])
    left = columns @ (truth[owners] * random.standard_normal(80)) + random.standard_normal(4000) + 0.3 * free
    model = by_sizes(columns, owners, left, free)
    sizes = model.most_probable(np.array([0.3, 0.3]))
    assert sizes[0] == pytest.approx(0.8, abs=3.0 * 0.8 / math.sqrt(80.0))
    assert sizes[1] < 0.05
    for factor in (0.9, 1.1):
        assert model.cost(sizes * [factor, 1.0]) > model.cost(sizes)


def test_a_bend_is_straight_at_both_ends_of_the_range() -> None:
    assert BEND.columns is not None
    assert BEND.amount is not None
    columns = BEND.columns(seen(np.linspace(0.0, SPAN, len(TIMES))))
    np.testing.assert_allclose(columns[[0, -1]], 0.0, atol=1e-12)
    assert BEND.amount(np.array([4e-6, 0.0, 0.0, 0.0, 0.0, 0.0]), columns) == pytest.approx(1e-6)


def test_drift_is_a_constant_and_ramps_that_stay() -> None:
    assert DRIFT.columns is not None
    columns = DRIFT.columns(seen())
    assert columns.shape == (len(TIMES), 1 + RAMPS * 5)  # four commands make five intervals
    np.testing.assert_allclose(columns[:, 0], 1.0)
    assert np.all(np.diff(columns[:, 1:], axis=0) >= -1e-12)
    np.testing.assert_allclose(columns[0, 1:], 0.0)


def test_drift_is_told_of_whole_strokes() -> None:
    """3 µm in each of two strokes of different lengths; half a stroke at the end, which drifts by less, is none."""
    assert DRIFT.columns is not None
    assert DRIFT.amount is not None
    zero = np.interp(TIMES, [0.0, 0.06, 0.15, TIMES[-1]], [0.0, 3e-6, 0.0, 1e-6])
    columns = DRIFT.columns(seen())
    coefficients = np.linalg.lstsq(columns, zero, rcond=None)[0]
    assert DRIFT.amount(coefficients, columns) == pytest.approx(3e-6)
    # A recording that is shorter than a stroke has what there is.
    short = DRIFT.columns(seen()._replace(times=TIMES[:1000], knots=np.array([0.01])))
    climbs = np.linalg.lstsq(short, zero[:1000], rcond=None)[0]
    assert DRIFT.amount(climbs, short) == pytest.approx(float(zero[999]))


def test_hum_holds_a_sine_of_the_mains_of_any_phase() -> None:
    assert HUM.columns is not None
    assert HUM.amount is not None
    wave = 2e-6 * np.sin(2.0 * math.pi * 150.0 * TIMES + 1.0)
    columns = HUM.columns(seen())
    coefficients = np.linalg.lstsq(columns, wave, rcond=None)[0]
    np.testing.assert_allclose(columns @ coefficients, wave, atol=1e-12)
    assert HUM.amount(coefficients, columns) == pytest.approx(2e-6, rel=1e-6)


def test_a_harmonic_that_samples_cannot_show_is_left_out() -> None:
    assert HUM.columns is not None
    slow = seen()._replace(times=np.arange(200) / 400.0, shown=np.zeros(200))
    assert HUM.columns(slow).shape[1] == 2 * len(
        [f for f in (50, 100, 150, 200, 250, 60, 120, 180, 240, 300) if f < 200]
    )


def test_a_mount_rings_after_contacts_alone_and_as_their_momentum() -> None:
    assert RINGING.columns is not None
    assert RINGING_SCATTER.columns is not None
    assert RINGING.columns(seen()).shape[1] == 0
    modes = (Mode(800.0, 2e-3),)
    columns = RINGING.columns(seen(modes=modes))
    assert columns.shape[1] == 4  # a pair at the seat and at the stop
    assert not np.any(columns[TIMES < 0.02])
    stop = columns[:, 2:]
    since = TIMES[(TIMES >= 0.02) & (TIMES < 0.03)] - 0.02
    np.testing.assert_allclose(
        stop[(TIMES >= 0.02) & (TIMES < 0.03), 0],
        np.exp(-since / 2e-3) * np.sin(2.0 * math.pi * 800.0 * since),
        atol=1e-9,
    )
    assert np.max(np.abs(columns[:, :2])) == pytest.approx(0.5, rel=0.1)
    assert RINGING_SCATTER.columns(seen(modes=modes)).shape[1] == 6


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: error.name)
def test_every_error_says_what_to_do_and_has_a_prior_with_its_slope(error: object) -> None:
    own = next(one for one in ERRORS if one is error)
    assert own.what_to_do
    assert own.title
    if not own.is_known:
        step = 1e-5
        slope = (own.log_prior(0.7 * math.exp(step), 2.0) - own.log_prior(0.7 * math.exp(-step), 2.0)) / (2.0 * step)
        assert own.log_slope(0.7, 2.0) == pytest.approx(slope, rel=1e-6)
        sizes = np.geomspace(1e-6, 1e6, 20_001)
        density = np.exp([own.log_prior(size, 1.0) for size in sizes.tolist()])
        assert np.trapezoid(density, sizes) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("truth", [0.8, 0.0])
def test_the_integral_over_a_size_is_that_of_a_fine_grid(truth: float) -> None:
    random = np.random.default_rng(6)
    columns, free = random.standard_normal((400, 5)), random.standard_normal(400)
    left = columns @ (truth * random.standard_normal(5)) + random.standard_normal(400)
    whole = np.column_stack([free, columns])
    information = whole.T @ whole + np.diag([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    owners = np.array([-1, 0, 0, 0, 0, 0], dtype=np.intp)
    model = BySizes((Group(0, DRIFT, 1.0),), owners, information, whole.T @ left)
    best = model.most_probable(np.array([0.3]))
    sizes = np.geomspace(1e-6, 1e3, 3000)
    likelihood = np.exp([model.cost(best) - model.cost(np.array([size])) for size in sizes.tolist()])
    assert model.log_integral(best) == pytest.approx(math.log(np.trapezoid(likelihood, sizes)), abs=0.1)


def test_what_is_read_at_rest_is_not_learned_beside_a_model() -> None:
    noise = StructuredNoise((Group(0, DRIFT, 1.0), Group(0, BEND, 1.0)), np.array([0.3, 0.3]), {}, {})
    read = noise.with_read(np.array([2.0, 5.0]))
    assert [group.is_learned for group in read.groups] == [False, True]
    np.testing.assert_array_equal(read.sizes, [2.0, 0.3])
    np.testing.assert_array_equal(read.resized(np.array([2.0, 7.0])).unlearned().sizes, [2.0, 0.3])


def test_what_nothing_determines_leaves_all_else_finite() -> None:
    random = np.random.default_rng(7)
    columns, free, left = random.standard_normal((60, 5)), random.standard_normal(60), random.standard_normal(60)
    whole = np.column_stack([free, np.zeros(60), columns])
    owners = np.array([-1, -1, 0, 0, 0, 0, 0], dtype=np.intp)
    model = BySizes((Group(0, DRIFT, 1.0),), owners, whole.T @ whole, whole.T @ left)
    known = BySizes((Group(0, DRIFT, 1.0),), owners[1:], *_without_second(whole, left))
    sizes = model.most_probable(np.array([0.3]))
    moves, covariance = model.estimates(sizes, 2)
    assert np.isfinite(covariance).all()
    np.testing.assert_allclose(moves[0], known.estimates(sizes, 1)[0][0], rtol=1e-6)
    np.testing.assert_allclose(covariance[0, 0], known.estimates(sizes, 1)[1][0, 0], rtol=1e-6)


def _without_second(whole: Array, left: Array) -> tuple[Array, Array]:
    rest = np.delete(whole, 1, axis=1)
    return rest.T @ rest, rest.T @ left


def test_the_integral_over_a_size_is_finite_however_sharply_the_size_is_known() -> None:
    # An error that would have to be 300 times its scale: next to the best size all others are impossible.
    column, owners = np.ones((1, 1)), np.array([0], dtype=np.intp)
    information, pull = column.T @ column, column.T @ np.array([1e5])
    model = BySizes((Group("damping[0]", STROKE_VARIATION, 1.0),), owners, information, pull)
    assert math.isfinite(model.log_integral(model.most_probable(np.array([1.0]))))
