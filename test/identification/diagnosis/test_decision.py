"""Every branch from a table of scores to a verdict, on tables that no simulator made."""

from __future__ import annotations

import math

import pytest
from valve_sim.identification.diagnosis.calibration import calibrated
from valve_sim.identification.diagnosis.decision import (
    EVEN,
    Choice,
    Claim,
    choice_of,
    claim_after_holdout,
    competitors,
    decide,
    is_claimable,
    look_alikes,
    share_of_evidence,
    weight_of,
)
from valve_sim.identification.selection.held_out import NOT_HELD_OUT, Judgement
from valve_sim.identification.selection.table import ScoreTable

from identification.selection.made_up_scores import BASE, of, scored, table

HOLDS = Judgement(is_white=True, ratio=0.4, predicts_better=True)
COLOURED = Judgement(is_white=False, ratio=0.4, predicts_better=True)
HARDLY_SMALLER = Judgement(is_white=False, ratio=0.7, predicts_better=True)
LARGER = Judgement(is_white=False, ratio=1.1, predicts_better=True)
NO_BETTER = Judgement(is_white=True, ratio=0.99, predicts_better=False)
DECLARED_HOLDS = Judgement(is_white=True, ratio=1.0, predicts_better=False)
DECLARED_FAILS = Judgement(is_white=False, ratio=1.0, predicts_better=False)


def test_a_rival_that_is_far_better_than_a_refuted_choice_weighs_no_more_than_one() -> None:
    """exp of half the difference of S is beyond the largest double from 1,420 on."""
    found = table(scored(BASE, 40_000.0), scored(of("a"), 100.0))
    refuted = claim_after_holdout(found, choice_of(found, of("a"), ()), [DECLARED_FAILS, NO_BETTER], 8)
    assert refuted.best == BASE
    (rival,) = competitors(found, refuted)
    assert weight_of(found[rival].score - found[BASE].score) == 1.0
    assert weight_of(2.0) == pytest.approx(math.exp(-1.0))
    assert weight_of(1e6) >= 0.0


def two(*, base_white: bool = False, best_white: bool = True, near: float = 30.0) -> ScoreTable:
    return table(
        scored(BASE, 400.0, white=base_white, left_out=3.0),
        scored(of("a"), 100.0, white=best_white, left_out=1.0),
        scored(of("b"), 100.0 + near, left_out=1.0),
    )


def chosen(found: ScoreTable, *curves: float, best: tuple[str, ...] = ("a",)) -> Choice:
    return choice_of(found, of(*best), curves)


# -- the choice --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("white", "false_alarm", "is_larger", "stands"),
    [
        (True, 0.001, False, True),
        (True, 0.02, False, False),
        (False, 0.02, False, True),
        (True, 0.001, True, False),
        (False, 0.001, True, False),
    ],
)
def test_a_false_alarm_or_a_larger_error_is_no_claim(
    white: bool, false_alarm: float, is_larger: bool, stands: bool
) -> None:
    assert is_claimable(two(best_white=white), of("a"), false_alarm, is_larger=is_larger) is stands


def test_a_choice_says_what_competes_with_it_and_whether_a_curve_does_better() -> None:
    found = two(near=8.0)
    assert chosen(found).competing == (of("b"),)
    assert chosen(two(near=30.0)).competing == ()
    assert not chosen(found, 95.0).curve_wins
    assert chosen(found, 120.0, 89.0).curve_wins
    assert chosen(found).halves_error
    assert not chosen(found, best=()).halves_error
    # Where no form is right nothing is judged beside the best: all would fail.
    assert chosen(two(best_white=False, near=8.0)).competing == ()


# -- the judgement -----------------------------------------------------------------------------------------------------


def test_what_held_out_data_confirm_stands() -> None:
    found = two()
    assert claim_after_holdout(found, chosen(found), (DECLARED_FAILS, HOLDS), 8) == Claim(of("a"), False, False)
    assert claim_after_holdout(found, chosen(found), (NOT_HELD_OUT, NOT_HELD_OUT), 3) == Claim(of("a"), False, False)


@pytest.mark.parametrize("judgement", [LARGER, NO_BETTER])
@pytest.mark.parametrize(
    ("base_white", "of_base", "is_unknown"),
    [(True, DECLARED_HOLDS, False), (True, DECLARED_FAILS, True), (False, DECLARED_HOLDS, True)],
)
def test_a_refuted_name_is_withdrawn_and_the_runner_up_is_not_named(
    judgement: Judgement, base_white: bool, of_base: Judgement, is_unknown: bool
) -> None:
    found = two(base_white=base_white, near=5.0)
    claim = claim_after_holdout(found, chosen(found), (of_base, judgement, HOLDS), 8)
    assert claim == Claim(BASE, is_unknown, False)
    kind = decide(claim, look_alikes(found, claim), 0.9, 8, singles_untried=False).kind
    assert kind == ("unknown" if is_unknown else "none")


def test_a_name_whose_residual_is_coloured_there_is_only_the_closest() -> None:
    found = two()
    assert claim_after_holdout(found, chosen(found), (DECLARED_FAILS, COLOURED), 8) == Claim(of("a"), True, False)


def test_a_competitor_that_is_refuted_is_not_listed_and_promotes_nothing() -> None:
    found = two(near=5.0)
    kept = claim_after_holdout(found, chosen(found), (DECLARED_FAILS, HOLDS, HOLDS), 8)
    assert look_alikes(found, kept) == {"a": ("b",)}
    assert competitors(found, kept) == [of("a"), of("b")]
    refuted = claim_after_holdout(found, chosen(found), (DECLARED_FAILS, HOLDS, COLOURED), 8)
    assert refuted.best == of("a")
    assert look_alikes(found, refuted) == {"a": ()}
    assert competitors(found, refuted) == [of("a")]
    assert share_of_evidence(found, refuted, ()) > 0.99 > share_of_evidence(found, kept, ()) > 0.9


@pytest.mark.parametrize(
    ("of_best", "curves", "names_most"), [(COLOURED, (), True), (HARDLY_SMALLER, (), False), (COLOURED, (10.0,), False)]
)
def test_beside_a_remainder_names_are_claimed_that_halve_both_errors(
    of_best: Judgement, curves: tuple[float, ...], names_most: bool
) -> None:
    found = two(best_white=False)
    claim = claim_after_holdout(found, chosen(found, *curves), (DECLARED_FAILS, of_best), 8)
    assert claim == Claim(of("a"), True, names_most)


def test_a_curve_that_does_better_leaves_the_name_only_the_closest() -> None:
    found = two()
    assert claim_after_holdout(found, chosen(found, 80.0), (DECLARED_FAILS, HOLDS), 8) == Claim(of("a"), True, False)


@pytest.mark.parametrize(("strokes", "is_unknown"), [(1, False), (8, True)])
def test_nothing_is_missing_only_where_held_out_data_agree_but_one_stroke_cannot_tell(
    strokes: int, is_unknown: bool
) -> None:
    found = two(base_white=True)
    choice = chosen(found, best=())
    assert claim_after_holdout(found, choice, (DECLARED_HOLDS, DECLARED_HOLDS), strokes) == Claim(BASE, False, False)
    failed = claim_after_holdout(found, choice, (DECLARED_FAILS, DECLARED_FAILS), strokes)
    assert failed == Claim(BASE, is_unknown, False)


@pytest.mark.parametrize("base_white", [True, False])
def test_without_time_to_open_held_out_data_nothing_is_claimed(base_white: bool) -> None:
    found = two(base_white=base_white)
    assert claim_after_holdout(found, chosen(found), None, 8) == Claim(BASE, not base_white, False)


# -- evidence ----------------------------------------------------------------------------------------------------------


def test_the_evidence_is_shared_with_what_is_near() -> None:
    alone = Claim(of("a"), False, False)
    assert share_of_evidence(two(near=100.0), alone, ()) == pytest.approx(1.0, abs=1e-4)
    assert share_of_evidence(two(near=0.0), alone, ()) == pytest.approx(0.5, abs=1e-4)
    # A curve has its share where it is near; what merely extends the claim has none.
    assert share_of_evidence(two(near=100.0), alone, (100.0,)) == pytest.approx(0.5, abs=1e-4)
    assert share_of_evidence(two(near=100.0), alone, (121.0,)) == pytest.approx(1.0, abs=1e-4)
    larger = table(*two(near=100.0).scores.values(), scored(of("a", "c"), 95.0))
    assert share_of_evidence(larger, alone, ()) == pytest.approx(1.0, abs=1e-4)


def test_a_look_alike_of_fewer_parameters_has_the_share_of_its_evidence() -> None:
    """However good its S is."""
    found = table(
        scored(BASE, 2000.0), scored(of("a"), 98.0, evidence=125.0),
        scored(of("b"), 100.0, evidence=100.0, parameters=6),
    )  # fmt: skip
    claim = Claim(of("b"), is_unknown=False, names_most=False)
    assert share_of_evidence(found, claim, []) == pytest.approx(1.0, abs=1e-5)
    assert look_alikes(found, claim) == {"b": ()}


def test_smaller_errors_of_stamps_are_no_evidence_where_stamps_refute_their_prior() -> None:
    timed = BASE._replace(timing=True)
    late = scored(of("a", timing=True), 100.0, of_recordings=284.0, stamp_variance=28.0)
    found = table(scored(timed, 150.0, of_recordings=340.0), late)
    share = share_of_evidence(found, Claim(timed, is_unknown=False, names_most=False), [])
    # Of 50, 56 (1 - 1/28) = 54 are relief, so that it is worse by 4.
    assert share == pytest.approx(1.0 / (1.0 + math.exp(-2.0)))


def test_weak_evidence_is_never_certain() -> None:
    weak = table(scored(BASE, 130.0), scored(of("a"), 100.0))
    gained = 1.0 - math.exp(-1.0)
    assert share_of_evidence(weak, Claim(of("a"), False, False), ()) == pytest.approx(gained, rel=1e-3)


def test_what_was_only_screened_has_its_share_beside_nothing() -> None:
    found = table(scored(BASE, 100.0), screened={"a": -4.0, "b": -40.0})
    share = share_of_evidence(found, Claim(BASE, False, False), ())
    assert share == pytest.approx(1.0 / (1.0 + math.exp(-2.0)), rel=1e-6)


# -- the verdict -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("claim", "strokes", "untried", "kind"),
    [
        (Claim(BASE, False, False), 8, False, "none"),
        (Claim(of("a"), False, False), 8, False, "effects"),
        (Claim(of("a"), False, False), 8, True, "effects"),
        (Claim(of("a"), False, False), 1, False, "insufficient"),
        (Claim(BASE, False, False), 1, False, "insufficient"),
        (Claim(of("a"), True, False), 8, False, "unknown"),
        (Claim(of("a"), True, False), 8, True, "insufficient"),
        (Claim(of("a"), True, True), 8, False, "effects"),
    ],
)
def test_kinds_of_verdict(claim: Claim, strokes: int, untried: bool, kind: str) -> None:
    alike = dict.fromkeys(claim.best.effects, ("b",))
    decision = decide(claim, alike, 0.97, strokes, singles_untried=untried)
    assert decision.kind == kind
    assert decision.effects == (() if kind == "none" else claim.best.effects)
    is_sure = kind in ("none", "effects") and not claim.is_unknown and not untried
    assert decision.probability == (calibrated(kind, 0.97) if is_sure else EVEN)


def test_a_class_of_more_than_four_is_no_answer() -> None:
    claim = Claim(of("a"), False, False)
    assert decide(claim, {"a": ("b", "c", "d")}, 0.9, 8, singles_untried=False).kind == "effects"
    assert decide(claim, {"a": ("b", "c", "d", "e")}, 0.9, 8, singles_untried=False).kind == "insufficient"


@pytest.mark.parametrize(("names", "probability"), [("abcd", calibrated("effects", 0.99)), ("abcde", EVEN)])
def test_more_names_than_any_claim_had_that_was_calibrated_are_an_even_chance(names: str, probability: float) -> None:
    claim = Claim(of(*names), False, False)
    decision = decide(claim, {name: () for name in names}, 0.99, 8, singles_untried=False)
    assert decision == ("effects", tuple(names), probability)


def test_where_the_form_is_wrong_known_look_alikes_are_listed() -> None:
    found = two(near=100.0)
    assert look_alikes(found, Claim(of("a"), False, False)) == {"a": ()}
    assert look_alikes(found, Claim(of("a"), True, True)) == {"a": ("b",)}


@pytest.mark.parametrize(("names", "others"), [(("a", "c"), ()), (("a", "c", "d"), ("b",))])
def test_where_many_names_put_the_form_in_doubt_known_look_alikes_are_listed(
    names: tuple[str, ...], others: tuple[str, ...]
) -> None:
    found = table(scored(BASE, 400.0, left_out=3.0), scored(of(*names), 100.0, left_out=1.0))
    assert look_alikes(found, Claim(of(*names), False, False))["a"] == others


def test_what_is_named_itself_takes_no_place_among_the_look_alikes_of_another() -> None:
    alike = {"a": ("b", "c", "d", "e"), "b": ("a",)}
    scores = table(scored(BASE, 400.0), scored(of("a", "b"), 100.0, white=False)).scores
    found = look_alikes(ScoreTable(scores, alike), Claim(of("a", "b"), True, False))
    assert found == {"a": ("c", "d", "e"), "b": ()}
