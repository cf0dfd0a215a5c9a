"""What is chosen from a table of scores, and that no fit changes one that decisions were drawn from."""

from __future__ import annotations

import pytest
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.stepwise import Exploration
from valve_sim.identification.selection.table import (
    Hypothesis,
    backward,
    best_claimable,
    best_few,
    choose,
    competing_models,
    delta_scores,
    larger_alternatives,
)

from identification.selection.made_up_scores import BASE, of, scored, table
from identification.selection.test_held_out import recorded
from valve_sim.identification.estimation.problem import Problem


def test_the_best_score_is_chosen_of_what_may_be_claimed() -> None:
    found = table(
        scored(BASE, 100.0), scored(of("a"), 50.0, claimable=False), scored(of("b"), 60.0), scored(of("c"), 70.0)
    )
    assert best_claimable(found) == of("b")
    assert choose(found) == of("b")


def test_without_a_declared_model_to_compare_with_nothing_is_claimed() -> None:
    late = of("a", timing=True)
    assert choose(table(scored(BASE, 100.0), scored(late, 10.0))) == BASE
    assert choose(table(scored(BASE, 100.0), scored(BASE._replace(timing=True), 90.0), scored(late, 10.0))) == late


def test_equal_scores_go_to_what_was_asked_for_first() -> None:
    assert best_claimable(table(scored(BASE, 100.0), scored(of("b"), 50.0), scored(of("a"), 50.0))) == of("b")


@pytest.mark.parametrize(("worse", "chosen"), [(9.9, of("a")), (10.1, of("a", "c"))])
def test_a_member_whose_loss_costs_little_is_dropped(worse: float, chosen: tuple[str, ...]) -> None:
    found = table(
        scored(BASE, 200.0), scored(of("a"), 50.0 + worse), scored(of("c"), 150.0), scored(of("a", "c"), 50.0)
    )
    assert backward(found, of("a", "c")) == chosen


@pytest.mark.parametrize(("left_out", "chosen"), [(1.0, of("a")), (3.0, of("a", "c"))])
def test_where_no_form_is_right_a_member_must_predict_other_strokes_better(
    left_out: float, chosen: tuple[str, ...]
) -> None:
    found = table(
        scored(BASE, 200.0, white=False, left_out=9.0),
        scored(of("a"), 90.0, white=False, left_out=left_out),
        scored(of("a", "c"), 50.0, white=False, left_out=1.0),
    )
    assert backward(found, of("a", "c")) == chosen


def test_stamps_that_err_are_dropped_where_they_cost_more_than_they_explain() -> None:
    timed = of("a", timing=True)
    found = table(
        scored(BASE, 200.0), scored(BASE._replace(timing=True), 190.0), scored(of("a"), 50.0), scored(timed, 55.0)
    )
    assert backward(found, timed) == of("a")


@pytest.mark.parametrize(("variance", "chosen"), [(1.0, of("a", timing=True)), (26.0, BASE._replace(timing=True))])
def test_smaller_errors_of_stamps_count_by_the_variance_that_they_have(variance: float, chosen: Hypothesis) -> None:
    """Stamps of a live node are off by many of their prior's deviations, whatever effect is assumed."""
    found = table(
        scored(BASE, 900.0), scored(BASE._replace(timing=True), 150.0, of_recordings=340.0),
        scored(of("a", timing=True), 100.0, of_recordings=284.0, stamp_variance=variance),
    )  # fmt: skip
    assert choose(found) == chosen
    gain = 50.0 if variance == 1.0 else 50.0 - 56.0 * 25.0 / 26.0
    assert found[of("a", timing=True)].gain_on(found[BASE._replace(timing=True)]) == pytest.approx(gain)


def test_where_no_form_is_right_what_is_left_out_decides() -> None:
    bends = scored(of("a"), 40.0, white=False, left_out=5.0)
    found = table(
        scored(BASE, 300.0, white=False, left_out=9.0), bends, scored(of("b"), 60.0, white=False, left_out=1.0)
    )
    assert best_claimable(found) == of("b")
    # A white residual needs none of this.
    assert best_claimable(table(*found.scores.values(), scored(of("c"), 50.0, left_out=9.0))) == of("c")


def test_what_cannot_be_among_the_best_is_not_worked_out() -> None:
    asked: list[int] = []

    def criterion(item: int) -> float:
        asked.append(item)
        return item + {3: 9.0, 4: 0.5}.get(item, 0.0)

    assert best_few([7, 4, 3, 5, 11], 2, float, criterion) == [4, 5]
    assert asked == [3, 4, 5]
    assert best_few([2], 3, float, criterion) == [2]


def test_competitors_are_of_equal_size_and_near() -> None:
    found = table(
        scored(BASE, 300.0),
        scored(of("a"), 50.0),
        scored(of("b"), 58.0),
        scored(of("c"), 65.0),
        scored(of("a", "b"), 50.0),
    )
    assert delta_scores(found, of("a")) == {of("a"): 0.0, of("b"): 8.0, of("c"): 15.0}
    assert competing_models(found, of("a")) == [of("a"), of("b")]


@pytest.mark.parametrize(
    ("parameters", "chi2", "claimable", "white", "listed"),
    [
        (5, 47.5, True, True, True),
        (5, 48.5, True, True, False),
        (3, 47.5, True, True, False),
        (5, 47.5, False, True, False),
        (5, 47.5, True, False, False),
    ],
)
def test_look_alikes_of_more_parameters_are_compared_by_evidence(
    parameters: int, chi2: float, claimable: bool, white: bool, listed: bool
) -> None:
    found = table(
        scored(BASE, 300.0), scored(of("a"), 50.0, evidence=55.0, white=white),
        scored(of("b"), 70.0, evidence=57.5, parameters=parameters, claimable=claimable, chi2=chi2),
        scored(of("c"), 51.0, parameters=9),
    )  # fmt: skip
    assert larger_alternatives(found, of("a")) == ({of("b"): 2.5} if listed else {})


@pytest.mark.parametrize(("evidence", "chosen"), [(44.9, "b"), (45.1, "a")])
def test_a_look_alike_of_more_parameters_is_chosen_where_its_evidence_is_decisively_better(
    evidence: float, chosen: str
) -> None:
    """S charges ln N for what tolerances, not samples, limit: friction by direction passed for Coulomb's."""
    found = table(
        scored(BASE, 300.0), scored(of("a"), 50.0, evidence=55.0),
        scored(of("b"), 53.0, evidence=evidence, parameters=6, chi2=26.0),
    )  # fmt: skip
    assert choose(found) == of(chosen)


@pytest.mark.parametrize(("evidence", "chosen", "listed"), [(45.0, "a", True), (54.0, "b", True), (56.0, "b", False)])
def test_a_look_alike_of_fewer_parameters_is_compared_by_evidence(evidence: float, chosen: str, listed: bool) -> None:
    """Not by S, which is better for it by what it charges the larger one for."""
    found = table(
        scored(BASE, 300.0), scored(of("a"), 55.0, evidence=evidence),
        scored(of("b"), 50.0, evidence=46.0, parameters=6, chi2=20.0), scored(of("c"), 58.0),
    )  # fmt: skip
    assert choose(found) == of(chosen)
    assert (of("a") in competing_models(found, of("b"))) is listed
    assert delta_scores(found, of("b"))[of("a")] == evidence - 46.0


def test_a_look_alike_of_more_parameters_is_no_competitor_by_score_alone() -> None:
    """One whose evidence speaks against it was listed: a wrong attraction polynomial beside attraction at rest."""
    found = table(
        scored(BASE, 300.0), scored(of("a"), 50.0, evidence=55.0),
        scored(of("b"), 58.0, evidence=71.0, parameters=6, chi2=40.0),
    )  # fmt: skip
    assert competing_models(found, of("a")) == [of("a")]


@pytest.mark.parametrize(
    ("of_declared", "chi2", "improves"),
    [(31.0, 60.0, True), (30.0, 60.0, False), (30.0, -60.0, False), (-31.0, -60.0, False), (0.0, 0.0, False)],
)
def test_what_brings_declared_values_back_need_not_predict_strokes_left_out_better(
    of_declared: float, chi2: float, improves: bool
) -> None:
    """Where that is most of what it gains."""
    smaller = scored(BASE, 100.0, left_out=1.0, chi2=100.0, of_declared=of_declared)
    assert scored(of("a"), 50.0, left_out=1.0, chi2=100.0 - chi2).improves_on(smaller) is improves


def test_without_strokes_to_leave_out_a_larger_model_improves_on_a_smaller_one() -> None:
    assert scored(of("a"), 50.0).improves_on(scored(BASE, 100.0, left_out=1.0))
    assert scored(of("a"), 50.0, left_out=9.0).improves_on(scored(BASE, 100.0))


def test_what_is_left_out_counts_by_how_slow_the_noise_is() -> None:
    assert scored(of("a"), 50.0, white=False, left_out=2.0, inflation=4.0).own_criterion == 60.0
    # Ten residuals fall from 1 to 0.5: the squares by 7.5, which is more than four times the root of 10 · 0.25 · 1.4.
    smaller = scored(BASE, 100.0, left_out=1.0)
    assert scored(of("a"), 50.0, left_out=0.5, inflation=1.4).improves_on(smaller)
    assert not scored(of("a"), 50.0, left_out=0.5, inflation=1.42).improves_on(smaller)


def test_rows_are_appended_and_the_best_counts_until_the_log_is_closed() -> None:
    search = Search(Problem(recorded(3, ramp_slope=2.0)))
    exploration = Exploration(search)
    search.fit(BASE)
    exploration.explore()
    before = search.log.rows
    scores = {name: one.score for name, one in exploration.table().scores.items()}
    exploration.settle()
    assert search.log.rows[: len(before)] == before
    assert len(search.log.rows) > len(before)
    assert {"declared", "scattered", "annealed"} <= {row.start for row in search.log.rows}
    search.log.close()
    closed = exploration.table()
    assert all(closed[name].score <= score for name, score in scores.items())
    for name, fit in search.log.best.items():
        assert fit.chi2 == min(row.fit.chi2 for row in search.log.rows if row.hypothesis == name)
    assert choose(closed) == of("ramp")
    with pytest.raises(RuntimeError, match="after the table of scores was closed"):
        search.refit(of("ramp"), {})
