"""The one table of plc_node's parameters: names, defaults, meaning and checks. Needs no ROS and no Modbus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from valve_sim.model import Parameter, ParameterError
from valve_sim.nodes.parameters import unknown_name


class PlcSettings(NamedTuple):
    """Settings of the node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    voltage: float = 9.0
    watchdog: float = 0.5
    plc_host: str = ""
    address: str = "0.0.0.0"
    port: int = 1502
    first_register: int = 0
    unit: int = 1
    rate: float = 100.0
    low_word_first: bool = False
    map_file: str = ""


_NUMBERS: Final = {
    rule.name: rule
    for rule in (
        Parameter("voltage", "V", "of an energised coil", 0.0, 1e4),
        Parameter("watchdog", "s", "without another heartbeat, after which a coil is de-energised", 0.01, 60.0),
        Parameter("rate", "Hz", "of commands that are repeated, and of polls of a PLC that is the server", 1.0, 1000.0),
    )
}
_WHOLE: Final = {
    rule.name: rule
    for rule in (
        Parameter("port", "", "of this server, or of the PLC", 1.0, 65535.0),
        Parameter("first_register", "", "of the map in a PLC that is the server, counted from 0", 0.0, 60000.0),
        Parameter("unit", "", "identifier of a PLC that is the server", 0.0, 255.0),
    )
}
_FLAGS: Final = ("low_word_first",)
_MAY_BE_EMPTY: Final = ("plc_host", "map_file")
DESCRIPTIONS: Final = {
    "valves": "the valves that are commanded and heard, relative to this node's namespace, in the order of the map",
    "plc_host": "the PLC's address where it is the server; empty: this node is the server, which the PLC polls",
    "address": "that this server listens on; 0.0.0.0: all of this machine",
    "low_word_first": "whether the second half of a FLOAT32 is in the first register",
    "map_file": "a file to which the register map is written at the start, as CSV; empty: none",
    **{name: f"[{rule.unit}] {rule.description}" for name, rule in _NUMBERS.items()},
    **{name: rule.description for name, rule in _WHOLE.items()},
}


def check_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> PlcSettings:
    """The settings to start with.

    Args:
        given: names and values; those of ROS itself left out.
        sources: name to the file where it was given; the command line where missing.

    Raises:
        ParameterError: unknown name, wrong type or out of range; one line.
    """
    checked: dict[str, Any] = {}
    for name, value in given.items():
        where = f"{sources.get(name, 'command line')}: {name}"
        if name not in PlcSettings._fields:
            raise unknown_name(where, value, "plc_node", PlcSettings._fields)
        checked[name] = _checked(name, value, where)
    settings = PlcSettings(**checked)
    if len(set(settings.valves)) != len(settings.valves):
        raise ParameterError(f"valves: found {', '.join(settings.valves)}, expected each valve once")
    return settings


def _checked(name: str, value: object, where: str) -> object:
    if name in _NUMBERS:
        return _NUMBERS[name].check(value, where)
    if name in _WHOLE:
        if not isinstance(value, int) or isinstance(value, bool):
            raise ParameterError(f"{where}: found {value!r}, expected a whole number")
        return int(_WHOLE[name].check(value, where))
    if name in _FLAGS:
        if not isinstance(value, bool):
            raise ParameterError(f"{where}: found {value!r}, expected true or false")
        return value
    if name == "valves":
        entries = list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else []
        if not entries or not all(isinstance(entry, str) and entry for entry in entries):
            raise ParameterError(f"{where}: found {value!r}, expected a list of names")
        return tuple(entries)
    if not isinstance(value, str) or not (value or name in _MAY_BE_EMPTY):
        raise ParameterError(f"{where}: found {value!r}, expected a text")
    return value
