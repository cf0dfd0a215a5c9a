"""A whole run: list, look, plan, examine, write; and what it would do, without doing it."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim.files.whole_files import write_whole
from valve_sim.fleet.cluster import run_batches
from valve_sim.fleet.columns import columns
from valve_sim.fleet.page import write_page
from valve_sim.fleet.results import Results
from valve_sim.fleet.sources import Bag, find_bags
from valve_sim.fleet.units import (
    EXAMINED,
    LOST,
    Options,
    ParameterChoice,
    Plan,
    Row,
    Survey,
    Unit,
    plan,
    remembered,
)
from valve_sim.fleet.work import REPORTS, Examined, Surveyed, examine_units, survey_bags

Progress = Callable[[str, float], None]
Connect = Callable[[], Any]
"""Gives a client of Dask, or None for work in this process."""

SURVEYED: Final = 0.1
"""Share of the progress that is shown for a first look at all bags."""
PAGE: Final = "fleet.html"
GIGA: Final = 1e9
_UNKNOWN: Final[Row] = {column.name: None for column in columns()}


class Outcome(NamedTuple):
    """What a run did.

    Attributes:
        rows: of the table. done: how many of them this run made. files: table and page.
        drifting: the valves that drift, in words, the surest first.
    """

    rows: list[Row]
    done: int
    files: tuple[Path, ...]
    drifting: list[str]

    @property
    def states(self) -> Counter[str]:
        """Rows of each state."""
        return Counter(row["state"] for row in self.rows)

    @property
    def verdicts(self) -> Counter[str]:
        """Examined valves of each verdict."""
        return Counter(row["verdict"] for row in self.rows if row["state"] == EXAMINED)


def examine_fleet(
    sources: Sequence[str],
    output: Path,
    client: Any = None,
    parameters: ParameterChoice | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Examine every valve of every bag, as far as that is not done yet.

    Args:
        sources: bags, folders, globs, URLs.
        output: the folder of table, page and reports.
        client: of Dask, on any cluster whose workers can read the sources; None: in this process.
        parameters: the declared valves; default the shipped one.
        options: see `Options`.
        progress: told what is being done, and the fraction done.

    Raises:
        ValveError: a source, a parameter file or the output cannot be used, or the cluster was lost. What was done
            until then is written.
    """
    return examine_with(lambda: client, sources, output, parameters, options, progress)


def examine_with(
    connect: Connect,
    sources: Sequence[str],
    output: Path,
    parameters: ParameterChoice | None = None,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Examine bags as `examine_fleet` does, with a client that is made only when there is work."""
    parameters, options = parameters or ParameterChoice(), options or Options()
    say = progress or (lambda what, fraction: None)
    parameters.check()
    results = Results(output)
    with results.locked():
        say("listing bags", 0.0)
        bags = find_bags(sources)
        known = results.rows()
        found = plan(_surveys(connect, bags, known, options, say), parameters, options, known)
        results.add(found.rows)
        made = _examine(connect, found, results, say)
        kept = _elsewhere(known, {bag.source for bag in bags}, [*found.rows, *found.kept, *made])
        rows = [{**_UNKNOWN, **row} for row in (*kept, *found.kept, *found.rows, *made)]
        say("writing", 1.0)
        results.compact(rows)
        page = output / PAGE
        drifting = write_page(rows, page)
    return Outcome(rows, len(found.rows) + len(made), (results.table, page), drifting)


def _surveys(
    connect: Connect, bags: Sequence[Bag], known: Iterable[Row], options: Options, say: Progress
) -> list[tuple[Bag, Survey]]:
    """What is in each bag: remembered, or looked at."""
    found = _without_a_look(bags, known, options)
    new = [bag for bag in bags if bag.source not in found]
    done = 0
    for batch in run_batches(connect, survey_bags, new, _seconds):
        for bag, answer in _answered(batch.items, batch.answers):
            lost = Survey("", (), f"{bag.source}: {batch.failure}", is_lost=True)
            found[bag.source] = lost if answer is None else answer.survey
        done += len(batch.items)
        say(f"bags looked at: {done} of {len(new)}", SURVEYED * done / len(new))
    return [(bag, found[bag.source]) for bag in bags]


def _without_a_look(bags: Sequence[Bag], known: Iterable[Row], options: Options) -> dict[str, Survey]:
    """What is known of bags that need not be opened, by their sources: they are too large, or in the table."""
    by_source: dict[str, list[Row]] = {}
    for row in known:
        by_source.setdefault(row["source"], []).append(row)
    surveys = {bag.source: _too_large(bag, options) or remembered(bag, by_source.get(bag.source, [])) for bag in bags}
    return {source: survey for source, survey in surveys.items() if survey is not None}


def _too_large(bag: Bag, options: Options) -> Survey | None:
    if bag.size <= options.largest:
        return None
    words = f"{bag.size / GIGA:.3g} GB are more than the {options.largest / GIGA:.3g} GB of --largest-bag"
    return Survey("", (), f"{bag.source}: {words}; cut it, or allow more")


def _seconds(answer: Surveyed | Examined) -> float:
    return answer.seconds


def _answered(items: Sequence[Any], answers: Sequence[Any]) -> list[tuple[Any, Any]]:
    """Each item with its answer, or with None where its process ended."""
    return list(zip(items, answers or [None] * len(items), strict=True))


def _examine(connect: Connect, found: Plan, results: Results, say: Progress) -> list[Row]:
    """Examine units, and write what is found as it comes."""
    rows: list[Row] = []
    count = len(found.units)
    for batch in run_batches(connect, partial(examine_units, output=results.folder), found.units, _seconds):
        new = []
        for unit, answer in _answered(batch.items, batch.answers):
            new.append(unit.row(LOST, error=f"{unit.bag.source}: {batch.failure}") if answer is None else answer.row)
            if answer is not None:
                _write_report(results.folder, answer)
        results.add(new)
        rows += new
        say(f"valves examined: {len(rows)} of {count}", SURVEYED + (1.0 - SURVEYED) * len(rows) / count)
    return rows


def _write_report(folder: Path, answer: Examined) -> None:
    for name, text in answer.report.items():
        write_whole(folder / REPORTS / Path(answer.row["report"]).parent.name / name, text)


def _elsewhere(known: Iterable[Row], listed: set[str], current: Iterable[Row]) -> list[Row]:
    """Rows of bags that this run was not asked about, and that have not been moved to where it was."""
    keys = {row["key"] for row in current}
    return [row for row in known if row["source"] not in listed and row["key"] not in keys]


class Forecast(NamedTuple):
    """What a run would do.

    Attributes:
        bags: that were found. size: their bytes. new: bags that nothing is known of. units: valves to examine, as far
            as they are known; of new bags as many as the others have on average. seconds: a unit's mean time; nan where
            none was ever examined with this output.
    """

    bags: int
    size: int
    new: int
    units: int
    seconds: float


def forecast(
    sources: Sequence[str], output: Path, parameters: ParameterChoice | None = None, options: Options | None = None
) -> Forecast:
    """What `examine_fleet` would do: bags are listed and not opened.

    Raises:
        ValveError: a source or a parameter file cannot be used.
    """
    parameters, options = parameters or ParameterChoice(), options or Options()
    parameters.check()
    bags, known = find_bags(sources), Results(output).rows()
    remembered_of = _without_a_look(bags, known, options)
    surveys = [(bag, remembered_of[bag.source]) for bag in bags if bag.source in remembered_of]
    new = len(bags) - len(surveys)
    valves = statistics.fmean([len(survey.valves) for _, survey in surveys if survey.valves] or [1])
    seconds = [row["seconds"] for row in known if row["state"] == EXAMINED and row["seconds"] is not None]
    units: list[Unit] = plan(surveys, parameters, options, known).units
    return Forecast(
        len(bags), sum(bag.size for bag in bags), new, len(units) + round(valves * new),
        statistics.fmean(seconds) if seconds else math.nan,
    )  # fmt: skip
