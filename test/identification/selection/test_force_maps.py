"""Which force maps are fitted beside a model, and what is said of them: on fits that are written down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import ForceMap, Nuisance
from valve_sim.identification.selection import force_maps
from valve_sim.identification.selection.force_maps import (
    AT_ONCE,
    PERIOD_STEP,
    competing_curves,
    describe,
    fit_maps,
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


OVER_X, OVER_V, OVER_TIME = a_map("x", "m", high=1e-3), a_map("v", "m/s", least=0.0), a_map("t", "s")
TURNS, BEATS = a_map("x, periodic", "m", high=1e-3), a_map("t, periodic", "s", high=2.0)


class Fits:
    """Fits in place of real ones: by the variable of the map that they free their ln p, and whether they are white.

    Attributes:
        calls: of `fit`, its arguments. said: what was said to be tried.
    """

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        evidence: Mapping[str, float],
        *maps: ForceMap,
        white: str = "",
        further: int = 0,
    ) -> None:
        self.evidence, self.maps, self.white = evidence, maps, white
        self.calls: list[dict[str, Any]] = []
        self.said: list[str] = []
        self.further = further
        problem = SimpleNamespace(plant=SimpleNamespace(force_maps=maps, timing_errors=(STAMP,)))
        values = {"mass": 2.0, "gain": 3.0, "clock": 1e-5}
        self.base = cast(
            "Fit",
            SimpleNamespace(
                problem=problem, free=("gain",), nuisances=(CLOCK,), names=["gain", CLOCK.name], values=values, over=""
            ),
        )
        patch.setattr(force_maps, "fit", self.fit)
        patch.setattr(force_maps, "likely_periods", self.periods)
        patch.setattr(force_maps, "adequacy", lambda one: Adequacy(float(one.over in self.white.split("; ")), "", 0.0))

    def say(self, what: str, fraction: float) -> None:
        self.said.append(what)

    def periods(self, choice: ForceMap, *bases: Any) -> list[list[Period]]:
        lengths = [(0.1, 0.01), (0.02, 0.001), *[(0.03, 0.001)] * self.further]
        found = [Period(length, sigma, 50.0, dict.fromkeys(choice.coefficients, length)) for length, sigma in lengths]
        return [found for _ in bases]

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
        evidence = self.evidence[over]
        if evidence == 0.0:
            raise SimulationError("it cannot be simulated")
        values = {**start, **given["fixed"], **dict.fromkeys(free, 1.0), **{own.name: own.mean for own in nuisances}}
        # A period of 0.1 is the worse one.
        evidence -= 5.0 * ([own.mean for own in nuisances if own.name.startswith("end")] == [0.1])
        return SimpleNamespace(
            problem=problem, free=tuple(free), nuisances=tuple(nuisances), values=values,
            names=[*free, *(own.name for own in nuisances)], log_evidence=evidence, over=over, chi2=-2.0 * evidence,
        )  # fmt: skip

    def fitted(self) -> list[tuple[str, float]]:
        """What `fit_maps` finds beside the curves that compete."""
        known = competing_curves(self.base, self.say)
        return [(entry.choice.variable, entry.fit.log_evidence) for entry in fit_maps(self.base, known, self.say)]


def test_curves_compete_beside_what_a_fit_estimates_and_waves_and_time_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": -60.0, "v": -50.0}, OVER_X, OVER_V, OVER_TIME, TURNS, BEATS)
    found = competing_curves(fits.base, fits.say)
    assert [(entry.choice.variable, entry.fit.log_evidence) for entry in found] == [("x", -60.0), ("v", -50.0)]
    first, second = sorted(fits.calls, key=lambda call: call["free"][1])[::-1]
    assert first["free"] == ("gain", *OVER_X.free)
    assert first["fixed"] == {"mass": 2.0, **OVER_X.held}
    assert (first["start"], first["nuisances"]) == (fits.base.values, (CLOCK,))
    assert (first["prior"].names, first["prior"].least, first["prior"].repeats) == (OVER_X.free, -np.inf, False)
    assert second["prior"].least == 0.0
    assert sorted(fits.said) == ["a force over v", "a force over x"]


def test_maps_come_by_their_evidence_and_curves_that_are_known_are_not_fitted_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fits = Fits(
        monkeypatch, {"x": -60.0, "v": -50.0, "t": -55.0, "x, periodic": -70.0}, OVER_X, OVER_V, OVER_TIME, TURNS
    )
    assert fits.fitted() == [("v", -50.0), ("t", -55.0), ("x", -60.0), ("x, periodic", -70.0)]
    assert sum(OVER_X.free[0] in call["free"] for call in fits.calls) == 1


def test_what_cannot_be_simulated_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x": 0.0, "v": -50.0, "x, periodic": 0.0}, OVER_X, OVER_V, TURNS)
    assert fits.fitted() == [("v", -50.0)]


@pytest.mark.parametrize(("white", "is_tried"), [("", True), ("x", False), ("x, periodic", False), ("t", True)])
def test_waves_over_time_are_tried_where_nothing_but_time_explains_all(
    monkeypatch: pytest.MonkeyPatch, white: str, *, is_tried: bool
) -> None:
    """A curve over time follows anything in the strokes that it is fitted to."""
    evidence = {"x": -60.0, "t": -55.0, "x, periodic": -70.0, "t, periodic": -20.0}
    fits = Fits(monkeypatch, evidence, OVER_X, OVER_TIME, TURNS, BEATS, white=white)
    assert ("t, periodic" in dict(fits.fitted())) == is_tried


def test_a_period_is_estimated_along_and_the_best_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = Fits(monkeypatch, {"x, periodic": -30.0}, TURNS)
    (entry,) = fit_maps(fits.base, [], fits.say)
    assert entry.fit.log_evidence == -30.0
    assert entry.choice.high == pytest.approx(0.02)
    lengths = [call["nuisances"][-1] for call in fits.calls]
    assert [(own.name, own.mean, own.sigma, own.unit, own.is_of_machine) for own in lengths] == [
        (TURNS.end, 0.1, 0.01, "m", True),
        (TURNS.end, 0.02, 0.001, "m", True),
    ]
    assert [own.step for own in lengths] == [PERIOD_STEP * 0.01, PERIOD_STEP * 0.001]
    assert all(TURNS.end not in call["fixed"] and call["prior"].repeats for call in fits.calls)
    assert [call["start"]["x, periodic0"] for call in fits.calls] == [0.1, 0.02]


@pytest.mark.parametrize(("white", "fitted"), [("x, periodic", AT_ONCE), ("", 8)])
def test_periods_are_fitted_three_at_once_until_one_explains_all(
    monkeypatch: pytest.MonkeyPatch, white: str, fitted: int
) -> None:
    fits = Fits(monkeypatch, {"x, periodic": -30.0}, TURNS, white=white, further=6)
    assert fits.fitted() == [("x, periodic", -30.0)]
    assert len(fits.calls) == fitted


# -- words and figures -------------------------------------------------------------------------------------------------


def curved(choice: ForceMap, coefficients: np.ndarray, variance: float = 0.0) -> Any:
    free = ("gain", *choice.free)
    return SimpleNamespace(
        free=free,
        values=dict(zip(choice.coefficients, coefficients, strict=True)),
        covariance=np.diag([99.0] + [variance] * len(choice.free)),
        log_evidence=-60.0,
        smooth=None,
    )


def test_a_curve_is_described_by_its_size_its_points_and_their_errors() -> None:
    coefficients = np.sin(np.arange(12.0))
    choice = OVER_X
    found = describe(choice, curved(choice, coefficients, 0.04), cast("Any", SimpleNamespace(log_evidence=-80.0)))
    # Six points in each of the nine intervals.
    at = np.linspace(0.0, 1e-3, 55)
    shapes = basis(at, 0.0, 1e-3, 12)
    np.testing.assert_allclose(found.at, at)
    np.testing.assert_allclose(found.force, shapes @ coefficients)
    np.testing.assert_allclose(found.stderr, 0.2 * np.linalg.norm(shapes, axis=1))
    assert (found.gain, found.variable) == (40.0, "x")
