"""`valve-sim fleet`."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from valve_sim.cli.cluster import chosen_cluster, cluster_options, refuse_without_fleet
from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, finite_number, json_option, params_option
from valve_sim.cli.printing import print_report, progress_bar, refuse
from valve_sim.files.json_text import finite_or_none

if TYPE_CHECKING:
    from valve_sim.fleet.run import Forecast, Outcome
    from valve_sim.fleet.units import Options, ParameterChoice


@click.command(cls=Command)
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True)
@params_option
@click.option(
    "--params-for",
    metavar="PATTERN=FILE",
    multiple=True,
    help="Parameter file of the valves whose names fit, e.g. `/tank_1/*=tank_1.yaml`. Repeatable; the first counts.",
)
@click.option("--output", metavar="DIR", type=FILE, default=Path("fleet"), help="Folder for table, page and reports.")
@cluster_options(
    "Dask scheduler, e.g. tcp://10.0.0.1:8786. Default: this machine.",
    "Processes on this machine. Default: one per processor.",
)
@click.option("--full", is_flag=True, help="Search for missing effects in every bag, also where nothing is left.")
@click.option("--no-search", is_flag=True, help="Refit and test alone: drifts are seen, effects are not named. Cheap.")
@click.option(
    "--budget",
    metavar="SECONDS",
    type=finite_number(1.0),
    default=120.0,
    help="Work for one valve of a bag: 4,000 simulated strokes for each second, on whatever machine.",
)
@click.option(
    "--largest-bag", metavar="GB", type=finite_number(0.0, is_open=True), default=4.0, help="Larger bags are not read."
)
@click.option("--archive", metavar="DIR", type=FILE, help="Archive of monitors that keeps each bag's result, too.")
@click.option("--dry-run", is_flag=True, help="Say what would be done, and how long it should take; open no bag.")
@json_option
def fleet(
    *,
    sources: tuple[str, ...],
    params: Path | None,
    params_for: tuple[str, ...],
    output: Path,
    full: bool,
    no_search: bool,
    budget: float,
    largest_bag: float,
    archive: Path | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    r"""Examine thousands of bags, and show which valve drifts.

    SOURCE is a bag, a folder that is searched for bags, a glob in quotes, or a URL such as s3://bucket/bags. Every
    valve of every bag is refitted within its tolerances; where that leaves a residual, the missing effect is searched
    for.
      valve-sim fleet bags --output results

    Writes DIR/fleet.parquet, one row for each bag and valve, DIR/fleet.html, and DIR/reports. The same command again
    does only what is missing: after a crash, for new bags, and for those whose parameter file has changed.

    From object storage, with a parameter file for one tank; on a cluster:
      valve-sim fleet s3://plant/2026 --output results \
          --params-for /tank_1/valve=tank_1.yaml
      valve-sim fleet bags --output results --scheduler tcp://10.0.0.1:8786

    Needs the extra fleet:
      pip install '.[fleet]'

    Read on: docs/how_to/fleet.md
    """
    refuse_without_fleet("fleet")
    cluster = chosen_cluster()
    if full and no_search:
        raise click.UsageError("--full searches in every bag, --no-search in none", click.get_current_context())
    from valve_sim.fleet.units import Options, ParameterChoice

    chosen = ParameterChoice(params, tuple(_pattern(text) for text in params_for))
    options = Options(full, budget, int(largest_bag * 1e9), not no_search)
    if dry_run:
        from valve_sim.fleet.run import forecast

        _print_forecast(forecast(sources, output, chosen, options), cluster[1] or os.cpu_count() or 1, as_json=as_json)
        return
    found = _examined(sources, output, cluster, chosen, options)
    kept = None
    if archive is not None:
        from valve_sim.fleet.archiving import archive_rows

        kept = f"{archive_rows(archive, found.rows)} results are new in {archive}"
    _print_outcome(found, kept, as_json=as_json)


def _examined(
    sources: tuple[str, ...],
    output: Path,
    cluster: tuple[str | None, int | None],
    chosen: ParameterChoice,
    options: Options,
) -> Outcome:
    from valve_sim.files.ledger import plan_files
    from valve_sim.fleet.cluster import Cluster
    from valve_sim.fleet.results import TABLE
    from valve_sim.fleet.run import PAGE, examine_with
    from valve_sim.warm import warm

    plan_files(output / TABLE, output / PAGE)
    with progress_bar() as progress, Cluster(*cluster, before=warm) as started:
        return examine_with(started.client, sources, output, chosen, options, progress)


def _pattern(text: str) -> tuple[str, Path]:
    pattern, equals, file = text.partition("=")
    if not (pattern and equals and file):
        refuse(f"--params-for {text!r}: expected a pattern of valves' names and a file, e.g. '/tank_1/*=tank_1.yaml'")
    return pattern, Path(file)


def _print_forecast(found: Forecast, workers: int, *, as_json: bool) -> None:
    lines = [f"{found.bags} bags, {found.size / 1e9:.3g} GB; {found.new} of them new"]
    first, total = f"would examine about {found.units} valves", found.units * found.seconds / workers
    if math.isnan(total):
        lines.append(f"{first}; how long one takes is not known before the first run")
    else:
        each = f"{found.seconds:.2g} s of a processor each, as earlier ones took"
        lines.append(f"{first}, {each}: {_duration(total)} on {workers} processor{'s' if workers > 1 else ''}")
    report = {**found._asdict(), "seconds": finite_or_none(found.seconds)}
    print_report(report, "\n".join(lines), (), as_json)


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def _print_outcome(found: Outcome, kept: str | None, *, as_json: bool) -> None:
    states, verdicts = found.states, found.verdicts
    listed = ", ".join(f"{count} {words}" for words, count in sorted(states.items()))
    lines = [f"{len(found.rows)} rows ({listed}), {found.done} of them new"]
    if verdicts:
        lines.append("verdicts: " + ", ".join(f"{count} {words}" for words, count in sorted(verdicts.items())))
    lines += [f"drifts: {valve}" for valve in found.drifting]
    lines += [kept] if kept else []
    report = {
        "rows": len(found.rows), "new": found.done, "states": states, "verdicts": verdicts, "drifting": found.drifting,
    }  # fmt: skip
    print_report(report, "\n".join(lines), found.files, as_json)
