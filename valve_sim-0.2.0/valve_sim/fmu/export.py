"""Writes a valve as a Functional Mock-up Unit: a file that simulation tools of other makes load."""

from __future__ import annotations

import importlib
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim import __version__
from valve_sim.files.parameter_files import save_valve
from valve_sim.files.whole_files import atomic_write
from valve_sim.fmu.identity import NEEDED, PARAMETER_FILE
from valve_sim.model import Valve, ValveError


class _Version(NamedTuple):
    """One version of FMI: the library that writes it, our script for it, and its name of the ability to step back."""

    library: str
    script: str
    steps_back: str


VERSIONS: Final = {
    "2.0": _Version("pythonfmu", "valve_sim_fmi2.py", "canGetAndSetFMUstate"),
    "3.0": _Version("pythonfmu3", "valve_sim_fmi3.py", "canGetAndSetFMUState"),
}
"""Versions of FMI that can be written."""


def export_unit(path: Path, valve: Valve, version: str) -> None:
    """Write a valve as a unit, whole or not at all.

    Args:
        path: the file, x.fmu, replaced if it exists. valve: what the unit is.
        version: one of `VERSIONS`.

    Raises:
        ValveError: the library that writes units is not installed, or the file cannot be written.
    """
    if path.suffix != ".fmu":
        raise ValveError(f"{path}: expected a name that ends in .fmu, such as valve.fmu")
    found = VERSIONS[version]
    library = _library(found.library, version)
    with atomic_write(path) as partial, tempfile.TemporaryDirectory(prefix="valve_sim_fmu_") as folder:
        parameters = Path(folder) / PARAMETER_FILE
        save_valve(parameters, valve, f"the valve of a unit that valve_sim {__version__} wrote")
        documentation = Path(folder) / "documentation"
        documentation.mkdir()
        (documentation / "index.html").write_text(_PAGE, encoding="utf-8")
        script = Path(folder) / found.script
        shutil.copyfile(Path(__file__).parent / "inside" / found.script, script)
        (Path(folder) / "made").mkdir()
        with _search_path_kept(script.stem):
            made = library.FmuBuilder.build_FMU(
                script,
                dest=Path(folder) / "made",
                project_files=[parameters],
                documentation_folder=documentation,
                needsExecutionTool="true",
                canHandleVariableCommunicationStepSize="true",
                **{found.steps_back: "true"},
            )
        shutil.copyfile(made, partial)


def _library(name: str, version: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ValveError(
            f"FMI {version} is written by {name}, which is not installed; pip install '.[fmi]' in a checkout"
        ) from error


@contextmanager
def _search_path_kept(module: str) -> Iterator[None]:
    """Undo what the libraries leave behind in this process: a folder to search, and the script as a loaded module."""
    before = list(sys.path)
    try:
        yield
    finally:
        sys.path[:] = before
        sys.modules.pop(module, None)


_PAGE: Final = f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>A valve of valve_sim {__version__}</title></head>
<body><h1>A valve of valve_sim {__version__}</h1>
<p>{NEEDED}</p>
<p>Inputs and parameters count from the beginning of the next step. The valve is in resources/{PARAMETER_FILE}; an
effect that is not declared there is not among the parameters. The state can be kept and set, so that a master can step
back.</p>
</body></html>
"""
