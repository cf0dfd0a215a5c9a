"""The one table of identification_node's parameters: names, defaults, meaning and checks. Needs no ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.identification.diagnosis.identify import check_free
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.model import ParameterError
from valve_sim.nodes.parameters import VALVE_KEYS, unknown_name

MODES: Final = ("identify", "diagnose")
_LOWEST: Final = {"rate": 0.0, "budget": 1.0}


class Settings(NamedTuple):
    """Settings of the node.

    Attributes:
        bag: the recording. map: which topic or column of it is what; empty for the topics of this package.
        valve_name: which valve in it; empty if there is one only.
        params: parameter file of the declared valve; empty for the shipped one.
        free: what is refitted.
        rate: seconds of the bag a second of the clock; 0 for as fast as possible. loop: replay it again and again.
        apply_to: the node that gets the result; empty for none. apply_always: whatever its residual.
        output: folder of the files. linger: stay after the last sample and the result, for ~/undo and late subscribers.
        mode: of MODES. budget: s, the work that a diagnosis may do.
    """

    bag: str = ""
    map: str = ""
    valve_name: str = ""
    params: str = ""
    free: tuple[str, ...] = DAMPINGS
    rate: float = 1.0
    loop: bool = False
    apply_to: str = ""
    apply_always: bool = False
    output: str = "."
    linger: bool = False
    mode: str = MODES[0]
    budget: float = 120.0


DESCRIPTIONS: Final = {
    "bag": "the recording: a rosbag2 folder, an .mcap file, or with `map` a table",
    "map": "file that says which topic or column of the recording is what; empty: those of this package",
    "valve_name": "which valve of the recording, such as /tank_1/valve; needed only where it holds several",
    "params": "parameter file of the declared valve; empty: the shipped one",
    "free": "parameters to refit (mode identify), such as pilot_damping or coulomb_friction.force; of a valve with one "
    "plunger the default is main_damping alone",
    "rate": "[–] replay: 1 as recorded, 2 twice as fast, 0 as fast as possible",
    "loop": "whether the replay begins anew at its end",
    "apply_to": "running valve node that is given the result, if nothing speaks against it; empty: none",
    "apply_always": "whether apply_to is given a result that something speaks against, too",
    "output": "folder of identified.yaml (diagnose: corrected.yaml, record_next.yaml) and before.yaml, as apply_to was",
    "linger": "whether the node stays when all is done, for ~/undo and late subscribers",
    "budget": "[s] work that a diagnosis may do, 4000 simulated strokes a second; it says what was left untried",
    "mode": "identify: refit `free`; diagnose: find the effect that the declared valve lacks",
}


def check_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> Settings:
    """The settings to start with.

    Args:
        given: names and values; those of ROS itself left out.
        sources: name to the file where it was given; the command line where missing.

    Raises:
        ParameterError: unknown name, wrong type or out of range; one line.
    """
    values: dict[str, object] = {}
    for name, value in given.items():
        where = f"{sources.get(name, 'command line')}: {name}"
        if name.startswith(VALVE_KEYS):
            raise ParameterError(f"{where}: belongs to a valve; give the file's name as the parameter params instead")
        if name not in Settings._fields:
            raise unknown_name(where, value, "identification_node", Settings._fields)
        values[name] = _checked(name, value, where)
    settings = Settings(**values)  # type: ignore[arg-type]
    if not settings.bag:
        raise ParameterError("bag: not given; expected a rosbag2 folder or an .mcap file (-p bag:=FILE)")
    return settings


def output_folder(settings: Settings) -> Path:
    """The folder of the results; it is made if missing.

    Raises:
        ParameterError: it cannot be made.
    """
    folder = Path(settings.output).expanduser()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"output: {folder}: cannot be made ({error.strerror}); expected a folder") from error
    return folder


def _checked(name: str, value: object, where: str) -> object:
    if name == "free":
        return _checked_free(value, where)
    if name in _LOWEST:
        lowest = _LOWEST[name]
        if isinstance(value, bool) or not isinstance(value, int | float) or not (lowest <= value < math.inf):
            raise ParameterError(f"{where}: found {value!r}, expected a number from {lowest:g} on")
        return float(value)
    if name in ("loop", "apply_always", "linger"):
        if not isinstance(value, bool):
            raise ParameterError(f"{where}: found {value!r}, expected true or false")
        return value
    if not isinstance(value, str):
        raise ParameterError(f"{where}: found {value!r}, expected text")
    if name == "mode" and value not in MODES:
        raise ParameterError(f"{where}: found {value!r}, expected {' or '.join(MODES)}")
    return value


def _checked_free(value: object, where: str) -> tuple[str, ...]:
    """Names as a list, or in one text separated by commas."""
    parts = value.split(",") if isinstance(value, str) else value
    if not isinstance(parts, Sequence) or not all(isinstance(part, str) for part in parts):
        raise ParameterError(f"{where}: found {value!r}, expected a list of names")
    names = tuple(dict.fromkeys(part.strip() for part in parts if part.strip()))
    if not names:
        raise ParameterError(f"{where}: found {value!r}, expected at least one name")
    check_free(names)
    return names
