"""The one table of command_profile's parameters: names, defaults, meaning and checks. Needs no ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.model import Drive, ParameterError
from valve_sim.nodes.parameters import unknown_name
from valve_sim.traces.synthetic import read_profile


class Settings(NamedTuple):
    """Settings of the node.

    Attributes:
        profile: file of the commands. valve: the node that gets them.
        max_voltage: V; a profile with more, of either sign, is refused.
        patience: s to wait for the valve. output: CSV file of what was commanded when.
    """

    profile: str = ""
    valve: str = "valve"
    max_voltage: float = 30.0
    patience: float = 10.0
    output: str = "commanded.csv"


DESCRIPTIONS: Final = {
    "profile": "what to command: rows of time in s and volts, as for `valve-sim simulate --profile`, the last one 0 V",
    "valve": "the node that is commanded, on its topic ~/coil_voltage",
    "max_voltage": "[V] a profile with a larger voltage, of either sign, is refused before anything is commanded",
    "patience": "[s] to wait for a node that hears the commands",
    "output": "CSV file of what was commanded when: ROS time in ns, s since the start, V",
}
_NUMBERS: Final = ("max_voltage", "patience")


def check_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> Settings:
    """The settings to start with.

    Args:
        given: names and values; those of ROS itself left out.
        sources: name to the file where it was given; the command line where missing.

    Raises:
        ParameterError: unknown name, wrong type or out of range; one line.
    """
    for name, value in given.items():
        where = f"{sources.get(name, 'command line')}: {name}"
        if name not in Settings._fields:
            raise unknown_name(where, value, "command_profile", Settings._fields)
        if name not in _NUMBERS and not isinstance(value, str):
            raise ParameterError(f"{where}: found {value!r}, expected text")
        if name in _NUMBERS and not _is_size(value):
            raise ParameterError(f"{where}: found {value!r}, expected a number from 0 on")
    settings = Settings(**given)  # type: ignore[arg-type]
    if not settings.profile:
        raise ParameterError("profile: not given; expected a file such as record_next.yaml (-p profile:=FILE)")
    return settings


def checked_profile(settings: Settings) -> Drive:
    """The commands, checked: all within max_voltage, and the last one 0 V.

    Raises:
        ValveError: the file cannot be used; one line.
    """
    path = Path(settings.profile).expanduser()
    drive = read_profile(path)
    for time, volts in zip(drive.times.tolist(), drive.volts.tolist(), strict=True):
        if not abs(volts) <= settings.max_voltage:
            raise ParameterError(
                f"{path}: found {volts:g} V at {time:g} s, expected at most {settings.max_voltage:g} V of either sign; "
                "lower it, or raise max_voltage if coil and driver bear it"
            )
    if drive.volts[-1] != 0.0:
        raise ParameterError(
            f"{path}: found {drive.volts[-1]:g} V as the last command; expected 0 V, so that the coil is not left on: "
            "add a last row, the time at which the voltage ends and 0"
        )
    return drive


def _is_size(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, int | float) and 0.0 <= value < math.inf
