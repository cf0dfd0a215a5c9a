"""The bootstrap of the search: it knows what noise alone offers, white or not, and what is more than that."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder
from scipy import stats
from valve_sim.identification.diagnosis.calibration import CALIBRATION, calibrated
from valve_sim.identification.selection.bootstrap import RESAMPLES, FalseAlarm, false_alarm, false_alarm_of_few
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.table import DECISIVE, Hypothesis

from identification.recordings import recorded
from identification.selection.linear_plant import COLUMNS, SAMPLES, LinearPlant, measured, problem_of
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit, Rows
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, EffectChoice
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Parameter

LINEAR = ("coulomb_friction", "constant_force", "drive_gain", "eddy_lag", "gap_offset", "sensor_gain")
"""Effects whose real fits the bootstrap is held against."""


def problem(
    effects: dict[str, dict[str, float]], recorder: Recorder, seed: int, *, take_for_white: bool = False
) -> Problem:
    plant = ValvePlant([recorded(recorder, seed=seed, effects=effects)], default_valve().exact())
    if not take_for_white:
        return Problem(plant)
    noise = Problem(plant).noises["position"]
    return Problem(
        plant, noises={"position": replace(noise, innovation=noise.sigma, coefficients=(), variance_inflation=1.0)}
    )


def alarm_of(given: Problem, found: str | None = None) -> FalseAlarm:
    search = Search(given)
    base = search.fit(Hypothesis(()))
    return false_alarm(base, base if found is None else search.fit(Hypothesis((found,))))


def test_noise_alone_offers_about_as_much_as_the_real_search_finds_in_it() -> None:
    found, usual = [], []
    for seed in range(6):
        search = Search(problem({}, Recorder(), seed))
        base = search.fit(Hypothesis(()))
        found.append(max(base.score - search.score(Hypothesis((name,))) for name in LINEAR))
        usual.append(false_alarm(base, base).usual)
    assert all(gain < most for gain, most in zip(found, usual, strict=True))
    # Each has the price of one parameter, ln of some ten thousand; 99 % of the best of some twenty stay below 15.
    assert max(usual) < DECISIVE + 5.0


def test_an_effect_is_more_than_noise_offers() -> None:
    friction = {"coulomb_friction": {"force": 0.05}}
    alarm = alarm_of(problem(friction, Recorder(), 3), "coulomb_friction")
    assert alarm.gain > 100.0
    assert alarm.probability == pytest.approx(1.0 / (1.0 + alarm.resamples))
    assert alarm.usual < DECISIVE + 5.0


def test_colour_that_whitening_missed_is_seen() -> None:
    """An error of the noise model must not become a name: what is left of coloured noise says how much it offers."""
    given = problem({}, Recorder(colour=0.95), 4, take_for_white=True)
    assert alarm_of(given).usual > 5.0 * DECISIVE


def test_it_repeats() -> None:
    given = problem({}, Recorder(), 5)
    assert alarm_of(given) == alarm_of(given)


@pytest.mark.parametrize("kind", sorted(CALIBRATION))
def test_more_evidence_is_never_worth_less(kind: str) -> None:
    worth = [calibrated(kind, share) for share in np.linspace(0.0, 1.0, 101).tolist()]
    assert worth == sorted(worth)
    assert 0.0 < worth[0] < worth[-1] < 1.0


# -- a linear plant, of which all is known -----------------------------------------------------------------------------

SIZE = Parameter("size", "N", "added", -1e6, 1e6, 2.0, 0.0)


def linear(count: int = 1, *, names: str = "e", declared: bool = False, inflation: float = 1.0, seed: int = 5) -> Fit:
    """A fit without effects; each effect has so many sizes, a column each."""
    parameters = tuple(SIZE._replace(name=f"size{number}") for number in range(count))
    effects = [EffectChoice(name, parameters, is_declared_value=declared) for name in names]
    all_names = [effect.free_name(one) for effect in effects for one in effect.parameters]

    def shown(values: Mapping[str, float]) -> Array:
        return sum(
            (values.get(name, 0.0) * COLUMNS[:, 1 + number] for number, name in enumerate(all_names)), np.zeros(SAMPLES)
        )

    return fit(problem_of(LinearPlant(measured(seed), shown, effects=effects), inflation), ("level",), {})


def variance_of(base: Fit, column: int) -> float:
    """Of what a column has in common with residuals whose blocks of 64 have random signs."""
    level = COLUMNS[:, 0] / np.linalg.norm(COLUMNS[:, 0])
    rest = COLUMNS[:, column] - level * (level @ COLUMNS[:, column])
    products = rest / np.linalg.norm(rest) * base.residuals
    return float(sum(np.sum(products[start : start + 64]) ** 2 for start in range(0, SAMPLES, 64)))


@pytest.mark.parametrize("inflation", [1.0, 2.0])
def test_what_one_effect_offers_in_noise_is_known(inflation: float) -> None:
    base = linear(inflation=inflation)
    variance = variance_of(base, 1) / inflation
    alarm = false_alarm(base, base)
    assert alarm.resamples == RESAMPLES == 2000
    # The gain of χ² has one degree of freedom, and costs ln N.
    assert alarm.usual == pytest.approx(max(0.0, variance * stats.chi2.ppf(0.99, 1) - math.log(SAMPLES)), abs=0.8)
    # Noise alone offers nothing in most cases, where nothing was found as well.
    assert alarm.gain == 0.0
    assert alarm.probability == 1.0


@pytest.mark.parametrize("inflation", [1.0, 2.0])
def test_of_effects_that_were_pointed_at_theory_says_what_noise_offers(inflation: float) -> None:
    """The fall of χ² along one column is χ² of one degree of freedom; of two that are independent, the larger one."""
    found = []
    for seed in range(300):
        base = linear(names="ab", inflation=inflation, seed=seed)
        plant = base.problem.plant
        fits = [fit(base.problem, ("level", f"{name}.size0"), {}) for name in plant.effects]
        best = min(fits, key=lambda one: one.chi2)
        alarm = false_alarm_of_few(base, best, 2)
        assert alarm.gain == pytest.approx(base.score - best.score, rel=1e-12)
        found.append(alarm)
    # Where residuals count half, they offer less.
    rare = sum(alarm.probability <= 0.1 for alarm in found) / len(found)
    assert rare == pytest.approx(0.1 if inflation == 1.0 else 0.02, abs=0.05)
    assert sum(alarm.gain > alarm.usual for alarm in found) <= 9
    assert found[0].usual == pytest.approx(stats.chi2.ppf(0.995, 1) - math.log(SAMPLES), rel=1e-9)
    strong = false_alarm_of_few(base, replace(best, chi2=best.chi2 - 100.0), 2)
    assert strong.probability == pytest.approx(
        2.0 * stats.chi2.sf((base.chi2 - best.chi2 + 100.0) / inflation, 1), rel=1e-6
    )


@pytest.mark.parametrize(("count", "names", "together"), [(2, "e", np.sum), (1, "abcdefgh", np.max)])
def test_sizes_of_an_effect_offer_their_sum_and_effects_the_best_of_them(
    count: int, names: str, together: Callable[..., Array]
) -> None:
    base = linear(count, names=names)
    residuals = 3.0 * base.residuals
    loud = replace(base, left=Rows(residuals, lambda: residuals))
    columns = range(1, 1 + count * len(names))
    gains = np.square(np.random.default_rng(3).standard_normal((20_000, len(columns))))
    gains *= [variance_of(loud, column) for column in columns]
    expected = float(np.quantile(together(gains, axis=1), 0.99)) - count * math.log(SAMPLES)
    assert false_alarm(base, loud).usual == pytest.approx(expected, rel=0.15)


def test_the_probability_is_how_often_noise_offers_as_much() -> None:
    base = linear()
    variance, price = variance_of(base, 1), math.log(SAMPLES)
    for gain in (0.1, 1.0, 2.0):
        best = replace(base, chi2=base.chi2 - gain)
        expected = stats.chi2.sf((gain + price) / variance, 1)
        found = false_alarm(base, best)
        assert found.gain == pytest.approx(gain)
        assert found.probability == pytest.approx(expected, abs=4.0 * math.sqrt(expected / RESAMPLES) + 1e-3)
    assert false_alarm(base, best, seed=1).probability != found.probability


def test_a_declared_value_offers_noise_nothing() -> None:
    base = linear(names="abcdefgh", declared=True)
    assert false_alarm(base, base).usual == 0.0
    better = replace(base, chi2=base.chi2 - 1.0)
    assert false_alarm(base, better).probability == 1.0 / (1.0 + RESAMPLES)
