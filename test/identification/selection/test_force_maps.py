"""Which force maps are fitted beside a model, and what is said of them: on fits that are written down."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from valve_sim.identification.selection.hypotheses import NEAR
from valve_sim.identification.selection.table import Hypothesis

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.descent import Effort
from valve_sim.identification.plants.protocol import ForceMap, Nuisance
from valve_sim.identification.selection import force_maps
from valve_sim.identification.selection.force_maps import (
    PERIOD_STEP,
    PLACES,
    describe,
    explains_all,
    fit_curves,
    fit_local_forces,
    fit_maps,
    on_top,
    where,
)
from valve_sim.identification.selection.periods import Period
from valve_sim.identification.selection.residual_tests import Adequacy
from valve_sim.model import SimulationError
from valve_sim.model.effects import basis

STAMP = Nuisance("stamp[0]", 1e-4, "s")
CLOCK = Nuisance("clock", 1e-4, "s")


def a_map(variable: str, unit: str, *, high: float = 1.0, count: int = 12, least: float = -np.inf) -> ForceMap:
    end = f"end of {variable}" if "periodic" in variable else ""
    names = tuple(f"{variable}{number}" for number in range(count))
    return ForceMap(variable, names, {"over": hash(variable) % 7}, 0.0, high, unit, "count", least, end=end)


OVER_X, OVER_V = a_map("x", "m", high=1e-3), a_map("v", "m/s", least=0.0)
TURNS, BEATS = a_map("x, periodic", "m", high=1e-3), a_map("t, periodic", "s", high=2.0)


class Fits:
    """Fits in place of real ones: by what they free their S, and whether they are white.

    Attributes:
        scores: of the variable of a map, with a "'" where stamps are estimated. calls: of `fit`, its arguments.
        scans: for periods, the stamps' marks of the fits that they are made beside.
    """

    def __init__(
        self, patch: pytest.MonkeyPatch, scores: Mapping[str, float], *maps: ForceMap, white: str = ""
    ) -> None:
        self.scores, self.maps, self.white = scores, maps, white
        self.calls: list[dict[str, Any]] = []
        self.scans: list[list[str]] = []
        self.further = 0
        self.plant = SimpleNamespace(force_maps=maps, timing_errors=(STAMP,))
        self.problem = SimpleNamespace(plant=self.plant, variance_inflation=1.0)
        self.search = SimpleNamespace(problem=self.problem, untried=[], say=lambda what, share: None, fit=self.rest)
        values = {"mass": 2.0, "gain": 3.0, "clock": 1e-5}
        self.base = SimpleNamespace(
            problem=self.problem, free=("gain",), nuisances=(CLOCK,), values=values, score=100.0, key=""
        )
        patch.setattr(force_maps, "fit", self.fit)
        patch.setattr(force_maps, "likely_periods", self.periods)
        patch.setattr(
            force_maps,
            "adequacy",
            lambda one: Adequacy(1.0 if one.key and one.key in white.split("; ") else 0.0, "", 0.0),
        )

    def periods(self, choice: ForceMap, *bases: Any) -> list[list[Period]]:
        self.scans.append(["'" * (STAMP in one.nuisances) for one in bases])
        lengths = [(0.1, 0.01), (0.02, 0.001), *[(0.03, 0.001)] * self.further]
        found = [Period(length, sigma, 50.0, dict.fromkeys(choice.coefficients, length)) for length, sigma in lengths]
        return [found for _ in bases]

    def rest(self, hypothesis: Hypothesis) -> Any:
        return SimpleNamespace(**{**vars(self.base), "free": ("gain", *hypothesis.effects), "nuisances": (STAMP,)})

    def fit(
        self,
        problem: Any,
        free: Sequence[str],
        start: Mapping[str, float],
        *,
        nuisances: Sequence[Nuisance] = (),
        fixed: Mapping[str, float] | None = None,
        effort: Any = None,
        prior: Any = None,
    ) -> Any:
        given = dict(
            free=tuple(free), start=dict(start), nuisances=tuple(nuisances), fixed=dict(fixed or {}), prior=prior,
            effort=effort,
        )  # fmt: skip
        self.calls.append(given)
        over = next((one.variable for one in self.maps if set(one.coefficients) & set(free)), "")
        key = over + "'" * (STAMP in nuisances)
        score = self.scores[key] if key in self.scores else self.scores.get(over, 100.0)
        if score == 0.0:
            raise SimulationError("it cannot be simulated")
        if score < 0.0:
            raise OutOfTimeError("no time is left")
        values = {**start, **given["fixed"], **dict.fromkeys(free, 1.0)}
        values.update({own.name: own.mean for own in nuisances})
        length = [own.mean for own in nuisances if own.name.startswith("end")]
        score += 5.0 * (length == [0.1])
        return SimpleNamespace(
            problem=self.problem,
            free=tuple(free),
            nuisances=tuple(nuisances),
            values=values,
            score=score,
            key=key,
            chi2=score,
            reach=score,
        )

    def fitted(self) -> list[tuple[str, float]]:
        """What `fit_maps` finds."""
        found = fit_maps(cast("Any", self.search), cast("Any", self.base))
        return [(entry.choice.variable, entry.fit.score) for entry in found]


def test_maps_are_fitted_beside_what_a_fit_estimates_best_first(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": 60.0, "v": 50.0}, OVER_X, OVER_V, white="v")
    assert fits.fitted() == [("v", 50.0), ("x", 60.0)]
    first, second = sorted(fits.calls, key=lambda call: call["free"][1])[::-1]
    assert first["free"] == ("gain", *OVER_X.free)
    assert first["fixed"] == {"mass": 2.0, **OVER_X.held}
    assert (first["start"], first["nuisances"]) == (fits.base.values, (CLOCK,))
    assert (first["prior"].names, first["prior"].least, first["prior"].repeats) == (OVER_X.free, -np.inf, False)
    assert second["prior"].least == 0.0


def test_curves_that_the_search_has_fitted_are_not_fitted_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A curve over time, which follows anything, and waves are not among these."""
    over_time = a_map("t", "s")
    fits = Fits(monkeypatch, {"x": 60.0, "v": 50.0, "t": 55.0, "x, periodic": 70.0}, OVER_X, OVER_V, over_time, TURNS)
    fits.plant.timing_errors = ()
    known = fit_curves(cast("Any", fits.search), cast("Any", fits.base))
    assert [entry.choice.variable for entry in known] == ["x", "v"]
    found = fit_maps(cast("Any", fits.search), cast("Any", fits.base), known)
    assert [entry.choice.variable for entry in found] == ["v", "t", "x", "x, periodic"]
    assert sum(OVER_X.free[0] in call["free"] for call in fits.calls) == 1


def test_where_no_map_explains_all_stamps_are_estimated_beside_each(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": 60.0, "v": 50.0, "x'": 40.0, "v'": 55.0}, OVER_X, OVER_V)
    assert fits.fitted() == [("x", 40.0), ("v", 50.0), ("v", 55.0), ("x", 60.0)]
    timed = [call for call in fits.calls if STAMP in call["nuisances"]]
    assert timed[0]["free"] == ("gain",)
    assert timed[0]["fixed"] == {"mass": 2.0}
    assert timed[0]["nuisances"] == (CLOCK, STAMP)
    # Where they are estimated already, once is enough; and where one is white.
    fits = Fits(monkeypatch, {"x": 60.0}, OVER_X)
    fits.base.nuisances = (STAMP,)
    assert fits.fitted() == [("x", 60.0)]
    assert len(Fits(monkeypatch, {"x": 60.0, "v": 50.0}, OVER_X, OVER_V, white="x").fitted()) == 2


def test_what_cannot_be_fitted_is_left_out_and_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": 0.0, "v": -1.0}, OVER_X, OVER_V)
    assert fits.fitted() == []
    assert fits.search.untried == ["a force over x", "a force over v"]
    late = Fits(monkeypatch, {"x": 60.0, "'": -1.0}, OVER_X)
    assert late.fitted() == [("x", 60.0)]


def test_where_effects_explain_all_neither_stamps_nor_waves_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": 60.0, "t, periodic": 20.0, "x, periodic": 30.0}, OVER_X, BEATS, TURNS)
    found = fit_maps(cast("Any", fits.search), cast("Any", fits.base), (), cast("Any", SimpleNamespace(score=50.0)))
    assert [entry.choice.variable for entry in found] == ["x"]
    assert not any(STAMP in call["nuisances"] for call in fits.calls)


def test_where_effects_explain_all_a_curve_that_cannot_come_near_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    goal = 50.0 + NEAR
    fits = Fits(monkeypatch, {"x": goal, "v": goal + 1.0}, OVER_X, OVER_V)
    found = fit_maps(cast("Any", fits.search), cast("Any", fits.base), (), cast("Any", SimpleNamespace(score=50.0)))
    assert [entry.choice.variable for entry in found] == ["x"]
    assert [call["effort"] for call in fits.calls] == [Effort(goal=goal)] * 2
    # That is no lack of time.
    assert fits.search.untried == []
    # Where nothing explains all, each is carried to its end.
    whole = Fits(monkeypatch, {"x": goal, "v": goal + 1.0}, OVER_X, OVER_V, white="v")
    assert whole.fitted() == [("x", goal), ("v", goal + 1.0)]
    assert [call["effort"] for call in whole.calls] == [Effort()] * 2


@pytest.mark.parametrize(
    ("further", "samples", "white", "is_explained"),
    [
        (1, 10_000, "b", True),
        (4, 10_000, "b", True),
        (4, 30_000, "b", False),
        (5, 10_000, "b", False),
        (1, 10_000, "", False),
    ],
)
def test_a_wave_has_three_parameters_at_the_least(
    monkeypatch: pytest.MonkeyPatch, further: int, samples: int, white: str, *, is_explained: bool
) -> None:
    """One further parameter costs ln 10 000 = 9.2 or ln 30 000 = 10.3, of which 10 decide."""
    fits = Fits(monkeypatch, {}, OVER_X, white=white)
    problem = SimpleNamespace(effective_samples=samples)
    best = SimpleNamespace(free=("gain", *map(str, range(further))), key="b", problem=problem)
    assert explains_all(cast("Any", fits.base), cast("Any", best)) is is_explained


@pytest.mark.parametrize("white", ["", "x", "x,"])
def test_periods_of_time_are_tried_last(monkeypatch: pytest.MonkeyPatch, white: str) -> None:
    fits = Fits(monkeypatch, {"x": 60.0, "t, periodic": 20.0, "x, periodic": 30.0}, OVER_X, BEATS, TURNS, white=white)
    fits.plant.timing_errors = ()
    found = fits.fitted()
    assert found == ([("x, periodic", 30.0), ("x", 60.0)] if white == "x" else [("t, periodic", 20.0), *found[1:]])
    assert len(found) == (2 if white == "x" else 3)


def test_a_period_is_estimated_along_and_the_best_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x, periodic": 30.0}, TURNS, white="periodic")
    fits.plant.timing_errors = ()
    assert fits.fitted() == [("x, periodic", 30.0)]
    lengths = [call["nuisances"][-1] for call in fits.calls]
    assert [(own.name, own.mean, own.sigma, own.unit, own.is_of_machine) for own in lengths] == [
        (TURNS.end, 0.1, 0.01, "m", True),
        (TURNS.end, 0.02, 0.001, "m", True),
    ]
    assert [own.step for own in lengths] == [PERIOD_STEP * 0.01, PERIOD_STEP * 0.001]
    assert all(TURNS.end not in call["fixed"] and call["prior"].repeats for call in fits.calls)
    assert [call["start"]["x, periodic0"] for call in fits.calls] == [0.1, 0.02]
    (entry,) = fit_maps(cast("Any", fits.search), cast("Any", fits.base))
    assert entry.choice.high == pytest.approx(0.02)


@pytest.mark.parametrize(("white", "fitted"), [("periodic", 3), ("", 8)])
def test_periods_are_fitted_three_at_once_until_one_explains_all(
    monkeypatch: pytest.MonkeyPatch, white: str, fitted: int
) -> None:
    fits = Fits(monkeypatch, {"x, periodic": 30.0}, TURNS, white="x, periodic" if white else "")
    fits.plant.timing_errors, fits.further = (), 6
    assert fits.fitted() == [("x, periodic", 30.0)]
    assert len(fits.calls) == fitted


def test_a_curve_over_time_that_explains_all_ends_no_search(monkeypatch: pytest.MonkeyPatch) -> None:
    over_time = a_map("t", "s")
    fits = Fits(monkeypatch, {"t": 60.0, "t, periodic": 20.0}, over_time, BEATS, white="t")
    fits.plant.timing_errors = ()
    assert fits.fitted() == [("t, periodic", 20.0), ("t", 60.0)]


def test_a_force_at_one_place_takes_the_place_of_each_member(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": 60.0, "v": 50.0}, OVER_X, OVER_V)
    found = fit_local_forces(cast("Any", fits.search), Hypothesis(("a", "b")))
    assert len(found) == len(fits.calls) == 2 * PLACES
    freed = {call["free"] for call in fits.calls}
    places = [f"x{number}" for number in range(1, PLACES + 1)]
    assert freed == {("gain", rest, place) for rest, place in itertools.product("ab", places)}
    call = fits.calls[0]
    assert (call["nuisances"], call["start"], call["prior"]) == ((STAMP,), fits.base.values, None)
    assert call["fixed"]["count"] == PLACES + 2
    assert sum(name.startswith("x") for name in call["fixed"]) == PLACES + 1
    assert [entry.fit.score for entry in found] == [60.0] * 16
    assert fit_local_forces(cast("Any", Fits(monkeypatch, {"x": 0.0}, OVER_X).search), Hypothesis(("a",))) == []


def test_a_map_on_top_shows_the_residual_with_all_else_held(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"v": 50.0}, OVER_V)
    on_top(OVER_V, cast("Any", fits.base))
    (call,) = fits.calls
    assert call["free"] == OVER_V.free
    assert call["fixed"] == {**fits.base.values, **OVER_V.held}
    assert (call["nuisances"], call["start"], call["prior"].least) == ((), {}, 0.0)


# -- words and figures -------------------------------------------------------------------------------------------------


def curved(choice: ForceMap, coefficients: np.ndarray, variance: float = 0.0) -> Any:
    free = ("gain", *choice.free)
    return SimpleNamespace(
        free=free,
        values=dict(zip(choice.coefficients, coefficients, strict=True)),
        covariance=np.diag([99.0] + [variance] * len(choice.free)),
        score=60.0,
        smooth=None,
    )


def test_a_curve_is_described_by_its_size_its_points_and_their_errors() -> None:
    coefficients = np.sin(np.arange(12.0))
    choice = OVER_X
    found = describe(choice, curved(choice, coefficients, 0.04), cast("Any", SimpleNamespace(score=100.0)))
    # Six points in each of the nine intervals.
    at = np.linspace(0.0, 1e-3, 55)
    shapes = basis(at, 0.0, 1e-3, 12)
    np.testing.assert_allclose(found.at, at)
    np.testing.assert_allclose(found.force, shapes @ coefficients)
    np.testing.assert_allclose(found.stderr, 0.2 * np.linalg.norm(shapes, axis=1))
    assert found.force_rms == pytest.approx(np.sqrt(np.mean((shapes @ coefficients) ** 2)))
    assert (found.gain, found.variable) == (40.0, "x")
    assert found.where == where(choice, curved(choice, coefficients))


@pytest.mark.parametrize(
    ("choice", "bump", "words"),
    [
        (a_map("x", "m", high=9e-3), 5, "x 3.17 to 4.83 mm"),
        (a_map("t", "s", high=9e-3), 5, "t 3.17 to 4.83 ms"),
        (a_map("v", "m/s", high=9.0), 5, "v 3.17 to 4.83 m/s"),
        (a_map("t·v", "s", high=9e-3), 5, "t 3.17 to 4.83 ms, times v"),
        (a_map("x·u²", "m", high=9e-3), 5, "x 3.17 to 4.83 mm, times u²"),
        (a_map("x, periodic", "m", high=9e-3), 5, "x 2.33 to 3.67 mm, again every 9 mm"),
        (a_map("x", "m", high=9e-3), 0, "x 0 to 0.333 mm"),
        (a_map("x", "m", high=9e-3), 11, "x 8.67 to 9 mm"),
    ],
)
def test_where_a_curve_is_strong_is_said_in_words(choice: ForceMap, bump: int, words: str) -> None:
    """A B-spline falls to half 0.72 intervals from its middle; what is said are the next points, a sixth apart."""
    coefficients = np.zeros(12)
    coefficients[bump] = -2.0
    assert where(choice, curved(choice, coefficients)) == words


def test_a_long_scan_over_time_is_made_once_for_both_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {}, OVER_X, TURNS, BEATS)
    fits.fitted()
    assert fits.scans == [[""], ["", "'"], ["'"]]
    # Where curves over the stroke explain all, there is none.
    fits = Fits(monkeypatch, {"x": 60.0}, OVER_X, BEATS, white="x")
    fits.fitted()
    assert fits.scans == []
