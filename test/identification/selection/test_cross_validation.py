"""Strokes left out of a fit, against refits of a linear model without them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from valve_sim.identification.selection.cross_validation import (
    MOST_FOLDS,
    cross_validate,
    folds_of,
    own_nuisances,
    predicts_better,
)

from valve_sim.identification.estimation.descent import Effort
from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array, Channel, Nuisance
from valve_sim.model import Parameter

SIGMA = 0.3
SAMPLES = 30


class Strokes:
    """Each stroke shows level + slope·t + bend·t², a drift of the sensor and an error of its own."""

    base = ("level", "slope", "bend")

    def __init__(self, strokes: int, seed: int = 1) -> None:
        random = np.random.default_rng(seed)
        times = np.arange(strokes * SAMPLES) / SAMPLES
        group = np.arange(strokes * SAMPLES) // SAMPLES
        self.own = random.normal(0.0, 0.5, strokes)
        data = 1.0 + 0.7 * times + 0.05 * times**2 + self.own[group] + random.normal(0.0, SIGMA, len(times))
        still = np.zeros(len(times), bool)
        self.channels = [Channel("", "position", times, data, still, group, "m")]
        self.nuisances: Sequence[Nuisance] = [Nuisance("drift", 0.2, "m")]
        self.timing_errors = [
            Nuisance(f"error[{number}]", 0.5, "m", during=(float(number) - 1e-9, float(number) + 1.0 - 1e-9))
            for number in range(strokes)
        ]

    def parameter(self, name: str) -> Parameter:
        return Parameter(name, "m", "of strokes", -1e3, 1e3, 2.0, 0.0)

    def declared(self, name: str) -> float:
        return 0.0

    def predict(self, values: dict[str, float]) -> list[Array]:
        times, group = self.channels[0].times, self.channels[0].group
        own = np.array([values.get(nuisance.name, 0.0) for nuisance in self.timing_errors])
        powers = [values.get(name, 0.0) * times**power for power, name in enumerate(self.base)]
        return [sum(powers) + values.get("drift", 0.0) + own[group]]


def fitted(strokes: int, free: tuple[str, ...], *, timing: bool) -> Fit:
    plant = Strokes(strokes)
    noises = {"position": Noise(SIGMA, SIGMA, (), 0.0, 1.0, 100)}
    problem = Problem(plant, noises=noises)  # type: ignore[arg-type]
    nuisances = [*plant.nuisances, *(plant.timing_errors if timing else ())]
    return fit(problem, free, {}, nuisances=nuisances)


@pytest.mark.parametrize("timing", [False, True])
@pytest.mark.parametrize("free", [("level",), ("level", "slope"), ("level", "slope", "bend")])
def test_a_linear_model_is_predicted_exactly(free: tuple[str, ...], timing: bool) -> None:
    result = fitted(5, free, timing=timing)
    found = cross_validate(result)
    assert found is not None
    assert found.folds == 5
    rise = 0.0
    for number, fold in enumerate(folds_of(result.problem)):
        own = [nuisance for nuisance in result.nuisances if nuisance.name == f"error[{number}]"]
        assert [result.nuisances[index] for index in own_nuisances(result, fold)] == own
        others = fit(result.problem.restricted(lambda i, g, n=number: g != n), free, {}, nuisances=result.nuisances)
        names = {nuisance.name for nuisance in own}
        machine = {name: value for name, value in others.values.items() if name not in names}
        alone = fit(result.problem.restricted(lambda i, g, n=number: g == n), (), {}, nuisances=own, fixed=machine)
        assert found.residuals[fold] == pytest.approx(alone.residuals[fold], abs=0.05)
        before = sum((result.values[nuisance.name] / nuisance.sigma) ** 2 for nuisance in own)
        rise += alone.chi2 - before - float(np.sum(np.square(result.residuals[fold])))
    assert found.rise == pytest.approx(rise, rel=0.02, abs=0.1)


def test_a_fit_that_has_come_to_no_optimum_predicts_no_better_than_it_fits() -> None:
    """One step would lead to it: strokes that are left out would be predicted far better than they are fitted."""
    plant = Strokes(5)
    problem = Problem(plant, noises={"position": Noise(SIGMA, SIGMA, (), 0.0, 1.0, 100)})  # type: ignore[arg-type]
    result = fit(problem, ("level", "slope"), {"level": 50.0}, effort=Effort(most=0))
    assert result.values["level"] == 50.0
    found = cross_validate(result)
    assert found is not None
    assert found.sum_squares < 1e-3 * float(np.sum(np.square(result.residuals)))
    assert found.rise == 0.0


def test_what_one_stroke_alone_shows_is_not_predicted_from_the_others() -> None:
    plant = Strokes(4)
    last = plant.channels[0].group == 3
    plain = plant.predict

    def with_bump(values: dict[str, float]) -> list[Array]:
        # `bend` acts in the last stroke alone.
        return [plain({**values, "bend": 0.0})[0] + values.get("bend", 0.0) * last]

    plant.predict = with_bump  # type: ignore[method-assign]
    plant.channels[0].data[:] = 0.1 * np.cos(np.arange(len(last))) + 3.0 * last
    problem = Problem(plant, noises={"position": Noise(SIGMA, SIGMA, (), 0.0, 1.0, 100)})  # type: ignore[arg-type]
    without, with_it = (cross_validate(fit(problem, free, {})) for free in (("level",), ("level", "bend")))
    assert without is not None
    assert with_it is not None
    # Left out, the last stroke is predicted by the level of the others and no bump: off by 3, ten standard deviations.
    assert float(np.mean(np.abs(with_it.residuals[last]))) == pytest.approx(10.0, rel=0.1)
    assert float(np.mean(np.abs(without.residuals[last]))) == pytest.approx(10.0, rel=0.1)


class Alone(Strokes):
    """Strokes that show a level each, and one of them also a `bump` of a given kind."""

    def __init__(self, levels: Sequence[float], bump: Parameter | None = None) -> None:
        super().__init__(len(levels))
        self.levels, self.bump, self.nuisances = levels, bump, ()
        self.last = self.channels[0].group == len(levels) - 1
        self.channels[0].data[:] = np.repeat(levels, SAMPLES) + 0.1 * np.cos(np.arange(len(self.last)))

    def parameter(self, name: str) -> Parameter:
        if name == "e.bump" and self.bump is not None:
            return self.bump
        return super().parameter(name)._replace(lower=0.5, upper=1e6)

    def declared(self, name: str) -> float:
        return 1.0

    def predict(self, values: dict[str, float]) -> list[Array]:
        return [values.get("level", 1.0) + values.get("e.bump", 0.0) * self.last]


def left_out(plant: Strokes, free: tuple[str, ...], start: dict[str, float]) -> Array:
    """What each stroke is missed by on average where it is left out, in its unit."""
    problem = Problem(plant, noises={"position": Noise(SIGMA, SIGMA, (), 0.0, 1.0, 100)})  # type: ignore[arg-type]
    found = cross_validate(fit(problem, free, start))
    assert found is not None
    return np.asarray(found.residuals.reshape(-1, SAMPLES).mean(axis=1) * SIGMA)


def test_without_a_stroke_a_parameter_stays_within_its_bounds() -> None:
    # Without the first, 0 would be the best level of the others, and 0.5 is the least.
    assert left_out(Alone([6.0, -1.0, 1.0]), ("level",), {}) == pytest.approx([5.5, -4.5, -1.5], abs=0.05)
    # On its bound in the fit to all, it stays there.
    assert left_out(Alone([0.0, -1.0, 1.0]), ("level",), {}) == pytest.approx([-0.5, -1.5, 0.5], abs=0.05)


@pytest.mark.parametrize(("off", "missed"), [(0.0, 3.0), (1.0, 2.0), (None, 0.0)])
def test_what_one_stroke_alone_shows_goes_back_to_off_and_a_shape_stays(off: float | None, missed: float) -> None:
    bump = Parameter("bump", "m", "of one stroke", -1e3, 1e3, 2.0, off)
    plant = Alone([2.0, 2.0, 2.0, 5.0], bump)
    plant.declared = lambda name: 1.0 if off is None else off  # type: ignore[method-assign]
    found = left_out(plant, ("level", "e.bump"), {"e.bump": 2.0})
    assert found == pytest.approx([0.0, 0.0, 0.0, missed], abs=0.06)


def test_a_larger_model_is_better_only_where_it_is_true() -> None:
    small, true, large = (
        cross_validate(fitted(6, free, timing=False)) for free in (("level",), ("level", "slope"), Strokes.base)
    )
    assert small is not None
    assert true is not None
    assert large is not None
    assert predicts_better(small, true, 1.0)
    assert not predicts_better(true, small, 1.0)
    assert not predicts_better(true, true, 1.0)


def test_one_stroke_leaves_nothing_to_predict_it_from() -> None:
    assert cross_validate(fitted(1, ("level",), timing=False)) is None


def test_many_strokes_are_left_out_several_at_once() -> None:
    folds = folds_of(fitted(40, ("level",), timing=False).problem)
    assert len(folds) == MOST_FOLDS
    assert np.array_equal(np.sum(folds, axis=0), np.ones(40 * SAMPLES))


def test_what_is_far_beyond_its_prior_scale_is_not_pulled_back() -> None:
    """A level of 200 km, where 2 m were expected, is known from the others all the same."""
    far = Alone([2e5, 2e5, 2e5])
    far.declared = lambda name: 0.0  # type: ignore[method-assign]
    assert left_out(far, ("level",), {}) == pytest.approx([0.0] * 3, abs=0.05)
