"""Recordings of five foreign layouts, read with the maps that docs/how_to/your_own_recordings.md prints."""

from __future__ import annotations

import itertools
import math
import re
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Profile, Recorder, Recording, record
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from valve_sim.files.recording_map import MapError, load_map
from valve_sim.model import Drive, ValveError, ValveParameters
from valve_sim.recordings import Signal, Trace, TraceError, describe, list_valves, read_trace, write_bag
from valve_sim.recordings.map_draft import draft_map

from .bag_makers import good_messages, make_mcap

PAGE = Path(__file__).parents[2] / "docs" / "how_to" / "your_own_recordings.md"
START = 1_700_000_000_000_000_000
GRAVITY = 9.81
VALVE = ValveParameters()
STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("uint8 number\nfloat32 level\n", "lab_msgs/msg/Channel"))
STORE.register(
    get_types_from_msg("std_msgs/Header header\nstring state\nlab_msgs/Channel[] channels\n", "lab_msgs/msg/DriveLog")
)
FLOAT = "std_msgs/msg/Float64"


def strokes(seed: int, **parameters: float) -> Recording:
    """Two full strokes at 10 and 12 V of an independent plant."""
    profile = Profile(np.array([0.01, 0.04, 0.07, 0.1]), np.array([10.0, 0.0, 12.0, 0.0]), 0.13)
    plant = DeclaredPlant({}, {**CAMPAIGN_VALVE, **parameters})
    return record(plant, profile, Recorder(with_current=True), seed)


def page_map(name: str, folder: Path) -> Path:
    """A map as the page prints it, written to a file."""
    found = re.search(rf"```yaml\n# {re.escape(name)}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found, f"the page has no {name}"
    path = folder / name
    path.write_text(found[1], encoding="utf-8")
    return path


class Bag:
    """Messages of any type, collected and written in time order."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, str, str, Any]] = []

    def header(self, time: float) -> Any:
        stamp = STORE.types["builtin_interfaces/msg/Time"](*divmod(START + round(time * 1e9), 10**9))
        return STORE.types["std_msgs/msg/Header"](stamp, "lab")

    def add(self, topic: str, kind: str, time: float, *values: Any, late: float = 0.0) -> None:
        self.messages.append((START + round((time + late) * 1e9), topic, kind, STORE.types[kind](*values)))

    def floats(self, topic: str, times: np.ndarray, values: np.ndarray) -> None:
        for time, value in zip(times.tolist(), values.tolist(), strict=True):
            self.add(topic, FLOAT, time, value)

    def write(self, path: Path, storage: StoragePlugin = StoragePlugin.MCAP) -> Path:
        with Writer(path, version=9, storage_plugin=storage) as writer:
            topics = {
                topic: writer.add_connection(topic, kind, typestore=STORE)
                for topic, kind in dict.fromkeys((topic, kind) for _, topic, kind, _ in self.messages)
            }
            for time, topic, kind, message in sorted(self.messages, key=lambda entry: entry[0]):
                writer.write(topics[topic], time, STORE.serialize_cdr(message, kind))
        return path


def lvdt(path: Path, made: Recording) -> Path:
    bag = Bag()
    bag.floats("/lab/supply", made.command_times, made.volts)
    bag.floats("/lab/lvdt", made.times, 12.5 - 1e3 * made.pilot_position)
    return bag.write(path / "lvdt")


def scope(path: Path, made: Recording) -> Path:
    """As an oscilloscope of a German laboratory exports it."""
    volts = np.where(made.times[:, None] >= made.command_times, made.volts, np.nan)
    level = np.nan_to_num(np.array([row[np.isfinite(row)][-1:].sum() for row in volts]))
    noise = np.random.default_rng(7).normal(0.0, 2e-3, len(level))
    assert made.coil_current is not None
    columns = (made.times - 0.02, 0.1 * level + noise, 1e3 * made.pilot_position, 0.1 * made.coil_current)
    rows = [";".join(f"{value:.9g}".replace(".", ",") for value in row) for row in zip(*columns, strict=True)]
    head = ["# Model;MSO44", "# Sample rate;20 kHz;;", "#", "Time;CH1;CH2;CH3", "s;V;V;V"]
    file = path / "scope.csv"
    file.write_text("\r\n".join([*head, *rows]) + "\r\n", encoding="latin-1")
    return file


def imu(path: Path, made: Recording) -> Path:
    bag, types = Bag(), STORE.types
    bag.floats("/driver/volts", made.command_times, made.volts)
    acceleration = np.gradient(np.gradient(made.truth.pilot_position, made.times), made.times)
    none, quaternion = np.zeros(9), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    vector = types["geometry_msgs/msg/Vector3"]
    for time, pilot, rise in zip(made.times.tolist(), made.pilot_position.tolist(), acceleration.tolist(), strict=True):
        felt = vector(0.0, 0.0, GRAVITY - rise)
        bag.add(
            "/imu", "sensor_msgs/msg/Imu", time, bag.header(time), quaternion, none, vector(0, 0, 0), none, felt, none
        )
        distance = np.float32(0.05 - pilot)
        bag.add("/laser", "sensor_msgs/msg/Range", time, bag.header(time), 1, 0.01, 0.02, 0.08, distance, 0.0)
    return bag.write(path / "imu", StoragePlugin.SQLITE3)


def tracker(path: Path, made: Recording) -> Path:
    """Everything arrives late and unevenly: only the stamps hold the times."""
    bag, types = Bag(), STORE.types
    lateness = np.random.default_rng(3).exponential(0.3e-3, len(made.times))
    for time, volts in zip(made.command_times.tolist(), made.volts.tolist(), strict=True):
        channels = [types["lab_msgs/msg/Channel"](number, level) for number, level in enumerate((5.0, 1e3 * volts))]
        bag.add("/driver/log", "lab_msgs/msg/DriveLog", time, bag.header(time), "running", channels, late=0.002)
    for time, pilot, late in zip(made.times.tolist(), made.pilot_position.tolist(), lateness.tolist(), strict=True):
        point = types["geometry_msgs/msg/Point"](0.1, 0.2, 0.3 + pilot)
        bag.add("/tracker", "geometry_msgs/msg/PointStamped", time, bag.header(time), point, late=late)
    return bag.write(path / "tracker")


def plc(path: Path, made: Recording, other: Recording) -> Path:
    bag = Bag()
    bag.floats("/plc/volts_1", made.command_times, made.volts)
    bag.floats("/plc/volts_2", other.command_times, other.volts)
    assert made.coil_current is not None and other.coil_current is not None
    for row, time in enumerate(made.times.tolist()):
        lifts = 1e3 * np.array([made.pilot_position[row], other.pilot_position[row]])
        currents = np.array([made.coil_current[row], other.coil_current[row]])
        names = ["tank_1_lift", "tank_2_lift"]
        bag.add(
            "/plc/joint_states",
            "sensor_msgs/msg/JointState",
            time,
            bag.header(time),
            names,
            lifts,
            np.zeros(0),
            currents,
        )
    return bag.write(path / "plc")


@pytest.fixture(scope="module")
def made() -> Recording:
    return strokes(1)


def check(trace: Trace, made: Recording, *, atol: float = 1e-12, command_atol: float = 1e-8) -> None:
    """The trace is the recording, on whatever clock it is; times come out relative to each other."""
    start = trace.times[0] - made.times[0]
    np.testing.assert_allclose(trace.times - start, made.times, atol=1e-8)
    np.testing.assert_allclose(trace.pilot_position, made.pilot_position, atol=atol)
    at = np.flatnonzero(np.diff(trace.drive.volts, prepend=0.0))
    np.testing.assert_allclose(trace.drive.times[at] - start, made.command_times, atol=command_atol)
    np.testing.assert_allclose(trace.drive.volts[at], made.volts, rtol=1e-3)


def test_lvdt_in_millimetres(tmp_path: Path, made: Recording) -> None:
    trace = read_trace(lvdt(tmp_path, made), None, load_map(page_map("lvdt.yaml", tmp_path)))
    check(trace, made, atol=1e-15)
    assert trace.clock == "bag"
    assert trace.findings == ()


def test_a_map_says_of_how_many_readings_a_position_is_the_mean(tmp_path: Path, made: Recording) -> None:
    path, recording = page_map("lvdt.yaml", tmp_path), lvdt(tmp_path, made)
    assert read_trace(recording, None, load_map(path)).averaging == 1
    path.write_text(path.read_text() + "sensor: {averaging: 8}\n")
    assert read_trace(recording, None, load_map(path)).averaging == 8
    assert read_trace(recording, None, load_map(path)).bandwidth == np.inf
    path.write_text(path.read_text().replace("averaging: 8", "bandwidth: 500"))
    assert read_trace(recording, None, load_map(path)).bandwidth == 500.0


def test_oscilloscope_table(tmp_path: Path, made: Recording) -> None:
    trace = read_trace(scope(tmp_path, made), None, load_map(page_map("scope.yaml", tmp_path)))
    # A step is dated to half a sample, a level to the median of its noise.
    check(trace, made, command_atol=26e-6)
    assert trace.coil_current is not None and made.coil_current is not None
    np.testing.assert_allclose(trace.coil_current.values, made.coil_current, atol=1e-8)
    assert any("4 steps of the measured voltage" in finding for finding in trace.findings)
    assert trace.drive_errors is not None
    assert trace.zero_error > 0.0


def test_imu_and_distance(tmp_path: Path, made: Recording) -> None:
    trace = read_trace(imu(tmp_path, made), None, load_map(page_map("imu.yaml", tmp_path)))
    check(trace, made, atol=5e-9)  # a float32 of 0.05 m
    assert trace.acceleration is not None
    expected = np.gradient(np.gradient(made.truth.pilot_position, made.times), made.times)
    np.testing.assert_allclose(trace.acceleration.values, expected, atol=1e-9)


@pytest.mark.parametrize("clock", ["header", "bag"])
def test_tracked_point_and_a_type_of_the_lab(clock: str, tmp_path: Path, made: Recording) -> None:
    path = page_map("tracker.yaml", tmp_path)
    path.write_text(path.read_text().replace("clock: header", f"clock: {clock}"))
    trace = read_trace(tracker(tmp_path, made), None, load_map(path))
    assert trace.clock == clock
    if clock == "header":
        check(trace, made, atol=1e-12)
    else:
        with pytest.raises(AssertionError):
            check(trace, made, atol=1e-12)


def test_two_valves_in_one_joint_state(tmp_path: Path, made: Recording) -> None:
    other = strokes(2, main_damping=7.0)
    bag, lab = plc(tmp_path, made, other), load_map(page_map("plc.yaml", tmp_path))
    assert list_valves(bag, lab) == ("/tank_1/valve", "/tank_2/valve")
    with pytest.raises(MapError, match=r"several valves .*--valve"):
        read_trace(bag, None, lab)
    for name, recording in (("/tank_1/valve", made), ("/tank_2/valve", other)):
        trace = read_trace(bag, name, lab)
        check(trace, recording)
        assert trace.coil_current is not None
        np.testing.assert_array_equal(trace.coil_current.values, recording.coil_current)


def test_a_cut_recording_keeps_its_foreign_messages(tmp_path: Path, made: Recording) -> None:
    file = next(tracker(tmp_path, made).glob("*.mcap"))
    whole = file.read_bytes()
    file = tmp_path / "cut.mcap"
    file.write_bytes(whole[:-40])  # the end of the index
    lab = page_map("lvdt.yaml", tmp_path)
    lab.write_text(
        "clock: header\ncommand: {topic: /tracker, field: point.x}\nposition: {topic: /tracker, field: point.z}\n"
    )
    assert len(read_trace(file, None, load_map(lab)).times) == len(made.times)


def test_a_folder_without_metadata_keeps_messages_of_a_type_of_the_lab(tmp_path: Path, made: Recording) -> None:
    bag = tracker(tmp_path, made)
    (bag / "metadata.yaml").unlink()
    trace = read_trace(bag, None, load_map(page_map("tracker.yaml", tmp_path)))
    check(trace, made)
    assert any("metadata.yaml is missing" in finding for finding in trace.findings)


# --- what is wrong is said in one line ---

LAB = "command: {topic: /lab/supply}\nposition: {topic: /lab/lvdt, unit: mm, sign: -1, offset: 12.5}\n"
TABLE = "time: Time\nvoltage: {column: CH1, scale: 10}\nposition: {column: CH2, unit: mm}\n"
WRONG_MAPS = {
    "a sensor that is a number": (LAB + "sensor: 8\n", r"sensor: found 8, expected \{averaging: 10\}"),
    "a sensor of no position": (
        LAB.replace("position", "current").replace("unit: mm", "unit: mA") + "sensor: {averaging: 8}\n",
        r"sensor: is that of the position, of which the map names none",
    ),
    "a mean of none": (LAB + "sensor: {averaging: 0}\n", r"sensor\.averaging: found 0, expected a whole number"),
    "half a reading": (LAB + "sensor: {averaging: 2.5}\n", r"sensor\.averaging: found 2\.5, expected a whole number"),
    "an unknown key of a sensor": (
        LAB + "sensor: {avraging: 2}\n",
        r"sensor\.avraging: unknown key; did you mean aver",
    ),
    "a bandwidth of nothing": (LAB + "sensor: {bandwidth: 0}\n", r"sensor\.bandwidth: found 0, expected a frequency"),
    "a bandwidth in words": (LAB + "sensor: {bandwidth: fast}\n", r"sensor\.bandwidth: found 'fast', expected a freq"),
    "a misspelt quantity": (LAB.replace("position", "positon"), r"positon: unknown key; did you mean position\?"),
    "a misspelt key": (LAB.replace("unit", "units"), r"position\.units: unknown key; did you mean unit\?"),
    "an unknown unit": (LAB.replace("unit: mm", "unit: millimetres"), "found 'millimetres', expected one of m, cm, mm"),
    "a unit of something else": (LAB.replace("unit: mm", "unit: bar"), "found 'bar', expected one of m, cm, mm"),
    "a sign that is a factor": (LAB.replace("sign: -1", "sign: -2"), "expected 1 or -1; a factor is scale:"),
    "a scale of nothing": (LAB.replace("sign: -1", "scale: 0"), "expected a number above 0"),
    "an unknown clock": ("clock: wall\n" + LAB, "clock: found 'wall', expected header or bag"),
    "no voltage": (LAB.splitlines()[1], "neither command nor voltage"),
    "no position": (LAB.splitlines()[0], "names no position"),
    "topic and column": (LAB + "current: {column: i}\n", "current is a column and command a topic"),
    "a table without time": (TABLE.replace("time: Time\n", ""), "names no time"),
    "a bag with time": (LAB + "time: {rate: 100}\n", "time: is for tables"),
    "column and rate": (TABLE.replace("time: Time", "time: {column: t, rate: 5}"), "expected either column: or rate:"),
    "nothing": ("", "found nothing; expected keys"),
    "no YAML": ("position: {topic", "expected valid YAML"),
}


@pytest.mark.parametrize("kind", WRONG_MAPS)
def test_a_wrong_map_is_refused(kind: str, tmp_path: Path) -> None:
    text, expected = WRONG_MAPS[kind]
    path = tmp_path / "lab.yaml"
    path.write_text(text)
    with pytest.raises(MapError, match=expected) as caught:
        load_map(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


UNFIT_MAPS = {
    "unknown topic": (LAB.replace("/lab/lvdt", "/lab/lvtd"), r"/lab/lvtd is not in .*it has /lab/lvdt, /lab/supply"),
    "unknown field": (LAB.replace("unit", "field: point.z, unit"), r"has no number point\.z; it has data"),
    "no such joint": (LAB.replace("unit", "joint: lift, unit"), "has no joint names, expected lift"),
    "a stamp that is none": ("clock: header\n" + LAB, "clock: header, but .*no stamp; use clock: bag"),
    "a column of a bag": (TABLE, "names a column, but .* is a bag"),
}


@pytest.mark.parametrize("kind", UNFIT_MAPS)
def test_a_map_that_does_not_fit_the_bag_is_refused(kind: str, tmp_path: Path, made: Recording) -> None:
    text, expected = UNFIT_MAPS[kind]
    (tmp_path / "lab.yaml").write_text(text)
    with pytest.raises(ValveError, match=expected) as caught:
        read_trace(lvdt(tmp_path, made), None, load_map(tmp_path / "lab.yaml"))
    assert "\n" not in str(caught.value)


def row(text: str, number: int, cells: str) -> str:
    """The text with the line of this number (from 1 on) replaced."""
    lines = text.splitlines()
    lines[number - 1] = cells
    return "\n".join(lines)


UNFIT_TABLES = {
    "missing column": (
        TABLE.replace("CH2", "CH9"),
        lambda text: text,
        r"lab.yaml: position.column: column CH9 is not in .*scope.csv; it has Time, CH1, CH2, CH3",
    ),
    "backwards": (TABLE, lambda text: row(text, 100, "-0,5;0;0;0"), "line 100: time column Time runs backwards"),
    "text": (TABLE, lambda text: row(text, 77, "1;0;ERROR 7;0"), "line 77: column CH2: found 'ERROR 7'"),
    "a short row": (TABLE, lambda text: row(text, 78, "1;0"), "line 78: column CH2: found nothing"),
    "a voltage that is no command": (
        TABLE.replace("voltage", "command"),
        lambda text: text,
        "changes in .* rows, as a measured voltage does; name it voltage:",
    ),
    "topics of a table": (LAB, lambda text: text, "names the topic /lab/supply, but .* is a table"),
}


@pytest.mark.parametrize("kind", UNFIT_TABLES)
def test_a_table_that_does_not_fit_is_refused(kind: str, tmp_path: Path, made: Recording) -> None:
    text, spoil, expected = UNFIT_TABLES[kind]
    (tmp_path / "lab.yaml").write_text(text)
    file = scope(tmp_path, made)
    file.write_text(spoil(file.read_text(encoding="latin-1")), encoding="latin-1")
    with pytest.raises(ValveError, match=expected) as caught:
        read_trace(file, None, load_map(tmp_path / "lab.yaml"))
    assert "\n" not in str(caught.value)


def test_a_table_without_a_map_says_what_it_has(tmp_path: Path, made: Recording) -> None:
    with pytest.raises(TraceError, match=r"a table \(Time, CH1, CH2, CH3\); say with --map"):
        read_trace(scope(tmp_path, made))


# --- a first map ---


def makers(made: Recording, other: Recording) -> dict[str, Any]:
    return {
        "lvdt.yaml": lambda path: lvdt(path, made),
        "imu.yaml": lambda path: imu(path, made),
        "tracker.yaml": lambda path: tracker(path, made),
        "plc.yaml": lambda path: plc(path, made, other),
        "scope.yaml": lambda path: scope(path, made),
    }


@pytest.mark.parametrize("name", ["lvdt.yaml", "imu.yaml", "tracker.yaml", "plc.yaml", "scope.yaml"])
def test_a_first_map_finds_the_position_and_marks_its_guesses(name: str, tmp_path: Path, made: Recording) -> None:
    recording = makers(made, strokes(2, main_damping=7.0))[name](tmp_path)
    text = draft_map(recording, VALVE, "valve-sim map")
    assert "# CHECK" in text
    draft = tmp_path / "draft.yaml"
    draft.write_text(text, encoding="utf-8")
    own = load_map(page_map(name, tmp_path))
    for mine, true in zip(list_valves(recording, load_map(draft)), list_valves(recording, own), strict=True):
        found, expected = read_trace(recording, mine, load_map(draft)), read_trace(recording, true, own)
        np.testing.assert_array_equal(found.times, expected.times)
        # The zero of the sensor is read from the noisy samples at rest.
        np.testing.assert_allclose(found.pilot_position, expected.pilot_position, atol=2e-6)
        assert (found.coil_current is None) == (expected.coil_current is None)
        scale = 0.1 if name == "scope.yaml" else 1.0  # of a probe, which nobody can guess
        np.testing.assert_allclose(found.drive.volts, scale * expected.drive.volts, rtol=1e-9)


def test_a_first_map_tells_pilot_from_main(tmp_path: Path) -> None:
    path = make_mcap(tmp_path / "a.mcap", good_messages())
    (tmp_path / "draft.yaml").write_text(draft_map(path, VALVE, "valve-sim map"))
    trace, expected = read_trace(path, None, load_map(tmp_path / "draft.yaml")), read_trace(path)
    np.testing.assert_array_equal(trace.pilot_position, expected.pilot_position)
    np.testing.assert_array_equal(trace.main_position, expected.main_position)
    np.testing.assert_array_equal(trace.drive.times, expected.drive.times)


def test_a_first_map_of_a_coil_alone_takes_no_command_for_a_position(tmp_path: Path) -> None:
    """The voltage is sampled as the current is, and beside it are the commands as they were sent."""
    times = np.arange(2000) / 20e3
    drive = Drive.of([0.010, 0.050, 0.070], [9.0, 0.0, 12.0])
    volts = np.concatenate([[0.0], drive.volts])[np.searchsorted(drive.times, times, side="right")]
    random = np.random.default_rng(3)
    signals = {
        "coil_current": Signal(times, volts / 8.0 + 1e-3 * random.standard_normal(len(times))),
        "coil_voltage": Signal(times, volts + 5e-3 * random.standard_normal(len(times))),
    }
    nothing = np.empty(0)
    write_bag(tmp_path / "a.mcap", Trace("a", drive, nothing, nothing, epoch_ns=10**9, **signals))
    text = draft_map(tmp_path / "a.mcap", VALVE, "valve-sim map")
    assert "without one the current alone is gone by" in text
    (tmp_path / "draft.yaml").write_text(text)
    found, own = (
        read_trace(tmp_path / "a.mcap", None, load_map(tmp_path / "draft.yaml")),
        read_trace(tmp_path / "a.mcap"),
    )
    assert not found.has_positions
    assert found.coil_current is not None and found.coil_voltage is not None and own.coil_current is not None
    np.testing.assert_array_equal(found.coil_current.values, own.coil_current.values)
    np.testing.assert_array_equal(found.drive.volts, own.drive.volts)


@pytest.mark.parametrize(
    ("header", "level", "expected"),
    [
        ("outlet_pressure [bar]", 20.0, "outlet_pressure"),
        ("coil_temp [°C]", 24.0, "temperature"),
        ("CH3", 0.5, "current"),
    ],
)
def test_the_last_column_is_a_current_only_where_nothing_says_what_it_is(
    header: str, level: float, expected: str, tmp_path: Path, made: Recording
) -> None:
    held = made.volts[np.maximum(np.searchsorted(made.command_times, made.times, side="right") - 1, 0)]
    last = level * (1.0 + 0.02 * np.sin(40.0 * made.times))
    columns = np.column_stack([made.times, held, 1e3 * made.pilot_position, last])
    path = tmp_path / "log.csv"
    np.savetxt(path, columns, delimiter=",", header=f"time [s],CH1 [V],CH2 [mm],{header}", comments="", fmt="%.9g")
    draft = draft_map(path, VALVE, "valve-sim map")
    entries = [line.partition(":")[0] for line in draft.splitlines() if line and not line.startswith("#")]
    assert entries[-1] == expected, draft
    assert len(entries) == 4, draft


@pytest.mark.parametrize(("repeated", "digits"), [(5, 7), (0, 3)])
def test_a_first_map_takes_no_rate_out_of_the_air(repeated: int, digits: int, tmp_path: Path, made: Recording) -> None:
    """Of a few rows with the time of the row before, and of times with too few digits."""
    held = made.volts[np.maximum(np.searchsorted(made.command_times, made.times, side="right") - 1, 0)]
    times = made.times.copy()
    times[100 : 100 + 2 * repeated : 2] = times[99 : 99 + 2 * repeated : 2]
    rows = [f"{t:.{digits}f},{v:g},{x:.6f}" for t, v, x in zip(times, held, 1e3 * made.pilot_position, strict=True)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["time [s],CH1 [V],lift [mm]", *rows]))
    if digits == 3:
        with pytest.raises(TraceError, match=r"column time .* repeats: it has too few digits"):
            draft_map(path, VALVE, "valve-sim map")
        return
    (tmp_path / "map.yaml").write_text(draft_map(path, VALVE, "valve-sim map"))
    summary = describe(read_trace(path, None, load_map(tmp_path / "map.yaml")))
    assert summary.timed_by == "column time [s]"
    assert summary.signals["position"].rate == pytest.approx(20e3)
    (tmp_path / "map.yaml").write_text("time: {rate: 20000}\ncommand: 2\nposition: {column: 3, unit: mm}\n")
    summary = describe(read_trace(path, None, load_map(tmp_path / "map.yaml")))
    assert summary.timed_by == f"the rate of 20000 Hz in {tmp_path / 'map.yaml'}"


def test_a_first_map_knows_one_value_a_row(tmp_path: Path, made: Recording) -> None:
    held = made.volts[np.maximum(np.searchsorted(made.command_times, made.times, side="right") - 1, 0)]
    rows = list(zip(made.times.tolist(), held.tolist(), (1e3 * made.pilot_position).tolist(), strict=True))
    path = tmp_path / "log.csv"
    path.write_text("time,name,value\n" + "".join(f"{t:.6f},u,{u}\n{t:.6f},lift,{x:.6f}\n" for t, u, x in rows))
    with pytest.raises(TraceError, match=r"the value of one quantity, which column name names \(u, lift\); export"):
        draft_map(path, VALVE, "valve-sim map")


@pytest.mark.parametrize("head", ["t_u;u;t_x;lift;t_i;current", "Time;Volts;Time;Stroke;Time;Current"])
def test_columns_with_times_of_their_own_are_read_by_these(tmp_path: Path, made: Recording, head: str) -> None:
    """Each channel has a column of times and a length of its own, as TwinCAT and LabVIEW export them."""
    held = np.append(0.0, made.volts)[np.searchsorted(made.command_times, made.times, side="right")]
    assert made.coil_current is not None
    late = made.times[5:] + 1e-5  # begins later, and between the others' samples
    channels = [
        (made.times[::2], held[::2]),
        (made.times, 1e3 * made.pilot_position),
        (late, np.interp(late, made.times, made.coil_current)),
    ]
    count = max(len(times) for times, _ in channels)
    cells = [
        [*(f"{own:.8g}" for own in column.tolist()), *[""] * (count - len(column))]
        for times, values in channels
        for column in (times, values)
    ]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([head, *(";".join(row) for row in zip(*cells, strict=True))]) + "\n")
    draft = draft_map(path, VALVE, "valve-sim map")
    assert draft.count("is another column of times, and is taken for that of the columns after it") == 2
    (tmp_path / "map.yaml").write_text(draft)
    found = read_trace(path, None, load_map(tmp_path / "map.yaml"))
    np.testing.assert_allclose(found.times, made.times, atol=1e-9)
    np.testing.assert_allclose(found.pilot_position, made.pilot_position, atol=1e-9)
    assert found.coil_current is not None
    np.testing.assert_allclose(found.coil_current.times, late, atol=1e-9)
    np.testing.assert_allclose(found.drive.times[1:], made.true_command_times, atol=1e-4)
    assert not [words for words in found.findings if "empty" in words or "dropped" in words]
    # Beside rows of a rate, too, in s.
    rates = draft.replace(re.search(r"^time: .*$", draft, re.MULTILINE)[0], "time: {rate: 1000}")
    first = head.split(";", maxsplit=1)[0]
    (tmp_path / "map.yaml").write_text(
        re.sub(r"^(command: {[^}]*)}", rf"\1, time: {first}}}", rates, flags=re.MULTILINE)
    )
    again = read_trace(path, None, load_map(tmp_path / "map.yaml"))
    np.testing.assert_allclose(again.drive.times, found.drive.times, atol=1e-9)
    np.testing.assert_allclose(again.times, found.times, atol=1e-9)
    # What is not in a column of a table has its own clock already.
    (tmp_path / "map.yaml").write_text("command: /u\nposition: {topic: /x, time: t}\n")
    with pytest.raises(MapError, match=r"position\.time: is a column; messages of a bag have their own"):
        load_map(tmp_path / "map.yaml")


@pytest.mark.parametrize("every", [1.0, 1.0 / 20.0], ids=["each ms", "as the other"])
def test_a_clock_may_count_milliseconds_or_be_longer_than_another(
    tmp_path: Path, made: Recording, every: float
) -> None:
    """A column of whole milliseconds is no counter of rows where it bears the name of the column of times."""
    end = 1e3 * made.times[-1]
    clock = np.arange(0.0, end, every)
    volts = np.append(0.0, made.volts)[np.searchsorted(1e3 * made.command_times, clock, side="right")]
    lifts = zip(1e3 * made.times[:-3], 1e3 * made.pilot_position[:-3], strict=True)
    rows = itertools.zip_longest(lifts, zip(clock, volts, strict=True), fillvalue=("", ""))
    path = tmp_path / "log.csv"
    path.write_text(
        "Time [ms];Lift [mm];Time [ms];Voltage [V]\n" + "".join(f"{a};{b};{c};{d}\n" for (a, b), (c, d) in rows)
    )
    (tmp_path / "map.yaml").write_text(draft_map(path, VALVE, "valve-sim map"))
    found = read_trace(path, None, load_map(tmp_path / "map.yaml"))
    np.testing.assert_allclose(found.drive.times[1:], made.true_command_times, atol=1.1e-3 * every)


DRAFTED = {
    # the head, a row of t s, u V and x mm, and what the draft says of the time and the position
    "stamps": ("sec,nanosec,u,lift", "{s},{ns},{u:.4f},{x:.5f}", "[sec, nanosec], unit: [s, ns]", "lift, unit: mm"),
    "stamps without names": ("", "{s},{ns},{u:.4f},{x:.5f}", "column: ['1', '2'], unit: [s, ns]", "'4', unit: mm"),
    "date and time": ("Date,Time,u,lift", "{d:%Y-%m-%d,%H:%M:%S.%f},{u:.4f},{x:.5f}", "[Date, Time]", "lift, unit: mm"),
    "American dates": (
        "t,u,lift", "{d:%m/%d/%Y %I:%M:%S.%f %p},{u:.4f},{x:.5f}", "'%m/%d/%Y %I:%M:%S.%f %p'", "lift, unit: mm",
    ),
    "voltages of a card": ("X_Value,Voltage,Voltage 1", "{t:.6f},{u:.4f},{x:.5f}", "X_Value", "Voltage 1, unit: mm"),
    "days": ("t,u,lift", "{days:.12f},{u:.4f},{x:.5f}", "unit: d", "lift, unit: mm"),
    "a log of changes": ("t,u,lift", "{t:.6f},{change},{x:.5f}", "column: t", "lift, unit: mm"),
    "a counter that jumps": ("n,t,u,lift", "{n},{t:.6f},{u:.4f},{x:.5f}", "column: t", "lift, unit: mm"),
    "ticks of Windows": ("t,u,lift", "{ticks},{u:.4f},{x:.5f}", "unit: 100ns", "lift, unit: mm"),
    "a laser in volts": ("t,u,laser_V", "{t:.6f},{u:.4f},{x:.5f}", "column: t", "laser_V, unit: mm"),
    "milliseconds beside the time of day": (
        "Time,ms,u,lift", "{d:%H:%M:%S},{d.microsecond}e-3,{u:.4f},{x:.5f}",
        "[Time, ms], unit: [s, ms]", "lift, unit: mm",
    ),
    "codes for no reading": ("t,u,lift", "{t:.6f},{u:.4f},{coded:.5f}", "column: t", "lift, unit: mm"),
    "nanometres": ("t,u,lift", "{t:.6f},{u:.4f},{nm:.0f}", "column: t", "lift, unit: nm"),
}  # fmt: skip


@pytest.mark.parametrize("kind", DRAFTED)
def test_a_first_map_of_a_table_finds_its_time_and_its_position(kind: str, tmp_path: Path, made: Recording) -> None:
    head, form, time, position = DRAFTED[kind]
    lines, midnight = [head] if head else [], datetime(2024, 3, 2, 23, 59, 59, 950_000)
    before = math.nan
    for n, (t, x) in enumerate(zip(made.times.tolist(), made.pilot_position.tolist(), strict=True)):
        u = float(made.volts[max(0, int(np.searchsorted(made.command_times, t, side="right")) - 1)])
        s, ns = divmod(1_709_390_268_950_000_000 + round(1e9 * t), 10**9)
        row = {"t": t, "s": s, "ns": ns, "d": midnight + timedelta(seconds=t), "u": u, "x": 1e3 * x, "nm": 1e9 * x}
        row |= {
            "days": t / 86_400.0,
            "change": u if u != before else "",
            "ticks": 133538 * 10**12 + round(1e7 * t),
            "n": n + 50 * (n > 99),
        }
        row |= {"coded": -9999.0 if n % 300 == 299 else 1e3 * x}
        before = u
        lines.append(form.format(**row))
    (tmp_path / "a.csv").write_text("\n".join(lines) + "\n")
    text = draft_map(tmp_path / "a.csv", VALVE, "valve-sim map")
    assert time in next(line for line in text.splitlines() if line.startswith("time:"))
    assert position in next(line for line in text.splitlines() if line.startswith("position:")), text
    (tmp_path / "map.yaml").write_text(text)
    found = read_trace(tmp_path / "a.csv", None, load_map(tmp_path / "map.yaml"))
    np.testing.assert_allclose(found.times, made.times - made.times[0], atol=1e-6)
    np.testing.assert_allclose(found.drive.times[1:], made.true_command_times[1:] - made.times[0], atol=6e-5)


def test_a_table_without_a_voltage_has_no_draft_but_words_on_its_columns(tmp_path: Path, made: Recording) -> None:
    columns = np.column_stack([made.times, 1e3 * made.pilot_position, 20.0 + 0.01 * np.sin(made.times)])
    np.savetxt(tmp_path / "a.csv", columns, delimiter=",", header="t,lift,degC", comments="", fmt="%.6f")
    with pytest.raises(TraceError, match=r"neither command nor voltage.* lift: .* a position.*degC: .* a temperature"):
        draft_map(tmp_path / "a.csv", VALVE, "valve-sim map")


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (
            ["0,0,0", "0.001,9,0", "0.002,9,1", "0.001,9,1"],
            "line 5: time column t runs backwards, 0.001 s after 0.002 s",
        ),
        (["0,0,0", "0.1,9,0", "0.2,9,1", "Run 2", "0,9,1"], "line 5: column t: found 'Run 2', expected a number"),
    ],
)
def test_a_draft_without_times_says_which_row_is_why(rows: list[str], words: str, tmp_path: Path) -> None:
    """Of several runs in one file, and of a logger that started again; no column of words is taken for one of names."""
    (tmp_path / "a.csv").write_text("\n".join(["t,u,lift", *rows, *(f"{n},9,1" for n in range(1, 30))]))
    with pytest.raises(TraceError, match=re.escape(words)):
        draft_map(tmp_path / "a.csv", VALVE, "valve-sim map")


def test_a_draft_asks_for_the_scale_of_a_sensor_in_per_cent(tmp_path: Path, made: Recording) -> None:
    held = made.volts[np.maximum(np.searchsorted(made.command_times, made.times, side="right") - 1, 0)]
    columns = np.column_stack([made.times, held, made.pilot_position / 1.23e-5])
    np.savetxt(tmp_path / "a.csv", columns, delimiter=",", header="t,u,lift_percent", comments="", fmt="%.6f")
    text = draft_map(tmp_path / "a.csv", VALVE, "valve-sim map")
    assert "CHECK scale: of a sensor in % or in V? Then scale: 12" in text


def test_nothing_that_moves_is_said(tmp_path: Path, made: Recording) -> None:
    bag = Bag()
    bag.floats("/lab/lvdt", made.times, np.full(len(made.times), 12.5))
    with pytest.raises(TraceError, match=r"nothing in it moves \(/lab/lvdt\); record while the valve works"):
        draft_map(bag.write(tmp_path / "still"), VALVE, "valve-sim map")


def test_what_ros_tells_of_itself_and_what_counts_is_no_quantity_of_a_valve(tmp_path: Path, made: Recording) -> None:
    """Words may lie: a stamp is no ampere, and a name may say more than the numbers can be."""
    bag, types, random = Bag(), STORE.types, np.random.default_rng(2)
    bag.floats("/lab/supply", made.command_times, made.volts)
    bag.floats("/lab/lvdt", made.times, 1e3 * made.pilot_position)
    few = made.times[::20]
    bag.floats("/lab/samples_amp", few, np.arange(len(few)) * 1.0)
    bag.floats("/lab/i_code", few, random.uniform(1e8, 1e9, len(few)))
    for time in few[::4].tolist():
        stamp = types["builtin_interfaces/msg/Time"](0, int(random.integers(1, 10**9)))
        bag.add("/parameter_events", "rcl_interfaces/msg/ParameterEvent", time, stamp, "/node", [], [], [])
        bag.add("/clock", "rosgraph_msgs/msg/Clock", time, types["builtin_interfaces/msg/Time"](int(time), 0))
    draft = draft_map(bag.write(tmp_path / "bag"), VALVE, "valve-sim map")
    entries = [line for line in draft.splitlines() if not line.startswith("#")]
    assert [entry.partition(":")[0] for entry in entries] == ["command", "position"], draft
    assert "parameter_events" not in draft
    assert "/clock" not in draft


def test_a_current_by_its_name_alone_must_be_one_that_can_flow(tmp_path: Path, made: Recording) -> None:
    assert made.coil_current is not None
    for factor, is_one in ((1.0, True), (1e3, True), (1e9, False)):
        bag = Bag()
        bag.floats("/lab/supply", made.command_times, made.volts)
        bag.floats("/lab/lvdt", made.times, 1e3 * made.pilot_position)
        bag.floats("/lab/clamp", made.times, factor * made.coil_current)
        draft = draft_map(bag.write(tmp_path / f"bag_{factor:g}"), VALVE, "valve-sim map")
        assert ("\ncurrent: {topic: /lab/clamp" in draft) is is_one, draft


# --- which voltage is the input ---


def controlled(path: Path, volts: np.ndarray, noise: float = 0.01) -> Path:
    """A coil under a voltage that was measured while its current was, as a table."""
    times = np.arange(len(volts)) / 20e3
    random = np.random.default_rng(6)
    columns = (times, volts + noise * random.standard_normal(len(times)), volts / 10.0)
    file = path / "coil.csv"
    file.write_text(
        "t,u,i\n" + "\n".join(",".join(f"{value:.6f}" for value in row) for row in zip(*columns, strict=True))
    )
    return file


COIL_MAP = "time: {column: t, unit: s}\nvoltage: {column: u}\ncurrent: {column: i}\n"
SECONDS = np.arange(4000) / 20e3


@pytest.mark.parametrize(
    ("volts", "words", "steps"),
    [
        (24.5 + 4.0 * np.sin(60.0 * SECONDS), "because it changes without a step", 0),
        (
            np.where(SECONDS > 0.05, 24.0 * np.exp(-(SECONDS - 0.05) / 0.05), 0.0),
            "because it goes on changing between its steps",
            None,
        ),
    ],
    ids=["controlled", "discharged"],
)
def test_a_voltage_that_goes_on_changing_is_itself_the_input(
    tmp_path: Path, volts: np.ndarray, words: str, steps: int | None
) -> None:
    file, path = controlled(tmp_path, volts), tmp_path / "map.yaml"
    path.write_text(COIL_MAP)
    trace = read_trace(file, None, load_map(path))
    (finding,) = [line for line in trace.findings if "measured voltage" in line]
    assert f"column u: the measured voltage itself is the input, {words}" in finding
    assert "0 steps" not in finding
    assert describe(trace).input == "the voltage measured by column u"
    drive = trace.input(0.0)
    held = drive.volts[np.searchsorted(drive.times, SECONDS, side="right") - 1]
    assert np.sqrt(np.mean(np.square(held - volts))) < 0.5, "it follows the voltage, and is no constant"
    assert steps is None or len(trace.drive.times) == 1 + steps


def test_a_switched_voltage_is_held_at_its_levels(tmp_path: Path, made: Recording) -> None:
    file = scope(tmp_path, made)
    trace = read_trace(file, None, load_map(page_map("scope.yaml", tmp_path)))
    assert trace.coil_voltage is None
    assert describe(trace).input == "the levels of the voltage measured by column CH1"


def test_command_and_voltage_may_be_one_column(tmp_path: Path) -> None:
    volts = np.where((SECONDS > 0.05) & (SECONDS < 0.15), 9.0, 0.0)
    file, path = controlled(tmp_path, volts, noise=0.0), tmp_path / "map.yaml"
    path.write_text(COIL_MAP + "command: {column: u}\n")
    trace = read_trace(file, None, load_map(path))
    assert trace.drive.volts.tolist() == [0.0, 9.0, 0.0]
    assert describe(trace).input == "the voltage measured by column u, between the commands of column u"


def test_a_controlled_voltage_in_a_bag_is_the_input(tmp_path: Path) -> None:
    bag, volts = Bag(), 24.5 + 4.0 * np.sin(60.0 * SECONDS)
    bag.floats("/lab/volts", SECONDS, volts)
    bag.floats("/lab/amps", SECONDS, volts / 10.0)
    (tmp_path / "map.yaml").write_text("voltage: {topic: /lab/volts}\ncurrent: {topic: /lab/amps}\n")
    trace = read_trace(bag.write(tmp_path / "bag"), None, load_map(tmp_path / "map.yaml"))
    assert trace.coil_voltage is not None
    np.testing.assert_allclose(trace.coil_voltage.values, volts)
    assert describe(trace).input == "the voltage measured by topic /lab/volts"
