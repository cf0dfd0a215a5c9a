"""What is written can be read back, by this package and by the tools of ROS; strokes, events and summaries of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection

from valve_sim.model import Drive
from valve_sim.recordings import (
    CSV_COLUMNS,
    BagRecorder,
    Signal,
    Trace,
    TraceError,
    describe,
    events_from_sensors,
    find_stroke_parts,
    read_trace,
    stroke_numbers,
    write_bag,
    write_bags,
    write_csv,
)

from .bag_makers import EPOCH, GAP, JOINT_STATE, LEAVES, REACHES_MAIN, REACHES_STOP, STORE, clean_trace, joint_state


def full_trace() -> Trace:
    trace = clean_trace()
    slow = trace.times[::10]
    return replace(
        trace,
        coil_current=Signal(slow, np.linspace(0, 0.5, len(slow))),
        acceleration=Signal(trace.times, np.cos(trace.times)),
        inlet_pressure=Signal(slow, np.full(len(slow), 70e6)),
        demand_pressure=Signal(slow, np.linspace(2e6, 3e6, len(slow))),
        coil_temperature=Signal(slow, np.full(len(slow), 25.0)),
    )


FORMS = {"bare.mcap": {}, "folder": {}, "database": {"storage": "sqlite3"}}


@pytest.mark.parametrize("name", FORMS)
def test_rosbags_reads_every_message(name: str, tmp_path: Path) -> None:
    trace = full_trace()
    write_bag(tmp_path / name, trace, **FORMS[name])  # type: ignore[arg-type]
    with AnyReader([tmp_path / name]) as reader:
        messages: list[tuple[Connection, int, Any]] = [
            (connection, time, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        ]
    assert len(messages) == 2 + 1000 + 100 + 1000 + 100 + 100 + 100
    times = [time for _, time, _ in messages]
    assert times == sorted(times)
    states = [message for connection, _, message in messages if connection.msgtype == JOINT_STATE]
    assert states[7].name == ["pilot_plunger", "main_plunger"]
    assert states[7].header.stamp.nanosec == 700_000
    for not_measured in (states[7].velocity, states[7].effort):
        assert np.isnan(not_measured).tolist() == [True, True]
    if name == "folder":
        metadata = (tmp_path / name / "metadata.yaml").read_text()
        assert "- folder.mcap" in metadata
        assert (tmp_path / name / "folder.mcap").exists()


def test_mcap_says_ros2_to_other_tools(tmp_path: Path) -> None:
    write_bag(tmp_path / "a.mcap", clean_trace())
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
    assert summary is not None
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}


def test_several_valves_in_one_recording(tmp_path: Path) -> None:
    first, second = clean_trace(seed=1), clean_trace(seed=2)
    write_bags(tmp_path / "a.mcap", {"/tank_1/valve": first, "tank_2/valve": second})
    np.testing.assert_array_equal(
        read_trace(tmp_path / "a.mcap", "/tank_2/valve").pilot_position, second.pilot_position
    )


def test_main_position_that_was_not_measured_stays_unknown(tmp_path: Path) -> None:
    write_bag(tmp_path / "a.mcap", replace(clean_trace(), main_position=None))
    assert read_trace(tmp_path / "a.mcap").main_position is None


def test_failed_recording_leaves_nothing(tmp_path: Path) -> None:
    sample = joint_state("/valve/joint_states", EPOCH, (0.0, 0.0))
    with pytest.raises(RuntimeError, match="stop"), BagRecorder(tmp_path / "a.mcap") as recorder:
        recorder.write(sample.topic, sample.type, sample.data, sample.time)
        raise RuntimeError("stop")
    assert list(tmp_path.iterdir()) == []


def test_recorder_streams_messages(tmp_path: Path) -> None:
    with BagRecorder(tmp_path / "bag") as recorder:
        recorder.add_topic("/valve/coil_voltage", "std_msgs/msg/Float64")
        for number in range(3):
            sample = joint_state("/valve/joint_states", EPOCH + number, (float(number), 0.0))
            recorder.write(sample.topic, sample.type, sample.data, sample.time)
    with AnyReader([tmp_path / "bag"], default_typestore=STORE) as reader:
        assert [time for _, time, _ in reader.messages()] == [EPOCH, EPOCH + 1, EPOCH + 2]
        assert set(reader.topics) == {"/valve/coil_voltage", "/valve/joint_states"}


def test_recorder_refuses_what_it_cannot_write(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(TraceError, match="exists already"):
        BagRecorder(tmp_path / "bag")
    (tmp_path / "file").write_text("")
    with pytest.raises(TraceError, match="cannot be written"):
        BagRecorder(tmp_path / "file" / "a.mcap")
    with (
        pytest.raises(TraceError, match="custom_msgs/msg/Odd is unknown"),
        BagRecorder(tmp_path / "a.mcap") as recorder,
    ):
        recorder.write("/odd", "custom_msgs/msg/Odd", b"", 0)
    with pytest.raises(TraceError, match="before 0"):
        write_bag(tmp_path / "a.mcap", replace(clean_trace(), epoch_ns=-1))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bag", "file"]


def test_an_existing_file_is_replaced_only_by_a_whole_one(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_bag(path, clean_trace(seed=1))
    before = path.read_bytes()
    with pytest.raises(TraceError):
        write_bag(path, replace(clean_trace(), epoch_ns=-1))
    assert path.read_bytes() == before
    write_bag(path, clean_trace(seed=2))
    np.testing.assert_array_equal(read_trace(path).pilot_position, clean_trace(seed=2).pilot_position)


def test_csv_has_the_columns_in_order(tmp_path: Path) -> None:
    times = np.array([0.0, 0.01, 0.02])
    volts = Drive.of([0.01], [9.0]).at(times)
    columns = {name: np.zeros(3) for name in CSV_COLUMNS} | {
        "time": times,
        "coil_voltage": volts,
        "phase": np.array([0, 1, 4]),
    }
    write_csv(tmp_path / "a.csv", columns)
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0] == "time,coil_voltage,coil_current,pilot_position,main_position,pilot_velocity,phase"
    assert lines[1:] == ["0.0,0.0,0.0,0.0,0.0,0.0,0", "0.01,9.0,0.0,0.0,0.0,0.0,1", "0.02,9.0,0.0,0.0,0.0,0.0,4"]
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_strokes_are_found_and_named() -> None:
    opening, closing = find_stroke_parts(clean_trace())
    assert opening.name == "opening at 0.010 s, 9.0 V"
    assert closing.name == "closing at 0.050 s, 0.0 V"
    assert (opening.start, opening.stop) == (0.010, 0.050)
    assert opening.moved
    assert closing.moved
    assert closing.stop > 0.0999


def test_repeated_commands_hold_levels_and_idle_steps_start_no_motion() -> None:
    trace = clean_trace()
    times = np.array([0.010, 0.012, 0.030, 0.050, 0.080])
    strokes = find_stroke_parts(replace(trace, drive=Drive(times, np.array([9.0, 9.0, 3.0, 0.0, 2.0]))))
    assert [(stroke.kind, stroke.moved) for stroke in strokes] == [
        ("opening", True),
        ("hold", False),
        ("closing", True),
        ("opening", False),
    ]


def test_a_pulse_that_never_reaches_the_stop() -> None:
    times = np.arange(2000) / 10_000
    position = clean_trace(noise=0.0).pilot_position
    part = np.clip(0.4e-3 * np.sin(np.pi * (times[:1000] - 0.02) / 0.04), 0, None) * (times[:1000] < 0.06)
    drive = Drive(np.array([0.010, 0.050, 0.110, 0.140]), np.array([9.0, 0.0, 8.0, 0.0]))
    trace = replace(clean_trace(), drive=drive, times=times, pilot_position=np.concatenate([position, part]))
    assert [stroke.kind for stroke in find_stroke_parts(trace)] == ["opening", "closing", "pulse", "closing"]
    assert [part.stroke for part in find_stroke_parts(trace)] == [0, 0, 1, 1]
    assert sorted(set(stroke_numbers(trace.drive, trace.times).tolist())) == [0, 1]


def test_no_motion_in_noise_of_any_colour() -> None:
    rng = np.random.default_rng(8)
    noise = np.zeros(20_000)
    for number, shock in enumerate(rng.normal(0, 1e-6, 19_999)):
        noise[number + 1] = 0.7 * noise[number] + shock
    for still in (noise, np.round(noise / 5e-6) * 5e-6):
        trace = replace(clean_trace(), times=np.arange(20_000) / 1e5, pilot_position=still, main_position=None)
        assert not any(stroke.moved for stroke in find_stroke_parts(trace))


def test_arrivals_from_positions_hit_the_truth_within_their_standard_errors() -> None:
    deviations = []
    for seed in range(40):
        opening = events_from_sensors(clean_trace(seed=seed), GAP)[0]
        assert [event.kind for event in opening.events] == ["pilot_reaches_main", "reaches_stop"]
        truth = (REACHES_MAIN, REACHES_STOP)
        deviations += [(event.time - true) / event.stderr for event, true in zip(opening.events, truth, strict=True)]
        assert opening.events[1].stderr < 20e-6
        assert opening.events[1].after_command == pytest.approx(opening.events[1].time - 0.010)
    assert 0.5 < np.std(deviations) < 1.7
    assert abs(np.mean(deviations)) < 0.5


def test_arrivals_of_a_closing_stroke() -> None:
    closing = events_from_sensors(clean_trace(), GAP)[1]
    times = {event.kind: event.time for event in closing.events}
    assert times["reaches_seat"] == pytest.approx(0.060, abs=20e-6)
    assert times["main_seats"] == pytest.approx(0.055 + 0.005 * (1 - GAP / 1230e-6), abs=20e-6)


def test_arrivals_from_spikes_of_the_accelerometer() -> None:
    trace = clean_trace()
    times = np.arange(2000) / 20_000
    values = np.random.default_rng(2).normal(0, 0.1, 2000)
    for arrival, height in ((REACHES_MAIN, 8.0), (REACHES_STOP, 60.0)):
        values[np.searchsorted(times, arrival - 1e-9)] += height
    found = events_from_sensors(replace(trace, acceleration=Signal(times, values)), GAP)[0].events
    spikes = {event.kind: event for event in found if event.sensor == "acceleration"}
    assert spikes["pilot_reaches_main"].time == pytest.approx(REACHES_MAIN, abs=50e-6)
    assert spikes["reaches_stop"].time == pytest.approx(REACHES_STOP, abs=50e-6)
    assert LEAVES < spikes["pilot_reaches_main"].time < spikes["reaches_stop"].time


def test_summary_in_numbers() -> None:
    trace = full_trace()
    kept = np.r_[0:200, 250:1000]
    summary = describe(
        replace(trace, times=trace.times[kept], pilot_position=trace.pilot_position[kept], main_position=None)
    )
    assert summary.signals["position"].samples == 950
    assert summary.signals["position"].rate == pytest.approx(10_000)
    assert summary.signals["coil_current"].rate == pytest.approx(1_000)
    assert [(round(gap.start, 4), round(gap.length, 4)) for gap in summary.gaps] == [(0.0199, 0.0051)]
    assert summary.voltages == (0.0, 9.0)
    assert summary.noise == pytest.approx(1e-6, rel=0.2)
    assert len(summary.strokes) == 2
