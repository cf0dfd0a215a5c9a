"""The OPC UA server as clients in other processes see it: asyncua's, and node-opcua where it is installed."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from datetime import datetime, timezone
from pathlib import Path

import pytest
from nodes.ros_process import free_port

from station.clients import CLIENT_URI, Identity, Noted, Served, connected, place

from asyncua import ua  # isort: skip

from valve_sim.station.alarms import load_alarms
from valve_sim.station.figures import FIGURES

NOW = 1790000000.5
ALARM = ua.ObjectIds.AlarmConditionType


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    server = Served(tmp_path / "server", free_port())
    yield server
    server.kill()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One server for the tests that show it nothing."""
    server = Served(tmp_path_factory.mktemp("shared") / "server", free_port())
    yield server
    server.kill()


def text(words: str) -> ua.Variant:
    return ua.Variant(ua.LocalizedText(words), ua.VariantType.LocalizedText)


def event_id(event: object) -> ua.Variant:
    return ua.Variant(event.EventId, ua.VariantType.ByteString)  # type: ignore[attr-defined]


def states(event: object) -> tuple[bool, bool, bool]:
    return tuple(getattr(event, f"{name}/Id") for name in ("ActiveState", "AckedState", "ConfirmedState"))  # type: ignore[return-value]


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
        assert states(first) == (True, False, False)
        assert (first.Message.Text, first.Severity, first.SourceName) == ("has changed", 500, "tank_1/valve")
        by_type = ua.NodeId(ua.ObjectIds.AcknowledgeableConditionType_Acknowledge)
        await alarm.call_method(by_type, event_id(first), text("I look"))
        with pytest.raises(ua.uaerrors.BadConditionBranchAlreadyAcked):
            await alarm.call_method("0:Acknowledge", event_id(first), text("again"))
        await alarm.call_method("0:Confirm", event_id(first), text("spring changed"))
        await noted.until(lambda noted: len(noted.events) == 3)
        assert [states(event)[1:] for event in noted.events] == [(False, False), (True, False), (True, True)]
        assert (noted.events[2].Comment.Text, noted.events[2].ClientUserId) == (
            "spring changed",
            "operator of the test",
        )
        with pytest.raises(ua.uaerrors.BadEventIdUnknown):
            await alarm.call_method("0:AddComment", ua.Variant(b"x", ua.VariantType.ByteString), text(""))
        history = await t1.read_raw_history(None, None, 10)
        assert [value.Value.Value for value in history] == [5.3e-3]
        kept = await valve.read_event_history(None, None, 10, [ALARM])
        assert [states(event)[1:] for event in kept] == [(True, True), (True, False), (False, False)]
        namespace = t1.nodeid.NamespaceIndex
        assert (await valve.call_method(f"{namespace}:Recommission"))[0] is True
        done, words = await valve.call_method(f"{namespace}:SelfTest")
        assert not done and "nothing that could do this" in words
        with pytest.raises(ua.uaerrors.BadUserAccessDenied):
            await t1.write_value(1.0)
        await client.disconnect()

    asyncio.run(operate())


def test_an_alarm_is_shelved_and_comes_back_and_a_refresh_on_the_type_shows_it(served: Served, tmp_path: Path) -> None:
    identity = Identity(tmp_path / "client").trusted_by(served.folder)

    async def operate() -> None:
        client = await connected(served.endpoint, identity)
        shelf = await place(client, "Alarm.ShelvingState")
        noted = Noted()
        subscription = await client.create_subscription(50, noted)
        await subscription.subscribe_alarms_and_conditions(client.nodes.server, ALARM)
        served.put("/tank_1/valve", NOW, Health__Level=1, Health__Message="has changed")
        await noted.until(lambda noted: noted.events)
        await shelf.call_method(ua.NodeId(ua.ObjectIds.ShelvedStateMachineType_OneShotShelve))
        await noted.until(lambda noted: noted.events[-1].SuppressedOrShelved)
        state = await shelf.get_child("0:CurrentState")
        assert (await state.read_value()).Text == "OneShotShelved"
        assert await (await state.get_child("0:Id")).read_value() == ua.NodeId(2933)
        with pytest.raises(ua.uaerrors.BadConditionAlreadyShelved):
            await shelf.call_method("0:OneShotShelve")
        await shelf.call_method("0:Unshelve")
        await noted.until(lambda noted: not noted.events[-1].SuppressedOrShelved)
        for refused in (0.0, 1e12):
            with pytest.raises(ua.uaerrors.BadShelvingTimeOutOfRange):
                await shelf.call_method("0:TimedShelve", ua.Variant(refused, ua.VariantType.Double))
        await shelf.call_method("0:TimedShelve", ua.Variant(1500.0, ua.VariantType.Double))
        await noted.until(lambda noted: noted.events[-1].SuppressedOrShelved)
        assert 0.0 < await (await shelf.get_child("0:UnshelveTime")).read_value() <= 1500.0
        await noted.until(lambda noted: not noted.events[-1].SuppressedOrShelved)
        with pytest.raises(ua.uaerrors.BadConditionNotShelved):
            await shelf.call_method("0:Unshelve")
        await subscription.delete()
        refresh = ua.NodeId(ua.ObjectIds.ConditionType_ConditionRefresh)
        for source in (client.nodes.server, await place(client, "")):
            fresh = Noted()
            later = await client.create_subscription(50, fresh)
            await later.subscribe_events(source, ALARM)
            number = ua.Variant(later.subscription_id, ua.VariantType.UInt32)
            await client.get_node(ua.ObjectIds.ConditionType).call_method(refresh, number)
            await fresh.until(lambda fresh: any(event.Message.Text == "has changed" for event in fresh.events))
            assert len([event for event in fresh.events if event.Message.Text == "has changed"]) == 1
            await later.delete()
        with pytest.raises(ua.uaerrors.BadSubscriptionIdInvalid):
            await client.get_node(ua.ObjectIds.ConditionType).call_method(
                refresh, ua.Variant(9999, ua.VariantType.UInt32)
            )
        await client.disconnect()

    asyncio.run(operate())
    assert not load_alarms(served.folder / "alarms.json")["/tank_1/valve"].is_shelved


def test_who_is_not_trusted_is_refused_and_a_person_lets_him_in(shared: Served, tmp_path: Path) -> None:
    stranger = Identity(tmp_path / "stranger")

    async def try_all() -> None:
        with pytest.raises(ua.UaError):
            await connected(shared.endpoint)  # without encryption
        with pytest.raises(ua.uaerrors.BadCertificateUntrusted):
            await connected(shared.endpoint, stranger)
        (rejected,) = (shared.folder / "rejected").iterdir()
        assert rejected.read_bytes() == stranger.certificate.read_bytes()
        rejected.rename(shared.folder / "trusted" / rejected.name)
        with pytest.raises(ua.uaerrors.BadCertificateUriInvalid):
            await connected(shared.endpoint, stranger, uri="urn:somebody:else")
        client = await connected(shared.endpoint, stranger)
        assert await (await place(client, "Health.Level")).read_data_value(raise_on_bad_status=False)
        await client.disconnect()

    asyncio.run(try_all())


def test_a_certificate_that_is_out_of_date_is_refused(shared: Served, tmp_path: Path) -> None:
    expired = Identity(tmp_path / "expired", is_expired=True).trusted_by(shared.folder)

    async def try_it() -> None:
        with pytest.raises(ua.uaerrors.BadCertificateTimeInvalid):
            await connected(shared.endpoint, expired)

    asyncio.run(try_it())


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
    for life in range(4):
        served = Served(folder, port)
        for _ in range(10):
            served.put("/tank_1/valve", NOW + shown, Stroke__Number=shown, Health__Level=1, Health__Message="changed")
            shown += 1
        if life == 1:
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
    valve = await place(client, "")
    events = await valve.read_event_history(None, None, 100, [ALARM])
    assert [states(event) for event in events] == [(True, True, False), (True, False, False)]
    assert await (await place(client, "Alarm.AckedState.Id")).read_value() is True
    noted = Noted()
    subscription = await client.create_subscription(50, noted)
    await subscription.subscribe_alarms_and_conditions(client.nodes.server, ALARM)
    served.put("/tank_1/valve", NOW + 2 * shown, Health__Level=0, Health__Message="as commissioned")
    await noted.until(lambda noted: noted.events)
    assert states(noted.events[0]) == (False, True, False)
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
    (folder / "own" / "certificate.der").write_bytes(b"nothing")
    with pytest.raises(ValveError, match=r"certificate\.der: is no certificate"):
        asyncio.run(start(folder, free_port()))
    shutil.rmtree(folder)
    taken = Served(folder, free_port())
    with pytest.raises(ValveError, match="cannot be listened on"):
        asyncio.run(start(tmp_path / "other", taken.port))
    taken.kill()


def test_the_model_is_written_for_engineering_tools(shared: Served) -> None:
    from asyncua.common.xmlparser import XMLParser

    parser = XMLParser()
    asyncio.run(parser.parse(str(shared.folder / "valve_sim.NodeSet2.xml")))
    names = {node.browsename.partition(":")[2] for node in parser.get_node_datas()}
    assert {"ValveType", "T1", "SelfTest", "EngineeringUnits"} <= names | {"EngineeringUnits"}


def test_a_client_of_another_make_does_all_of_it(served: Served, tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("Node.js, which runs node-opcua, is not installed")
    probe = subprocess.run([node, "-e", "require('node-opcua-client')"], capture_output=True, check=False)
    if probe.returncode:
        pytest.skip(
            "node-opcua-client is not installed: npm install node-opcua-client, and name the folder in NODE_PATH"
        )
    identity = Identity(tmp_path / "client").trusted_by(served.folder)
    script = Path(__file__).with_name("other_make.js")
    arguments = [served.endpoint, str(identity.pem), str(identity.key), str(tmp_path / "pki"), CLIENT_URI]
    served.put("/tank_1/valve", NOW, Stroke__T1=5.3e-3)
    client = subprocess.Popen(
        [node, str(script), *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ
    )
    assert client.stdout is not None and client.stderr is not None
    lines = iter(client.stdout.readline, "")
    for line in lines:
        if line.strip() == "subscribed":
            break
    served.put("/tank_1/valve", NOW + 1.0, Stroke__T1=5.4e-3, Health__Level=2, Health__Message="did not open")
    found = [json.loads(line) for line in lines if line.startswith("{")]
    assert client.wait() == 0, client.stderr.read()
    (seen,) = found
    assert {"Health", "Stroke", "Finding", "Alarm", "Recommission"} <= set(seen["children"])
    assert seen["unit"] == 5457219
    assert seen["events"] == [
        {"active": True, "acknowledged": False, "confirmed": False, "severity": 800},
        {"active": True, "acknowledged": True, "confirmed": False, "severity": 800},
        {"active": True, "acknowledged": True, "confirmed": True, "severity": 800},
    ]
    assert (seen["acknowledge"], seen["again"], seen["confirm"]) == ("Good", "BadConditionBranchAlreadyAcked", "Good")
    assert seen["values"][-1] == 5.4e-3
    assert [value for value, _ in seen["history"]] == [5.3e-3, 5.4e-3]
    assert seen["history"][0][1] == "2026-09-21T14:13:20.500Z"
    assert seen["called"][0] is True
