"""What commands print: reports, progress, provenance, refusals."""

from __future__ import annotations

import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NoReturn

import click

from valve_sim.files.json_text import json_text

Progress = Callable[[str, float], None]


LINE_EVERY: Final = 10.0
"""s between two lines of progress where stderr is no terminal."""


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A bar on stderr while that is a terminal; a line every ten seconds elsewhere."""
    if not sys.stderr.isatty():
        with _progress_lines() as lines:
            yield lines
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=1.0)
        yield lambda what, fraction: bar.update(task, description=what, completed=fraction)


@contextmanager
def _progress_lines() -> Iterator[Progress]:
    latest, begun, has_ended = ("starting", 0.0), time.monotonic(), threading.Event()

    def note(what: str, fraction: float) -> None:
        nonlocal latest
        latest = (what, fraction)

    def write() -> None:
        while not has_ended.wait(LINE_EVERY):
            what, fraction = latest
            click.echo(f"valve-sim: {time.monotonic() - begun:.0f} s, {100.0 * fraction:.0f} % done: {what}", err=True)

    thread = threading.Thread(target=write, daemon=True)
    thread.start()
    try:
        yield note
    finally:
        has_ended.set()
        thread.join()


def print_report(report: Mapping[str, Any], text: str, written: Sequence[Path], as_json: bool) -> None:
    """Print a report, and which files it was written to."""
    if as_json:
        print_json(report)
        return
    click.echo(shown(text))
    if written:
        click.echo(shown(f"wrote {', '.join(str(path) for path in written)}"))


def provenance(params: Path | None, lines: Sequence[str]) -> str:
    """Comments for a written parameter file: the command, and where its values are from."""
    command = shlex.join(["valve-sim", *sys.argv[1:]])
    return "\n".join(
        [f"Written by: {command}", f"From: {params or 'the shipped valve.yaml'}, changed as follows", *lines]
    )


def print_json(report: Mapping[str, Any]) -> None:
    """Print a report as JSON."""
    click.echo(json_text(report), nl=False)


def refuse(message: str) -> NoReturn:
    """End the command because its input cannot be used.

    Raises:
        ValveError: always.
    """
    from valve_sim.model.errors import ValveError

    raise ValveError(message)


def one_line(message: str) -> str:
    """A message without line breaks, safe for a terminal."""
    return shown(" ".join(message.split()))


def shown(text: str) -> str:
    """Text that is safe for a terminal and XML: control characters, which names in bags may have, are replaced."""
    return "".join(character if character.isprintable() or character == "\n" else "\ufffd" for character in text)
