"""The tables of the station's nodes, of topics and of parameters, and what holds between the latter. Needs no ROS."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from valve_sim.model import ParameterError
from valve_sim.nodes.parameters import NodeSettings, option
from valve_sim.nodes.topics import LAST_STROKES, LATCHED, RELIABLE, Qos, Topic

_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_FLOAT: Final = "std_msgs/msg/Float64"
_PRESSURE: Final = "sensor_msgs/msg/FluidPressure"

LATEST: Final = Qos(1, is_reliable=False)
"""Of what comes often, the last one is enough."""

SAID: Final = (
    Topic("{monitor}/stroke_report", _DIAGNOSTICS, "in", "the figures of each stroke", qos=RELIABLE),
    Topic("{monitor}/finding", _DIAGNOSTICS, "in", "what has changed", qos=LATCHED),
    Topic("/diagnostics", _DIAGNOSTICS, "in", "of valves and monitors", qos=Qos(100)),
)
"""Topics of monitors and valves that are subscribed to."""
LIVE: Final = (
    Topic("{valve}/phase", "std_msgs/msg/UInt8", "in", "phase of the stroke", qos=LATCHED),
    Topic("{valve}/is_open", "std_msgs/msg/Bool", "in", "whether the flow path is fully open", qos=LATCHED),
    Topic("{valve}/coil_current", _FLOAT, "in", "shows that the valve's node runs", "A", LATEST),
    Topic("{valve}/outlet_pressure", _PRESSURE, "in", "behind a valve with gas", "Pa", LATEST),
)
"""Topics of a valve that are published often; only the latest message counts."""
ARCHIVE_TOPICS: Final = (
    *(topic._replace(qos=LAST_STROKES) if "stroke_report" in topic.name else topic for topic in SAID),
    Topic("{alarms}", _DIAGNOSTICS, "in", "acknowledgements of alarms over OPC UA", qos=Qos(100)),
    Topic(
        "{valve}/serviced", "std_srvs/srv/Trigger", "service", "records a service; strokes count from 0 again",
        qos=None,
    ),
)  # fmt: skip
OPCUA_TOPICS: Final = (
    *SAID,
    *LIVE,
    Topic("~/alarms", _DIAGNOSTICS, "out", "each acknowledgement of an alarm", qos=Qos(100)),
)
PLC_TOPICS: Final = (Topic("{valve}/coil_voltage", _FLOAT, "out", "the command to each of `valves`", "V"), *LIVE)


@dataclass(frozen=True)
class ArchiveSettings(NodeSettings):
    """Settings of archive_node."""

    program = "archive_node"

    valves: tuple[str, ...] = option(
        ("valve",), "names of the valves whose messages are archived, relative to the node's namespace"
    )
    monitors: tuple[str, ...] = option(("monitor",), "monitor of each valve, in the same order")
    alarms: str = option(
        "opcua/alarms",
        "topic on which an opcua_node publishes acknowledgements, relative to the node's namespace",
    )
    folder: str = option("~/.local/share/valve_sim/archive", "folder of the archive")
    years: float = option(10.0, "time for which rows are kept", "years", 0.01, 100.0)
    megabytes: float = option(2000.0, "size beyond which the oldest months are removed", "MB", 1.0, 1e6)

    def completed(self) -> ArchiveSettings:
        """These settings, if there is a monitor for each valve."""
        _check_one_each(self.valves, monitors=self.monitors)
        _check_filled(folder=self.folder, alarms=self.alarms)
        return self


@dataclass(frozen=True)
class OpcUaSettings(NodeSettings):
    """Settings of opcua_node."""

    program = "opcua_node"

    valves: tuple[str, ...] = option(("valve",), "names of the served valves, relative to the node's namespace")
    monitors: tuple[str, ...] = option(("monitor",), "monitor of each valve, in the same order")
    serial_numbers: tuple[str, ...] = option(("",), "serial number of each valve, in the same order; default: unknown")
    folder: str = option("~/.local/share/valve_sim/opcua", "folder of certificates, history and alarms")
    address: str = option("0.0.0.0", "address that the server listens on; 0.0.0.0: all of this machine")
    port: int = option(4840, "port that the server listens on", "", 1.0, 65535.0)
    anonymous_read: bool = option(False, "whether clients without a certificate may read, without encryption")
    history_days: float = option(3650.0, "time for which history is kept", "days", 0.01, 36500.0)

    def completed(self) -> OpcUaSettings:
        """These settings, with a serial number for each valve, empty where none is given."""
        is_known = self.serial_numbers != ("",)
        found = self if is_known else replace(self, serial_numbers=("",) * len(self.valves))
        _check_one_each(found.valves, monitors=found.monitors, serial_numbers=found.serial_numbers)
        _check_filled(folder=found.folder, address=found.address)
        return found


@dataclass(frozen=True)
class PlcSettings(NodeSettings):
    """Settings of plc_node."""

    program = "plc_node"

    valves: tuple[str, ...] = option(
        ("valve",),
        "names of the valves that the PLC commands, relative to the node's namespace, in the order of the map",
    )
    voltage: float = option(9.0, "voltage of an energised coil", "V", 0.0, 1e4)
    watchdog: float = option(0.5, "time without a new heartbeat after which a coil is de-energised", "s", 0.01, 60.0)
    plc_host: str = option(
        "",
        "address of a PLC that is the server; empty: this node is the server, and the PLC polls it",
    )
    address: str = option("0.0.0.0", "address that this server listens on; 0.0.0.0: all of this machine")
    port: int = option(1502, "port of this server, or of the PLC", "", 1.0, 65535.0)
    first_register: int = option(0, "first register of the map in a PLC that is the server, from 0", "", 0.0, 60000.0)
    unit: int = option(1, "unit identifier of a PLC that is the server", "", 0.0, 255.0)
    rate: float = option(
        100.0, "rate of the watchdogs, and of polling a PLC that is the server", "Hz", 1.0, 1000.0
    )  # fmt: skip
    low_word_first: bool = option(False, "whether the second half of a FLOAT32 is in the first register")
    map_file: str = option("", "a file to which the register map is written at the start, as CSV; empty: none")

    def completed(self) -> PlcSettings:
        """These settings, if each valve is named once."""
        _check_one_each(self.valves)
        _check_filled(address=self.address)
        return self


def _check_one_each(valves: Sequence[str], **lists: Sequence[str]) -> None:
    """Check that there is one entry for each valve, and each name once.

    Raises:
        ParameterError: another number, or a name twice.
    """
    for name, entries in lists.items():
        if len(entries) != len(valves):
            raise ParameterError(f"{name}: found {len(entries)}, expected {len(valves)}, one for each of valves")
    for name, entries in {"valves": valves, "monitors": lists.get("monitors", ())}.items():
        if len(set(entries)) != len(entries):
            raise ParameterError(f"{name}: found {', '.join(entries)}, expected each once")


def _check_filled(**texts: str) -> None:
    """Check that no text is empty.

    Raises:
        ParameterError: one is.
    """
    for name, text in texts.items():
        if not text.strip():
            raise ParameterError(f"{name}: found {text!r}, expected a text; leave it out for the default")
