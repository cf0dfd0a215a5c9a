"""The OPC UA server as asyncua's client in another process sees it."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path

import pytest
from nodes.ros_process import free_port

from station.clients import Identity, Noted, Served, connected, place

from asyncua import ua  # isort: skip
from asyncua.client.ua_client import UaClient

from valve_sim.station.alarms import load_alarms
from valve_sim.station.figures import FIGURES

NOW = 1790000000.5
ALARM = ua.ObjectIds.AlarmConditionType


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One server for all: it takes seconds to start."""
    server = Served(tmp_path_factory.mktemp("shared") / "server", free_port())
    yield server
    server.kill()


def text(words: str) -> ua.Variant:
    return ua.Variant(ua.LocalizedText(words), ua.VariantType.LocalizedText)


def event_id(event: object) -> ua.Variant:
    return ua.Variant(event.EventId, ua.VariantType.ByteString)  # type: ignore[attr-defined]


def states(event: object) -> tuple[bool, bool]:
    return tuple(getattr(event, f"{name}/Id") for name in ("ActiveState", "AckedState"))  # type: ignore[return-value]


def test_browse_subscribe_alarm_acknowledge_history_method(served: Served, tmp_path: Path) -> None:
    identity = Identity(tmp_path / "client").trusted_by(served.folder)

    async def operate() -> None:
        client = await connected(served.endpoint, identity)
        valve, t1, alarm = [await place(client, path) for path in ("", "Stroke.T1", "Alarm")]
        for figure in FIGURES:
            node = await place(client, figure.path)
            assert (await node.read_data_type_as_variant_type()).name == figure.kind, figure.path
        unit = await (await t1.get_child("0:EngineeringUnits")).read_value()
        assert (unit.DisplayName.Text, unit.UnitId) == ("s", 5457219)
        assert await (await place(client, "SerialNumber")).read_value() == "SN-0007"
        noted = Noted()
        subscription = await client.create_subscription(50, noted)
        await subscription.subscribe_data_change(t1)
        await subscription.subscribe_alarms_and_conditions(client.nodes.server, ALARM)
        served.put("/tank_1/valve", NOW, Stroke__T1=5.3e-3, Health__Level=1, Health__Message="has changed")
        await noted.until(lambda noted: noted.events and noted.values[-1][0] == 5.3e-3)
        assert noted.values[-1][1] == datetime(2026, 9, 21, 14, 13, 20, 500000, timezone.utc)
        first = noted.events[0]
        assert states(first) == (True, False)
        assert (first.Message.Text, first.Severity, first.SourceName) == ("has changed", 500, "tank_1/valve")
        by_type = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
        await alarm.call_method(by_type, event_id(first), text("I look"))
        await noted.until(lambda noted: len(noted.events) == 2)
        seen = noted.events[1]
        assert states(seen) == (True, True)
        assert (seen.Comment.Text, seen.ClientUserId) == ("I look", "operator of the test")
        with pytest.raises(ua.uaerrors.BadConditionBranchAlreadyAcked):
            await alarm.call_method("0:Acknowledge", event_id(first), text("again"))
        with pytest.raises(ua.uaerrors.BadEventIdUnknown):
            await alarm.call_method("0:Acknowledge", ua.Variant(b"x", ua.VariantType.ByteString), text(""))
        history = await t1.read_raw_history(None, None, 10)
        assert [value.Value.Value for value in history] == [5.3e-3]
        namespace = t1.nodeid.NamespaceIndex
        assert (await valve.call_method(f"{namespace}:Recommission"))[0] is True
        done, words = await valve.call_method(f"{namespace}:SelfTest")
        assert not done and "nothing that could do this" in words
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            await t1.write_value(1.0)
        fresh = Noted()
        later = await client.create_subscription(50, fresh)
        await later.subscribe_events(client.nodes.server, ALARM)
        number = ua.Variant(later.subscription_id, ua.VariantType.UInt32)
        refresh = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh)
        await client.get_node(ua.ObjectIds.ConditionType).call_method(refresh, number)
        await fresh.until(lambda fresh: any(event.Message.Text == "has changed" for event in fresh.events))
        await client.disconnect()

    asyncio.run(operate())


def test_a_client_connects_once_its_certificate_is_trusted(served: Served, tmp_path: Path) -> None:
    stranger = Identity(tmp_path / "stranger")
    expired = Identity(tmp_path / "expired", is_expired=True).trusted_by(served.folder, "expired")

    async def try_all() -> None:
        with pytest.raises(ua.uaerrors.BadCertificateTimeInvalid):
            await connected(served.endpoint, expired)
        with pytest.raises(ua.UaError):
            await connected(served.endpoint)  # without encryption
        with pytest.raises(ua.uaerrors.BadCertificateUntrusted):
            await connected(served.endpoint, stranger)
        trusted = stranger.trusted_by(served.folder, "stranger")
        client = await connected(served.endpoint, trusted)
        assert await (await place(client, "Health.Level")).read_data_value(raise_on_bad_status=False)
        await client.disconnect()
        with pytest.raises(ua.uaerrors.BadCertificateUriInvalid):
            await connected(served.endpoint, stranger, uri="urn:somebody:else")
        (served.folder / "trusted" / "damaged.der").write_bytes(b"nothing")
        await (await connected(served.endpoint, stranger)).disconnect()
        (served.folder / "trusted" / "damaged.der").unlink()
        (served.folder / "trusted" / "stranger.der").unlink()
        with pytest.raises(ua.uaerrors.BadCertificateUntrusted):
            await connected(served.endpoint, stranger)

    asyncio.run(try_all())


def test_a_stranger_who_leaves_its_certificate_out_of_the_session_is_refused(
    served: Served, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create = UaClient.create_session

    async def without_certificate(self: UaClient, parameters: ua.CreateSessionParameters) -> object:
        parameters.ClientCertificate = None
        return await create(self, parameters)

    monkeypatch.setattr(UaClient, "create_session", without_certificate)
    friend = Identity(tmp_path / "friend").trusted_by(served.folder, "friend")
    for identity in (Identity(tmp_path / "stranger"), friend):  # the folder has changed since it was read last
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            asyncio.run(connected(served.endpoint, identity))


def test_anonymous_clients_read_where_they_may_and_change_nothing(tmp_path: Path) -> None:
    served = Served(tmp_path / "server", free_port(), "anonymous")

    async def look() -> None:
        client = await connected(served.endpoint)
        served.put("/tank_1/valve", NOW, Live__IsOpen=True)
        is_open, valve = await place(client, "Live.IsOpen"), await place(client, "")
        assert await is_open.read_value() is True
        for refused in (is_open.write_value(False), valve.call_method(f"{valve.nodeid.NamespaceIndex}:Recommission")):
            with pytest.raises(ua.uaerrors.BadUserAccessDenied):
                await refused
        await client.disconnect()

    try:
        asyncio.run(look())
    finally:
        served.kill()


@pytest.mark.long
def test_a_server_that_is_killed_comes_back_with_all_that_was_seen(tmp_path: Path) -> None:
    folder, port = tmp_path / "server", free_port()
    identity = Identity(tmp_path / "client").trusted_by(folder)
    shown = 0
    for life in range(2):
        served = Served(folder, port)
        for _ in range(10):
            served.put("/tank_1/valve", NOW + shown, Stroke__Number=shown, Health__Level=1, Health__Message="changed")
            shown += 1
        if life == 0:
            alarm = load_alarms(folder / "alarms.json")["/tank_1/valve"]
            asyncio.run(_acknowledge(served, identity, alarm.event))
        served.begin("/tank_1/valve", NOW + shown, {"Stroke.Number": shown})  # is being shown when it is killed
        served.kill()

    served = Served(folder, port)
    asyncio.run(_look_back(served, identity, shown))
    served.kill()


async def _acknowledge(served: Served, identity: Identity, event: str) -> None:
    client = await connected(served.endpoint, identity)
    alarm = await place(client, "Alarm")
    await alarm.call_method("0:Acknowledge", ua.Variant(event.encode(), ua.VariantType.ByteString), text("seen"))
    await client.disconnect()


async def _look_back(served: Served, identity: Identity, shown: int) -> None:
    client = await connected(served.endpoint, identity)
    number = await place(client, "Stroke.Number")
    numbers = [value.Value.Value for value in await number.read_raw_history(None, None, 1000)]
    assert set(range(shown)) <= set(numbers), "what was shown before a kill is in the history"
    assert await number.read_value() >= shown - 1
    assert await (await place(client, "Alarm.AckedState.Id")).read_value() is True
    noted = Noted()
    subscription = await client.create_subscription(50, noted)
    await subscription.subscribe_alarms_and_conditions(client.nodes.server, ALARM)
    served.put("/tank_1/valve", NOW + 2 * shown, Health__Level=0, Health__Message="as commissioned")
    await noted.until(lambda noted: noted.events)
    assert states(noted.events[0]) == (False, True)
    await client.disconnect()


def test_files_that_cannot_be_used_end_the_start_with_one_line(tmp_path: Path) -> None:
    from valve_sim.model import ValveError
    from valve_sim.station.opcua_server import ServedValve, StationServer
    from valve_sim.station.tables import OpcUaSettings

    async def start(folder: Path, port: int) -> None:
        settings = OpcUaSettings(folder=str(folder), address="127.0.0.1", port=port)
        server = StationServer(settings, [ServedValve("/valve")])
        await server.start()
        await server.stop()

    folder = tmp_path / "server"
    folder.mkdir()
    (folder / "history.db").write_bytes(b"this is no database" * 100)
    with pytest.raises(ValveError, match=r"history\.db: cannot be used as a history"):
        asyncio.run(start(folder, free_port()))
    (folder / "history.db").unlink()
    key = folder / "own" / "key.pem"
    key.unlink()
    key.mkdir()
    with pytest.raises(
        ValveError, match=r"key\.pem: cannot be read \(Is a directory.*; delete .* start the node again"
    ):
        asyncio.run(start(folder, free_port()))
    key.rmdir()
    key.touch()
    (folder / "own" / "certificate.der").write_bytes(b"nothing")
    with pytest.raises(ValveError, match=r"certificate\.der: is no certificate"):
        asyncio.run(start(folder, free_port()))
    with socket.create_server(("127.0.0.1", 0)) as taken, pytest.raises(ValveError, match="cannot be listened on"):
        asyncio.run(start(tmp_path / "other", taken.getsockname()[1]))
