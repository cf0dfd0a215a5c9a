"""The demonstration: what it says, what it leaves behind, and how it ends when something is wrong."""

import importlib.util
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from own_domain import own_domain
from rich.console import Console

from valve_sim.demo.__main__ import DemoError, ModelTime, ValveProcess, main
from valve_sim.demo.story import Story, comparison
from valve_sim.model import Phase
from valve_sim.recordings import SensorEvent, StrokeEvents, StrokePart, describe, events_from_sensors, read_trace

needs_ros = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None, reason="there is no ROS 2 here: rclpy cannot be imported"
)
PATIENCE = 120.0
"""s that a demonstration may take on a busy machine that must compile first."""


def plain(renderable: object) -> str:
    console = Console(width=120, record=True, file=Path(os.devnull).open("w"))  # noqa: SIM115
    console.print(renderable)
    return console.export_text()


def test_what_has_no_stamp_has_that_of_its_step():
    clock = ModelTime(0.02)
    assert clock.stamp_of(0) is None
    for step in range(3):
        clock.observe(step * 20_000, 1_000_000 * step)
    assert clock.stamp_of(1_000_050) == 20_000  # 50 µs after the joint states of its step
    assert clock.stamp_of(1_999_999) == 20_000
    assert clock.stamp_of(-5) == 0  # latched, from before the first step that was heard
    assert clock.stamp_of(2_000_050) is None  # the next step could still be published before it


def opened() -> Story:
    story = Story()
    story.command(1.0, 9.0)
    return story


def test_the_picture_has_phase_and_current_where_they_belong():
    story = opened()
    # Heard in this order: on a busy machine the joint states come last.
    story.phase(1.0053, Phase.MAIN)
    story.current(1.002, 0.25)
    story.current(1.004, 0.5)
    story.command(1.03, 0.0)
    for step in range(10):
        story.joint_states(1.0 + 1e-3 * step, (0.0, 0.0), 0.0, 0.0)
    response, _ = story.first_stroke()
    assert response.phase.tolist() == [Phase.CLOSED] * 6 + [Phase.MAIN] * 4
    assert response.coil_current.tolist() == [0.0] * 2 + [0.25] * 2 + [0.5] * 6


def test_a_line_counts_from_the_command_before_it_even_if_it_is_heard_after_the_next():
    story = opened()
    story.command(1.03, 0.0)
    line = story.phase(1.0001, Phase.PILOT)
    assert line is not None and line.split("ms")[0].strip() == "0.10"
    story.phase(1.01, Phase.MAIN)
    story.phase(1.02, Phase.OPEN)
    assert story.phase(1.0413, Phase.MAIN) == "   11.30 ms  all parts leave the core"


def stroke_events(offset: float) -> StrokeEvents:
    stroke = StrokePart("opening", 1.0, 1.03, 9.0, "opening at 1.000 s, 9.0 V", True)
    times = {"pilot_reaches_main": 5.3e-3 + offset, "reaches_stop": 9.9e-3 + offset}
    return StrokeEvents(stroke, tuple(SensorEvent(kind, 1.0 + t, t, 0.0, "position") for kind, t in times.items()))


def test_comparison_takes_the_mean_of_the_strokes_and_says_how_well_a_time_is_known():
    whole, later = stroke_events(1e-5), stroke_events(3e-5)
    holed = later._replace(events=tuple(event._replace(stderr=4.5e-4) for event in later.events))
    lines = plain(comparison([whole, holed])).splitlines()
    rows = {
        name: [cell.strip() for cell in line.split("│")[2:6]]
        for line in lines
        for name in ("t1", "seated")
        if name in line
    }
    assert rows["t1"] == ["5.310", "5.330 ± 0.45", "5.3", "+0.020"], "messages were lost in the second"
    assert rows["seated"] == ["–", "–", "–", "–"], "not seen"


def test_a_node_that_dies_is_quoted(tmp_path: Path):
    process = ValveProcess(
        [sys.executable, "-c", "print('one', flush=True); raise SystemExit('no such valve')"], tmp_path / "log"
    )
    process._process.wait(PATIENCE)
    with pytest.raises(DemoError, match="ended with code 1: no such valve"):
        process.check()
    process.stop()


def test_a_node_that_ignores_being_asked_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("valve_sim.demo.__main__.STOP_LIMIT", 0.2)
    script = (
        "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print('up', flush=True); time.sleep(600)"
    )
    process = ValveProcess([sys.executable, "-c", script], tmp_path / "log")
    deadline = time.monotonic() + PATIENCE
    while process.last_words() != "up" and time.monotonic() < deadline:
        time.sleep(0.01)
    process.stop()
    assert process._process.returncode == -signal.SIGKILL


def start(folder: Path, *arguments: str, **environment: str) -> subprocess.Popen[str]:
    surroundings = {
        **os.environ,
        "ROS_DOMAIN_ID": str(own_domain()),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        **environment,
    }
    return subprocess.Popen(
        [sys.executable, "-m", "valve_sim.demo", "--output", str(folder), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=surroundings,
    )


@pytest.mark.ros
@needs_ros
def test_demonstration_shows_records_and_compares(tmp_path: Path):
    demo = start(tmp_path / "demo", "--strokes", "2")
    output, errors = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 0, errors
    assert output.count("all parts have reached the core: open") == 2
    assert output.count("closed") == 2
    assert (tmp_path / "demo" / "stroke.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "demo" / "strokes" / "metadata.yaml").is_file()
    trace = read_trace(tmp_path / "demo" / "strokes")
    openings = [found for found in events_from_sensors(trace, 0.26e-3) if found.stroke.kind == "opening"]
    assert len(openings) == 2
    is_whole = np.diff(trace.times).max() < 1e-4  # a recorder on a busy machine misses messages
    told = [float(line.split("ms")[0]) for line in output.splitlines() if "takes the main" in line or ": open" in line]
    assert trace.coil_voltage is not None
    heard = trace.coil_voltage.times
    for found, lines in zip(openings, (told[:2], told[2:]), strict=True):
        events = {event.kind: event for event in found.events}
        # Counted from when the coil has its voltage: how late a busy machine hands a command over does not matter. What
        # its recorder misses does: the voltage steps in the gap before its first sample, and an arrival is anywhere
        # in its own, √12 of its standard errors long.
        first = int(np.searchsorted(heard, found.stroke.start + 1e-9))
        unheard = float(np.diff(heard[first - 2 : first + 1]).max())
        for kind, when in (("pilot_reaches_main", 5.3e-3), ("reaches_stop", 9.9e-3)):
            open_for = unheard + np.sqrt(12.0) * events[kind].stderr
            assert events[kind].after_command == pytest.approx(when, abs=1e-6 + open_for)
        recorded = [1e3 * event.after_command for event in found.events]
        if is_whole:
            # A phase is told at the first of its samples, which are 0.02 ms apart.
            assert lines == pytest.approx(recorded, abs=0.03)
    assert f"{1e3 * openings[0].events[0].after_command:.3f}" in output
    assert trace.coil_current is not None
    if is_whole:
        rate = describe(trace).signals["coil_current"]
        assert (rate.rate, rate.in_bursts) == (pytest.approx(50_000, rel=0.05), False)
    (following,) = (line.removeprefix("next: ") for line in output.splitlines() if line.startswith("next: "))
    shown = subprocess.run(["bash", "-c", following], capture_output=True, text=True, timeout=PATIENCE, check=False)
    # Whoever runs this before the model is compiled is told that it is.
    warnings = [line for line in shown.stderr.splitlines() if "compiling the model" not in line]
    assert (shown.returncode, warnings) == (0, [])
    assert not is_whole or "50000 Hz" in shown.stdout


@pytest.mark.ros
@needs_ros
def test_interrupted_demonstration_leaves_no_half_bag_and_no_node(tmp_path: Path):
    demo = start(tmp_path / "demo")
    assert demo.stdout is not None
    for line in demo.stdout:
        if "stroke 1" in line:
            break
    demo.send_signal(signal.SIGTERM)
    _, errors = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 130, errors
    assert "demo: stopped" in errors.splitlines()
    assert "Traceback" not in errors
    assert sorted(path.name for path in (tmp_path / "demo").iterdir()) == ["log", "valve_node.log"]
    assert "Traceback" not in (tmp_path / "demo" / "valve_node.log").read_text()


def test_without_ros_one_line_says_the_mend(tmp_path: Path):
    (tmp_path / "rclpy.py").write_text("raise ImportError('No module named rclpy')")
    demo = start(tmp_path / "demo", PYTHONPATH=os.pathsep.join([str(tmp_path), *sys.path]))
    _, errors = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == 2
    assert errors.count("\n") == 1
    assert "make run" in errors


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path):
    (tmp_path / "file").touch()
    ran = CliRunner().invoke(main, ["--output", str(tmp_path / "file" / "demo")])
    assert ran.exit_code == 2
    assert "choose another place with --output" in ran.stderr
