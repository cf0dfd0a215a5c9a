"""From where each hypothesis is fitted, and which of its fits is kept: on fits that are written down."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from valve_sim.identification.selection.hypotheses import (
    ANNEALING,
    KEPT,
    NEAR,
    SCATTER,
    Search,
)
from valve_sim.identification.selection.table import FitLog, Row

from identification.selection.made_up_fits import SIZE, World, of, switches
from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.descent import TRIAL, Effort
from valve_sim.identification.plants.protocol import EffectChoice
from valve_sim.identification.selection.starts import effect_starts, robust_cost, start_near_off, starts_from_declared
from valve_sim.model import Parameter, SimulationError

ONE_SIDED = Parameter("force", "N", "added", 0.0, 100.0, 2.0, 0.0)
TWO_SIDED = Parameter("offset", "N", "added", -100.0, 100.0, 2.0, 0.0)
SHAPE = Parameter("time", "s", "of it", 1e-3, 10.0, 4.0)
RECIPROCAL = Parameter("film", "m", "of it", 1e-6, math.inf, 1e-3, math.inf)


def starts(parameters: tuple[Parameter, ...], missed: Mapping[str, float] | None = None) -> list[dict[str, float]]:
    """Starts of an effect; the residual is by how far its values are off `missed`."""
    effect = EffectChoice("a", parameters)
    aim = missed or {}
    world = World({"": 0.0}, {"a": effect})
    world.missed = lambda values: sum(abs(values[name] - at) for name, at in aim.items())
    return effect_starts(partial(robust_cost, world.problem), effect, {"gain": 1.0})


# -- starts of an effect -----------------------------------------------------------------------------------------------


def test_one_size_starts_near_off_and_from_the_best_that_is_large() -> None:
    """0.05 prior scales of 2 N, and 0.5, 1.5 or 3 of them."""
    for aim, best in ((0.0, 1.0), (2.5, 3.0), (50.0, 6.0)):
        assert starts((ONE_SIDED,), {"a.force": aim}) == [{"a.force": 0.1}, {"a.force": best}]


def test_a_size_of_either_sign_starts_from_the_better_sign() -> None:
    for aim, best in ((2.9, 3.0), (-2.9, -3.0), (-9.0, -6.0), (-0.9, -1.0)):
        assert starts((TWO_SIDED,), {"a.offset": aim}) == [{"a.offset": 0.1}, {"a.offset": best}]


def test_two_sizes_start_from_the_two_best_pairs() -> None:
    aim = {"a.force": 1.1, "a.offset": -3.2}
    near, *far = starts((ONE_SIDED, TWO_SIDED), aim)
    assert near == {"a.force": 0.1, "a.offset": 0.1}
    # Of 3 times 6; the next best has the other size wrong by 2.
    assert far == [{"a.force": 1.0, "a.offset": -3.0}, {"a.force": 3.0, "a.offset": -3.0}]


def test_of_three_sizes_all_are_alike() -> None:
    three = tuple(ONE_SIDED._replace(name=name) for name in "uvw")
    near, *far = starts(three, {"a.u": 3.0, "a.v": 3.0, "a.w": 3.0})
    assert near == dict.fromkeys(("a.u", "a.v", "a.w"), 0.1)
    assert far == [dict.fromkeys(near, 3.0), dict.fromkeys(near, 1.0)]


@pytest.mark.parametrize(("aim", "shape"), [(4.0, 4.0), (0.9, 0.8), (99.0, 10.0)])
def test_a_shape_starts_at_its_scale_and_a_fifth_and_five_times_that(aim: float, shape: float) -> None:
    """Five times the scale is beyond its bound of 10 s."""
    near, *far = starts((ONE_SIDED, SHAPE), {"a.force": 3.0, "a.time": aim})
    assert near == {"a.force": 0.1, "a.time": 4.0}
    assert far == [{"a.force": 3.0, "a.time": pytest.approx(shape)}]


def test_where_off_is_infinite_no_start_is_near_it() -> None:
    """The gradient vanishes there. Sizes are of the reciprocal."""
    assert starts((RECIPROCAL,), {"a.film": 0.0}) == [{"a.film": pytest.approx(1e-3 / size)} for size in (3.0, 1.5)]
    assert start_near_off(EffectChoice("a", (RECIPROCAL,))) == {"a.film": pytest.approx(1e-3 / 0.05)}


def test_what_cannot_be_simulated_comes_last() -> None:
    effect = EffectChoice("a", (ONE_SIDED,))
    world = World({"": 0.0}, {"a": effect})

    def missed(values: Mapping[str, float]) -> float:
        if values["a.force"] < 5.0:
            raise SimulationError("too small")
        return 1.0

    world.missed = missed
    assert effect_starts(partial(robust_cost, world.problem), effect, {})[1:] == [{"a.force": 6.0}]


def test_a_declared_value_starts_where_it_is() -> None:
    mass = EffectChoice("valve.m", (Parameter("m", "kg", "", 0.1, 9.0, 0.2, 1.0),), is_declared_value=True)
    assert effect_starts(partial(robust_cost, World({"": 0.0}, {"a": mass}).problem), mass, {}) == [{}]


def test_a_size_whose_off_is_its_upper_bound_starts_below() -> None:
    top = Parameter("gain", "1", "of it", 0.1, 1.0, 0.2, 1.0)
    near, far = starts((top,), {"a.gain": 0.72})
    assert near == {"a.gain": pytest.approx(0.99)}
    assert far == {"a.gain": pytest.approx(0.7)}
    # Beyond the other bound it starts on it.
    assert starts((top,), {"a.gain": -9.0})[1] == {"a.gain": pytest.approx(0.4)}
    assert starts((top._replace(lower=0.8),), {"a.gain": -9.0})[1] == {"a.gain": pytest.approx(0.8)}


# -- starts from what is declared --------------------------------------------------------------------------------------


def from_declared(
    parameters: tuple[Parameter, ...], aim: Mapping[str, float], known: Mapping[str, float] | None = None
) -> list[dict[str, float]]:
    """Starts of an effect whose values are sought; what is missing is off."""
    effect = EffectChoice("a", parameters)
    world = World({"": 0.0}, {"a": effect})
    world.missed = lambda values: sum(abs(values.get(name, 0.0) - at) for name, at in aim.items())
    return starts_from_declared(partial(robust_cost, world.problem), effect, known or {})


def test_a_strong_effect_starts_from_what_is_declared_and_near_its_size() -> None:
    """Of 1, 2, 4 ... 64 N the best, and of that the best of 0.7, 1 and 1.4."""
    for aim, best in ((22.0, 16.0 * math.sqrt(2.0)), (31.0, 32.0), (1.0, 1.0), (99.0, 64.0 * math.sqrt(2.0))):
        assert from_declared((ONE_SIDED,), {"a.force": aim}) == [{"a.force": pytest.approx(best)}]
    assert from_declared((TWO_SIDED,), {"a.offset": -22.0}) == [{"a.offset": pytest.approx(-16.0 * math.sqrt(2.0))}]


def test_effects_that_are_there_already_keep_their_values() -> None:
    found = from_declared((ONE_SIDED,), {"a.force": 32.0, "b.size": 3.0}, {"b.size": 3.0})
    assert found == [{"a.force": 32.0, "b.size": 3.0}]


def test_two_sizes_are_alike_and_shapes_are_tried() -> None:
    both = (ONE_SIDED, TWO_SIDED)
    assert from_declared(both, {"a.force": 16.0, "a.offset": 16.0}) == [{"a.force": 16.0, "a.offset": 16.0}]
    (found,) = from_declared((ONE_SIDED, SHAPE), {"a.force": 16.0, "a.time": 0.8})
    assert found == {"a.force": 16.0, "a.time": pytest.approx(0.8)}


def test_what_explains_little_from_there_needs_no_such_start() -> None:
    """An aim of 10 beyond reach: the best of all sizes leaves 10 of 11, or of 13."""
    out_of_reach = {"a.force": 1.0, "elsewhere": 10.0}
    assert from_declared((ONE_SIDED,), out_of_reach) == []
    assert from_declared((ONE_SIDED,), {**out_of_reach, "a.force": 8.0}) != []
    mass = EffectChoice("valve.m", (Parameter("m", "kg", "", 0.1, 9.0, 0.2, 1.0),), is_declared_value=True)
    assert starts_from_declared(partial(robust_cost, World({"": 0.0}, {"a": mass}).problem), mass, {}) == []


# -- fits of a hypothesis ----------------------------------------------------------------------------------------------


def searched(patch: pytest.MonkeyPatch, world: World) -> Search:
    return world.use(patch).search()


def kinds(search: Search, key: str) -> list[str]:
    return [row.start for row in search.log.rows if row.hypothesis == of(key)]


def test_the_declared_model_is_fitted_from_its_values_and_three_times_those(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "'": 290.0}, switches("a"), timing=True)
    search = searched(monkeypatch, world)
    search.fit(of("'"))
    assert [start for _, start, _ in world.starts] == [{}, {"gain": 21.0}]
    # Once the declared model is known, stamps are estimated from its values on.
    again = searched(monkeypatch, World({"": 300.0, "'": 290.0}, switches("a"), timing=True))
    declared = again.fit(of(""))
    again.fit(of("'"))
    assert kinds(again, "'") == ["declared model"]
    assert kinds(again, "") == ["declared", "declared, tripled"]
    assert again.fit(of("")) is declared


def test_a_set_is_fitted_from_its_best_smaller_one(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 200.0, "b": 100.0, "ab": 50.0}, switches("ab"))
    search = searched(monkeypatch, world)
    search.fit_each([of("a"), of("b")], (0.0, 1.0))
    search.fit(of("ab"))
    begun = [start for key, start, _ in world.starts if key == "ab"]
    assert [start["at"] for start in begun] == [100.0, 100.0]
    # b stays where the smaller fit left it: 5 standard errors of a tenth of its scale; a is added.
    assert [(start["a.size"], start["b.size"]) for start in begun] == [(0.1, 1.0), (1.0, 1.0)]
    assert search.score(of("ab")) == 50.0
    assert search.best([of("a"), of("b"), of("ab")]) == of("ab")


def test_where_no_smaller_set_is_known_the_one_without_the_last_is_fitted_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World({"": 300.0, "ab": 50.0}, switches("ab"))
    search = searched(monkeypatch, world)
    search.fit(of("ab"))
    assert list(dict.fromkeys(key for key, *_ in world.starts)) == ["", "a", "ab"]


def test_with_stamps_that_err_a_set_starts_from_the_same_without_too(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "'": 290.0, "a": 100.0, "a'": 90.0}, switches("a"), timing=True)
    search = searched(monkeypatch, world)
    search.fit(of("a"))
    search.fit(of("a'"))
    assert kinds(search, "a'") == ["untimed", "sizes", "sizes"]
    assert next(start for key, start, _ in world.starts if key == "a'")["at"] == 100.0


@pytest.mark.parametrize(("shape", "is_lost"), [(0.0, False), (1e9, True), (-1e9, True)])
def test_a_shape_that_runs_to_a_bound_is_tried_from_others(
    monkeypatch: pytest.MonkeyPatch, shape: float, is_lost: bool
) -> None:
    effect = EffectChoice("a", (SIZE, SHAPE._replace(lower=0.1)))
    world = World({"": 300.0, "a": 100.0}, {"a": effect}, sizes={("a", "a.time"): shape})
    search = searched(monkeypatch, world)
    search.fit(of("a"))
    assert kinds(search, "a") == ["sizes", "sizes"] + ["shapes"] * 3 * is_lost
    tried = [(start["a.size"], start["a.time"]) for key, start, _ in world.starts if key == "a"][2:]
    assert tried == [(0.1, 4.0), (0.1, pytest.approx(0.8)), (0.1, 10.0)][: 3 * is_lost]
    # A size on its bound has lost no shape.
    other = World({"": 300.0, "a": 100.0}, {"a": effect}, sizes={("a", "a.size"): 1e9, ("a", "a.time"): 0.0})
    search = searched(monkeypatch, other)
    search.fit(of("a"))
    assert "shapes" not in kinds(search, "a")


def test_starts_that_cannot_be_simulated_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0}, switches("a"))
    world.fails = lambda start: start.get("a.size", 0.0) > 0.5
    search = searched(monkeypatch, world)
    search.fit(of("a"))
    assert kinds(search, "a") == ["sizes"]
    world.fails = lambda start: True
    with pytest.raises(SimulationError, match="the declared model: the model cannot be simulated from any start"):
        searched(monkeypatch, world).fit(of(""))


def test_what_cannot_be_simulated_is_left_out_of_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Far from the data one effect of fifty could not be simulated, and the diagnosis ended with its error."""
    world = World(
        {"": 300.0, "a": 100.0, "b": 50.0}, switches("ab"), fails=lambda start: start.get("b.size", 0.0) > 0.0
    )
    search = searched(monkeypatch, world)
    search.fit(of(""))
    search.fit_each([of("a"), of("b")], (0.0, 1.0))
    assert of("a") in search.log
    assert of("b") not in search.log
    assert search.is_tried(of("b"))
    assert search.untried == ["B"]
    search.fit_each([of("b")], (0.0, 1.0))
    assert len(search.untried) == 1


def test_it_is_annealed_once_and_the_better_fit_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0}, switches("a"), annealed={"a": 80.0})
    search = searched(monkeypatch, world)
    assert search.fit(of("a")).chi2 == 100.0
    assert search.fit(of("a"), anneal=True).chi2 == search.fit(of("a")).chi2 == 80.0
    search.fit(of("a"), anneal=True)
    assert kinds(search, "a").count("annealed") == 1
    (start,) = [start for _, start, robust in world.starts if robust == ANNEALING]
    assert start["at"] == 100.0


def test_a_polish_scatters_starts_about_the_best_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    effects = {"a": EffectChoice("a", (SIZE._replace(upper=1.1),))}
    world = World({"": 300.0, "a": 100.0}, effects)
    search = searched(monkeypatch, world)
    search.polish(of("a"))
    scattered = [start for key, start, robust in world.starts if key == "a" and not robust][-len(SCATTER) :]
    assert kinds(search, "a").count("scattered") == len(SCATTER)
    # Some standard errors of 0.2 N about 1 N, and within the bounds.
    random = np.random.default_rng(1)
    for start, spread in zip(scattered, SCATTER, strict=True):
        gain, size = 6.0 + spread * 0.4 * random.standard_normal(), 1.0 + spread * 0.2 * random.standard_normal()
        assert start["gain"] == pytest.approx(max(gain, 0.0))
        assert start["a.size"] == pytest.approx(min(size, 1.1))
    search.polish(of("a"))
    assert kinds(search, "a").count("scattered") == len(SCATTER)


def test_what_the_data_do_not_hold_is_scattered_by_its_scale(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0}, {})
    search = searched(monkeypatch, world)
    found = search.fit(of(""))
    found.covariance[0, 0] = math.inf
    search.polish(of(""))
    random = np.random.default_rng(0)
    first = next(start for _, start, robust in world.starts[3:] if not robust)
    assert first["gain"] == pytest.approx(6.0 + 4.0 * random.standard_normal())


def test_a_refit_starts_where_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0}, switches("a"))
    search = searched(monkeypatch, world)
    assert search.refit(of("a"), {"a.size": 0.7}).chi2 == 100.0
    assert world.starts[-1] == ("a", {"a.size": 0.7}, ())
    assert kinds(search, "a")[-1] == "from a larger model"


def test_fits_side_by_side_are_told_of_in_order_and_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0}, switches("abcd"))
    search = searched(monkeypatch, world)
    search.fit(of("c"))
    before = len(search.log.rows)
    search.fit_each([of("c"), *map(of, "dabab")], (0.2, 0.5))
    assert world.told == [(str(of("d")), 0.2), (str(of("a")), pytest.approx(0.3)), (str(of("b")), pytest.approx(0.4))]
    assert list(search.log.best) == [of(key) for key in ("", "c", "d", "a", "b")]
    assert kinds(search, "c") == ["sizes", "sizes"]
    assert len(search.log.rows) == before + 6


def test_fits_side_by_side_are_carried_on_towards_the_best_few(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 9000.0, "a": 1000.0, "b": 1100.0, "c": 1200.0, "d": 1300.0, "e": 1350.0, "f": 8000.0}
    world = World(scores, switches("abcdef"), unfinished="cf")
    search = searched(monkeypatch, world)
    search.fit_each([of(key) for key in "abcdef"], (0.0, 1.0))
    assert kinds(search, "a") == ["sizes", "sizes"]
    assert kinds(search, "c") == kinds(search, "f") == ["sizes", "sizes", "continued", "continued"]
    efforts = [(key, effort) for key, effort in world.efforts if key in scores and effort.made]
    # The fourth best has 1300; what is within 100 of it is near enough.
    limit = 1300.0 + NEAR
    assert sorted(efforts) == [("c", Effort(goal=1200.0, made=TRIAL))] * 2 + [("f", Effort(goal=limit, made=TRIAL))] * 2
    begun = [effort for key, effort in world.efforts if key == "c" and not effort.made]
    assert [effort.most for effort in begun] == [TRIAL, TRIAL]
    # What cannot come near enough any more is not gone on with.
    lost = World(scores, switches("abcdef"), unfinished="cf", stuck="cf")
    search = searched(monkeypatch, lost)
    search.fit_each([of(key) for key in "abcdef"], (0.0, 1.0))
    assert kinds(search, "c")[2:] == ["continued", "continued"]
    assert kinds(search, "f") == ["sizes", "sizes"]
    # Of a few, each is carried to its end.
    few = World(scores, switches("abc"), unfinished="c")
    searched(monkeypatch, few).fit_each([of(key) for key in "abc"], (0.0, 1.0))
    assert [effort.goal for key, effort in few.efforts if effort.made] == [1200.0, 1200.0]


def test_what_is_to_replace_a_set_that_was_fitted_must_come_near_it(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 9000.0, "a": 1000.0, "b": 1100.0, "c": 1200.0, "d": 1300.0, "e": 1350.0, "f": 400.0}
    world = World(scores, switches("abcdef"), unfinished="ce")
    search = searched(monkeypatch, world)
    search.fit(of("f"))
    search.fit_each([of(key) for key in "abcde"], (0.0, 1.0), of("f"))
    efforts = [(key, effort.goal) for key, effort in world.efforts if effort.made]
    # Without one it would be 1300 + NEAR, or what a hypothesis has come to.
    assert set(efforts) == {("c", 400.0 + NEAR), ("e", 400.0 + NEAR)}


def test_beside_an_effect_that_explains_all_others_have_one_start_and_a_goal(monkeypatch: pytest.MonkeyPatch) -> None:
    effects = {**switches("ab"), "c": EffectChoice("c", (RECIPROCAL,))}
    world = World({"": 9000.0, "a": 100.0, "b": 8000.0, "c": 8000.0}, effects)
    search = searched(monkeypatch, world)
    search.fit_nearby([of("b"), of("c")], 140.0, (0.1, 0.3))
    assert kinds(search, "b") == kinds(search, "c") == ["one start"]
    begun = {key: (start, effort) for (key, start, _), (_, effort) in zip(world.starts, world.efforts, strict=True)}
    # From what the declared model was fitted to; where the gradient vanishes at "off", not as near to it.
    assert begun["b"] == ({"at": 9000.0, "gain": 6.0, "b.size": 0.1}, Effort(goal=140.0, is_near=True))
    assert begun["c"][0]["c.film"] == pytest.approx(2e-3, rel=1e-9)
    assert world.told == [(str(of("b")), 0.1), (str(of("c")), pytest.approx(0.2))]
    world.fails = lambda start: "a.size" in start
    search.fit_nearby([of("a")], 140.0, (0.3, 0.3))
    assert search.untried == [str(of("a"))] and search.is_tried(of("a"))


def test_where_the_plant_points_at_a_fit_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 9000.0, "a": 100.0}, {"a": EffectChoice("a", (SIZE,), start={"a.size": 3.0, "other": 1.0})})
    search = searched(monkeypatch, world)
    search.fit_pointed_at([of("a")], (0.0, 0.1))
    (start,) = (start for key, start, _ in world.starts if key == "a")
    assert start["a.size"] == 3.0 and start["other"] == 1.0
    assert world.efforts[-1] == ("a", Effort())


def test_jacobians_are_kept_of_the_best_few_fits_only(monkeypatch: pytest.MonkeyPatch) -> None:
    names = "abcdefghijklmnopqrstu"
    world = World({"": 9000.0, **{name: 100.0 + place for place, name in enumerate(names)}}, switches(names))
    search = searched(monkeypatch, world)
    search.fit_each([of(name) for name in names], (0.0, 1.0))
    kept = [key for key in names if search.log[of(key)].derivatives.is_at_hand]
    assert kept == list(names[:KEPT])
    assert [row.fit.derivatives.is_at_hand for row in search.log.rows_of(of("a"))] == [True, False]


def test_what_was_only_begun_when_the_time_was_used_up_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0, "b": 120.0}, switches("ab"), unfinished="b")
    search = searched(monkeypatch, world)
    world.ends_with = "b"
    with pytest.raises(OutOfTimeError):
        search.fit_each([of("a"), of("b")], (0.0, 1.0))
    assert search.untried == [str(of("b"))]
    assert search.is_tried(of("a"))
    assert of("b") in search.log
    assert not search.is_tried(of("b"))


def test_what_is_left_when_the_time_is_used_up_is_noted(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0}, switches("abc"), out_of_time=("b", "c"))
    search = searched(monkeypatch, world)
    with pytest.raises(OutOfTimeError):
        search.fit_each([of("a"), of("b"), of("c")], (0.0, 1.0))
    assert search.untried == [str(of("b")), str(of("c"))]


def test_a_hypothesis_is_fitted_from_what_is_declared_too(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 90.0}, switches("a"))
    world.missed = lambda values: abs(values.get("a.size", 0.0) + 32.0)
    search = searched(monkeypatch, world)
    search.fit(of("a"))
    assert kinds(search, "a")[-1] == "as declared"
    assert world.starts[-1] == ("a", {"a.size": -32.0}, ())


def test_what_was_begun_from_what_is_declared_is_tried_from_everywhere_later(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 90.0}, switches("ab"))
    world.missed = lambda values: abs(values.get("a.size", 0.0) + 32.0)
    search = searched(monkeypatch, world)
    search.fit(of(""))
    assert search.begin_from_declared([of("a"), of("b")], (0.0, 0.1)) == [of("a")]
    assert kinds(search, "a") == ["as declared"]
    assert not search.is_tried(of("a"))
    search.fit_each([of("a"), of("b")], (0.1, 0.3))
    assert kinds(search, "a") == ["as declared", "sizes", "sizes", "as declared"]
    assert search.is_tried(of("a"))


def test_beside_what_explains_all_others_start_near_off_from_where_that_left_all_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those that can still come near are carried on; the limit is a score."""
    world = World({"": 300.0, "a": 90.0, "b": 95.0, "c": 99.0}, switches("abcd"), unfinished="bc", stuck="c")
    world.fails = lambda start: "d.size" in start
    search = searched(monkeypatch, world)
    search.fit(of("a"))
    search.fit_beside(of("a"), [of(key) for key in "bcd"], 97.0, (0.1, 0.3))
    (start,) = {tuple(start.items()) for key, start, _ in world.starts if key == "c"}
    left = search.log[of("a")].values
    assert dict(start) == {"at": 90.0, "gain": left["gain"], "c.size": 0.1}
    assert (kinds(search, "b"), kinds(search, "c")) == (["beside the best", "continued"], ["beside the best"])
    assert [search.is_tried(of(key)) for key in "bcd"] == [True, True, True]
    assert search.untried == ["D"]


def test_of_equal_fits_the_one_without_a_parameter_on_its_bound_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is on a bound names nothing: a residual magnetism that always holds the valve open may be of any size."""
    world = World({"": 300.0, "a": 50.0}, switches("a"))
    inside = searched(monkeypatch, world).fit(of("a"))
    for worse, kept in ((0.05, True), (0.15, False), (-0.05, True)):
        on_bound = replace(inside, chi2=inside.chi2 - worse, coordinates=np.array([35.0, 100.0]))
        for order in ((inside, on_bound), (on_bound, inside)):
            log = FitLog()
            for one in order:
                log.append(Row(of("a"), "made up", one))
            assert (log[of("a")] is inside) is kept


@pytest.mark.parametrize(("samples", "limit"), [(50.0, 41300.0 + 0.05 * 41250.0), (41000.0, 41300.0 + NEAR)])
def test_how_near_is_near_enough_is_a_share_of_what_is_not_noise(
    monkeypatch: pytest.MonkeyPatch, samples: float, limit: float
) -> None:
    scores = {"": 9000.0, "a": 1000.0, "b": 1100.0, "c": 1200.0, "d": 1300.0, "e": 1350.0, "f": 8000.0}
    world = World({key: 40000.0 + score for key, score in scores.items()}, switches("abcdef"), unfinished="f")
    world.problem.effective_samples = samples
    searched(monkeypatch, world).fit_each([of(key) for key in "abcdef"], (0.0, 1.0))
    assert {effort.goal for key, effort in world.efforts if key == "f" and effort.made} == {limit}
