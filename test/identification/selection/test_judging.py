"""What held-out data are fitted with, and what they say of a model: on plants and predictions that are made up."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from valve_sim.identification.selection.held_out import (
    ALIKE,
    FAILS_HELD_OUT,
    NOT_HELD_OUT,
    SAME,
    HeldOut,
    Judgement,
)
from valve_sim.identification.selection.predictive_density import Prediction

from identification.selection.linear_plant import COLUMNS, SAMPLES, SIGMA, LinearPlant, measured, problem_of
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Nuisance
from valve_sim.identification.selection import held_out
from valve_sim.identification.selection.residual_tests import SIGNIFICANT, Adequacy
from valve_sim.model import SimulationError

CLOCK = Nuisance("clock", 0.5, "m")
STAMP = Nuisance("stamp", 0.5, "m")
RATE = Nuisance("rate", 0.1, "N", is_of_machine=True)


def shown(values: Mapping[str, float]) -> Array:
    if values.get("rate", 0.0) > 5.0:
        raise SimulationError("too stiff")
    return np.asarray(
        values.get("clock", 0.0) * COLUMNS[:, 1]
        + values.get("stamp", 0.0) * COLUMNS[:, 2]
        + values.get("rate", 0.0) * COLUMNS[:, 3]
    )


def plant_of(data: Array, *nuisances: Nuisance) -> LinearPlant:
    plant = LinearPlant(data, shown, nuisances=nuisances)
    plant.timing_errors = (STAMP,)
    return plant


def trained(*nuisances: Nuisance, more: float = 0.0) -> tuple[Fit, HeldOut]:
    """A fit to training data, and held-out data that show 3 rather than 2 of the first column and `more` of `rate`."""
    training = plant_of(measured(1) + 0.3 * COLUMNS[:, 1], *nuisances)
    others = plant_of(measured(2) + COLUMNS[:, 0] - 0.4 * COLUMNS[:, 1] + more * COLUMNS[:, 3], *nuisances)
    result = fit(problem_of(training), ("level",), {}, nuisances=nuisances)
    return result, HeldOut(training, problem_of(others))  # type: ignore[arg-type]


# -- what is fitted ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("timing", [False, True])
def test_the_machine_stays_as_it_was_and_errors_of_the_recording_are_estimated_anew(timing: bool) -> None:
    result, held = trained(CLOCK)
    found = held.fit(result, timing=timing)
    assert found is not None
    assert (result.values["level"], result.values["clock"]) == pytest.approx((2.0, 0.3), abs=0.05)
    assert found.values["level"] == result.values["level"]
    assert found.values["clock"] == pytest.approx(-0.4, abs=0.1)
    assert found.free == ()
    assert [own.name for own in found.nuisances] == ["clock"] + ["stamp"] * timing
    assert held.fit(result, timing=timing) is found


def test_with_tolerances_the_machine_moves_within_what_the_training_data_leave_open() -> None:
    result, held = trained(CLOCK, RATE, more=0.05)
    found = held.fit(result, timing=False)
    assert found is not None
    assert found.free == ("level",)
    assert {own.name for own in found.nuisances} == {"clock", "rate"}
    # As in one fit to both, each recording with a clock of its own.
    nothing = np.zeros(SAMPLES)
    rows = np.vstack(
        [
            np.column_stack([COLUMNS[:, 0], COLUMNS[:, 3], COLUMNS[:, 1], nothing]) / SIGMA,
            np.column_stack([COLUMNS[:, 0], COLUMNS[:, 3], nothing, COLUMNS[:, 1]]) / SIGMA,
            np.diag([0.0, 1.0 / RATE.sigma, 1.0 / CLOCK.sigma, 1.0 / CLOCK.sigma]),
        ]
    )
    data = [plant.channels[0].data / SIGMA for plant in (result.problem.plant, held.problem.plant)]  # type: ignore[union-attr]
    both = np.linalg.lstsq(rows, np.concatenate([*data, np.zeros(4)]))[0]
    assert [found.values[name] for name in ("level", "rate", "clock")] == pytest.approx(both[[0, 1, 3]], abs=2e-3)


def test_what_cannot_be_simulated_there_has_no_fit() -> None:
    result, held = trained(CLOCK)
    result.values["rate"] = 9.0
    assert held.fit(result, timing=False) is None
    assert HeldOut(held.plant, None).fit(result, timing=False) is None


@pytest.mark.parametrize(
    ("nuisances", "p_value", "is_needed"),
    [((CLOCK,), 1.0, False), ((CLOCK,), 0.5 * SIGNIFICANT, True), ((CLOCK, STAMP), 1.0, True)],
)
def test_stamps_there_may_err_where_those_of_the_training_data_did_or_the_model_is_wrong(
    monkeypatch: pytest.MonkeyPatch, nuisances: tuple[Nuisance, ...], p_value: float, is_needed: bool
) -> None:
    monkeypatch.setattr(held_out, "adequacy", lambda result: Adequacy(p_value, "made up", 0.0))
    monkeypatch.setattr(held_out, "whiteness", lambda *given: Adequacy(1.0, "made up", 0.0))
    monkeypatch.setattr(held_out, "rmse", lambda held: 0.0)
    result, held = trained(*nuisances)
    assert held.needs_timing(result) is is_needed
    cast("Any", held.plant).timing_errors = ()
    assert held.needs_timing(result) is False


@pytest.mark.parametrize(("error", "p_value", "is_needed"), [(0.0, 1.0, False), (9.0, 1.0, True), (0.0, 0.0, True)])
def test_stamps_there_may_err_where_held_out_data_miss_the_model(
    monkeypatch: pytest.MonkeyPatch, error: float, p_value: float, is_needed: bool
) -> None:
    monkeypatch.setattr(held_out, "adequacy", lambda result: Adequacy(1.0, "made up", 0.0))
    monkeypatch.setattr(held_out, "whiteness", lambda *given: Adequacy(p_value, "made up", 0.0))
    for name in ("rmse", "effective_rmse"):
        monkeypatch.setattr(held_out, name, lambda held: error)
    result, held = trained(CLOCK)
    assert held.needs_timing(result) is is_needed
    # What those stamps explain is compared, and excuses nothing.
    judgement = held.open(result)[0]
    assert judgement.is_white is not is_needed
    result.values["rate"] = 9.0
    assert not HeldOut(held.plant, held.problem).needs_timing(result)


# -- what it says ------------------------------------------------------------------------------------------------------


class Judged:
    """Held-out data of which it is written down what each model makes of them: by name its error and density."""

    def __init__(self, patch: pytest.MonkeyPatch, *, relief: bool = False, p_value: float = 1.0) -> None:
        self.known: dict[str, tuple[float, float] | None] = {}
        self.timing: list[bool] = []
        for error in ("rmse", "effective_rmse"):
            patch.setattr(held_out, error, lambda held: self.known[held.name][0])  # type: ignore[index]
        patch.setattr(held_out, "predict_held_out", self.predicted)
        patch.setattr(held_out, "is_relief", lambda base, result: relief)
        patch.setattr(held_out, "adequacy", lambda result: Adequacy(1.0, "made up", 0.0))
        patch.setattr(
            held_out, "whiteness", lambda problem, residuals, free: Adequacy(0.0 if free else p_value, "made up", 0.0)
        )
        problem = SimpleNamespace(noise=SimpleNamespace(sigma=1.0))
        self.held = HeldOut(cast("Any", SimpleNamespace(timing_errors=())), cast("Any", problem))
        patch.setattr(self.held, "fit", self.fit)
        self.problem = problem

    def predicted(self, training: Any, held: Any) -> Prediction:
        assert training.name == held.name
        return Prediction(self.known[held.name][1], np.zeros(3))  # type: ignore[index]

    def fit(self, result: Any, *, timing: bool) -> Any:
        self.timing.append(timing)
        if self.known[result.name] is None:
            return None
        return SimpleNamespace(name=result.name, problem=self.problem)

    def open(
        self, base: tuple[float, float] | None, best: tuple[float, float] | None, gained: float = 0.0
    ) -> Judgement:
        """The judgement of the best of (error in noises, −2 ln density), whose S is by `gained` better."""
        self.known = {"base": base, "best": best}
        names = [
            SimpleNamespace(name="base", score=gained, nuisances=()),
            SimpleNamespace(name="best", score=0.0, nuisances=()),
        ]
        return self.held.open(*cast("list[Any]", names))[1]


def test_a_model_is_better_where_it_predicts_decisively_better(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch)
    assert judged.open((2.0, 100.0), (1.0, 89.9)) == Judgement(True, 0.5, True, SAME)
    assert judged.open((2.0, 100.0), (1.0, 90.0)) == Judgement(True, 0.5, False, SAME)
    # What it gained in training does not count.
    assert not judged.open((2.0, 100.0), (1.0, 90.0), gained=50.0).predicts_better
    assert judged.held.looks == 3


def test_of_relief_training_and_held_out_data_count_together(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch, relief=True)
    assert judged.open((2.0, 100.0), (2.0, 104.9), gained=15.0) == Judgement(False, 1.0, True, ALIKE)
    assert not judged.open((2.0, 100.0), (2.0, 105.0), gained=15.0).predicts_better


@pytest.mark.parametrize(
    ("error", "p_value", "is_white"),
    [
        (FAILS_HELD_OUT, 1.0, True),
        (1.01 * FAILS_HELD_OUT, 1.0, False),
        (1.0, 1.01 * SIGNIFICANT, True),
        (1.0, SIGNIFICANT, False),
    ],
)
def test_its_residual_there_must_be_white_and_no_larger_than_noise(
    monkeypatch: pytest.MonkeyPatch, error: float, p_value: float, is_white: bool
) -> None:
    assert Judged(monkeypatch, p_value=p_value).open((2.0, 100.0), (error, 50.0)).is_white is is_white


def test_what_cannot_be_simulated_there_is_refuted_unless_nothing_can(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch)
    assert judged.open((2.0, 100.0), None) == Judgement(False, math.inf, False)
    assert judged.open(None, None) == Judgement(False, 1.0, False)
    # Where only the declared model cannot be, any that can is better.
    assert judged.open(None, (1.0, 500.0)) == Judgement(True, 0.0, True)


def test_of_an_exact_declared_model_any_error_is_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    judged = Judged(monkeypatch)
    assert judged.open((0.0, 100.0), (0.0, 100.0)).ratio == 1.0
    assert judged.open((0.0, 100.0), (1e-9, 50.0)).ratio == math.inf


def test_nothing_held_out_refutes_nothing_and_is_no_look() -> None:
    held = HeldOut(cast("Any", SimpleNamespace()), None)
    result = cast("Any", SimpleNamespace())
    assert held.open(result, result, result) == (NOT_HELD_OUT,) * 3
    assert held.looks == 0
    assert not NOT_HELD_OUT.refutes_names


@pytest.mark.parametrize("slack", [SAME, ALIKE])
def test_errors_that_differ_by_rounding_are_equal(slack: float) -> None:
    assert not Judgement(True, 1.0 + 0.9 * slack, True, slack).is_larger
    assert Judgement(True, 1.0 + 1.1 * slack, True, slack).is_larger


@pytest.mark.parametrize(
    ("is_white", "ratio", "predicts_better", "is_gain", "refutes"),
    [
        (True, 0.5, True, True, False),
        (False, 0.5, True, True, True),
        (True, 1.5, True, False, True),
        (True, 0.5, False, False, True),
    ],
)
def test_a_name_needs_all_three(
    is_white: bool, ratio: float, predicts_better: bool, is_gain: bool, refutes: bool
) -> None:
    judgement = Judgement(is_white, ratio, predicts_better)
    assert (judgement.is_gain, judgement.refutes_names) == (is_gain, refutes)


def test_an_error_of_a_fit_s_form_is_told_from_noise() -> None:
    """Whole, on a linear plant: the right form holds, and one that lacks a column is refuted."""
    training = LinearPlant(measured(1) + COLUMNS[:, 3], shown)
    others = LinearPlant(measured(2) + COLUMNS[:, 3], shown)
    base, best = (fit(problem_of(training), free, {}) for free in (("level",), ("level", "rate")))
    held = HeldOut(training, problem_of(others))  # type: ignore[arg-type]
    of_base, of_best = held.open(base, best)
    assert (of_base.is_white, of_base.ratio, of_base.predicts_better) == (False, 1.0, False)
    assert (of_best.is_white, of_best.predicts_better) == (True, True)
    assert of_best.ratio == pytest.approx(SIGMA / math.hypot(SIGMA, 1.0), rel=0.1)
