"""One runner of blind cases: nothing is missing in the first half, one effect in the others; each is judged.

`benchmarks.sensorless` and `benchmarks.gas_recordings` say what a case is, and what else is asked of it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from rich.console import Console
from rich.table import Table

from valve_sim.identification.diagnosis.run import Verdict

CONFIDENT: Final = 0.9


class Answer(NamedTuple):
    """What a verdict says, and whether that is right (in the class of the truth) or confidently wrong."""

    kind: str
    effects: tuple[str, ...]
    probability: float
    is_right: bool
    is_wrong: bool

    @classmethod
    def of(cls, verdict: Verdict, missing: str) -> Answer:
        """Judge a verdict by what is missing; empty: nothing."""
        names = {*verdict.effects, *(name for others in verdict.confusable_with.values() for name in others)}
        is_right = missing in names if missing else verdict.kind == "none"
        is_wrong = verdict.kind == "effects" and not is_right and verdict.probability >= CONFIDENT
        return cls(verdict.kind, verdict.effects, verdict.probability, is_right, is_wrong)

    @property
    def row(self) -> tuple[str, str]:
        """Two cells: the verdict, and whether it is right."""
        words = f"{self.kind} {' + '.join(self.effects)}".strip()
        return f"{words} {self.probability:.2f}", "yes" if self.is_right else "WRONG" if self.is_wrong else "no"


class Study(NamedTuple):
    """Cases of one kind.

    Attributes:
        title, headings: of the table; before these headings stand case, what it is, and what is missing.
        effects: what may be missing. draw: a case by seed and what is missing. words: what a case is.
        examine: diagnoses a case; what it returns has `answer`. row: its cells. counts: how many are as they should be.
        options: adds options of its own.
    """

    title: str
    headings: tuple[str, ...]
    effects: Sequence[str]
    draw: Callable[[int, str, argparse.Namespace], Any]
    examine: Callable[[Any, argparse.Namespace], Any]
    row: Callable[[Any], tuple[str, ...]]
    counts: Mapping[str, Callable[[Any], bool]]
    options: Callable[[argparse.ArgumentParser], None] = lambda parser: None


def run(study: Study, description: str, cases: int) -> None:
    """Run a study by the options of the command line, and print it."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=cases, help=f"how many (default: {cases})")
    parser.add_argument("--first", type=int, default=0, help="seed of the first case")
    parser.add_argument("--effects", action="store_true", help="only cases in which something is missing")
    parser.add_argument("--missing", choices=study.effects, help="what is missing in every case")
    study.options(parser)
    options = parser.parse_args()
    table = Table("case", "", "missing", "verdict", "right", *study.headings, title=study.title)
    found: dict[str, list[Any]] = {"nothing missing": [], "one effect missing": []}
    for number in range(options.cases):
        seed, is_none = options.first + number, not options.effects and number < options.cases // 2
        missing = options.missing or ("" if is_none else study.effects[seed % len(study.effects)])
        case = study.draw(seed, missing, options)
        outcome = study.examine(case, options)
        found["one effect missing" if missing else "nothing missing"].append(outcome)
        cells = (f"{seed}", case.words, missing or "–", *outcome.answer.row, *study.row(outcome))
        print(" | ".join(cells), flush=True)
        table.add_row(*cells)
    Console(width=170).print(table)
    asked: Mapping[str, Callable[[Any], bool]] = {
        "right": lambda own: own.answer.is_right,
        "confidently wrong": lambda own: own.answer.is_wrong,
        **study.counts,
    }
    for words, outcomes in found.items():
        if outcomes:
            counts = (f"{what} {sum(map(holds, outcomes))} of {len(outcomes)}" for what, holds in asked.items())
            print(f"{words}: {', '.join(counts)}")
