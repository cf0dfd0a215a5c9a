"""The tables of plc_node, of topics and of parameters, and what holds between the latter. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.model import Parameter
from valve_sim.nodes.parameters import Words, check_given, settings_of, table_of
from valve_sim.nodes.topics import Topic
from valve_sim.station.hearing_tables import LIVE, check_filled, check_one_each

TOPICS: Final = (
    Topic("{valve}/coil_voltage", "std_msgs/msg/Float64", "out", "the command to each of `valves`", "V"),
    *LIVE,
)


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


PARAMETERS: Final = table_of(
    PlcSettings,
    Words(
        "valves",
        "the valves that are commanded and heard, relative to this node's namespace, in the order of the map",
    ),
    Parameter("voltage", "V", "of an energised coil", 0.0, 1e4),
    Parameter("watchdog", "s", "without another heartbeat, after which a coil is de-energised", 0.01, 60.0),
    Words("plc_host", "the PLC's address where it is the server; empty: this node is the server, which the PLC polls"),
    Words("address", "that this server listens on; 0.0.0.0: all of this machine"),
    Parameter("port", "", "of this server, or of the PLC", 1.0, 65535.0),
    Parameter("first_register", "", "of the map in a PLC that is the server, counted from 0", 0.0, 60000.0),
    Parameter("unit", "", "identifier of a PLC that is the server", 0.0, 255.0),
    Parameter("rate", "Hz", "of commands that are repeated, and of polls of a PLC that is the server", 1.0, 1000.0),
    Words("low_word_first", "whether the second half of a FLOAT32 is in the first register"),
    Words("map_file", "a file to which the register map is written at the start, as CSV; empty: none"),
)


def plc_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> PlcSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(PlcSettings, check_given(given, PARAMETERS, sources, "plc_node"))
    check_one_each(settings.valves)
    check_filled(address=settings.address)
    return settings
