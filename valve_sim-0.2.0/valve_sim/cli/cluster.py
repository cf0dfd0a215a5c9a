"""Options of commands that work on a cluster."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Final, TypeVar

import click

from valve_sim.cli.printing import refuse

NEEDED: Final = ("dask", "distributed", "fsspec", "pyarrow")
"""Packages of the extra `fleet`; s3fs is needed for S3 alone, and fsspec says so."""

CLUSTER_KEY: Final = "valve_sim.cluster"
"""Where click's context keeps what was given as --scheduler and --workers."""
Decorated = TypeVar("Decorated", bound=Callable[..., object])


def cluster_options(of_scheduler: str, of_workers: str) -> Callable[[Decorated], Decorated]:
    """--scheduler and --workers, with these helps; see `chosen_cluster`."""

    def kept(context: click.Context, option: click.Parameter, value: object) -> None:
        context.meta.setdefault(CLUSTER_KEY, {})[option.name] = value

    scheduler = click.option("--scheduler", metavar="ADDRESS", help=of_scheduler, expose_value=False, callback=kept)
    workers = click.option(
        "--workers", metavar="N", type=click.IntRange(min=1), help=of_workers, expose_value=False, callback=kept
    )
    return lambda command: scheduler(workers(command))


def chosen_cluster() -> tuple[str | None, int | None]:
    """The scheduler's address, and the number of processes; not both, for a scheduler has workers of its own."""
    context = click.get_current_context()
    found = context.meta[CLUSTER_KEY]
    if found["scheduler"] is not None and found["workers"] is not None:
        raise click.UsageError("--workers is for this machine; a --scheduler has its own", context)
    return found["scheduler"], found["workers"]


def refuse_without_fleet(command: str) -> None:
    """Say which packages of the extra are missing."""
    missing = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        refuse(f"{command} needs {', '.join(missing)}, which is not here; install the extra: pip install '.[fleet]'")
