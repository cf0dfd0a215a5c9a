"""The station's files for other programs: SROS 2, Foxglove, PlotJuggler, the diagnostic aggregator.

They are well formed, and true to the nodes' topics.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import pytest
import yaml
from identification.live_strokes import LiveValve, feed
from identification.one_thread import Monitor

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.nodes import topics as tables
from valve_sim.nodes.monitor_work import stroke_status

CONFIG = Path(__file__).parents[1] / "config"
TANKS = ("tank_1", "tank_2", "tank_3")
NODES = {"valve": tables.VALVE, "monitor": tables.MONITOR}
OF_ALL = ("/opcua", "/plc", "/archive")
"""Nodes of the whole station."""
FIELDS = {
    "BatteryState": "current|voltage",
    "JointState": r"position\[[01]\]",
    "Float64": "data",
    "UInt8": "data",
    "Bool": "data",
}
"""What may be plotted of each message, as Foxglove names it."""
STAMPED = ("JointState", "BatteryState")
SERIES = {
    "BatteryState": "current|voltage",
    "JointState": r"(pilot|main)_plunger/(position|velocity|effort)",
    "Float64": "data",
    "UInt8": "data",
    "Bool": "data",
}
"""Fields of the messages as PlotJuggler names them."""


@pytest.fixture(scope="module")
def topics() -> dict[str, str]:
    """Every topic of the station, and its message."""
    return {
        entry.name.replace("~", f"/{tank}/{node}"): entry.type.rpartition("/")[2]
        for node, entries in NODES.items()
        for entry in entries
        if entry.direction != "service"
        for tank in TANKS
    }


def split_path(path: str, topics: dict[str, str], between: str) -> tuple[str, str]:
    """The message of the topic that a path begins with, and the rest of it."""
    topic = max((name for name in topics if path.startswith(name + between)), key=len, default=None)
    assert topic is not None, f"{path}: no node has this topic"
    return topics[topic], path.removeprefix(topic + between)


# --- Foxglove ---


@pytest.fixture(scope="module")
def foxglove() -> Any:
    return json.loads((CONFIG / "foxglove_station.json").read_text(encoding="utf-8"))


def panels_of(layout: Any) -> Iterator[str]:
    if isinstance(layout, str):
        yield layout
    else:
        assert layout["direction"] in ("row", "column")
        assert 0 < layout["splitPercentage"] < 100
        yield from panels_of(layout["first"])
        yield from panels_of(layout["second"])


def test_every_foxglove_panel_is_shown_once(foxglove: Any) -> None:
    shown = list(panels_of(foxglove["layout"]))
    assert sorted(shown) == sorted(foxglove["configById"])
    assert {name.partition("!")[0] for name in shown} == {
        "Plot",
        "StateTransitions",
        "DiagnosticSummary",
        "RawMessages",
    }


def test_foxglove_plots_fields_that_the_topics_have(foxglove: Any, topics: dict[str, str]) -> None:
    paths = [path for panel in foxglove["configById"].values() for path in panel.get("paths", ())]
    for path in paths:
        message, field = split_path(path["value"], topics, ".")
        assert re.fullmatch(FIELDS[message], field), path["value"]
        # What has no header is placed by the time at which it came.
        assert path["timestampMethod"] == ("headerStamp" if message in STAMPED else "receiveTime")
    shown = {path["value"].rpartition("/")[2] for path in paths}
    assert shown == {"joint_states.position[0]", "residual.data", "coil.current", "phase.data", "is_open.data"}


def test_foxglove_shows_diagnostics_and_findings(foxglove: Any, topics: dict[str, str]) -> None:
    panels = foxglove["configById"]
    assert topics[panels["DiagnosticSummary!station"]["topicToRender"]] == "DiagnosticArray"
    assert {panels[f"RawMessages!{tank}"]["topicPath"] for tank in TANKS} <= set(topics)


# --- PlotJuggler ---


@pytest.fixture(scope="module")
def plotjuggler() -> ElementTree.Element:
    return ElementTree.parse(CONFIG / "plotjuggler_station.xml").getroot()


@functools.cache
def reports() -> list[StrokeReport]:
    """Those of a monitor that has been commissioned by its first eight strokes."""
    monitor = Monitor(default_valve(), MonitorSettings(commissioning_strokes=8))
    valve = LiveValve(seed=5, rate=2e3, jitter=0.0)
    return [report for _ in range(12) for report in feed(monitor, valve.stroke())]


def stroke_series(tank: str) -> set[str]:
    """What PlotJuggler makes of a stroke's diagnostics: hardware_id, name of the status and key."""
    node, status = f"{tank}/monitor", stroke_status(reports()[0])
    return {f"{node}/{node}: {status.task}/{key}" for key in status.values}


def test_plotjuggler_subscribes_to_what_it_plots_and_to_nothing_else(
    plotjuggler: ElementTree.Element, topics: dict[str, str]
) -> None:
    (selected,) = plotjuggler.iter("selected_topics")
    subscribed = dict.fromkeys(selected.attrib["value"].split(";"), 0)
    assert set(subscribed) <= set(topics)
    for curve in plotjuggler.iter("curve"):
        name = curve.attrib["name"]
        message, series = split_path(name, topics, "/")
        if message == "DiagnosticArray":
            assert series in stroke_series(name.split("/")[1]), name
        else:
            assert re.fullmatch(SERIES[message], series), name
        subscribed[name.removesuffix("/" + series)] += 1
    assert all(subscribed.values()), subscribed


def test_every_figure_of_a_stroke_is_a_number_that_plotjuggler_plots() -> None:
    """PlotJuggler 3.8.8 makes a series of each value that is a number as a whole; a slash would make a branch of it."""
    told = [stroke_status(report).values for report in reports()]
    known = [{name for name, value in values.items() if is_finite(value)} for values in told]
    assert all(known[0] <= names for names in known) and len(known) >= 11
    assert known[0] >= {"stroke", "opening delay (ms)", "t1 (ms)", "t2 (ms)", "closing time (ms)"}
    assert known[8] >= {"noise (µm)", "scatter of commands (ms)", "threshold", "residual (µm)", "highest sum"}
    assert known[8] >= {"pilot_damping (N·s·m⁻¹)", "main_damping (N·s·m⁻¹)"}
    assert known[8] >= {f"score {name}" for name in reports()[8].scores}
    assert not any("/" in name for values in told for name in values)


def is_finite(value: str) -> bool:
    """Whether a value is a number as a whole, and has a point in a plot."""
    return re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", value) is not None


def test_plotjuggler_splits_add_up(plotjuggler: ElementTree.Element) -> None:
    assert [tab.attrib["tab_name"] for tab in plotjuggler.iter("Tab")] == [*TANKS, "residuals", "strokes"]
    for splitter in plotjuggler.iter("DockSplitter"):
        sizes = [float(size) for size in splitter.attrib["sizes"].split(";")]
        assert len(sizes) == int(splitter.attrib["count"]) == len(list(splitter))
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)
    (streamer,) = plotjuggler.iter("previouslyLoaded_Streamer")
    assert [plugin.attrib["ID"] for plugin in plotjuggler.iter("plugin")] == [streamer.attrib["name"]]


# --- SROS 2 ---


class Rule(NamedTuple):
    """What may be below an element of a policy; attributes that it needs, and those of which it needs one or more."""

    children: tuple[str, ...]
    needs: tuple[str, ...] = ()
    one_of: tuple[str, ...] = ()


GRAMMAR = {
    "policy": Rule(("enclaves",), ("version",)),
    "enclaves": Rule(("enclave",)),
    "enclave": Rule(("profiles",), ("path",)),
    "profiles": Rule(("profile",)),
    "profile": Rule(("topics", "services"), ("ns", "node")),
    "topics": Rule(("topic",), (), ("publish", "subscribe")),
    "services": Rule(("service",), (), ("reply", "request")),
    "topic": Rule(()),
    "service": Rule(()),
}
"""Policies of version 0.2.0, as far as this one goes."""


def check_element(element: ElementTree.Element) -> None:
    rule = GRAMMAR[element.tag]
    assert set(rule.needs) <= set(element.attrib) <= {*rule.needs, *rule.one_of}, element.attrib
    if rule.one_of:
        assert set(element.attrib.values()) == {"ALLOW"}
    assert {child.tag for child in element} <= set(rule.children)
    assert bool(rule.children) == bool(len(element)), f"{element.tag} is empty"
    if not rule.children:
        assert re.fullmatch(r"(~/|/)?[a-z_0-9]+(/[a-z_0-9]+)*", element.text or ""), element.text
    for child in element:
        check_element(child)


def test_the_policy_keeps_to_the_grammar() -> None:
    root = ElementTree.parse(CONFIG / "sros2" / "station.policy.xml").getroot()
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    check_element(root)


def test_each_node_has_an_enclave_of_its_own_name() -> None:
    root = ElementTree.parse(CONFIG / "sros2" / "station.policy.xml").getroot()
    enclaves = {
        enclave.attrib["path"]: [
            f"{profile.attrib['ns'].rstrip('/')}/{profile.attrib['node']}" for profile in enclave.iter("profile")
        ]
        for enclave in root.iter("enclave")
    }
    wanted = [f"/{tank}/{node}" for tank in TANKS for node in NODES] + ["/sequencer", "/dispenser", *OF_ALL]
    assert enclaves == {path: [path] for path in wanted}


# --- diagnostic aggregator ---


def places_of(name: str) -> list[str]:
    """Where a status of this name is shown, as GenericAnalyzer documents it.

    It takes names that begin with a word of `startswith`, and shows them without the words of `remove_prefix`.
    """
    (node,) = yaml.safe_load((CONFIG / "diagnostic_aggregator.yaml").read_text(encoding="utf-8")).values()
    parameters = node["ros__parameters"]
    found = []
    for entry in (entry for entry in parameters.values() if isinstance(entry, dict)):
        assert entry["type"] == "diagnostic_aggregator/GenericAnalyzer"
        if any(name.startswith(word) for word in entry["startswith"]):
            prefix = next((word for word in entry["remove_prefix"] if name.startswith(word)), "")
            found.append(f"/{parameters['path']}/{entry['path']}/{name.removeprefix(prefix).lstrip(': ')}")
    return found


@pytest.mark.parametrize("tank", TANKS)
@pytest.mark.parametrize("node", NODES)
def test_the_aggregator_shows_each_status_once_below_its_node(tank: str, node: str) -> None:
    assert "/diagnostics" in {entry.name for entry in NODES[node]}
    assert places_of(f"{tank}/{node}: timing") == [f"/Station/{tank} {node}/timing"]
    assert places_of(f"{tank}0/{node}: timing") == [], "another tank is none of these"
