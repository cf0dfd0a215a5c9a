"""What all benchmarks do alike: options, work in several processes, tables, and figures that may fall short."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

Item = TypeVar("Item")
Result = TypeVar("Result")


def parser(name: str, words: str | None) -> argparse.ArgumentParser:
    """The options of `python -m benchmarks.NAME`, whose help begins with these words, line by line."""
    return argparse.ArgumentParser(
        prog=f"python -m benchmarks.{name}", description=words, formatter_class=argparse.RawDescriptionHelpFormatter
    )


def add_seeds(options: argparse.ArgumentParser, seeds: int = 10, first: int = 0) -> None:
    """Options --seeds and --first: how many, and from which on."""
    options.add_argument("--seeds", type=at_least_one, default=seeds, help=f"how many (default: {seeds})")
    options.add_argument("--first", type=int, default=first, help=f"the first seed (default: {first})")


def add_jobs(options: argparse.ArgumentParser) -> None:
    """Option --jobs: in how many processes."""
    options.add_argument("--jobs", type=at_least_one, default=2, help="processes (default: 2)")


def at_least_one(text: str) -> int:
    """A whole number of an option.

    Raises:
        ArgumentTypeError: it is less than 1, or no number.
    """
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: expected at least 1")
    return int(text)


def in_processes(
    work: Callable[[Item], Result], items: Sequence[Item], jobs: int
) -> Iterator[tuple[Item, Future[Result]]]:
    """Each item with what a picklable function made of it, as they end, in so many processes.

    A terminal shows a bar meanwhile. A future holds what was raised.
    """
    console = Console(stderr=True)
    bar = Progress(
        BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(), TextColumn("{task.description}"),
        console=console, transient=True, disable=not console.is_terminal,
    )  # fmt: skip
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool, bar:
        task = bar.add_task("", total=len(items))
        futures = {pool.submit(work, item): place for place, item in enumerate(items)}
        for future in as_completed(futures):
            item = items[futures[future]]
            bar.update(task, advance=1, description=f"{item}")
            yield item, future


def mapped(work: Callable[[int], Any], options: argparse.Namespace) -> list[Any]:
    """What a picklable function makes of each seed of --first and --seeds, in their order, in --jobs processes."""
    seeds = range(options.first, options.first + options.seeds)
    found = {seed: future.result() for seed, future in in_processes(work, seeds, options.jobs)}
    return [found[seed] for seed in seeds]


def resident(process: int | str = "self") -> float:
    """Memory that a process holds now, MB; without its number, this one's."""
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def say(is_good: bool, words: str) -> bool:
    """Print a line that says whether a figure is as wanted; returns it."""
    print(f"{'ok   ' if is_good else 'SHORT'} {words}", flush=True)
    return is_good


def show(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of so many columns."""
    table = Table(*headings, title=title)
    for row in rows:
        table.add_row(*row)
    Console(width=150).print(table)


class Column(NamedTuple):
    """A column of a table in plain text: its heading and width, and what a row's members come to."""

    heading: str
    width: int
    cell: Callable[[Sequence[Any]], str]


def in_columns(first: str, width: int, columns: Sequence[Column], rows: dict[str, Sequence[Any]]) -> str:
    """A table in plain text of named rows, the names in a first column of so many characters."""
    lines = [f"{first:<{width}}" + "".join(f"{column.heading:>{column.width}}" for column in columns)]
    for name, members in rows.items():
        cells = (f"{column.cell(members):>{column.width}}" for column in columns)
        lines.append(f"{name:<{width}}{''.join(cells)}".rstrip())
    return "\n".join(lines)
