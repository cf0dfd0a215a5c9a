"""The tables of opcua_node, of topics and of parameters, and what holds between the latter. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.model import Parameter
from valve_sim.nodes.parameters import Words, check_given, settings_of, table_of
from valve_sim.station.hearing_tables import LIVE, SAID, check_filled, check_one_each

TOPICS: Final = (*SAID, *LIVE)


class OpcUaSettings(NamedTuple):
    """Settings of the node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    monitors: tuple[str, ...] = ("monitor",)
    serial_numbers: tuple[str, ...] = ("",)
    folder: str = "~/.local/share/valve_sim/opcua"
    address: str = "0.0.0.0"
    port: int = 4840
    anonymous_read: bool = False
    history_days: float = 3650.0


PARAMETERS: Final = table_of(
    OpcUaSettings,
    Words("valves", "the valves that are served, relative to this node's namespace"),
    Words("monitors", "the monitor of each valve, in the same order"),
    Words("serial_numbers", "the serial number of each valve, in the same order; left out: none is known"),
    Words("folder", "of certificates, history and alarms"),
    Words("address", "that the server listens on; 0.0.0.0: all of this machine"),
    Parameter("port", "", "that the server listens on", 1.0, 65535.0),
    Words("anonymous_read", "whether clients without a certificate may read, without encryption"),
    Parameter("history_days", "days", "of history that are kept", 0.01, 36500.0),
)


def opcua_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> OpcUaSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(OpcUaSettings, check_given(given, PARAMETERS, sources, "opcua_node"))
    if "serial_numbers" not in given:
        settings = settings._replace(serial_numbers=("",) * len(settings.valves))
    check_one_each(settings.valves, monitors=settings.monitors, serial_numbers=settings.serial_numbers)
    check_filled(folder=settings.folder, address=settings.address)
    return settings
