"""What a diagnosis says of blind recordings: `python -m benchmarks.campaign` runs all, a slice for CI, or one case."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TextIO

from plants.laboratory import true_sizes
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from benchmarks.campaign import __doc__ as campaign_words
from benchmarks.campaign.cases import BENCHES, EXACT, FAMILIES, NOISES, RECORDED, WITHIN, draw_case, planned
from benchmarks.campaign.constants import constants_table
from benchmarks.campaign.effects import CATALOGUED, EARLIER_LIMITS
from benchmarks.campaign.figures import (
    confusion_table,
    family_table,
    figures,
    imperfection_table,
    least_demands,
    measured_table,
    reliability_table,
    tolerance_figures,
)
from benchmarks.campaign.limits import Knowledge, detection_limit
from benchmarks.campaign.running import Cost, Outcome, Timing, cost_of, examine, run_cases, time_cold, true_declared
from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.reporting.summary import summarise

TIMED: Final = [
    *(("single", seed) for seed in (0, 5, 11, 12, 17)),
    *(("pair", seed) for seed in (0, 1, 2)),
    *(("none", seed) for seed in (0, 1, 2)),
]
"""Cases that cold processes diagnose, one at a time."""
COMPARED: Final = [("none_within", 0), ("none_within", 1), *(("single_within", seed) for seed in (0, 5, 11, 12, 17))]
"""Cases that are diagnosed with and without tolerances, one at a time."""
MEASURED_APART: Final = ("time", "cost")
DRAWN_BY_LIMITS: Final = {"single", "pair", "mismatched", "opening", "at_limits", "unnamed_beside"}
DRAWN_WITHIN: Final = {
    "single_within",
    "folder",
    "mismatched_within",
    "reluctance",
    "at_limits_within",
    "beside",
    "low_rate",
}
"""Families whose amplitudes are in detection limits: of exact values, and of those with tolerances."""
SHOWN_CANDIDATES: Final = 8


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is asked for; 1 if a figure falls short."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if options.case is not None:
        return _run_again(parser, options.case)
    usual = (*WITHIN, "uncatalogued", "cost") if options.tolerances else (*EXACT, "time")
    families = tuple(name.strip() for name in options.only.split(",")) if options.only else usual
    if unknown := [name for name in families if name not in (*FAMILIES, *MEASURED_APART)]:
        parser.error(f"--only {unknown[0]}: expected some of {', '.join((*FAMILIES, *MEASURED_APART))}")
    for name in ("seeds", "jobs"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} {getattr(options, name)}: expected at least 1")
    if options.first < 0:
        parser.error(f"--first {options.first}: expected at least 0")
    if options.json is not None and not options.json.parent.is_dir():
        parser.error(f"--json {options.json}: expected a file in a folder that exists")
    if options.pool:
        pooled = [outcome for path in options.pool for outcome in _read(path)]
        _print_tables(pooled, has_limits=False)
        print(constants_table(pooled))
        return 0
    started = time.perf_counter()
    outcomes, timings, costs = _measure(options, families)
    _print_tables(outcomes, has_limits=not options.slice)
    shown = tolerance_figures(outcomes, costs) if options.tolerances else figures(outcomes, timings)
    print("\n".join(figure.line(is_judged=not options.slice) for figure in shown))
    judged = shown
    if options.slice:
        judged = least_demands(outcomes)
        print("\nof a slice it is asked that:", *(figure.line() for figure in judged), sep="\n")
    short = [figure for figure in judged if figure.is_short]
    print(
        f"\n{len(outcomes)} cases, {len(timings)} cold processes, {len(costs)} costs, "
        f"{time.perf_counter() - started:.0f} s; "
        f"{len(short)} of {len(judged)} figures fall short"
    )
    return 1 if short else 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.campaign", description=campaign_words, formatter_class=argparse.RawTextHelpFormatter
    )
    rounds = ", ".join(f"{family.per_round} {name}" for name, family in FAMILIES.items())
    parser.add_argument("--seeds", type=int, default=10, help=f"rounds (default: 10); in each {rounds}")
    parser.add_argument(
        "--first", type=int, default=0, help="the first round (default: 0); others than were run before"
    )
    known = ", ".join((*FAMILIES, *MEASURED_APART))
    parser.add_argument(
        "--only",
        help=f"families, with commas: {known}\n"
        f"(default: those with tolerances, or all others; never {', '.join((*RECORDED, *BENCHES))})",
    )
    parser.add_argument(
        "--tolerances", action="store_true", help="declared values off within their tolerances, and the figures of that"
    )
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: 2)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every case as it ends, one line of JSON each")
    parser.add_argument("--pool", type=Path, nargs="+", metavar="FILE", help="run nothing: the tables of such lines")
    parser.add_argument("--slice", action="store_true", help="a few cases of every family, judged by the least demands")
    parser.add_argument("--case", metavar="FAMILY:SEED", help="diagnose one case again and print what was tried")
    return parser


def _measure(options: argparse.Namespace, families: tuple[str, ...]) -> tuple[list[Outcome], list[Timing], list[Cost]]:
    """Run the pool, then the cold processes, then what tolerances cost; outcomes in the order of the plan."""
    plan = planned(range(options.first, options.first + options.seeds), families, is_slice=options.slice)
    timed = TIMED if "time" in families and not options.slice else []
    compared = COMPARED if "cost" in families and not options.slice else []
    outcomes: list[Outcome] = []
    timings: list[Timing] = []
    costs: list[Cost] = []
    with _lines(options.json) as lines, _progress() as progress:
        task = progress.add_task("cases", total=len(plan) + len(timed) + len(compared))
        for outcome in run_cases(plan, options.jobs):
            outcomes.append(outcome)
            _write(lines, outcome.to_json())
            progress.update(task, advance=1, description=f"{outcome.case.name} {outcome.label}")
        for family, seed in timed:
            timings.append(time_cold(family, seed))
            _write(lines, timings[-1].to_json())
            progress.update(task, advance=1, description=f"cold process, {family}")
        for family, seed in compared:
            costs.append(cost_of(family, seed))
            _write(lines, costs[-1].to_json())
            progress.update(task, advance=1, description=f"cost, {family}")
    order = {case: place for place, case in enumerate(plan)}
    return sorted(outcomes, key=lambda outcome: order[outcome.case.family, outcome.case.seed]), timings, costs


@contextmanager
def _lines(path: Path | None) -> Iterator[TextIO | None]:
    if path is None:
        yield None
        return
    with path.open("w", encoding="utf-8") as lines:
        yield lines


def _write(lines: TextIO | None, document: object) -> None:
    """One line, at once: what was measured before an interruption is kept."""
    if lines is not None:
        lines.write(json.dumps(document, ensure_ascii=False, allow_nan=False) + "\n")
        lines.flush()


def _read(path: Path) -> list[Outcome]:
    """The cases among a campaign's lines."""
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Outcome.from_json(row) for row in rows if "case" in row]


def _progress() -> Progress:
    """A bar on a terminal, nothing elsewhere."""
    console = Console(stderr=True)
    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(
        *columns, TextColumn("{task.description}"), console=console, transient=True, disable=not console.is_terminal
    )


def _print_tables(outcomes: Sequence[Outcome], *, has_limits: bool) -> None:
    families = {outcome.case.family for outcome in outcomes}
    if has_limits and families & DRAWN_BY_LIMITS:
        print(_limits_table(), end="\n\n")
    if has_limits and families & DRAWN_WITHIN:
        print(_limits_within_table(), end="\n\n")
    if outcomes:
        print(confusion_table(outcomes), end="\n\n")
        print(family_table(outcomes), end="\n\n")
        print(reliability_table(outcomes), end="\n\n")
    if any(outcome.case.laboratory for outcome in outcomes):
        print(imperfection_table(outcomes), end="\n\n")
    if measured := measured_table([one for one in outcomes if one.case.family in {"mistake", *BENCHES}]):
        print(measured, end="\n\n")


def _limits_table() -> str:
    """Detection limits in white noise that amplitudes are drawn by, for shapes in the middle of their ranges."""
    lines = [f"{'detection limit, as a size':<28}{'here':>12}{'earlier':>12}"]
    for name, scale in CATALOGUED.items():
        known = f"{EARLIER_LIMITS[name]:>12.3g}" if name in EARLIER_LIMITS else f"{'–':>12}"
        lines.append(f"{name:<28}{detection_limit(name, scale.middle(), NOISES['white']):>12.3g}{known}")
    return "\n".join(lines)


def _limits_within_table() -> str:
    """Detection limits of the valve with a data sheet: declared exactly, and within its tolerances."""
    lines = [f"{'detection limit, as a size':<28}{'exact':>12}{'within':>12}{'ratio':>8}"]
    for name, scale in CATALOGUED.items():
        exact, within = (
            detection_limit(name, scale.middle(), NOISES["white"], knowledge)
            for knowledge in (Knowledge.SHEET, Knowledge.WITHIN)
        )
        lines.append(f"{name:<28}{exact:>12.3g}{within:>12.3g}{within / exact:>8.1f}")
    return "\n".join(lines)


def _run_again(parser: argparse.ArgumentParser, name: str) -> int:
    """Diagnose one case and print all that helps to see why."""
    family, colon, seed = name.partition(":")
    if family not in FAMILIES or not colon or not seed.isdecimal():
        parser.error(f"--case {name}: expected FAMILY:SEED with one of {', '.join(FAMILIES)}")
    case = draw_case(family, int(seed))
    print(f"truth      {case.truth or 'none'}")
    units = "of what is declared" if case.family == "exact_wrong" else "detection limits (µm RMS where uncatalogued)"
    print(f"amplitude  {case.amplitudes} {units}")
    print(f"dampings   {case.dampings}")
    if case.deviations:
        print(
            f"deviations {', '.join(f'{name} {value:+.1f}' for name, value in case.deviations.items())}, in tolerances"
        )
    if (bench := case.bench) is not None:
        print(f"bench      {bench.words}")
    print(
        f"recorded   {case.noise}, {'with' if case.with_current else 'without'} current, clocks {case.clock_offsets} s"
    )
    if case.laboratory:
        sizes = {name: size for name, size in true_sizes(case.laboratory_of(0)).items() if size}
        print(f"laboratory {case.laboratory}, errors that have a size {sizes or 'none'} (SI units)")
    outcome, diagnoses = examine(case)
    for diagnosis in diagnoses:
        print(f"\n{_diagnosis_text(diagnosis)}")
    covered = outcome.is_covered or {}
    for figure, value in outcome.measured.items():
        print(f"measured   {figure} {math.nan if value is None else value:.4g}")
    print(f"\nlabel      {outcome.label}, noise of the last bag {outcome.noise_floor:.4f} µm")
    print(f"covered    {covered}")
    for value, entry in outcome.answers[0].declared.items():
        true = math.nan if case.bench is not None else true_declared(case).get(value, math.nan)
        print(f"    {value:<28} true {true:.6g}, {', '.join(f'{key} {number:.6g}' for key, number in entry.items())}")
    print(f"seconds    {', '.join(f'{answer.seconds:.1f}' for answer in outcome.answers)}")
    return 0


def _diagnosis_text(diagnosis: Diagnosis) -> str:
    verdict = diagnosis.verdict
    lines = [
        f"verdict    {verdict.kind} {', '.join(verdict.effects)}, probability {verdict.probability:.4f}, unnamed "
        f"{verdict.unnamed:.4f}, {diagnosis.work:.0f} simulated strokes",
        f"confusable {dict(verdict.confusable_with)}",
        f"summary    {summarise(diagnosis)}",
    ]
    for words, state in (("before", diagnosis.before), ("after", diagnosis.after)):
        lines.append(
            f"{words:<10} train {1e6 * state.train_rmse:.4f} µm, holdout {1e6 * state.holdout_rmse:.4f} µm "
            f"({1e6 * state.holdout_predicted:.4f} predicted), "
            f"adequacy p {state.adequacy.p_value:.2g} ({state.adequacy.worst})"
        )
    for parameter, interval in diagnosis.after.intervals.items():
        lines.append(f"    {parameter:<40} {interval.value:.6g} [{interval.low:.6g}, {interval.high:.6g}]")
    lines.append("probability   unnamed   ΔBIC         train, µm   holdout, µm")
    for candidate in diagnosis.candidates[:SHOWN_CANDIDATES]:
        timing = " with errors of the stamps" if candidate.timing else ""
        lines.append(
            f"{candidate.probability:<14.3g}{candidate.unnamed:<10.3g}{candidate.delta_bic:<13.1f}"
            f"{1e6 * candidate.train_rmse:<12.4f}{1e6 * candidate.holdout_rmse:<12.4f}"
            f"{' + '.join(candidate.effects)}{timing}"
        )
    if diagnosis.unexplained is not None:
        lines.append(f"remainder  {diagnosis.unexplained.where}, {diagnosis.unexplained.force_rms:.3g} N RMS")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
