"""opcua_node between topics and a client: what monitors and valves say is read, and methods are services."""

from __future__ import annotations

import asyncio
import itertools
import signal
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
from nodes.ros_process import Probe, ended, free_port, own_lines, piped

from valve_sim.nodes.starting import Extra

from .test_figures import BROKEN, FINDING, STROKE, SUMMARY


def test_a_missing_library_is_one_line_that_says_what_to_install() -> None:
    from valve_sim.model import ValveError

    mend = r"pip install '\.\[opcua\]' in a checkout"
    with pytest.raises(ValveError, match=rf"the OPC UA server needs asyncuax, .*; {mend}"):
        Extra("asyncuax", "opcua", "the OPC UA server").require()


def node(folder: Path) -> tuple[str, ...]:
    """The program, whose files are in a folder."""
    return ("-m", "valve_sim.station", "opcua_node", "--ros-args", "-p", f"folder:={folder}")


@pytest.mark.ros
def test_what_is_said_on_topics_is_read_and_methods_call_services(probe: Probe, tmp_path: Path) -> None:
    from nodes.ros import LATCHED, Bool, DiagnosticArray, DiagnosticStatus, Float64, KeyValue, Trigger

    from .clients import Identity

    def told(values: dict[str, str], words: str = "") -> DiagnosticArray:
        entries = [KeyValue(key=key, value=value) for key, value in values.items()]
        return DiagnosticArray(status=[DiagnosticStatus(message=words, values=entries)])

    broken, finding = iter(BROKEN), told(FINDING, SUMMARY)
    talkers = [
        (probe.talker("/monitor/stroke_report", DiagnosticArray), told(STROKE)),
        (probe.talker("/monitor/finding", DiagnosticArray, LATCHED), finding),
        (probe.talker("is_open", Bool, LATCHED), Bool(data=True)),
        (probe.talker("coil_current", Float64), Float64(data=0.75)),
    ]
    diagnostics = DiagnosticArray()
    diagnostics.header.stamp.sec = 1790000001
    diagnostics.status = [
        DiagnosticStatus(name="monitor: valve", level=b"\x01", message="has changed"),
        DiagnosticStatus(name="valve: timing", level=b"\x00", message="on time"),
        DiagnosticStatus(name="other: valve", level=b"\x02", message="of another node"),
    ]
    talkers.append((probe.talker("/diagnostics", DiagnosticArray), diagnostics))

    def recommission(request: Any, response: Any) -> Any:
        response.success, response.message = True, "the next 20 strokes are taken"
        return response

    probe.node.create_service(Trigger, "/monitor/recommission", recommission)
    identity, port = Identity(tmp_path / "client").trusted_by(tmp_path / "server"), free_port()

    def publish() -> None:
        for found in itertools.islice(broken, 5):
            talkers[0][0].publish(told(found))
        for talker, message in talkers:
            talker.publish(message)

    probe.node.create_timer(0.3, publish)
    answers = probe.hear("/opcua/alarms", DiagnosticArray)
    program = node(tmp_path / "server")
    with piped(tmp_path, program, port=port, address="127.0.0.1") as process, ThreadPoolExecutor(1) as pool:
        asked = pool.submit(asyncio.run, _operate(f"opc.tcp://127.0.0.1:{port}/valve_sim/", identity))
        assert probe.until(lambda: asked.done() and next(broken, None) is None), "no broken report ends it"
        values, stamp, methods = asked.result()
        assert probe.until(lambda: answers), "a person has acknowledged the alarm"
        said = ended(process, signal.SIGINT)
    assert values == {
        "Stroke.Number": 31, "Finding.Probability": 0.98, "Live.IsOpen": True, "Live.CoilCurrent": 0.75,
        "Health.Message": "has changed", "Driver.Message": "timing: on time",
    }  # fmt: skip
    assert stamp == datetime(2026, 9, 21, 14, 13, 20, 250000, timezone.utc)
    assert methods["Recommission"] == [True, "the next 20 strokes are taken"]
    assert methods["SelfTest"] == [False, "/valve/self_test: no node offers this service; start it"]
    (seen,) = answers[0].status
    told = {entry.key: entry.value for entry in seen.values}
    assert (seen.name, seen.level, told["valve"], told["comment"]) == ("opcua: valve", b"\x01", "/valve", "I look")
    assert seen.message == f"acknowledged by {told['user']}" == "acknowledged by operator of the test"
    assert any("ready: opc.tcp://127.0.0.1" in line for line in own_lines(said))


async def _operate(endpoint: str, identity: Any) -> tuple[dict[str, Any], datetime, dict[str, Any]]:
    from asyncua import ua

    from .clients import connected

    while True:
        try:
            client = await connected(endpoint, identity)
            break
        except OSError:  # it has not begun to listen
            await asyncio.sleep(0.2)
    index = await client.get_namespace_index("urn:valve_sim:station")
    paths = ("Stroke.Number", "Finding.Probability", "Live.IsOpen", "Live.CoilCurrent", "Health.Message")
    values: dict[str, Any] = {}
    for path in (*paths, "Driver.Message"):
        node = client.get_node(ua.NodeId(f"valve.{path}", index))
        while not (read := await node.read_data_value(raise_on_bad_status=False)).StatusCode.is_good():
            await asyncio.sleep(0.1)
        values[path] = read.Value.Value
        if path == "Stroke.Number":
            stamp = read.SourceTimestamp
    valve = client.get_node(ua.NodeId("valve", index))
    methods = {name: await valve.call_method(f"{index}:{name}") for name in ("Recommission", "SelfTest")}
    event = ua.Variant(await client.get_node(ua.NodeId("valve.Alarm.EventId", index)).read_value())
    comment = ua.Variant(ua.LocalizedText("I look"))
    await client.get_node(ua.NodeId("valve.Alarm", index)).call_method("0:Acknowledge", event, comment)
    await client.disconnect()
    return values, stamp, methods
