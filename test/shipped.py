"""The shipped recordings and what the package finds in them: each is read, fitted and diagnosed once a process."""

from __future__ import annotations

import functools
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import yaml

import valve_sim as vs
from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.model import Valve
from valve_sim.recordings import Trace

ROOT: Final = Path(__file__).parents[1]
BAGS: Final = {
    "eight_strokes": "bags/eight_strokes.mcap",
    "friction": "bags/friction",
    "live": "bags/live.mcap",
    "one_opening": "bags/one_opening.mcap",
    "oscilloscope": "bags/oscilloscope.csv",
}
"""Name to path from the root."""
TUTORIAL: Final = ROOT / "docs" / "tutorials" / "own_oscilloscope.md"
"""Declares the valve of the oscilloscope's table, and has its map."""


def declared_file(name: str) -> str:
    """The text of a file that the tutorial has its reader write."""
    (text,) = re.findall(rf"^\$ cat > {name} <<END\n(.*?)^END$", TUTORIAL.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    return str(text)


def options(name: str, folder: Path) -> Sequence[str]:
    """What the command line needs beside a recording: its valve and its map, written into a folder."""
    if name != "oscilloscope":
        return ()
    for file in ("bench_valve.yaml", "scope.yaml"):
        (folder / file).write_text(declared_file(file), encoding="utf-8")
    return ("--params", str(folder / "bench_valve.yaml"), "--map", str(folder / "scope.yaml"))


@functools.cache
def declared(name: str) -> Valve:
    """The valve of a recording as a file declares it."""
    if name != "oscilloscope":
        return default_valve()
    with tempfile.TemporaryDirectory() as folder:
        options(name, Path(folder))
        return load_valve(Path(folder) / "bench_valve.yaml")


@functools.cache
def recording(name: str) -> Trace:
    """A shipped recording."""
    found = vs.read(ROOT / BAGS[name], yaml.safe_load(declared_file("scope.yaml")) if name == "oscilloscope" else None)
    assert isinstance(found, Trace)
    return found


@functools.cache
def identified(name: str) -> vs.Identification:
    """The dampings refitted."""
    return vs.identify(recording(name), declared(name))


@functools.cache
def diagnosed(name: str) -> vs.Diagnosis:
    """The whole catalogue searched, without a limit of work."""
    return vs.diagnose(recording(name), declared(name))
