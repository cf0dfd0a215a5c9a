"""An OPC UA server of valves: variables with history, an alarm that can be acknowledged, methods. Knows no ROS.

    Objects / Station / <valve> / Health, Driver, Live, Stroke, Finding (the table of `figures`)
                                / Alarm, Recommission, SelfTest, SerialNumber

Node identifiers are text, "tank_1/valve.Stroke.T1", and stay the same from start to start.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
import sqlite3
import uuid
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, Final, NamedTuple

from asyncua import Server, ua, uamethod
from asyncua.common.events import Event
from asyncua.server.history_sql import HistorySQLite

from valve_sim import __version__
from valve_sim.model.errors import ValveError
from valve_sim.station.alarms import SEVERITIES, Alarm, Refusal, load_alarms, save_alarms
from valve_sim.station.figures import BY_PATH, FIGURES, Figure, Report, unit_id, unit_words, utc
from valve_sim.station.opcua_security import Gate, NamingServer, Rules, caller, ensure_identity
from valve_sim.station.tables import OpcUaSettings

NAMESPACE: Final = "urn:valve_sim:station"
"""The namespace of all nodes of this server."""
_UNITS: Final = "http://www.opcfoundation.org/UA/units/un/cefact"


_ACKNOWLEDGE: Final = ua.ObjectIds.AcknowledgeableConditionType_Acknowledge

Action = Callable[[str], Awaitable[tuple[bool, str]]]
"""What a method does, given the valve: whether it was done, and what to say."""
Told = Callable[[str, Alarm], None]
"""Told the valve and its alarm, which a person has just acknowledged."""


class ServedValve(NamedTuple):
    """A valve that is served: full name of its node, and the serial number of the part."""

    name: str
    serial_number: str = ""

    @property
    def identifier(self) -> str:
        """How its nodes' identifiers begin: the name without its first slash."""
        return self.name.lstrip("/")


class StationServer:
    """The server. Call every method in the event loop that started it.

    Args:
        settings: how it is reached, and what it keeps. valves: that are served.
        recommission, self_test: what the methods of a valve do; default: they say that nobody does it.
        told: called in the server's thread when a person has acknowledged an alarm.
    """

    def __init__(
        self, settings: OpcUaSettings, valves: Sequence[ServedValve], *,
        recommission: Action | None = None, self_test: Action | None = None,
        told: Told = lambda valve, alarm: None,
    ) -> None:  # fmt: skip
        self._told = told
        self._settings, self._valves, self._folder = settings, tuple(valves), Path(settings.folder).expanduser()
        self._actions = {"Recommission": recommission or _nobody, "SelfTest": self_test or _nobody}
        self._alarms_file = self._folder / "alarms.json"
        self._index = 0
        self._alarms: dict[str, Alarm] = {}
        self._server: Any = None
        self._history = _History(self._folder / "history.db")
        self._writing = asyncio.Lock()

    @property
    def endpoint(self) -> str:
        """The address for clients on this machine."""
        return f"opc.tcp://{_host(self._settings.address)}:{self._settings.port}/valve_sim/"

    async def start(self) -> None:
        """Make what is missing, show what was known last, and listen.

        Raises:
            ValveError: a file cannot be used, or the port is taken.
        """
        settings = self._settings
        uri = f"{NAMESPACE}:{socket.gethostname()}"
        certificate, key = await asyncio.to_thread(ensure_identity, self._folder, uri)
        kept = await asyncio.to_thread(load_alarms, self._alarms_file)
        self._alarms = {valve.name: kept.get(valve.name, Alarm()) for valve in self._valves}
        gate = Gate(self._folder, allows_anonymous=settings.anonymous_read)
        await gate.load()
        self._history.prepare()
        self._server = server = Server(iserver=NamingServer(user_manager=gate))
        server.iserver.bind_condition_methods = SEVERITIES[0]  # of the events before and after a refresh
        server.iserver.history_manager.set_storage(self._history)
        await server.init()
        try:
            server.name, server.manufacturer_name = "valve_sim station", "valve_sim"
            server.set_endpoint(f"opc.tcp://{settings.address}:{settings.port}/valve_sim/")
            await server.set_application_uri(uri)
            now = datetime.now(timezone.utc)
            await server.set_build_info("urn:valve_sim", "valve_sim", server.name, __version__, "0", now)
            policies = [ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt]
            if settings.anonymous_read:
                policies.append(ua.SecurityPolicyType.NoSecurity)
            server.set_security_policy(policies, Rules())
            server.set_identity_tokens([ua.AnonymousIdentityToken])
            server.set_certificate_validator(gate.validate)
            await server.load_certificate(certificate)
            await server.load_private_key(key)
            self._index = await server.register_namespace(NAMESPACE)
            await self._make_nodes()
            await server.start()
        except OSError as error:
            await self._history.stop()
            raise ValveError(
                f"port {settings.port} of {settings.address}: cannot be listened on ({error.strerror or error}); "
                "choose another by the parameter port"
            ) from error
        except BaseException:
            await self._history.stop()
            raise
        for valve in self._valves:
            if self._alarms[valve.name].is_retained:
                await self._tell(valve, self._alarms[valve.name])

    async def stop(self) -> None:
        """Say goodbye to the clients and close all files."""
        async with self._writing:
            await self._server.stop()

    async def put(self, report: Report) -> None:
        """Show a report on a valve, with the time to which it belongs.

        A value is in the history before a client sees it. A report on a valve that is not served changes nothing.

        Raises:
            ValveError: the file of alarms cannot be written.
        """
        valve = next((valve for valve in self._valves if valve.name == report.valve), None)
        if valve is None:
            return
        async with self._writing:
            for path, value in report.values.items():
                node, shown = self._node_id(valve, path), _data_value(BY_PATH[path], value, report.time)
                if BY_PATH[path].is_kept:
                    await self._history.save_node_value(node, shown)
                await self._server.write_attribute_value(node, shown)
            level = report.values.get("Health.Level")
            if isinstance(level, int):
                message = str(report.values.get("Health.Message") or "")
                changed = self._alarms[valve.name].reported(level, message, report.time.timestamp(), _new_event())
                if changed is not None:
                    await self._change(valve, changed)

    # --- the address space ---

    def _node_id(self, valve: ServedValve, path: str = "") -> Any:
        return ua.NodeId(f"{valve.identifier}.{path}" if path else valve.identifier, self._index)

    def _name(self, name: str) -> Any:
        return ua.QualifiedName(name, self._index)

    async def _make_nodes(self) -> None:
        kind = await self._make_type()
        objects, server = self._server.nodes.objects, self._server.nodes.server
        station = await objects.add_folder(ua.NodeId("Station", self._index), self._name("Station"))
        for valve in self._valves:
            node = await station.add_object(
                self._node_id(valve), self._name(valve.identifier), objecttype=kind.nodeid, instantiate_optional=False
            )
            await server.add_reference(node, ua.ObjectIds.HasNotifier)
            await self._fill(valve, node)
        self._history.index()

    async def _make_type(self) -> Any:
        """The type of all valves, so that a client's screens can be made for the type."""
        base = self._server.get_node(ua.ObjectIds.BaseObjectType)
        kind = await base.add_object_type(ua.NodeId("ValveType", self._index), self._name("ValveType"))
        groups: dict[str, Any] = {}
        serial = await kind.add_property(
            ua.NodeId("ValveType.SerialNumber", self._index), self._name("SerialNumber"), "", ua.VariantType.String
        )
        await serial.set_modelling_rule(True)
        for figure in FIGURES:
            if figure.group not in groups:
                identifier = ua.NodeId(f"ValveType.{figure.group}", self._index)
                groups[figure.group] = await kind.add_object(identifier, self._name(figure.group))
                await groups[figure.group].set_modelling_rule(True)
            await self._add_figure(groups[figure.group], figure)
        for name, words in (
            ("Recommission", "Take the next strokes as the new baseline of the monitor."),
            ("SelfTest", "One stroke of a copy of the simulated valve; the real one does not move."),
        ):
            outputs = [_argument("Done", ua.ObjectIds.Boolean), _argument("Message", ua.ObjectIds.String)]
            method = await kind.add_method(
                ua.NodeId(f"ValveType.{name}", self._index), self._name(name), self._act(name), [], outputs
            )
            await method.write_attribute(ua.AttributeIds.Description, _text(words))
            await method.set_modelling_rule(True)
        return kind

    async def _add_figure(self, group: Any, figure: Figure) -> None:
        identifier = ua.NodeId(f"ValveType.{figure.path}", self._index)
        variant = _variant(figure, None)
        node = await group.add_variable(identifier, self._name(figure.name), variant)
        await node.write_attribute(ua.AttributeIds.Description, _text(figure.description))
        if figure.is_list:
            await node.write_value_rank(ua.ValueRank.OneDimension)
        if figure.is_kept:
            access = ua.AccessLevel.to_bitfield({ua.AccessLevel.CurrentRead, ua.AccessLevel.HistoryRead})
            for attribute in (ua.AttributeIds.AccessLevel, ua.AttributeIds.UserAccessLevel):
                await node.write_attribute(attribute, ua.DataValue(ua.Variant(access, ua.VariantType.Byte)))
            await node.write_attribute(ua.AttributeIds.Historizing, ua.DataValue(True))
        if figure.unit:
            unit = ua.EUInformation(
                NamespaceUri=_UNITS, UnitId=unit_id(figure.unit), DisplayName=ua.LocalizedText(figure.unit),
                Description=ua.LocalizedText(unit_words(figure.unit)),
            )  # fmt: skip
            place = ua.NodeId(f"ValveType.{figure.path}.EngineeringUnits", self._index)
            added = await node.add_property(place, ua.QualifiedName("EngineeringUnits", 0), unit)
            await added.set_modelling_rule(True)
        await node.set_modelling_rule(True)

    async def _fill(self, valve: ServedValve, node: Any) -> None:
        """A valve's history, alarm and methods, and what was known last."""
        await (await node.get_child(self._name("SerialNumber"))).write_value(valve.serial_number)
        await node.set_event_notifier([ua.EventNotifier.SubscribeToEvents])
        period = timedelta(days=self._settings.history_days)
        for figure in FIGURES:
            place, last = self._node_id(valve, figure.path), []
            if figure.is_kept:
                await self._history.new_historized_node(place, period)
                last, _ = await self._history.read_node_history(place, None, None, 1)
            unknown = _data_value(figure, None, datetime.now(timezone.utc))
            await self._server.write_attribute_value(place, last[0] if last else unknown)
        for name in self._actions:
            self._server.link_method(self._server.get_node(self._node_id(valve, name)), self._act(name))
        await self._make_alarm(valve, node)

    async def _make_alarm(self, valve: ServedValve, node: Any) -> None:
        alarm = await node.add_object(
            self._node_id(valve, "Alarm"), self._name("Alarm"), objecttype=ua.ObjectIds.AlarmConditionType,
            instantiate_optional=False,
        )  # fmt: skip
        await node.add_reference(alarm, ua.ObjectIds.HasCondition)
        for place in (self._node_id(valve, "Alarm.Acknowledge"), ua.NodeId(_ACKNOWLEDGE)):
            self._server.link_method(self._server.get_node(place), self._acknowledge())
        await self._show(valve, self._alarms[valve.name])

    # --- methods ---

    def _served_at(self, node: Any, path: str = "") -> ServedValve | None:
        """The valve below which a node stands at this path."""
        return next((valve for valve in self._valves if self._node_id(valve, path) == node), None)

    def _act(self, name: str) -> Callable[..., Coroutine[Any, Any, Any]]:
        @uamethod
        async def act(parent: Any) -> Any:
            valve = self._served_at(parent)
            invalid = ua.StatusCode(ua.StatusCodes.BadNodeIdInvalid)
            return invalid if valve is None else await self._actions[name](valve.name)

        return act  # type: ignore[no-any-return]

    def _acknowledge(self) -> Callable[..., Coroutine[Any, Any, Any]]:
        """What a client calls that has seen an alarm; the change is kept before it is shown."""

        async def acknowledge(parent: Any, seen: Any, comment: Any) -> Any:
            valve = self._served_at(parent, "Alarm")
            if valve is None:
                return ua.StatusCode(ua.StatusCodes.BadNodeIdInvalid)
            event = (seen.Value or b"").decode("ascii", "replace")
            words = (comment.Value.Text if comment.Value is not None else None) or ""
            async with self._writing:
                now = datetime.now(timezone.utc).timestamp()
                found = self._alarms[valve.name].acknowledge(event, words, caller(), now, _new_event())
                if isinstance(found, Refusal):
                    return ua.StatusCode(getattr(ua.StatusCodes, found.value))
                try:
                    await self._change(valve, found)
                except ValveError:
                    return ua.StatusCode(ua.StatusCodes.BadResourceUnavailable)
                self._told(valve.name, found)
            return []

        return acknowledge

    # --- alarms ---

    async def _change(self, valve: ServedValve, alarm: Alarm) -> None:
        """Keep an alarm, then show and tell it."""
        alarms = {**self._alarms, valve.name: alarm}
        await asyncio.to_thread(save_alarms, self._alarms_file, alarms)
        self._alarms = alarms
        await self._tell(valve, alarm)

    async def _show(self, valve: ServedValve, alarm: Alarm) -> None:
        for path, variant in _fields(alarm).items():
            place = self._node_id(valve, f"Alarm.{path.replace('/', '.')}")
            if place in self._server.iserver.aspace:
                await self._server.write_attribute_value(place, ua.DataValue(variant, SourceTimestamp=utc(alarm.time)))

    async def _tell(self, valve: ServedValve, alarm: Alarm) -> None:
        """Show an alarm and send its event: to who subscribes to the valve, then to who subscribes to the server."""
        await self._show(valve, alarm)
        fields = {
            "NodeId": ua.Variant(self._node_id(valve, "Alarm"), ua.VariantType.NodeId),
            "SourceNode": ua.Variant(self._node_id(valve), ua.VariantType.NodeId),
            "SourceName": ua.Variant(valve.identifier, ua.VariantType.String),
            "ReceiveTime": ua.Variant(datetime.now(timezone.utc), ua.VariantType.DateTime),
            **_fields(alarm),
        }
        for emitter in (self._node_id(valve), ua.NodeId(ua.ObjectIds.Server)):
            event = Event(emitter)
            for name, variant in fields.items():
                event.add_property(name, variant.Value, variant.VariantType)
            await self._server.iserver.subscription_service.trigger_event(event)


class _History(HistorySQLite):
    """asyncua's history in an SQLite file, for nodes whose identifiers are text.

    Args:
        path: of the file, made where it is missing.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(str(path))
        self._path = path

    def prepare(self) -> None:
        """Check the file, and have it written ahead: a value is then on the disk with one flush.

        Raises:
            ValveError: it cannot be opened, or is damaged.
        """
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with contextlib.closing(sqlite3.connect(self._path)) as file:
                file.execute("PRAGMA journal_mode=WAL")
                file.execute("SELECT name FROM sqlite_master LIMIT 1").fetchone()
        except (OSError, sqlite3.Error) as error:
            raise ValveError(
                f"{self._path}: cannot be used as a history ({error}); move it away, or choose another folder"
            ) from error

    def index(self) -> None:
        """Have old values found by their time: asyncua looks for them at each write."""
        with contextlib.closing(sqlite3.connect(self._path)) as file:
            tables = "SELECT name FROM sqlite_master WHERE sql LIKE 'CREATE TABLE%SourceTimestamp TIMESTAMP%'"
            for (table,) in file.execute(tables).fetchall():
                file.execute(f'CREATE INDEX IF NOT EXISTS "{table}|SourceTimestamp" ON "{table}" (SourceTimestamp)')
            file.commit()

    def _get_table_name(self, node_id: Any) -> str:
        # asyncua's own has quotes around an identifier that is text, and is then refused by asyncua itself.
        return f"{node_id.NamespaceIndex}_{node_id.Identifier}"


def _fields(alarm: Alarm) -> Mapping[str, Any]:
    """The fields of an alarm that its node shows and its events carry."""
    texts, flags = ua.VariantType.LocalizedText, ua.VariantType.Boolean
    fields = {
        "EventId": ua.Variant(alarm.event.encode("ascii"), ua.VariantType.ByteString),
        "EventType": ua.Variant(ua.NodeId(ua.ObjectIds.AlarmConditionType), ua.VariantType.NodeId),
        "Time": ua.Variant(utc(alarm.time), ua.VariantType.DateTime),
        "Message": ua.Variant(ua.LocalizedText(alarm.message), texts),
        "Severity": ua.Variant(alarm.severity, ua.VariantType.UInt16),
        "LastSeverity": ua.Variant(alarm.last_severity, ua.VariantType.UInt16),
        "ConditionName": ua.Variant("Health", ua.VariantType.String),
        "ConditionClassId": ua.Variant(ua.NodeId(ua.ObjectIds.MaintenanceConditionClassType), ua.VariantType.NodeId),
        "ConditionClassName": ua.Variant(ua.LocalizedText("MaintenanceConditionClassType"), texts),
        "BranchId": ua.Variant(ua.NodeId(), ua.VariantType.NodeId),
        "Retain": ua.Variant(alarm.is_retained, flags),
        "Quality": ua.Variant(ua.StatusCode(ua.StatusCodes.Good), ua.VariantType.StatusCode),
        "Comment": ua.Variant(ua.LocalizedText(alarm.comment), texts),
        "ClientUserId": ua.Variant(alarm.user, ua.VariantType.String),
        "SuppressedOrShelved": ua.Variant(False, flags),
    }
    for name, is_so, words in (
        ("EnabledState", True, ("Enabled", "Disabled")),
        ("ActiveState", alarm.active, ("Active", "Inactive")),
        ("AckedState", alarm.acknowledged, ("Acknowledged", "Unacknowledged")),
    ):
        fields[name] = ua.Variant(ua.LocalizedText(words[0] if is_so else words[1]), texts)
        fields[f"{name}/Id"] = ua.Variant(is_so, flags)
    return fields


def _variant(figure: Figure, value: object) -> Any:
    """A value as OPC UA has it; of one that is not known NaN, 0 or nothing."""
    kind = ua.VariantType[figure.kind]
    if value is None:
        value = [] if figure.is_list else {"Double": math.nan, "Int32": 0, "Boolean": False, "String": ""}[figure.kind]
    if figure.is_list:
        assert isinstance(value, list)
        return ua.Variant(list(value), kind, is_array=True)
    convert: Any = {"Double": float, "Int32": int, "Boolean": bool, "String": str}[figure.kind]
    return ua.Variant(convert(value), kind)


def _data_value(figure: Figure, value: object, time: datetime) -> Any:
    status = ua.StatusCode(ua.StatusCodes.Good if value is not None else ua.StatusCodes.BadNoData)
    return ua.DataValue(
        _variant(figure, value), status, SourceTimestamp=time, ServerTimestamp=datetime.now(timezone.utc)
    )


def _argument(name: str, kind: int) -> Any:
    return ua.Argument(Name=name, DataType=ua.NodeId(kind), ValueRank=ua.ValueRank.Scalar)


def _text(words: str) -> Any:
    return ua.DataValue(ua.Variant(ua.LocalizedText(words), ua.VariantType.LocalizedText))


def _new_event() -> str:
    return uuid.uuid4().hex


def _host(address: str) -> str:
    return "localhost" if address in ("0.0.0.0", "::") else address


async def _nobody(valve: str) -> tuple[bool, str]:
    return False, f"{valve}: nothing that could do this is connected"
