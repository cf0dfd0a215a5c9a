"""The place of the files that ship with the code: config/ of a checkout, or share/valve_sim of an installation."""

from pathlib import Path

from valve_sim.model.errors import ValveError


def config_path(name: str) -> Path:
    """The parameter file that ships under this name, such as "valve.yaml".

    Found from the place of the code itself, so that no environment variable can select a file of another version.

    Raises:
        ValveError: no such file ships, or the installation lacks its share folder.
    """
    folder = _config_folder(Path(__file__).resolve())
    path = folder / name
    if not path.is_file():
        shipped = ", ".join(sorted(file.name for file in folder.iterdir() if file.is_file()))
        raise ValveError(f"{name}: no such file ships with valve_sim; expected one of {shipped}, or give a path")
    return path


def _config_folder(code: Path) -> Path:
    """The config folder that belongs to this file of code.

    A checkout has package.xml beside the package. An installation has share/valve_sim under its prefix, some folders
    above site-packages: how many differs between colcon, pip, pip --target and Debian, so the nearest one is taken.
    """
    checkout = code.parents[2]
    if (checkout / "package.xml").is_file():
        candidates = [checkout / "config"]
    else:
        candidates = [folder / "share" / "valve_sim" / "config" for folder in code.parents]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise ValveError(f"{candidates[0]}: no such folder above {code}; install valve_sim again, with pip or colcon")
