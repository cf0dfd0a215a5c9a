"""The one table of archive_node's parameters: names, defaults, meaning and checks. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from valve_sim.model import Parameter, ParameterError
from valve_sim.nodes.parameters import unknown_name


class ArchiveSettings(NamedTuple):
    """Settings of the node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    monitors: tuple[str, ...] = ("monitor",)
    folder: str = "~/.local/share/valve_sim/archive"
    years: float = 10.0
    megabytes: float = 2000.0


_NUMBERS: Final = {
    rule.name: rule
    for rule in (
        Parameter("years", "years", "that are kept", 0.01, 100.0),
        Parameter("megabytes", "MB", "beyond which the oldest months are taken out", 1.0, 1e6),
    )
}
DESCRIPTIONS: Final = {
    "valves": "the valves of which is kept what is said, relative to this node's namespace",
    "monitors": "the monitor of each valve, in the same order",
    "folder": "of the archive",
    **{name: f"[{rule.unit}] {rule.description}" for name, rule in _NUMBERS.items()},
}


def check_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> ArchiveSettings:
    """The settings to start with.

    Args:
        given: names and values; those of ROS itself left out.
        sources: name to the file where it was given; the command line where missing.

    Raises:
        ParameterError: unknown name, wrong type, out of range, or lists of different lengths; one line.
    """
    checked: dict[str, Any] = {}
    for name, value in given.items():
        where = f"{sources.get(name, 'command line')}: {name}"
        if name not in ArchiveSettings._fields:
            raise unknown_name(where, value, "archive_node", ArchiveSettings._fields)
        checked[name] = _checked(name, value, where)
    settings = ArchiveSettings(**checked)
    if len(settings.monitors) != len(settings.valves):
        raise ParameterError(
            f"monitors: found {len(settings.monitors)}, expected {len(settings.valves)}, one for each of valves"
        )
    return settings


def _checked(name: str, value: object, where: str) -> object:
    if name in _NUMBERS:
        return _NUMBERS[name].check(value, where)
    if name == "folder":
        if not isinstance(value, str) or not value:
            raise ParameterError(f"{where}: found {value!r}, expected a folder")
        return value
    entries = list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else []
    if not entries or not all(isinstance(entry, str) and entry for entry in entries):
        raise ParameterError(f"{where}: found {value!r}, expected a list of names")
    return tuple(entries)
