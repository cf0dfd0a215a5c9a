"""How every command fails and helps: one line on stderr, and help with examples that work as they stand."""

from __future__ import annotations

import inspect
import os
import re
import sys
from typing import Any, Final, NoReturn

import click

from valve_sim.cli.printing import one_line
from valve_sim.files.ledger import keeping_ledger
from valve_sim.invocation import invocation

UNUSABLE: Final = 2
STOPPED: Final = 130
"""Exit codes."""
COMPLETE_VAR: Final = "_VALVE_SIM_COMPLETE"
"""What a shell sets to ask for completions; however the program is called, it is the same for the scripts that ship."""


class Command(click.Command):
    """A command whose help shows paragraphs with indented lines, its examples, as they stand."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "help": _with_examples(settings.get("help"))})

    def get_help(self, ctx: click.Context) -> str:
        """The help, with examples that work in this terminal as they stand."""
        return _as_typed(super().get_help(ctx))


class CommandLine(click.Group):
    """A group whose every failure is one line on stderr."""

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **{**settings, "help": _with_examples(settings.get("help"))})

    def get_help(self, ctx: click.Context) -> str:
        """The help, with examples that work in this terminal as they stand."""
        return _as_typed(super().get_help(ctx))

    def main(self, *arguments: Any, **settings: Any) -> Any:
        """Run the command line and exit."""
        settings = {"prog_name": invocation(), "complete_var": COMPLETE_VAR, **settings, "standalone_mode": False}
        try:
            with keeping_ledger() as ledger:
                code = super().main(*arguments, **settings)
            sys.stdout.flush()
        except click.ClickException as error:
            context = getattr(error, "ctx", None)
            hint = f" (see {context.command_path} --help)" if context else ""
            _end(f"{one_line(error.format_message()).removesuffix('.')}{hint}")
        except click.Abort:
            _end(one_line(f"stopped; {ledger.words()}"), STOPPED)
        except BrokenPipeError:
            # Whoever read the output, such as head, has had enough; Python's own last flush must not complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(0)
        except Exception as error:
            from valve_sim.model.errors import ValveError

            if not isinstance(error, ValveError):
                raise
            _end(one_line(str(error)))
        sys.exit(code if isinstance(code, int) else 0)


def _with_examples(text: str | None) -> str | None:
    """Help in which click leaves the lines of paragraphs with indented lines alone."""
    if text is None:
        return None
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(f"\b\n{words}" if "\n  " in f"\n{words}" else words for words in paragraphs)


def _as_typed(text: str) -> str:
    """Help in which the program of the examples is typed as it must be here, .venv/bin/valve-sim say."""
    return re.sub(r"^( +)valve-sim(?= )", lambda found: f"{found[1]}{invocation()}", text, flags=re.MULTILINE)


def _end(message: str, code: int = UNUSABLE) -> NoReturn:
    click.echo(f"valve-sim: {message}", err=True)
    sys.exit(code)
