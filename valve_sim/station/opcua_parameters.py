"""The one table of opcua_node's parameters: names, defaults, meaning and checks. Needs no ROS and no OPC UA."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from valve_sim.model import Parameter, ParameterError
from valve_sim.nodes.parameters import unknown_name


class NodeSettings(NamedTuple):
    """Settings of the node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    monitors: tuple[str, ...] = ("monitor",)
    serial_numbers: tuple[str, ...] = ("",)
    folder: str = "~/.local/share/valve_sim/opcua"
    address: str = "0.0.0.0"
    port: int = 4840
    anonymous_read: bool = False
    history_days: float = 3650.0


_LISTS: Final = ("valves", "monitors", "serial_numbers")
_PORT: Final = Parameter("port", "", "that the server listens on", 1.0, 65535.0)
_DAYS: Final = Parameter("history_days", "days", "of history that are kept", 0.01, 36500.0)
DESCRIPTIONS: Final = {
    "valves": "the valves that are served, relative to this node's namespace",
    "monitors": "the monitor of each valve, in the same order",
    "serial_numbers": "the serial number of each valve, in the same order; empty where there is none",
    "folder": "of certificates, history and alarms",
    "address": "that the server listens on; 0.0.0.0: all of this machine",
    "port": _PORT.description,
    "anonymous_read": "whether clients without a certificate may read, without encryption",
    "history_days": f"[{_DAYS.unit}] {_DAYS.description}",
}


def check_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> NodeSettings:
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
        if name not in NodeSettings._fields:
            raise unknown_name(where, value, "opcua_node", NodeSettings._fields)
        checked[name] = _checked(name, value, where)
    settings = NodeSettings(**checked)
    count = len(settings.valves)
    if "serial_numbers" not in given:
        settings = settings._replace(serial_numbers=("",) * count)
    for name in ("monitors", "serial_numbers"):
        if len(getattr(settings, name)) != count:
            raise ParameterError(
                f"{name}: found {len(getattr(settings, name))}, expected {count}, one for each of valves"
            )
    for name in ("valves", "monitors"):
        if len(set(getattr(settings, name))) != count:
            raise ParameterError(f"{name}: found {', '.join(getattr(settings, name))}, expected each once")
    return settings


def _checked(name: str, value: object, where: str) -> object:
    if name == "port":
        if not isinstance(value, int) or isinstance(value, bool):
            raise ParameterError(f"{where}: found {value!r}, expected a whole number from 1 to 65535")
        return int(_PORT.check(value, where))
    if name == "history_days":
        return _DAYS.check(value, where)
    if name == "anonymous_read":
        if not isinstance(value, bool):
            raise ParameterError(f"{where}: found {value!r}, expected true or false")
        return value
    if name in _LISTS:
        entries = list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else []
        if not entries or not all(isinstance(entry, str) for entry in entries):
            raise ParameterError(f"{where}: found {value!r}, expected a list of texts, one for each valve")
        if name != "serial_numbers" and not all(entries):
            raise ParameterError(f"{where}: found {value!r}, expected a list of names")
        return tuple(entries)
    if not isinstance(value, str) or not value:
        raise ParameterError(f"{where}: found {value!r}, expected a text")
    return value
