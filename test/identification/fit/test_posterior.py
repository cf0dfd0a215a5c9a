"""The posterior and the verdict, functions of a table of evidence alone."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

import pytest

from valve_sim.identification.fit.posterior import (
    ALIKE,
    EXPECTED,
    FORM_IS_RIGHT,
    MOST_BESIDE,
    SURE,
    Decision,
    Evidence,
    Rivals,
    Set,
    class_of,
    decide,
    posterior_of,
)

NAMES = "abcdefgh"
MANY = Rivals(frozenset(NAMES), frozenset({"valve.p", "valve.q"}))
NEVER = -1e4


def subsets(names: frozenset[str] | set[str]) -> list[Set]:
    ordered = sorted(names)
    return [own for size in range(len(ordered) + 1) for own in itertools.combinations(ordered, size)]


def table(plain: Mapping[str, float], unnamed: float = NEVER) -> dict[Set, Evidence]:
    """Of sets that are given by their letters; beside something unnamed each has so much."""
    return {tuple(names): Evidence(own, unnamed) for names, own in plain.items()}


def decided(plain: Mapping[str, float], unnamed: float = NEVER) -> Decision:
    return decide(posterior_of(MANY, table(plain, unnamed)))


# -- priors ------------------------------------------------------------------------------------------------------------


def test_prior_probabilities_add_up() -> None:
    every = subsets(MANY.effects | MANY.declared)
    plain = math.fsum(math.exp(MANY.log_prior(names)[0]) for names in every)
    unnamed = math.fsum(math.exp(MANY.log_prior(names)[1]) for names in every if len(names) <= MOST_BESIDE)
    assert plain == pytest.approx(FORM_IS_RIGHT)
    # The other half is that of smooth curves.
    assert unnamed == pytest.approx(0.5 * (1.0 - FORM_IS_RIGHT))


def test_how_many_act_is_a_poisson_number_of_effects_and_one_of_wrong_values() -> None:
    counts: dict[tuple[int, int], float] = {}
    for names in subsets(MANY.effects | MANY.declared):
        wrong = sum(name in MANY.declared for name in names)
        key = len(names) - wrong, wrong
        counts[key] = counts.get(key, 0.0) + math.exp(MANY.log_prior(names)[0])
    assert counts[1, 0] / counts[0, 0] == pytest.approx(EXPECTED)
    assert counts[2, 0] / counts[0, 0] == pytest.approx(EXPECTED**2 / 2.0)
    assert counts[0, 1] / counts[0, 0] == pytest.approx(EXPECTED)
    assert counts[3, 2] / counts[0, 0] == pytest.approx(EXPECTED**5 / 12.0)


# -- the posterior -----------------------------------------------------------------------------------------------------

SOME = {"": 0.0, "a": 6.0, "b": 4.5, "ab": 7.0, "c": -2.0}


def test_probabilities_add_up_to_one_whatever_is_in_the_table() -> None:
    for forced in (-math.inf, 3.0, 90.0):
        tried = table(SOME, 5.0)
        tried["a",] = tried["a",]._replace(forced=forced)
        found = posterior_of(MANY, tried, {("a",): 2.0})
        assert math.fsum(share.total for share in found.shares.values()) == pytest.approx(1.0)
        assert found.unnamed == pytest.approx(math.fsum(share.unnamed for share in found.shares.values()))


def test_odds_are_those_of_prior_and_evidence() -> None:
    found = posterior_of(MANY, table(SOME, 5.0))
    odds = math.log(found.shares["a",].plain / found.shares[()].plain)
    assert odds == pytest.approx(6.0 + MANY.log_prior(("a",))[0] - MANY.log_prior(())[0])
    beside = math.log(found.shares["a",].unnamed / found.shares["a",].plain)
    assert beside == pytest.approx(5.0 - 6.0 + MANY.log_prior(("a",))[1] - MANY.log_prior(("a",))[0])


def test_held_out_odds_raise_the_unnamed_of_their_set_alone() -> None:
    before, after = (posterior_of(MANY, table(SOME, 3.0), odds) for odds in (None, {("a",): 4.0}))
    assert after.unnamed > before.unnamed
    ratio = (after.shares["a",].unnamed / after.shares["a",].plain) / (
        before.shares["a",].unnamed / before.shares["a",].plain
    )
    assert math.log(ratio) == pytest.approx(4.0)
    others = [own.shares["b",].unnamed / own.shares["b",].plain for own in (before, after)]
    assert others[0] == pytest.approx(others[1])


def test_inclusion_adds_all_sets_with_a_name() -> None:
    found = posterior_of(MANY, table(SOME, 3.0))
    inclusion = found.inclusion()
    assert set(inclusion) == {"a", "b", "c"}
    assert inclusion["b"] == pytest.approx(found.shares["b",].total + found.shares["a", "b"].total)
    assert math.fsum(found.beside.values()) == pytest.approx(1.0)
    ratio = found.shares["a",].unnamed / found.shares["b",].unnamed
    assert found.beside["a",] / found.beside["b",] == pytest.approx(ratio)


def test_a_set_that_another_contains_leads_where_it_is_nearly_as_probable() -> None:
    sizes = {"a": 4, "b": 1}
    near = posterior_of(MANY, {**table({"": -400.0}), ("a",): Evidence(0.0, 0.0), ("a", "b"): Evidence(2.5, 2.5)})
    assert decide(near, sizes=sizes).names == ("a",)
    far = posterior_of(MANY, {**table({"": -400.0}), ("a",): Evidence(0.0, 0.0), ("a", "b"): Evidence(9.0, 9.0)})
    assert decide(far, sizes=sizes).names == ("a", "b")


def test_what_was_left_untried_lowers_every_probability() -> None:
    tried = table({"": 0.0, "a": 9.0})
    bound = Evidence(9.0, NEVER, is_fitted=False)
    more = {**tried, **{(name,): bound for name in "bcde"}}
    before, after = decide(posterior_of(MANY, tried)), decide(posterior_of(MANY, more))
    assert before.kind == "effects"
    assert after.kind == "insufficient"
    assert posterior_of(MANY, more).shares["a",].total == pytest.approx(0.2, abs=0.01)
    # What was not fitted never leads.
    best = {**tried, ("b",): Evidence(50.0, NEVER, is_fitted=False)}
    assert decide(posterior_of(MANY, best)).names == ("a",)


# -- look-alikes -------------------------------------------------------------------------------------------------------


def test_look_alikes_differ_in_one_member_and_are_nearly_as_probable() -> None:
    weights = {("a", "b"): 0.5, ("a", "c"): 0.3, ("c", "d"): 0.1, ("a", "e"): 0.4 / ALIKE, ("b", "f"): 0.06, (): 0.02}
    found = class_of(weights, ("a", "b"))
    assert found.others == {"a": ("f",), "b": ("c",)}
    assert found.probability == pytest.approx(0.5 + 0.3 + 0.06)


def test_a_further_effect_makes_no_name_wrong() -> None:
    weights = {("a",): 0.6, ("a", "b"): 0.2, ("c",): 0.1, ("c", "d"): 0.05, ("b",): 0.01, ("b", "d"): 0.04}
    assert class_of(weights, ("a",)).probability == pytest.approx(0.95)


# -- the verdict -------------------------------------------------------------------------------------------------------


def odds(probability: float, names: str = "a") -> float:
    """Evidence that a set needs to have such a probability beside nothing."""
    prior = MANY.log_prior(())[0] - MANY.log_prior(tuple(names))[0]
    return prior + math.log(probability / (1.0 - probability))


@pytest.mark.parametrize(("probability", "kind"), [(0.4, "none"), (0.6, "insufficient"), (0.89, "insufficient"),
                                                   (0.91, "effects")])  # fmt: skip
def test_effects_are_named_from_the_probability_that_is_sure(probability: float, kind: str) -> None:
    found = decided({"": 0.0, "a": odds(probability)})
    assert found.kind == kind
    assert found.probability == pytest.approx(1.0 - probability if kind == "none" else probability)
    assert found.names == (() if kind == "none" else ("a",))
    assert (found.probability >= SURE) == (kind == "effects")


def test_nothing_is_said_to_be_missing_only_where_that_has_half_of_all() -> None:
    thirds = decided({"": 0.0, **{name: odds(0.4) for name in "ab"}})
    assert (thirds.kind, thirds.names) == ("insufficient", ())
    # That nothing acts, not that nothing or anything does.
    assert thirds.probability == pytest.approx(1.0 / (1.0 + 2.0 * 0.4 / 0.6))


def test_what_cannot_be_told_apart_is_named_together() -> None:
    found = decided({"": 0.0, "a": 20.0, "b": 19.0})
    assert (found.kind, found.names, found.others) == ("effects", ("a",), {"a": ("b",)})
    assert found.probability > 0.99
    assert decided({"": 0.0, **dict.fromkeys("abcde", 20.0)}).kind == "insufficient"


def test_what_has_no_name_is_unknown_whatever_leads_beside_it() -> None:
    own = posterior_of(MANY, {**table({"": 0.0}, 30.0), ("a",): Evidence(9.0, 60.0)})
    found = decide(own)
    assert (found.kind, found.probability) == ("unknown", pytest.approx(own.unnamed))
    assert found.probability > 0.99
    # However much better a name is than none: forms without a name are imitated. It is the nearest, and not claimed.
    assert found.names == ("a",)
    assert own.beside["a",] > 0.99


def test_a_force_without_a_name_is_unnamed_as_well() -> None:
    for forced, kind in ((30.0, "unknown"), (-3.0, "none")):
        tried = {**table({"": 0.0}), (): Evidence(0.0, -math.inf, forced=forced)}
        assert decide(posterior_of(MANY, tried)).kind == kind
