"""How this package's programs are typed, so that whoever copies a printed command finds that it works."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from typing import Final

PACKAGE: Final = "valve_sim"
MODULES: Final = {"valve-sim": PACKAGE}
"""What to run by `python -m` for a program; the others are nodes of `valve_sim.nodes`."""


def invocation(program: str = "valve-sim") -> str:
    """What to type for a program of this package, in the terminal and folder in which this process was started.

    Its name where that is found; `ros2 run valve_sim ...` where colcon has put it; else its path (.venv/bin/valve-sim),
    or the module.
    """
    own = [script for script in _scripts(program) if script.is_file()]
    found = shutil.which(program)
    if found and any(Path(found).samefile(script) for script in own):
        return program
    if shutil.which("ros2") and any((prefix / "lib" / PACKAGE / program).is_file() for prefix in _ament_prefixes()):
        return f"ros2 run {PACKAGE} {program}"
    if own:
        return _typed(own[0])
    return f"{_typed(Path(sys.executable))} -m {MODULES.get(program, f'{PACKAGE}.nodes {program}')}"


def _scripts(program: str) -> Iterator[Path]:
    """Where pip puts a program of the running Python, for all or for one user."""
    yield Path(sysconfig.get_path("scripts")) / program
    if "posix_user" in sysconfig.get_scheme_names():
        yield Path(sysconfig.get_path("scripts", "posix_user")) / program


def _ament_prefixes() -> Iterator[Path]:
    return (Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix)


def _typed(path: Path) -> str:
    """A path as one would type it here: its name where that is found, from here on where it lies below."""
    found = shutil.which(path.name)
    if found and Path(found) == path:
        return path.name
    below = os.path.relpath(path)
    return shlex.quote(str(path) if below.startswith(os.pardir) else below)
