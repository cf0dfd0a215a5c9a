"""Recordings that are hard on a diagnosis, all or the first of each kind: `python -m benchmarks.hard_recordings`."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from typing import Final, NamedTuple

from benchmarks.hard_recordings import __doc__ as words
from benchmarks.hard_recordings.cases import Case, cases
from valve_sim.identification.diagnosis.run import diagnose
from valve_sim.identification.estimation.budget import Budget

BUDGET: Final = 60.0
"""s, which stand for the work of a diagnosis, unless told."""
OVERSHOOT: Final = 1.1
"""Of the work that is allowed, at most."""
SAME: Final = 1e-9
"""Share by which equal errors differ for rounding."""


class Row(NamedTuple):
    """What came of a case; errors in m, CPU seconds, and the share of the work that was allowed."""

    case: Case
    verdict: str
    effects: tuple[str, ...]
    train: tuple[float, float]
    holdout: tuple[float, float]
    seconds: float
    spent: float
    untried: int

    def faults(self) -> list[str]:
        """What must not be, in words."""
        found = []
        for name, (before, after) in (("fitted", self.train), ("held-out", self.holdout)):
            if after > before * (1.0 + SAME) or math.isnan(after) != math.isnan(before):
                found.append(f"worse on {name} data")
        if self.spent > OVERSHOOT:
            found.append("beyond its budget")
        if self.verdict not in self.case.allowed:
            found.append(f"expected {' or '.join(self.case.allowed)}")
        return found


def examine(case: Case, seconds: float) -> Row:
    """Record and diagnose one case with the work that so many seconds stand for."""
    traces = case.make(case.seed)
    begun = time.process_time()
    found = diagnose(traces, [], case.declared, budget=Budget.of_seconds(seconds))
    before, after = found.before, found.after
    return Row(
        case,
        found.verdict.kind,
        found.verdict.effects,
        (before.train_rmse, after.train_rmse),
        (before.holdout_rmse, after.holdout_rmse),
        time.process_time() - begun,
        found.work / found.allowed,
        len(found.untried),
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 if anything is at fault."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hard_recordings",
        description=words,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--budget", type=float, default=BUDGET, help=f"as of valve-sim diagnose (default: {BUDGET:g})")
    parser.add_argument("--only", default="", help="kinds that contain this")
    parser.add_argument("--slice", action="store_true", help="the first of each kind")
    options = parser.parse_args(arguments)
    chosen = [case for case in cases() if options.only in case.kind and (case.seed == 1 or not options.slice)]
    print(f"{'recording':<38}{'verdict':<46}{'fitted, µm':>22}{'held out, µm':>22}{'CPU s':>7}{'work':>7}")
    bad = 0
    for row in (examine(case, options.budget) for case in chosen):
        faults = row.faults()
        bad += bool(faults)
        print(_line(row, faults), flush=True)
    print(f"{len(chosen)} recordings, {bad} at fault; budget {options.budget:g} s each")
    return 1 if bad else 0


def _line(row: Row, faults: Sequence[str]) -> str:
    words = f"{row.verdict} {' + '.join(row.effects)}" + (f" ({row.untried} untried)" if row.untried else "")
    errors = [f"{1e6 * before:.4g} → {1e6 * after:.4g}" for before, after in (row.train, row.holdout)]
    end = "  FAULT: " + ", ".join(faults) if faults else ""
    spent = f"{row.seconds:>7.1f}{row.spent:>7.0%}"
    return f"{f'{row.case.kind} {row.case.seed}':<38}{words:<46}{errors[0]:>22}{errors[1]:>22}{spent}{end}"


if __name__ == "__main__":
    sys.exit(main())
