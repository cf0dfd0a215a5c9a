"""What all commands share: one line on stderr for each failure, and help that keeps the lines of its examples."""

from __future__ import annotations

import inspect
import itertools
import os
import sys
from pathlib import Path
from typing import Any, Final, NoReturn

import click

from valve_sim.cli.printing import one_line

UNUSABLE: Final = 2
STOPPED: Final = 130
"""Exit codes."""
WRITTEN: Final = ("output", "plot", "junit")
"""Options that name a file or a folder to write."""
COMPLETE_VAR: Final = "_VALVE_SIM_COMPLETE"
"""Environment variable by which a shell asks for completions. The shipped completion scripts use this name."""


class Command(click.Command):
    """A command whose help keeps the line breaks of its examples."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "help": _with_examples(settings.get("help"))})

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; refuse before any work what it could not write."""
        from valve_sim.files.whole_files import refuse_unwritable

        for name in WRITTEN:
            path = ctx.params.get(name)
            if isinstance(path, Path):
                refuse_unwritable(path / "any" if path.is_dir() else path)
        return super().invoke(ctx)


class CommandLine(click.Group):
    """A group whose every failure is one line on stderr."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "help": _with_examples(settings.get("help"))})

    def main(self, *arguments: Any, **settings: Any) -> Any:
        """Run the command line and exit."""
        settings = {"prog_name": "valve-sim", "complete_var": COMPLETE_VAR, **settings, "standalone_mode": False}
        try:
            code = super().main(*arguments, **settings)
            sys.stdout.flush()
        except click.ClickException as error:
            context = getattr(error, "ctx", None)
            hint = f" (see {context.command_path} --help)" if context else ""
            _end(f"{one_line(error.format_message()).removesuffix('.')}{hint}")
        except click.Abort:
            _end("stopped", STOPPED)
        except BrokenPipeError:
            # The reader of the output, such as head, has closed it; the flush at Python's exit must not complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(0)
        except Exception as error:
            from valve_sim.model.errors import ValveError

            if not isinstance(error, ValveError):
                raise
            _end(one_line(str(error)))
        sys.exit(code if isinstance(code, int) else 0)


def _with_examples(text: str | None) -> str | None:
    """Help whose prose click wraps to the terminal, and whose indented lines it leaves as they are."""
    if text is None:
        return None
    parts: list[str] = []
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        for is_example, lines in itertools.groupby(paragraph.splitlines(), key=lambda line: line.startswith("  ")):
            words = "\n".join(lines)
            parts.append(f"\b\n{words}" if is_example else words)
    return "\n\n".join(parts)


def _end(message: str, code: int = UNUSABLE) -> NoReturn:
    click.echo(f"valve-sim: {message}", err=True)
    sys.exit(code)
