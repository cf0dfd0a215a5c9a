"""`valve-sim fleet`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from valve_sim.cli.command_line import Command
from valve_sim.cli.options import FILE, finite_number, json_option, params_option
from valve_sim.cli.printing import print_report, progress_bar, refuse

if TYPE_CHECKING:
    from valve_sim.fleet.run import Outcome

NEEDED: Final = ("dask", "distributed", "fsspec", "pyarrow")
"""Packages of the extra `fleet`; s3fs is needed for S3 alone, and fsspec says so."""


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
@click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler, e.g. tcp://10.0.0.1:8786. Default: this machine.")
@click.option(
    "--workers",
    metavar="N",
    type=click.IntRange(min=1),
    help="Processes on this machine. Default: one per processor.",
)
@click.option("--full", is_flag=True, help="Search for missing effects in every bag, even if no residual is left.")
@click.option("--no-search", is_flag=True, help="Only refit and test: finds drifts, but names no effects. Fast.")
@click.option(
    "--budget",
    metavar="SECONDS",
    type=finite_number(1.0),
    default=120.0,
    help="Work for one valve of a bag: 4,000 simulated strokes for each second, on any machine.",
)
@click.option(
    "--largest-bag", metavar="GB", type=finite_number(0.0, is_open=True), default=4.0, help="Larger bags are not read."
)
@click.option("--dry-run", is_flag=True, help="Count the bags and those that are new; open none.")
@json_option
def fleet(
    *,
    sources: tuple[str, ...],
    params: Path | None,
    params_for: tuple[str, ...],
    output: Path,
    scheduler: str | None,
    workers: int | None,
    full: bool,
    no_search: bool,
    budget: float,
    largest_bag: float,
    dry_run: bool,
    as_json: bool,
) -> None:
    r"""Examine thousands of bags, and show which valve drifts.

    SOURCE is a bag, a folder that is searched for bags, a glob in quotes, or a URL such as s3://bucket/bags. Every
    valve of every bag is refitted within its tolerances. If that leaves a residual, a search looks for the missing
    effect.
      valve-sim fleet bags --output results

    Writes DIR/fleet.parquet, one row for each bag and valve, DIR/fleet.html, and DIR/reports. If you repeat the
    command, it does only what is missing: after a crash, for new bags, and for those whose parameter file has changed.

    From object storage, with a parameter file for one tank; on a cluster:
      valve-sim fleet s3://plant/2026 --output results \
          --params-for /tank_1/valve=tank_1.yaml
      valve-sim fleet bags --output results --scheduler tcp://10.0.0.1:8786

    Needs the extra fleet:
      pip install '.[fleet]'

    Read on: docs/how_to/fleet.md
    """
    if missing := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
        refuse(f"fleet needs {', '.join(missing)}, which is not here; install the extra: pip install '.[fleet]'")
    if scheduler is not None and workers is not None:
        raise click.UsageError("--workers is for this machine; a --scheduler has its own", click.get_current_context())
    if full and no_search:
        raise click.UsageError("--full searches in every bag, --no-search in none", click.get_current_context())
    from valve_sim.fleet.run import dask_client, examine_fleet, new_bags
    from valve_sim.fleet.units import Options, ParameterChoice

    chosen = ParameterChoice(params, tuple(_pattern(text) for text in params_for))
    options = Options(full, budget, int(largest_bag * 1e9), not no_search)
    if dry_run:
        chosen.check()
        bags, new = new_bags(sources, output, options)
        report = {"bags": len(bags), "size": sum(bag.size for bag in bags), "new": len(new)}
        print_report(report, f"{len(bags)} bags, {report['size'] / 1e9:.3g} GB; {len(new)} of them new", (), as_json)
        return
    with progress_bar() as progress, dask_client(scheduler, workers) as client:
        outcome = examine_fleet(sources, output, client, chosen, options, progress)
    _print_outcome(outcome, as_json=as_json)


def _pattern(text: str) -> tuple[str, Path]:
    pattern, equals, file = text.partition("=")
    if not (pattern and equals and file):
        refuse(f"--params-for {text!r}: expected a pattern of valves' names and a file, e.g. '/tank_1/*=tank_1.yaml'")
    return pattern, Path(file)


def _print_outcome(outcome: Outcome, *, as_json: bool) -> None:
    states, verdicts = outcome.states, outcome.verdicts
    listed = ", ".join(f"{count} {words}" for words, count in sorted(states.items()))
    lines = [f"{len(outcome.rows)} rows ({listed}), {outcome.done} of them new"]
    if verdicts:
        lines.append("verdicts: " + ", ".join(f"{count} {words}" for words, count in sorted(verdicts.items())))
    lines += [f"drifts: {valve}" for valve in outcome.drifting]
    report = {
        "rows": len(outcome.rows), "new": outcome.done, "states": states, "verdicts": verdicts,
        "drifting": outcome.drifting,
    }  # fmt: skip
    print_report(report, "\n".join(lines), outcome.files, as_json)
