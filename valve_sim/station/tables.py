"""The tables of the station's nodes, of topics and of parameters, and what holds between the latter. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from valve_sim.model import Parameter, ParameterError
from valve_sim.model.gas import FLUIDS
from valve_sim.nodes.parameters import Words, check_given, settings_of, table_of
from valve_sim.nodes.topics import LATCHED, RELIABLE, Qos, Topic

_DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"
_FLOAT: Final = "std_msgs/msg/Float64"
_PRESSURE: Final = "sensor_msgs/msg/FluidPressure"

LATEST: Final = Qos(1, is_reliable=False)
"""Of what comes often, the last one is enough."""

SAID: Final = (
    Topic("{monitor}/stroke_report", "std_msgs/msg/String", "in", "each stroke, in JSON", qos=RELIABLE),
    Topic("{monitor}/finding", _DIAGNOSTICS, "in", "what has changed", qos=LATCHED),
    Topic("/diagnostics", _DIAGNOSTICS, "in", "of valves and monitors", qos=Qos(100)),
)
"""Topics of monitors and valves that are subscribed to."""
LIVE: Final = (
    Topic("{valve}/phase", "std_msgs/msg/UInt8", "in", "of the stroke", qos=LATCHED),
    Topic("{valve}/is_open", "std_msgs/msg/Bool", "in", "whether the flow path is fully open", qos=LATCHED),
    Topic("{valve}/coil_current", _FLOAT, "in", "by which it is known to live", "A", LATEST),
    Topic("{valve}/outlet_pressure", _PRESSURE, "in", "behind a valve with gas", "Pa", LATEST),
)
"""Topics of a valve that are published often; only the latest message counts."""
ARCHIVE_TOPICS: Final = (
    *SAID,
    Topic("{alarms}", _DIAGNOSTICS, "in", "who has answered or shelved an alarm over OPC UA", qos=Qos(100)),
    Topic(
        "{valve}/serviced", "std_srvs/srv/Trigger", "service", "keep that it was serviced: its strokes count anew",
        qos=None,
    ),
)  # fmt: skip
OPCUA_TOPICS: Final = (
    *SAID,
    *LIVE,
    Topic("~/alarms", _DIAGNOSTICS, "out", "each alarm that a person has answered or shelved", qos=Qos(100)),
)
PLC_TOPICS: Final = (Topic("{valve}/coil_voltage", _FLOAT, "out", "the command to each of `valves`", "V"), *LIVE)
DISPENSER_TOPICS: Final = (
    Topic("{valve}/outlet_pressure", _PRESSURE, "in", "behind each of `valves`", "Pa"),
    Topic("{valve}/coil_voltage", _FLOAT, "out", "opens or closes each of `valves`", "V"),
    Topic("{valve}/demand_pressure", _PRESSURE, "out", "the line's pressure, to each of `valves`", "Pa"),
    Topic("{valve}/inlet_pressure", _PRESSURE, "out", "its tank's pressure, where that has a volume", "Pa"),
    Topic("~/line_pressure", _PRESSURE, "out", "of the line that all tanks feed", "Pa"),
    Topic("~/vehicle_pressure", _PRESSURE, "out", "of the tank that is filled", "Pa"),
)


class ArchiveSettings(NamedTuple):
    """Settings of archive_node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    monitors: tuple[str, ...] = ("monitor",)
    alarms: str = "opcua/alarms"
    folder: str = "~/.local/share/valve_sim/archive"
    years: float = 10.0
    megabytes: float = 2000.0


ARCHIVE: Final = table_of(
    ArchiveSettings,
    Words("valves", "the valves of which is kept what is said, relative to this node's namespace"),
    Words("monitors", "the monitor of each valve, in the same order"),
    Words("alarms", "the topic of an opcua_node that says who has answered or shelved an alarm, relative likewise"),
    Words("folder", "of the archive"),
    Parameter("years", "years", "that are kept", 0.01, 100.0),
    Parameter("megabytes", "MB", "beyond which the oldest months are taken out", 1.0, 1e6),
)


def archive_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> ArchiveSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(ArchiveSettings, check_given(given, ARCHIVE, sources, "archive_node"))
    _check_one_each(settings.valves, monitors=settings.monitors)
    _check_filled(folder=settings.folder, alarms=settings.alarms)
    return settings


class OpcUaSettings(NamedTuple):
    """Settings of opcua_node; units as in the table."""

    valves: tuple[str, ...] = ("valve",)
    monitors: tuple[str, ...] = ("monitor",)
    serial_numbers: tuple[str, ...] = ("",)
    folder: str = "~/.local/share/valve_sim/opcua"
    address: str = "0.0.0.0"
    port: int = 4840
    anonymous_read: bool = False
    history_days: float = 3650.0


OPCUA: Final = table_of(
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
    settings = settings_of(OpcUaSettings, check_given(given, OPCUA, sources, "opcua_node"))
    if "serial_numbers" not in given:
        settings = settings._replace(serial_numbers=("",) * len(settings.valves))
    _check_one_each(settings.valves, monitors=settings.monitors, serial_numbers=settings.serial_numbers)
    _check_filled(folder=settings.folder, address=settings.address)
    return settings


class PlcSettings(NamedTuple):
    """Settings of plc_node; units as in the table."""

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


PLC: Final = table_of(
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
    Parameter(
        "rate", "Hz", "of looks at the valves and the watchdogs, and of polls of a PLC that is the server", 1.0, 1000.0
    ),
    Words("low_word_first", "whether the second half of a FLOAT32 is in the first register"),
    Words("map_file", "a file to which the register map is written at the start, as CSV; empty: none"),
)


def plc_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> PlcSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(PlcSettings, check_given(given, PLC, sources, "plc_node"))
    _check_one_each(settings.valves)
    _check_filled(address=settings.address)
    return settings


class DispenserSettings(NamedTuple):
    """Settings of dispenser_node; units as in the table."""

    valves: tuple[str, ...] = ("tank_1/valve", "tank_2/valve", "tank_3/valve")
    tank_pressures: tuple[float, ...] = (20e6, 26e6, 32e6)
    tank_volumes: tuple[float, ...] = (0.05, 0.05, 0.05)
    restrictor_diameter: float = 0.06e-3
    nozzle_diameter: float = 0.3e-3
    discharge_coefficient: float = 0.8
    line_volume: float = 2e-6
    vehicle_volume: float = 10e-6
    vehicle_pressure: float = 2e6
    target_pressure: float = 28e6
    least_difference: float = 1e6
    least_flow: float = 0.0
    least_open: float = 1.0
    pause: float = 3.0
    voltage: float = 9.0
    temperature: float = 288.15
    fluid: str = "hydrogen"
    rate: float = 20.0


_ASSUMED: Final = " (assumed)"
"""No station publishes such sizes: the defaults are a bench whose vehicle fills in ten seconds."""
DISPENSER: Final = table_of(
    DispenserSettings,
    Words("valves", "the nodes that are commanded and heard, relative to this node's namespace; one for each tank"),
    Parameter("tank_pressures", "Pa", "of each tank at the start, as its file declares it", 1e3, 2e8),
    Parameter("tank_volumes", "m³", "of each tank" + _ASSUMED + "; 0: its pressure stays", 0.0, 1e3),
    Parameter("restrictor_diameter", "m", "of each valve's demand orifice, as its file declares it", 1e-6, 0.1),
    Parameter("nozzle_diameter", "m", "of the orifice between line and vehicle" + _ASSUMED, 1e-6, 0.1),
    Parameter("discharge_coefficient", "–", "C_d, of every orifice", 0.05, 1.0),
    Parameter("line_volume", "m³", "of the line" + _ASSUMED, 1e-9, 1e3),
    Parameter("vehicle_volume", "m³", "of the tank that is filled" + _ASSUMED, 1e-9, 1e3),
    Parameter(
        "vehicle_pressure", "Pa", "with which a vehicle comes, and to which the line is vented" + _ASSUMED, 1e3, 2e8
    ),
    Parameter("target_pressure", "Pa", "at which a vehicle is full" + _ASSUMED, 1e3, 2e8),
    Parameter(
        "least_difference", "Pa", "between a valve's outlet and the line; below, the next tank" + _ASSUMED, 0.0, 2e8
    ),
    Parameter("least_flow", "kg/s", "from a tank; below, the next one" + _ASSUMED, 0.0, 1e3),
    Parameter("least_open", "s", "that a valve stays open before the next: it opens late" + _ASSUMED, 0.0, 1e3),
    Parameter("pause", "s", "between a full vehicle and the next" + _ASSUMED, 0.0, 1e6),
    Parameter("voltage", "V", "that opens a valve", 0.0, 1e4),
    Parameter("temperature", "K", "of all gas", 50.0, 1000.0),
    Words("fluid", f"one of {', '.join(FLUIDS)}", tuple(FLUIDS)),
    Parameter("rate", "Hz", "of the pressures that are published; commands are repeated as often", 1.0, 1000.0),
)


def dispenser_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> DispenserSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(DispenserSettings, check_given(given, DISPENSER, sources, "dispenser_node"))
    count = len(settings.valves)
    for name in ("tank_pressures", "tank_volumes"):
        if len(getattr(settings, name)) != count:
            raise ParameterError(
                f"{name}: found {len(getattr(settings, name))} numbers, expected {count}, one for each of valves"
            )
    if len(set(settings.valves)) != count:
        raise ParameterError(f"valves: found {', '.join(settings.valves)}, expected each valve once")
    if settings.target_pressure <= settings.vehicle_pressure:
        raise ParameterError(
            f"target_pressure: found {settings.target_pressure:g} Pa, expected more than vehicle_pressure, "
            f"{settings.vehicle_pressure:g} Pa"
        )
    return settings


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
