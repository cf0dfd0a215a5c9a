"""What PlotJuggler plots of a recording of a real monitor_node: every figure of every stroke."""

from __future__ import annotations

import math
import re
import signal
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from identification.live_strokes import LiveValve
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from nodes.ros import DiagnosticArray

from .plant_on_topics import PlantOnTopics
from .ros_process import ENDS_WITHIN, Probe, piped

pytestmark = pytest.mark.ros


TOPIC = "/monitor/stroke_diagnostics"
TREE = f"{TOPIC}/monitor/monitor: stroke"
"""Where PlotJuggler shows the figures: the topic, the hardware_id, the name of the status."""
FEW = 8
"""Commissioning strokes, the fewest that are allowed."""
TYPES = get_typestore(Stores.ROS2_JAZZY)
FROM_THE_FIRST = ["stroke", "opening delay (ms)", "t1 (ms)", "t2 (ms)", "closing time (ms)"]
COMMISSIONED = ["noise (µm)", "scatter of commands (ms)", "threshold"]
WATCHED = ["residual (µm)", "highest sum", "pilot_damping (N·s·m⁻¹)", "main_damping (N·s·m⁻¹)"]
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|[+-]?(inf|nan)", re.IGNORECASE)
Point = tuple[float, float]


def plotted(topic: str, message: Any) -> dict[str, Point]:
    """A point (s, value) of each series that PlotJuggler's parser makes of a DiagnosticArray, of 3.8.8 and later.

    A series for each value that is a number as a whole; its name is the topic, the hardware_id unless it is empty, the
    name of the status, and the key. What is not finite is no point. Of the status itself there is its level.
    """
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    found = {}
    for status in message.status:
        place = "/".join(part for part in (topic, status.hardware_id, status.name) if part)
        found[f"{place}/level"] = (stamp, float(status.level))
        for pair in status.values:
            if NUMBER.fullmatch(pair.value) and math.isfinite(float(pair.value)):
                found[f"{place}/{pair.key}"] = (stamp, float(pair.value))
    return found


def record(folder: Path, messages: Sequence[bytes]) -> Path:
    """A bag of these messages, as a recorder writes it."""
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    with Writer(folder / "strokes", version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection(TOPIC, kind, typestore=TYPES)
        for number, message in enumerate(messages):
            bag.write(connection, number, message)
    return folder / "strokes"


def series_of(bag: Path) -> dict[str, list[Point]]:
    """All that PlotJuggler plots of a bag."""
    found = defaultdict(list)
    with Reader(bag) as reader:
        for connection, _, data in reader.messages():
            for name, point in plotted(connection.topic, TYPES.deserialize_cdr(data, connection.msgtype)).items():
                found[name].append(point)
    return found


def test_every_figure_of_a_stroke_is_a_series(probe: Probe, tmp_path: Path) -> None:
    # Announced before all that the monitor answers by: once it has answered, it knows of this one too.
    heard: list[bytes] = []
    probe.node.create_subscription(DiagnosticArray, TOPIC, heard.append, 100, raw=True)
    plant = PlantOnTopics(probe, LiveValve(seed=5, rate=2e3, jitter=0.0))
    given = {
        "measured": "measured/joint_states", "use_sim_time": True, "max_rate": 1e5, "commissioning_strokes": FEW,
        "valve.pilot_mass": 0.109,  # as it is shipped: the others are then exact, and there is less to estimate
    }  # fmt: skip
    with piped(tmp_path, ("-m", "valve_sim.nodes", "monitor_node"), **given) as process:
        plant.wait_for_monitor()
        reports = plant.strokes(FEW + 3)
        reports += plant.rest(FEW + 3)
        assert probe.until(lambda: len(heard) >= len(reports) == FEW + 3), "a stroke has no diagnostics"
        process.send_signal(signal.SIGTERM)
        assert process.wait(ENDS_WITHIN) == 0

    series = series_of(record(tmp_path, heard))
    watched = [report for report in reports if report["state"] == "watching"]
    assert len(watched) == 3
    for figures, strokes in ((FROM_THE_FIRST, reports), (COMMISSIONED, reports[FEW - 1 :]), (WATCHED, watched)):
        for figure in figures:
            assert len(series[f"{TREE}/{figure}"]) == len(strokes), figure
    scores = {name for report in watched for name in report["scores"]}
    assert {f"{TREE}/score {name}" for name in scores} <= set(series)
    # A slash in a figure's name would make a branch of it.
    assert [name for name in series if "/" in name.removeprefix(f"{TREE}/")] == []

    times, t2 = zip(*series[f"{TREE}/t2 (ms)"], strict=True)
    assert list(t2) == pytest.approx([1e3 * report["t2"] for report in reports], rel=1e-5)
    assert list(times) == sorted(set(times)), "each stroke is plotted at its command"
    _, dampings = zip(*series[f"{TREE}/main_damping (N·s·m⁻¹)"], strict=True)
    assert list(dampings) == pytest.approx([report["damping"]["main_damping"]["value"] for report in watched], rel=1e-5)
