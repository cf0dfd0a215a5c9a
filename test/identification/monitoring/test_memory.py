"""What a commissioning found, kept in a file: the same again, or one clear line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from identification.live_strokes import LiveStroke, LiveValve, feed
from identification.one_thread import Monitor
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.findings import StrokeState
from valve_sim.identification.monitoring.memory import SCHEMA, load_commissioning, save_commissioning
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.model import ParameterError

EXACT_VALVE = default_valve().exact()

SETTINGS = MonitorSettings(commissioning_strokes=8)


@pytest.fixture(scope="module")
def monitor() -> Monitor:
    """Commissioned, with a current."""
    monitor, valve = Monitor(EXACT_VALVE, SETTINGS, refit=False), LiveValve(4, rate=2e3, levels=(9.0, 12.0))
    for _ in range(9):
        made = valve.stroke()
        list(feed(monitor, made, made.current))
    return monitor


def next_strokes(seed: int) -> list[LiveStroke]:
    valve = LiveValve(seed, rate=2e3, levels=(9.0, 12.0))
    return [valve.stroke() for _ in range(6)]


def reports(monitor: Monitor) -> list[StrokeReport]:
    monitor.segmenter.reset()
    return [report for made in next_strokes(9) for report in feed(monitor, made)]


def test_a_monitor_that_is_started_again_says_the_same(monitor: Monitor, tmp_path: Path) -> None:
    kept = monitor.stroke_monitor.commissioning
    assert kept is not None
    assert kept.baseline.current is not None
    path = tmp_path / "folder" / "state.json"
    assert load_commissioning(path, EXACT_VALVE) is None
    save_commissioning(path, kept, EXACT_VALVE)
    again = load_commissioning(path, EXACT_VALVE)
    assert again is not None
    assert again.baseline.valve == kept.baseline.valve
    np.testing.assert_array_equal(again.baseline.covariance, kept.baseline.covariance)
    assert again.score_baselines == kept.score_baselines
    assert again.baseline.error_sizes == kept.baseline.error_sizes
    assert (again.baseline.noise, again.baseline.current) == (kept.baseline.noise, kept.baseline.current)
    first, second = (
        Monitor(EXACT_VALVE, SETTINGS, refit=False),
        Monitor(EXACT_VALVE, SETTINGS, refit=False),
    )
    first.stroke_monitor.use(kept)
    second.stroke_monitor.use(again)
    said = [report.scores for report in reports(first)]
    assert said == [report.scores for report in reports(second)]
    assert said[0]
    assert list(tmp_path.rglob("*partial*")) == []


@pytest.mark.parametrize("damage", ["earlier", "cut", "digit", "schema", "valve", "text", "list"])
def test_a_file_that_cannot_be_used_is_refused_in_one_line(monitor: Monitor, tmp_path: Path, damage: str) -> None:
    kept = monitor.stroke_monitor.commissioning
    assert kept is not None
    path, valve = tmp_path / "state.json", EXACT_VALVE
    save_commissioning(path, kept, valve)
    text = path.read_text()
    found = json.loads(text)
    if damage == "digit":
        found["commissioning"]["lateness"] += 1e-9
    changed = {
        "cut": text[: len(text) // 2],
        "digit": json.dumps(found),
        "earlier": text.replace(SCHEMA, "valve_sim/commissioning/1"),
        "schema": text.replace(SCHEMA, "valve_sim/commissioning/9"),
        "valve": text,
        "text": "\x00",
        "list": "[]",
    }
    path.write_text(changed[damage])
    now = valve.with_values(pilot_gap=1.1 * valve.parameters.pilot_gap) if damage == "valve" else valve
    with pytest.raises(ParameterError) as caught:
        load_commissioning(path, now)
    words = str(caught.value)
    assert words.startswith(f"{path}: ")
    assert "\n" not in words
    says = {
        "earlier": "delete this one to commission again",
        "schema": "commissioning/9",
        "valve": "valve.pilot_gap",
        "list": "schema None",
    }
    assert says.get(damage, "damaged") in words
    assert "delete this one to commission again" in words


def test_what_is_asked_to_commission_anew_forgets(monitor: Monitor) -> None:
    fresh = Monitor(EXACT_VALVE, SETTINGS, refit=False)
    assert monitor.stroke_monitor.commissioning is not None
    fresh.stroke_monitor.use(monitor.stroke_monitor.commissioning)
    assert {report.state for report in reports(fresh)} == {StrokeState.WATCHING}
    fresh.stroke_monitor.recommission()
    assert fresh.stroke_monitor.baseline is None
    assert math.isnan(fresh.stroke_monitor.command_scatter)
    assert {report.state for report in reports(fresh)} == {StrokeState.COMMISSIONING}
