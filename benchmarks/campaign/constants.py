"""What each constant of the posterior decides: verdicts of stored tables of evidence, by three times it and a third."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple
from unittest import mock

from benchmarks.campaign.running import Answer, Outcome, grounds_of
from benchmarks.campaign.tables import is_misnamed, standing
from benchmarks.common import Column, in_columns
from valve_sim.identification.fit import posterior


class Constant(NamedTuple):
    """A constant of `fit.posterior`, what it means, and other values: a third of it, and three times it."""

    name: str
    meaning: str
    less: float
    more: float


CONSTANTS: Final = (
    Constant("FORM_IS_RIGHT", "probability that nothing acts but what has a name", 1.0 - 0.15, 1.0 - 0.05 / 3.0),
    Constant("EXPECTED", "effects, and wrong declared values, before the data are seen", 1.0 / 3.0, 3.0),
    Constant("MOST_BESIDE", "most named things beside something unnamed", 3, 24),
    Constant("SURE", "probability from which names are claimed, by its odds", 0.75, 0.964),
    Constant("EVEN", "probability from which nothing, or something unnamed, is claimed, by its odds", 0.25, 0.75),
    Constant("ALIKE", "odds within which a set is a look-alike", 20.0 / 3.0, 60.0),
    Constant("NEARLY", "odds within which the simpler set stands first", 1.0, 9.0),
    Constant("MOST_CLAIMED", "names of a claim", 1, 6),
    Constant("LARGEST_CLASS", "names of a class that is an answer", 2, 12),
)


def answered(answer: Answer, changed: Mapping[str, float]) -> Answer:
    """What an answer would have been by other constants."""
    with mock.patch.multiple(posterior, **changed):
        decision = grounds_of(answer).decision
    return replace(
        answer,
        kind=decision.kind,
        effects=decision.names,
        confusable_with=dict(decision.others),
        probability=decision.probability,
        unnamed=decision.unnamed,
    )


def constants_table(outcomes: Sequence[Outcome]) -> str:
    """For each constant, how many verdicts become others, and how many are confidently wrong."""
    known = [one for one in outcomes if one.answers and all(answer.grounds for answer in one.answers)]
    before = list(map(standing, known))

    def differ(found: Sequence[Outcome]) -> str:
        return f"{sum(standing(one) != own for one, own in zip(found, before, strict=True))}"

    def counted(label: str) -> Column:
        return Column(label, 8, lambda found: f"{sum(standing(one) == label for one in found)}")

    columns = (
        Column("differ", 8, differ),
        *map(counted, ("unique", "class", "missed", "wrong")),
        Column("≥ 0.9 wrong", 13, lambda found: f"{sum(map(is_misnamed, found))}"),
    )
    rows: dict[str, Sequence[Outcome]] = {"as they are": known}
    for constant in CONSTANTS:
        for value in (constant.less, constant.more):
            rows[f"{constant.name:<16}{f'{value:.3g}':>8}"] = [
                replace(one, answers=tuple(answered(answer, {constant.name: value}) for answer in one.answers))
                for one in known
            ]
    return in_columns(f"{'constant':<16}{'value':>8}", 24, columns, rows)
