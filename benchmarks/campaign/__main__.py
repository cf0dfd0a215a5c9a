"""What a diagnosis says of blind recordings: `python -m benchmarks.campaign` runs all, a slice for CI, or one case."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.campaign import __doc__ as campaign_words
from benchmarks.campaign.cases import BENCHES, EXACT, FAMILIES, RECORDED, WITHIN, draw_case, planned
from benchmarks.campaign.constants import constants_table
from benchmarks.campaign.running import Outcome, examine, run_cases, true_declared
from benchmarks.campaign.tables import DEMANDS, OF_A_SLICE, tables
from benchmarks.common import add_jobs, add_seeds, parser
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for; 1 if a figure falls short."""
    known = _parser()
    options = known.parse_args(arguments)
    if options.case is not None:
        return _run_again(known, options.case)
    if options.pool:
        pooled = [outcome for path in options.pool for outcome in _read(path)]
        print(tables(pooled), constants_table(pooled), sep="\n\n")
        return 0
    families = [name.strip() for name in options.only.split(",")]
    if unknown := [name for name in families if name not in FAMILIES]:
        known.error(f"--only {unknown[0]}: expected some of {', '.join(FAMILIES)}")
    if options.first < 0:
        known.error(f"--first {options.first}: expected at least 0")
    if options.json is not None and not options.json.parent.is_dir():
        known.error(f"--json {options.json}: expected a file in a folder that exists")
    started = time.perf_counter()
    plan = planned(range(options.first, options.first + options.seeds), families, is_slice=options.slice)
    outcomes = _measured(plan, options)
    print(tables(outcomes), end="\n\n")
    lines = [demand.line(outcomes, is_judged=not options.slice) for demand in DEMANDS]
    print("\n".join(filter(None, lines)))
    judged = DEMANDS
    if options.slice:
        judged = OF_A_SLICE
        print("\nof a slice it is asked that:", *(one.line(outcomes, is_judged=True) for one in judged), sep="\n")
    short = sum(one.is_short(outcomes) for one in judged)
    print(f"\n{len(outcomes)} cases, {time.perf_counter() - started:.0f} s; {short} figures fall short")
    return 1 if short else 0


def _parser() -> argparse.ArgumentParser:
    options = parser("campaign", campaign_words)
    add_seeds(options)
    add_jobs(options)
    options.epilog = "cases of each of the seeds: " + ", ".join(
        f"{family.per_round} {name}" for name, family in FAMILIES.items()
    )
    asked = ", ".join((*WITHIN, *RECORDED, *BENCHES))
    words = f"families, with commas (default: {', '.join(EXACT)}; where they are asked for: {asked})"
    options.add_argument("--only", default=",".join(EXACT), help=words)
    options.add_argument("--json", type=Path, metavar="FILE", help="write every case as it ends, one line of JSON each")
    options.add_argument("--pool", type=Path, nargs="+", metavar="FILE", help="run nothing: the tables of such lines")
    options.add_argument("--slice", action="store_true", help="a few cases of every family, by the least demands")
    options.add_argument("--case", metavar="FAMILY:SEED", help="diagnose one case again and print what was tried")
    return options


def _measured(plan: Sequence[tuple[str, int]], options: argparse.Namespace) -> list[Outcome]:
    """Outcomes in the order of the plan; each is written at once, so that an interruption loses none."""
    outcomes = {}
    with (options.json or Path("/dev/null")).open("w", encoding="utf-8") as lines:
        for outcome in run_cases(plan, options.jobs):
            outcomes[outcome.case.family, outcome.case.seed] = outcome
            lines.write(json.dumps(outcome.to_json(), ensure_ascii=False, allow_nan=False) + "\n")
            lines.flush()
    return [outcomes[case] for case in plan]


def _read(path: Path) -> list[Outcome]:
    """The cases among a campaign's lines."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Outcome.from_json(row) for row in rows if "case" in row]


def _run_again(known: argparse.ArgumentParser, name: str) -> int:
    """Diagnose one case and print all that helps to see why."""
    family, colon, seed = name.partition(":")
    if family not in FAMILIES or not colon or not seed.isdecimal():
        known.error(f"--case {name}: expected FAMILY:SEED with one of {', '.join(FAMILIES)}")
    case = draw_case(family, int(seed))
    bench = case.bench
    outcome, diagnoses = examine(case)
    document = outcome.to_json()
    for key, value in {"bench": bench and bench.words, **document["case"]}.items():
        print(f"{key:<15} {value}")
    for diagnosis in diagnoses:
        print("", diagnosis_document(diagnosis).to_text(), "probability   unnamed   ΔBIC", sep="\n")
        for one in diagnosis.candidates[:8]:
            print(f"{one.probability:<14.3g}{one.unnamed:<10.3g}{one.delta_bic:<13.1f}{' + '.join(one.effects)}")
    for key in ("label", "noise_floor", "is_covered", "advice", "measured"):
        print(f"{key:<15} {document[key]}")
    true = {} if bench is not None else true_declared(case)
    for value, entry in outcome.answers[0].declared.items():
        print(f"    {value:<28} true {true.get(value, math.nan):.6g}, {entry}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
