"""Writes a valve as a Functional Mock-up Unit: a file that simulation tools of other makes load."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from valve_sim import __version__
from valve_sim.files.parameter_files import save_valve
from valve_sim.files.whole_files import atomic_write
from valve_sim.model import Valve, ValveError

PARAMETER_FILE: Final = "valve.yaml"
"""Among the resources of a unit: the whole valve."""
NEEDED: Final = (
    f"Needs Linux on x86-64 and a Python with the package valve_sim {__version__} in the tool that loads it; "
    "without that the unit does not load."
)
_SCRIPT: Final = Path(__file__).parent / "inside" / "valve_sim_fmi2.py"


def export_unit(path: Path, valve: Valve) -> None:
    """Write a valve as a unit of FMI 2.0 to x.fmu, whole or not at all; the file is replaced if it exists.

    Raises:
        ValveError: pythonfmu is not installed, or the file cannot be written.
    """
    if path.suffix != ".fmu":
        raise ValveError(f"{path}: expected a name that ends in .fmu, such as valve.fmu")
    try:
        from pythonfmu import FmuBuilder
    except ImportError as error:
        raise ValveError(
            "an FMU is written by pythonfmu, which is not installed; pip install '.[fmi]' in a checkout"
        ) from error
    with atomic_write(path) as partial, tempfile.TemporaryDirectory(prefix="valve_sim_fmu_") as name:
        folder = Path(name)
        parameters, documentation = folder / PARAMETER_FILE, folder / "documentation"
        save_valve(parameters, valve, f"the valve of a unit that valve_sim {__version__} wrote")
        documentation.mkdir()
        (documentation / "index.html").write_text(_PAGE, encoding="utf-8")
        script = Path(shutil.copy(_SCRIPT, folder))
        (folder / "made").mkdir()
        with _search_path_kept(script.stem):
            made = FmuBuilder.build_FMU(
                script,
                dest=folder / "made",
                project_files=[parameters],
                documentation_folder=documentation,
                needsExecutionTool="true",
                canHandleVariableCommunicationStepSize="true",
                canGetAndSetFMUstate="true",
            )
        shutil.copyfile(made, partial)


@contextmanager
def _search_path_kept(module: str) -> Iterator[None]:
    """Undo what the library leaves behind in this process: a folder to search, and the script as a loaded module."""
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
