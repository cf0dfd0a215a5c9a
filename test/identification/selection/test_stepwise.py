"""Which hypotheses are tried, in which order, and which may be claimed: on fits that are written down."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import pytest
from valve_sim.identification.selection.hypotheses import NEAR
from valve_sim.identification.selection.stepwise import (
    DECISIVE,
    HINT,
    MOST_OF_ANOTHER_FORM,
    MOST_ROUNDS,
    NEARLY,
    POLISHED,
    Exploration,
)
from valve_sim.identification.selection.table import MOST_EFFECTS, Hypothesis, choose

from identification.selection.made_up_fits import SIZE, World, key_of, of, switches
from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.plants.protocol import EffectChoice, Nuisance
from valve_sim.identification.selection.residual_tests import SIGNIFICANT
from valve_sim.model import Parameter


def explored(world: World, patch: pytest.MonkeyPatch) -> Exploration:
    exploration = Exploration(world.use(patch).search())
    exploration.explore()
    return exploration


def tried(exploration: Exploration) -> list[str]:
    return [key_of(hypothesis) for hypothesis in exploration.tried()]


def rows(exploration: Exploration) -> list[tuple[str, str]]:
    return [(key_of(row.hypothesis), row.start) for row in exploration.search.log.rows]


# -- when the search ends ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("p_value", "gains", "is_enough"),
    [
        (HINT, {"a": 0.0, "b": -3.0}, True),
        (0.99 * HINT, {"a": 0.0, "b": -3.0}, False),
        (1.0, {"a": 0.1, "b": -3.0}, False),
        (1.0, {"a": -1.0, "valve.m": 0.5 * DECISIVE}, True),
        (1.0, {"a": -1.0, "valve.m": 0.5 * DECISIVE + 0.1}, False),
        # b is the same thing as a declared value.
        (1.0, {"a": -1.0, "b": 0.5 * DECISIVE}, True),
        # Without a test there is nothing to go by.
        (1.0, {}, False),
    ],
)
def test_an_adequate_declared_model_costs_one_fit(
    monkeypatch: pytest.MonkeyPatch, p_value: float, gains: Mapping[str, float], is_enough: bool
) -> None:
    mass = {"valve.m": EffectChoice("valve.m", (Parameter("m", "kg", "", 0.1, 9.0, 0.2, 1.0),), is_declared_value=True)}
    tolerances = (Nuisance("m", 0.02, "kg", is_of_machine=True), Nuisance("q", 0.1, "N", same_as="b.size"))
    effects = {**switches("ab"), **mass}
    # What is promised is kept, if only just.
    fits = {"": 100.0, "a": 99.9, "valve.m": 99.9}
    world = World(fits, effects, white={"": p_value}, gains={"": gains}, tolerances=tolerances)
    found = explored(world, monkeypatch)
    singles = {one.effects for one in found.tried() if len(one.effects) == 1}
    assert singles == (set() if is_enough else {("a",), ("b",), ("valve.m",)})
    assert found.screened == (gains if is_enough else {})
    assert found.table().screened == found.screened
    assert not found.singles_untried()


@pytest.mark.parametrize("is_claimable", [False, True])
def test_what_gains_but_may_not_be_claimed_is_no_reason_to_look_further(
    monkeypatch: pytest.MonkeyPatch, is_claimable: bool
) -> None:
    gains = {"a": 5.0, "b": -3.0, "c": 0.1}
    sizes = {} if is_claimable else {("a", "a.size"): 1e9}  # on its bound
    world = World({"": 100.0, "a": 97.0}, switches("abc"), white={"": 1.0}, gains={"": gains}, sizes=sizes)
    found = explored(world, monkeypatch)
    assert ("b" in tried(found)) is is_claimable
    assert choose(found.table()) == of("a" if is_claimable else "")


def test_what_the_score_test_promises_is_fitted_and_no_more_where_it_does_not_come(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World({"": 100.0}, switches("abc"), white={"": 1.0}, gains={"": {"a": 5.0, "b": -3.0, "c": 0.1}})
    found = explored(world, monkeypatch)
    assert set(tried(found)) == {"", "a", "c"}
    assert found.screened["b"] == -3.0
    assert max(found.screened["a"], found.screened["c"]) <= 0.0
    assert found.best_claimable() == of("")


@pytest.mark.parametrize(
    ("p_value", "gain", "without", "stamp_variance", "is_enough"),
    [
        (HINT, 0.0, 400.0, 1.0, True),
        (0.99 * HINT, 0.0, 400.0, 1.0, False),
        (1.0, 0.1, 400.0, 1.0, False),
        # What explains more than half of what stamps explain may be what they stand for.
        (1.0, 0.0, 400.1, 1.0, False),
        # Stamps that are further off than their prior says may hide anything.
        (1.0, 0.0, 400.0, 3.0, False),
    ],
)
def test_an_adequate_declared_model_with_stamps_that_err_costs_two_fits(
    monkeypatch: pytest.MonkeyPatch, p_value: float, gain: float, without: float, stamp_variance: float, is_enough: bool
) -> None:
    promised = {"a'": 99.9} if gain > 0.0 else {}
    world = World(
        {"": 900.0, "'": 100.0, **promised}, switches("ab"), white={"'": p_value},
        gains={"": {"a": without, "b": 3.0}, "'": {"a": gain, "b": -3.0}},
        stamp_variances={"'": stamp_variance}, timing=True,
    )  # fmt: skip
    found = explored(world, monkeypatch)
    assert tried(found)[:2] == ["", "'"]
    assert ("a" in tried(found)) is not is_enough
    assert found.screened == ({"a": gain, "b": -3.0} if is_enough else {})
    assert found.best_claimable() == of("a'" if promised else "'")


@pytest.mark.parametrize(("p_value", "is_enough"), [(1.01 * SIGNIFICANT, True), (0.99 * SIGNIFICANT, False)])
def test_where_an_effect_that_the_plant_points_at_explains_all_others_are_looked_at_once(
    monkeypatch: pytest.MonkeyPatch, p_value: float, is_enough: bool
) -> None:
    effects = {**switches("bc"), "a": EffectChoice("a", (SIZE,), start={"a.size": 3.0})}
    scores = {"": 9000.0, "a": 100.0, "b": 100.0 + NEARLY - 0.1, "c": 100.0 + NEARLY}
    # The score test promises a second effect, but what is left is white.
    world = World(scores, effects, white={"a": p_value}, gains={"a": {"b": 3.0 * DECISIVE}})
    found = explored(world, monkeypatch)
    if not is_enough:
        assert "ab" in tried(found) and ("b", "sizes") in rows(found)
        return
    assert rows(found)[2:] == [("a", "one start"), ("b", "one start"), ("c", "one start")]
    assert {effort.goal for key, effort in world.efforts if key in ("b", "c")} == {100.0 + NEARLY}
    found.settle()
    assert polished(found) == {"a", "b"}


def test_an_effect_that_the_plant_points_at_is_not_polished_where_nothing_is_near(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    effects = {**switches("b"), "a": EffectChoice("a", (SIZE,), start={"a.size": 3.0})}
    found = explored(World({"": 9000.0, "a": 100.0, "b": 8000.0}, effects, white={"a": 1.0}), monkeypatch)
    found.settle()
    assert not polished(found)
    assert choose(found.table()) == of("a")


@pytest.mark.parametrize("short_step", [1e-3, None])
@pytest.mark.parametrize("explains", [True, False])
def test_with_gas_what_explains_all_from_what_is_declared_judges_the_others(
    monkeypatch: pytest.MonkeyPatch, short_step: float | None, *, explains: bool
) -> None:
    """Else, and without gas, every effect is tried from every start."""
    white = {"a": 1.0} if explains else {}
    world = World({"": 9000.0, "a": 100.0, "b": 120.0}, switches("abc"), white=white)
    world.missed = lambda values: abs(values.get("a.size", 0.0) - 16.0)
    world.problem.plant.short_step, world.problem.plant.channels = short_step, []
    found = explored(world, monkeypatch)
    first = dict.fromkeys(key for key, _ in rows(found) if len(key) == 1)
    kinds = {key: {kind for own, kind in rows(found) if own == key} for key in first}
    if explains and short_step:
        assert kinds == {"a": {"as declared"}, "b": {"beside the best"}, "c": {"beside the best"}}
    else:
        assert all("sizes" in kinds[key] for key in "abc")
    assert not found.singles_untried()


@pytest.mark.parametrize(
    ("p_value", "gain", "is_enough"),
    [(HINT, DECISIVE, True), (0.99 * HINT, DECISIVE, False), (1.0, DECISIVE + 0.1, False)],
)
def test_singles_are_enough_where_the_best_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, p_value: float, gain: float, is_enough: bool
) -> None:
    scores = {"": 300.0, "a": 100.0, "b": 280.0, "c": 290.0}
    world = World(scores, switches("abc"), white={"a": p_value}, gains={"a": {"b": gain, "c": -1.0}})
    found = explored(world, monkeypatch)
    assert tried(found)[:4] == ["", "a", "b", "c"]
    assert (len(tried(found)) == 4) is is_enough


def test_the_two_best_are_extended_and_no_gain_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0, "b": 150.0, "c": 200.0, "d": 220.0}, switches("abcd"))
    found = explored(world, monkeypatch)
    assert tried(found) == ["", "a", "b", "c", "d", "ab", "ac", "ad", "bc", "bd"]
    assert found.best_claimable() == of("a")
    # What is extended is polished before, so that a poor start does not pass for a missing effect.
    assert [kind for key, kind in rows(found) if key == "a"].count("scattered") > 0


@pytest.mark.parametrize(("gained", "goes_on"), [(DECISIVE, False), (DECISIVE + 0.1, True)])
def test_triples_are_tried_where_a_pair_gained_a_decisive_difference(
    monkeypatch: pytest.MonkeyPatch, gained: float, goes_on: bool
) -> None:
    world = World({"": 300.0, "a": 100.0, "b": 250.0, "c": 260.0, "ab": 100.0 - gained}, switches("abc"))
    assert ("abc" in tried(explored(world, monkeypatch))) is goes_on


def scores_falling(names: str, by: float = 100.0) -> dict[str, float]:
    """Each further effect lowers S alike, so that the first ones are the best."""
    sets = itertools.chain(*(itertools.combinations(names, count) for count in range(len(names) + 1)))
    return {"".join(chosen): 1000.0 - by * len(chosen) + 0.1 * sum(map(names.index, chosen)) for chosen in sets}


@pytest.mark.parametrize(("p_value", "most"), [(HINT, 4), (0.99 * HINT, MOST_OF_ANOTHER_FORM)])
def test_more_than_four_effects_are_tried_one_at_a_time_where_four_leave_something(
    monkeypatch: pytest.MonkeyPatch, p_value: float, most: int
) -> None:
    found = explored(World(scores_falling("abcdefgh"), switches("abcdefgh"), white={"abcd": p_value}), monkeypatch)
    assert max(len(one.effects) for one in found.tried()) == most
    assert found.best_claimable() == of("abcdef"[:most])
    # One set alone is extended, and no member is swapped.
    further = [key for key in tried(found) if len(key) > MOST_EFFECTS]
    assert further == (["abcde", "abcdf", "abcdg", "abcdh", "abcdef", "abcdeg", "abcdeh"] if most > 4 else [])


@pytest.mark.parametrize(("gained", "most"), [(0.9 * DECISIVE, 5), (1.1 * DECISIVE, MOST_OF_ANOTHER_FORM)])
def test_a_sixth_effect_is_tried_where_the_fifth_was_decisive(
    monkeypatch: pytest.MonkeyPatch, gained: float, most: int
) -> None:
    scores = {**scores_falling("abcdefgh"), "abcde": scores_falling("abcd")["abcd"] - gained}
    scores = {key: score for key, score in scores.items() if len(key) <= MOST_EFFECTS or key == "abcde"}
    found = explored(World(scores, switches("abcdefgh")), monkeypatch)
    assert max(len(one.effects) for one in found.tried()) == most


@pytest.mark.parametrize("p_value", [0.0, 1.0])
@pytest.mark.parametrize(("missed", "most"), [(0.5, 5), (0.4, MOST_OF_ANOTHER_FORM)])
def test_a_sixth_effect_is_tried_where_the_fifth_predicts_strokes_left_out(
    monkeypatch: pytest.MonkeyPatch, missed: float, most: int, p_value: float
) -> None:
    """Of five effects no form is right even if they leave noise. Of 100 samples 0.5 each is as much as without it."""
    scores, left_out = scores_falling("abcdefgh"), dict.fromkeys(scores_falling("abcdefgh"), 0.5)
    left_out["abcde"] = missed
    white, gains = {"abcde": p_value}, {"abcde": {"f": 2.0 * DECISIVE}}
    world = World(scores, switches("abcdefgh"), left_out=left_out, white=white, gains=gains)
    assert max(len(one.effects) for one in explored(world, monkeypatch).tried()) == most


@pytest.mark.parametrize(("curve", "most"), [(700.0 - NEAR - 0.1, 3), (700.0 - NEAR + 0.1, 5), (math.inf, 5)])
def test_no_more_than_three_are_tried_where_a_curve_without_a_name_leaves_nothing(
    monkeypatch: pytest.MonkeyPatch, curve: float, most: int
) -> None:
    """Sets of three are at 700: they do not come near the first curve, which is fitted once."""
    names = "abcde"
    scores = {
        "".join(chosen): 1000.0 - 100.0 * count for count in range(6) for chosen in itertools.combinations(names, count)
    }
    world = World(scores, switches(names), curve=curve)
    found = explored(world, monkeypatch)
    assert max(len(one.effects) for one in found.tried()) == most
    assert world.asked == 1
    assert len(found.curves(found.search.fit(of("")))) == (curve < math.inf)


def test_members_of_the_best_are_swapped_through_the_catalogue(monkeypatch: pytest.MonkeyPatch) -> None:
    # b and d are the answer; b alone is the worst of all, so that pairs are made of a and c only.
    scores = {"": 400.0, "a": 200.0, "b": 390.0, "c": 210.0, "d": 380.0, "ab": 150.0, "bd": 90.0}
    found = explored(World(scores, switches("abcd"), white={"bd": 1.0}), monkeypatch)
    assert tried(found).index("ab") < tried(found).index("bd")
    assert found.best_claimable() == of("bd")
    assert "abc" not in tried(found)


@pytest.mark.parametrize("is_white", [False, True])
@pytest.mark.parametrize("timing", [False, True])
def test_a_pair_that_leaves_something_is_annealed_and_tried_with_stamps_that_err(
    monkeypatch: pytest.MonkeyPatch, is_white: bool, timing: bool
) -> None:
    scores = {"": 300.0, "a": 200.0, "b": 250.0, "ab": 100.0}
    world = World(scores, switches("ab"), white={"ab": 1.0} if is_white else {}, timing=timing)
    found = explored(world, monkeypatch)
    assert (("ab", "annealed") in rows(found)) is not is_white
    assert ("ab'" in tried(found)) is (timing and not is_white)


# -- stamps that err ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("timed", "white", "is_explored"),
    [
        (100.0 - DECISIVE, {}, False),
        (100.0 - DECISIVE - 0.1, {}, True),
        (150.0, {"b'": 1.0}, True),
        # One of the best two only is tried with them at first.
        (150.0, {"c'": 1.0}, False),
    ],
)
def test_stamps_are_tried_with_all_where_they_explain_more_or_all(
    monkeypatch: pytest.MonkeyPatch, timed: float, white: Mapping[str, float], is_explored: bool
) -> None:
    scores = {"": 300.0, "a": 100.0, "b": 110.0, "c": 120.0, "'": 290.0, "a'": timed, "b'": 160.0, "c'": 170.0}
    found = explored(World(scores, switches("abc"), white=white, timing=True), monkeypatch)
    assert tried(found)[:7] == ["", "'", "a", "b", "c", "a'", "b'"]
    assert ("c'" in tried(found)[:8]) is is_explored


def test_stamps_that_explain_nearly_all_alone_are_tried_with_effects_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scores = {"": 9000.0, "a": 8000.0, "b": 8100.0, "c": 8200.0, "'": 300.0, "c'": 40.0}
    found = explored(World(scores, switches("abc"), white={"c'": 1.0}, timing=True), monkeypatch)
    assert found.best_claimable() == of("c'")


def test_stamps_that_explain_all_alone_are_tried_with_effects_that_promise_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scores = {"": 9000.0, "a": 8000.0, "b": 8100.0, "c": 8200.0, "'": 300.0, "c'": 40.0}
    white, gains = {"'": 1.0, "c'": 1.0}, {"'": {"c": 100.0}, "c'": {"a": -5.0, "b": -5.0}}
    found = explored(World(scores, switches("abc"), white=white, gains=gains, timing=True), monkeypatch)
    assert found.best_claimable() == of("c'")


def test_the_best_single_is_that_which_may_be_claimed(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 300.0, "a": 100.0, "b": 110.0, "c": 120.0}
    # a is on its bound.
    world = World(scores, switches("abc"), timing=True, sizes={("a", "a.size"): 1e9})
    assert tried(explored(world, monkeypatch))[5:7] == ["b'", "c'"]


def test_without_stamps_that_may_err_none_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    found = explored(World({"": 300.0, "a": 100.0, "b": 110.0}, switches("ab")), monkeypatch)
    assert not any(one.timing for one in found.tried())


def test_stamps_may_hide_a_second_effect_so_that_pairs_are_tried_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 300.0, "a": 100.0, "b": 110.0, "'": 290.0, "a'": 50.0, "b'": 60.0}
    world = World(scores, switches("ab"), white={"a'": 1.0}, timing=True)
    found = explored(world, monkeypatch)
    assert found.best_claimable() == of("a'")
    assert "ab" in tried(found)
    # Beside a pair with stamps nothing more is hidden.
    scores = {**scores, "ab": 40.0, "ab'": 20.0}
    world = World(scores, switches("abc"), white={"a'": 1.0, "ab'": 1.0}, timing=True)
    assert "abc" not in tried(explored(world, monkeypatch))


@pytest.mark.parametrize(("of_timed", "is_extended"), [(89.0, True), (90.0, True), (90.1, False)])
def test_where_nothing_is_right_stamps_that_explain_as_much_as_a_pair_get_a_second_effect(
    monkeypatch: pytest.MonkeyPatch, of_timed: float, is_extended: bool
) -> None:
    scores = {"": 300.0, "a": 110.0, "b": 200.0, "ab": 90.0, "'": 290.0, "a'": of_timed, "b'": 250.0}
    world = World(scores, switches("abc"), timing=True)
    assert ("ac'" in tried(explored(world, monkeypatch))) is is_extended


@pytest.mark.parametrize(
    ("without", "curve", "most"),
    [(1890.0, math.inf, 3), (1890.0, 90.0 - NEAR + 0.1, 3), (1890.0, 90.0 - NEAR - 0.1, 2), (190.0, math.inf, 2)],
)
def test_a_pair_that_is_the_best_beside_stamps_that_must_err_gets_a_third_effect_unless_a_curve_does_better(
    monkeypatch: pytest.MonkeyPatch, without: float, curve: float, most: int
) -> None:
    """Although one effect beside them explains less than the pair without them."""
    scores = {
        "": 4000.0,
        "a": without + 20.0,
        "b": 2000.0,
        "ab": without,
        "'": 2900.0,
        "a'": without + 10.0,
        "b'": 2500.0,
    }
    white = {"ab'": 0.9 * HINT, "abc'": 1.0}
    world = World({**scores, "ab'": 90.0, "abc'": 20.0}, switches("abcd"), white=white, timing=True, curve=curve)
    assert explored(world, monkeypatch).best_claimable() == of("abc"[:most] + "'")


def test_beside_stamps_that_err_sets_grow_and_members_are_swapped_as_without_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """b, c and d are the answer, of which b' alone explains less than a'."""
    scores = {
        "": 900.0, "a": 800.0, "b": 850.0, "c": 860.0, "d": 870.0, "ab": 790.0, "'": 700.0, "a'": 500.0, "b'": 600.0,
        "c'": 610.0, "d'": 620.0, "ac'": 400.0, "bc'": 300.0, "bcd'": 100.0,
    }  # fmt: skip
    found = explored(World(scores, switches("abcd"), white={"bcd'": 1.0}, timing=True), monkeypatch)
    assert found.best_claimable() == of("bcd'")
    # Where stamps explain more than a second effect does, a third without them is not looked for.
    assert not any(len(one.effects) > 2 for one in found.tried() if not one.timing)


def test_stamps_that_explain_more_without_being_believed_end_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 900.0, "a": 500.0, "b": 550.0, "ab": 400.0, "abc": 300.0, "'": 700.0, "a'": 480.0, "ab'": 200.0}
    found = explored(World(scores, switches("abcd"), timing=True), monkeypatch)
    assert "abcd" in tried(found)
    assert found.best_claimable() == of("abc")


@pytest.mark.parametrize(("gained", "goes_on"), [(DECISIVE, False), (DECISIVE + 0.1, True)])
def test_beside_stamps_that_err_triples_are_tried_where_a_pair_gained_a_decisive_difference(
    monkeypatch: pytest.MonkeyPatch, gained: float, goes_on: bool
) -> None:
    scores = {"": 900.0, "a": 800.0, "b": 850.0, "'": 700.0, "a'": 500.0, "b'": 600.0, "ab'": 500.0 - gained}
    assert ("abc'" in tried(explored(World(scores, switches("abc"), timing=True), monkeypatch))) is goes_on


def test_where_there_is_one_effect_alone_stamps_get_no_second(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 900.0, "a": 800.0, "'": 700.0, "a'": 500.0}
    assert tried(explored(World(scores, switches("a"), timing=True), monkeypatch)) == ["", "'", "a", "a'"]


def test_stamps_alone_get_no_second_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 300.0, "a": 110.0, "b": 200.0, "'": 10.0}
    world = World(scores, switches("ab"), timing=True, sizes={("a'", "a.size"): 1e9, ("b'", "b.size"): 1e9})
    found = explored(world, monkeypatch)
    assert "ab'" not in tried(found)


# -- what may be claimed -----------------------------------------------------------------------------------------------

SHAPE = Parameter("shape", "s", "of it", 1e-3, 1e3, 0.1)
ONE_SIDED = Parameter("size", "N", "added", 0.0, 100.0, 2.0, 0.0)


def claimable(
    patch: pytest.MonkeyPatch, parameters: Sequence[Parameter], sizes: Sequence[float], rest: float = 100.0
) -> bool:
    """Whether an effect of S = 95 may be claimed beside the declared model's."""
    effect = EffectChoice("a", tuple(parameters))
    named = {("a", effect.free_name(one)): size for one, size in zip(parameters, sizes, strict=True)}
    exploration = Exploration(World({"": rest, "a": 95.0}, {"a": effect}, sizes=named).use(patch).search())
    exploration.search.fit(of(""))
    exploration.search.fit(of("a"))
    return exploration.is_claimable(of("a"))


@pytest.mark.parametrize(("size", "is_on"), [(1.95, False), (1.97, True), (-1.97, True)])
def test_an_effect_is_on_where_its_size_is_significant(
    monkeypatch: pytest.MonkeyPatch, size: float, is_on: bool
) -> None:
    assert claimable(monkeypatch, [SIZE], [size]) is is_on
    # Of two sizes one is enough; a shape is none.
    assert claimable(monkeypatch, [SIZE, SIZE._replace(name="other")], [0.0, size]) is is_on
    assert not claimable(monkeypatch, [SIZE, SHAPE], [0.0, abs(size)])


def test_an_effect_on_a_bound_is_not_claimed_however_much_it_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    assert not claimable(monkeypatch, [SIZE], [1e9], rest=1000.0)
    assert not claimable(monkeypatch, [SIZE, SHAPE], [5.0, 1e9], rest=1000.0)
    assert not claimable(monkeypatch, [SIZE, SIZE._replace(name="other")], [5.0, -1e9], rest=1000.0)
    # Off is a bound of many an effect: one of its sizes may stay there.
    assert claimable(monkeypatch, [SIZE, ONE_SIDED._replace(name="other")], [5.0, 0.0])
    assert not claimable(monkeypatch, [ONE_SIDED], [0.0])


@pytest.mark.parametrize(("gained", "is_on"), [(DECISIVE, False), (DECISIVE + 0.1, True)])
def test_collinear_sizes_are_on_where_their_loss_is_decisive(
    monkeypatch: pytest.MonkeyPatch, gained: float, is_on: bool
) -> None:
    assert claimable(monkeypatch, [SIZE], [0.5], rest=95.0 + gained) is is_on


def test_without_the_fit_of_the_rest_nobody_knows_what_a_collinear_effect_gains(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    world = World({"": 300.0, "a": 100.0, "ab": 50.0}, switches("ab"), sizes={("ab", "b.size"): 0.0})
    exploration = Exploration(world.use(monkeypatch).search())
    exploration.search.fit(of("b"))
    exploration.search.fit(of("ab"))
    assert not exploration.is_claimable(of("ab"))
    exploration.search.fit(of("a"))
    assert exploration.is_claimable(of("ab"))


@pytest.mark.parametrize(
    ("least", "left", "is_claimed"),
    [(549.9, 100.0, False), (550.1, 100.0, True), (99.9, 50.1, False), (100.1, 50.1, True)],
)
def test_stamps_that_err_are_claimed_where_nothing_is_left_or_little_of_what_is_without_them(
    monkeypatch: pytest.MonkeyPatch, least: float, left: float, is_claimed: bool
) -> None:
    # Of 50 samples noise alone leaves 50.
    scores = {"": 900.0, "a": least, "'": 200.0, "a'": 110.0, "b'": left}
    world = World(scores, switches("ab"), white={"a'": 1.0}, timing=True)
    exploration = Exploration(world.use(monkeypatch).search())
    for key in ("", "a", "'", "a'", "b'"):
        exploration.search.fit(of(key))
    claimed = [True, True, False, True, is_claimed]
    assert [exploration.is_claimable(of(key)) for key in ("", "a", "'", "a'", "b'")] == claimed


def test_the_table_says_what_every_fit_is_worth(monkeypatch: pytest.MonkeyPatch) -> None:
    effects = {"a": EffectChoice("a", (SIZE,), confused_with=("b",)), **switches("b")}
    world = World({"": 300.0, "a": 100.0}, effects, white={"a": 1.0}, left_out={"": 2.0})
    exploration = Exploration(world.use(monkeypatch).search())
    exploration.search.fit(of(""))
    exploration.search.fit(of("a"))
    table = exploration.table()
    score = table[of("a")]
    assert (score.score, score.evidence, score.parameters, score.chi2) == (100.0, 103.0, 2, 100.0)
    assert (score.is_white, score.is_claimable, table[of("")].is_white) == (True, True, False)
    assert table.look_alikes == {"a": ("b",), "b": ()}
    # Where the residual is not white, what strokes left out rise by is added: 100 residuals of 2.
    assert table[of("")].own_criterion == exploration.selection_criterion(of("")) == 700.0
    assert exploration.selection_criterion(of("a")) == 100.0


# -- the end -----------------------------------------------------------------------------------------------------------


def test_members_without_an_effect_are_dropped_from_the_best_score(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 300.0, "a": 110.0, "b": 280.0, "ab": 100.0}
    found = explored(World(scores, switches("ab"), sizes={("ab", "b.size"): 0.0}), monkeypatch)
    assert [row for row in rows(found) if row[1] == "from a larger model"] == [("a", "from a larger model")]
    # Where its loss is decisive, it has one.
    again = explored(World({**scores, "ab": 99.0}, switches("ab"), sizes={("ab", "b.size"): 0.0}), monkeypatch)
    assert "from a larger model" not in [kind for _, kind in rows(again)]


def test_idle_members_are_dropped_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left is fitted again each time, and may need the next."""
    scores = {"": 300.0, "a": 299.0, "b": 299.0, "c": 105.0, "ab": 299.0, "ac": 104.0, "bc": 104.0, "abc": 103.0}
    idle = {(key, f"{name}.size"): 0.0 for key in scores for name in key if name in "ab"}
    exploration = Exploration(World(scores, switches("abc"), sizes=idle).use(monkeypatch).search())
    for key in scores:
        exploration.search.fit(of(key))
    exploration._drop_idle()
    assert [key for key, kind in rows(exploration) if kind == "from a larger model"] == ["bc", "c"]


def settled(world: World, patch: pytest.MonkeyPatch, *keys: str) -> Exploration:
    exploration = Exploration(world.use(patch).search())
    for key in keys:
        exploration.search.fit(of(key))
    exploration.settle()
    return exploration


def polished(exploration: Exploration) -> set[str]:
    return {key for key, kind in rows(exploration) if kind == "scattered"}


def test_the_best_and_what_is_near_are_polished_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {
        "": 300.0, "a": 100.0, "b": 100.0 + NEARLY - 0.1, "c": 100.0 + NEARLY, "ab": 95.0
    }  # fmt: skip
    found = settled(World(scores, switches("abc")), monkeypatch, "", "a", "b", "c")
    assert polished(found) == {"a", "b"}
    # Of more that are near the nearest: the best itself is one of them.
    names = "abcdefg"
    scores = {"": 300.0, **{name: 100.0 + number for number, name in enumerate(names)}}
    found = settled(World(scores, switches(names)), monkeypatch, "", *names)
    assert polished(found) == set(names[:POLISHED])


def test_the_rests_of_the_best_start_from_it_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 200.0, "b": 250.0, "ab": 100.0}, switches("ab"))
    found = settled(world, monkeypatch, "", "a", "b", "ab")
    assert {key for key, kind in rows(found) if kind == "from a larger model"} == {"a", "b"}
    assert {key for key, start, _ in world.starts if start.get("at") == 100.0} == {"a", "b", "ab"}


def test_the_declared_model_alone_is_not_polished(monkeypatch: pytest.MonkeyPatch) -> None:
    found = settled(World({"": 100.0}, switches("a"), white={"": 1.0}), monkeypatch, "", "a")
    assert not polished(found)


def test_a_better_best_that_polishing_brings_up_is_polished_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 300.0, "a": 100.0, "b": 110.0, "c": 145.0}
    found = settled(World(scores, switches("abc"), annealed={"b": 90.0}), monkeypatch, "", "a", "b", "c")
    # c was not near a or b.
    assert polished(found) == {"a", "b"}
    found = settled(World({**scores, "c": 135.0}, switches("abc"), annealed={"c": 5.0}), monkeypatch, "", *"abc")
    assert found.best_claimable() == of("c")


def test_rounds_of_polishing_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here each would bring up another best."""
    names = "abcdefghi"
    scores = {"": 1000.0, **{name: 500.0 + 39.0 * number for number, name in enumerate(names)}}
    annealed = {name: 490.0 - 60.0 * number for number, name in enumerate(names)}
    exploration = Exploration(World(scores, switches(names), annealed=annealed).use(monkeypatch).search())
    for key in ("", *names):
        exploration.search.fit(of(key))
    rounds: list[Hypothesis] = []

    def polish_the_next(best: Hypothesis) -> None:
        rounds.append(best)
        exploration.search.polish(of(names[len(rounds)]))

    monkeypatch.setattr(exploration, "polish_near", polish_the_next)
    exploration.settle()
    assert [key_of(best) for best in rounds] == list(names[:MOST_ROUNDS])


# -- time and progress -------------------------------------------------------------------------------------------------


def test_progress_never_goes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"": 900.0, "a": 700.0, "b": 750.0, "ab": 500.0, "abc": 300.0, "'": 880.0, "a'": 690.0, "ab'": 495.0}
    world = World(scores, switches("abcde"), timing=True, white={"a'": 1.0})
    explored(world, monkeypatch)
    shares = [share for _, share in world.told]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert shares[-1] <= 0.9
    begun = {what: share for what, share in reversed(world.told)}
    assert begun[str(of("ab"))] == pytest.approx(0.5)
    assert begun[str(of("abc"))] == pytest.approx(0.6)


def test_what_the_time_was_too_short_for_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0, "b": 110.0, "c": 120.0}, switches("abc"), out_of_time=("b", "c"))
    found = explored(world, monkeypatch)
    assert found.is_cut_short
    assert found.singles_untried()
    assert found.untried == [str(of("b")), str(of("c")), "sets of more effects"]
    whole = explored(World({"": 300.0, "a": 100.0}, switches("ab")), monkeypatch)
    assert not whole.is_cut_short
    assert not whole.singles_untried()
    assert whole.untried == []


def test_time_that_is_used_up_while_polishing_is_the_caller_s_to_handle(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World({"": 300.0, "a": 100.0}, switches("a"))
    exploration = Exploration(world.use(monkeypatch).search())
    exploration.search.fit(of(""))
    exploration.search.fit(of("a"))
    world.out_of_time = ("a",)
    with pytest.raises(OutOfTimeError):
        exploration.settle()
    assert math.isfinite(exploration.table()[of("a")].score)
