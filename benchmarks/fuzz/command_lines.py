"""Command lines that nobody would type on purpose, on files that are hardly files: a surface of `benchmarks.fuzz`.

Every command line must end with 0 (done), 1 (validate: outside) or 2, and with 2 must say why in one line on stderr,
the last; lines before it, as after any end, are remarks on recordings that had to be repaired.
"""

from __future__ import annotations

import contextlib
import io
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Final

import click
import numpy as np

from valve_sim.cli import main

ROOT: Final = Path(__file__).parents[2]
WORDS: Final = (
    "", "nan", "inf", "-inf", "1e308", "1e-308", "-1", "0", "0.5", "3", "9", "1e9", "0x10", "1,2", "text", "--json",
    "pilot_damping", "a0,a1,a0", "mass,,", "coulomb_friction.force", "no_such.effect", "/tank_1/valve", "/", "é\u202e",
    "\x1b[31m", "a" * 300, "-h", "--",
)  # fmt: skip
"""Values that an option may be given where another is meant."""
TABLES: Final = (
    "", "time,volts\n0.01,9\n0.04,0\n", "time,volts\n0.04,9\n0.01,0\n", "time,volts\nnan,9\n", "time\n1\n", "a,b,c\n",
    "displacement,force\n0,3\n1e-3,2\n2e-3,1\n1.5e-3,1.2\n", "displacement,force\n0,inf\n", "[[0.01, 9], [0.04, 0]]",
    "[[0.01]]", "{}", "schema: nonsense", "- {time: 0.01, volts: 9}", "\x00\xff", "[[[[", "time,volts\n" + "9," * 5000,
)  # fmt: skip
"""Contents of a profile, a table of forces or of events."""
SHORT: Final = ("0.001", "0.02", "0.1")
"""s: durations that a simulation may be asked for among others."""

Random = np.random.Generator
BadFile = Callable[[Random, Path], Path]


def try_command_line(random: Random, folder: Path, bad_bag: BadFile, bad_file: BadFile) -> str:
    """Run one command line in `folder`: 'done' or 'refused'.

    Raises:
        AssertionError: it ended otherwise, or did not say why in one line.
    """
    arguments = _arguments(random, folder, bad_bag, bad_file)
    out, err = io.StringIO(), io.StringIO()
    code: object = None
    before = Path.cwd()
    os.chdir(folder)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main.main(args=arguments, prog_name="valve-sim")
    except SystemExit as end:
        code = end.code
    finally:
        os.chdir(before)
    said = err.getvalue()
    words = f"valve-sim {' '.join(map(repr, arguments))}: {code!r}, {said!r}"
    assert code in ((0, 1, 2) if arguments[0] == "validate" else (0, 2)), words
    lines = said.split("\n")[:-1]
    assert len(lines) >= 1 or code != 2, words
    assert all(line.startswith("valve-sim: ") and line.isprintable() for line in lines), words
    return "refused" if code == 2 else "done"


def _arguments(random: Random, folder: Path, bad_bag: BadFile, bad_file: BadFile) -> list[str]:
    """A command with most of what it needs, some of it wrong, in any order."""
    name = str(random.choice(sorted(main.commands)))
    pieces: list[list[str]] = []
    for parameter in main.commands[name].params:
        is_needed = parameter.required or parameter.name in ("bags", "profile", "voltage")
        if random.random() > (0.95 if is_needed else 0.25):
            continue
        value = [] if getattr(parameter, "is_flag", False) else [_value(parameter, random, folder, bad_bag, bad_file)]
        pieces.append(value if isinstance(parameter, click.Argument) else [parameter.opts[0], *value])
    if random.random() < 0.1:
        pieces.append([str(random.choice(WORDS))])
    random.shuffle(pieces)
    return [name, *(word for piece in pieces for word in piece)]


def _value(parameter: click.Parameter, random: Random, folder: Path, bad_bag: BadFile, bad_file: BadFile) -> str:
    """What a parameter is given: mostly of the right kind, seldom right."""
    places = ("out", "out.csv", "out.mcap", "out.png", "no/such/place.csv", ".", "table.csv/below", "/dev/null/x")
    name = parameter.name if random.random() > 0.15 else None
    value: str | Path
    if name in ("bags", "bag", "holdout"):
        value = _bag(random, folder, bad_bag)
    elif name == "params":
        value = bad_file(random, folder) if random.random() < 0.5 else ROOT / "config" / "valve.yaml"
    elif name in ("profile", "file"):
        value = _table(random, folder)
    elif name in ("output", "plot", "junit"):
        value = random.choice(places)
    else:
        value = random.choice(SHORT if name == "duration" else WORDS)
    return str(value)


def _table(random: Random, folder: Path) -> Path:
    """A table that suits some command, or none."""
    if random.random() < 0.2:
        return ROOT / "config" / "published.yaml"
    path = folder / f"table{random.choice(['.csv', '.yaml', '.txt', ''])}"
    path.write_text(str(random.choice(TABLES)), encoding="utf-8")
    return path


def _bag(random: Random, folder: Path, bad_bag: BadFile) -> str:
    """A changed bag, a good one, another kind of file, a folder, or nothing."""
    kind = random.random()
    if kind < 0.6:
        for left in ("bag", "bag.mcap"):
            shutil.rmtree(folder / left, ignore_errors=True)
        return str(bad_bag(random, folder))
    if kind < 0.8:
        return str(ROOT / "bags" / "one_opening.mcap")
    return str(random.choice([str(ROOT / "README.md"), str(ROOT / "bags"), str(folder), "nowhere.mcap"]))
