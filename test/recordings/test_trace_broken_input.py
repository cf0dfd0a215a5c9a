"""Thirty and more kinds of broken recordings: each is refused in one clear line or read with a finding that counts."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from valve_sim.files.recording_map import map_from
from valve_sim.model import ValveParameters
from valve_sim.recordings import TraceError, list_valves, read_trace
from valve_sim.recordings.map_draft import draft_map
from valve_sim.recordings.mcap_files import unpack_zstd

from .bag_makers import (
    EPOCH,
    FLOAT,
    GAP,
    JOINT_STATE,
    Message,
    changed,
    clean_trace,
    float_message,
    good_messages,
    header,
    joint_state,
    make_folder,
    make_mcap,
)

VOLTAGE = "/valve/coil_voltage"
MEASURED = "/valve/measured/joint_states"


def cut(path: Path, share: float) -> Path:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path


def without(messages: list[Message], topic: str) -> list[Message]:
    return [message for message in messages if message.topic != topic]


def samples_of(messages: list[Message]) -> list[Message]:
    return [message for message in messages if message.type == JOINT_STATE]


def only_commands() -> list[Message]:
    return without(good_messages(), MEASURED)


def restamped(stamp: Callable[[int, int], int]) -> list[Message]:
    """Return the good messages with header stamps of number and true time (ns since the epoch)."""
    trace = clean_trace()
    messages = only_commands()
    for number, (time, pilot) in enumerate(zip(trace.times.tolist(), trace.pilot_position.tolist(), strict=True)):
        true = EPOCH + round(time * 1e9)
        messages.append(joint_state(MEASURED, true, (pilot, max(0.0, pilot - GAP)), stamp=stamp(number, true)))
    return sorted(messages, key=lambda message: message.time)


def foxglove_mcap(path: Path) -> Path:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("", "test")
        schema = writer.register_schema("JointState", "jsonschema", b"{}")
        channel = writer.register_channel(VOLTAGE, "json", schema)
        writer.add_message(channel, EPOCH, json.dumps({"data": 1}).encode(), EPOCH)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_bytes(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def folder_with(path: Path, **files: bytes) -> Path:
    path.mkdir()
    for name, data in files.items():
        (path / name.replace("_", ".")).write_bytes(data)
    return path


def broken_metadata(path: Path) -> Path:
    folder = make_folder(path / "bag", only_commands(), silent=((MEASURED, JOINT_STATE),))
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    return folder


def headless_sqlite(path: Path) -> Path:
    folder = make_folder(path / "bag", good_messages(), storage=StoragePlugin.SQLITE3)
    file = next(folder.glob("*.db3"))
    write_bytes(file, b"\0" * 4096 + file.read_bytes()[4096:])
    return folder


def folder_of_recordings(path: Path) -> Path:
    for name in ("monday.mcap", "tuesday.mcap"):
        make_mcap(path / name, good_messages())
    make_folder(path / "wednesday", good_messages())
    for left in path.glob("*.folder"):
        shutil.rmtree(left)
    return path


REFUSED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing file": (lambda tmp: tmp / "none.mcap", "does not exist"),
    "empty file": (lambda tmp: write_bytes(tmp / "a.mcap", b""), "is empty"),
    "garbage file": (lambda tmp: write_bytes(tmp / "a.mcap", bytes(range(256)) * 9), "is not a .mcap file"),
    "garbage database": (lambda tmp: write_bytes(tmp / "a.db3", b"no database" * 99), "is not a .db3 file"),
    "magic and nothing more": (lambda tmp: write_bytes(tmp / "a.mcap", b"\x89MCAP0\r\n"), "no message could be saved"),
    "magic, then garbage": (
        lambda tmp: write_bytes(tmp / "a.mcap", b"\x89MCAP0\r\n" + bytes(range(256)) * 9),
        "no message could be saved",
    ),
    "another kind of file": (
        lambda tmp: write_bytes(tmp / "a.csv", b"time,volts\n0,1\n1,2\n"),
        "is not a recording.*--map",
    ),
    "ROS 1 bag": (lambda tmp: write_bytes(tmp / "a.bag", b"#ROSBAG V2.0\n"), "ROS 1 bag"),
    "empty folder": (lambda tmp: folder_with(tmp / "bag"), "holds no .mcap or .db3"),
    "folder of several recordings": (
        folder_of_recordings,
        "holds 3 recordings: monday.mcap, tuesday.mcap, wednesday; name one",
    ),
    "folder with metadata alone": (lambda tmp: folder_with(tmp / "bag", metadata_yaml=b"{}"), "holds no .mcap or .db3"),
    "folder with a zero-length file": (lambda tmp: folder_with(tmp / "bag", a_mcap=b""), "no message could be saved"),
    "no message at all": (
        lambda tmp: make_mcap(tmp / "a.mcap", [], silent=((VOLTAGE, "std_msgs/msg/Float64"), (MEASURED, JOINT_STATE))),
        "holds no message",
    ),
    "cut within the first bytes": (lambda tmp: cut(make_mcap(tmp / "a.mcap", good_messages()), 0.0005), "be saved"),
    "database without its first page": (headless_sqlite, "no message could be saved"),
    "metadata is no YAML, no samples": (broken_metadata, f"{MEASURED} holds no message"),
    "JSON messages": (lambda tmp: foxglove_mcap(tmp / "a.mcap"), "encoded as json"),
    "no valve": (lambda tmp: make_mcap(tmp / "a.mcap", [float_message("/tf", EPOCH, 1.0)]), "no valve in it"),
    "no positions": (lambda tmp: make_mcap(tmp / "a.mcap", only_commands()), "neither .*measured/joint_states"),
    "no voltage": (lambda tmp: make_mcap(tmp / "a.mcap", without(good_messages(), VOLTAGE)), VOLTAGE),
    "silent voltage": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", without(good_messages(), VOLTAGE), silent=((VOLTAGE, "std_msgs/msg/Float64"),)
        ),
        f"{VOLTAGE} holds no message",
    ),
    "silent positions beside a node's output": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", good_messages(measured="joint_states"), silent=((MEASURED, JOINT_STATE),)
        ),
        f"{MEASURED} holds no message",
    ),
    "wrong type of positions": (
        lambda tmp: make_mcap(tmp / "a.mcap", [*only_commands(), float_message(MEASURED, EPOCH, 1.0)]),
        f"{MEASURED} is std_msgs/msg/Float64, expected sensor_msgs/msg/JointState",
    ),
    "wrong type of voltage": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", [*without(good_messages(), VOLTAGE), joint_state(VOLTAGE, EPOCH + 10**9, (1.0, 1.0))]
        ),
        f"{VOLTAGE} is sensor_msgs/msg/JointState, expected std_msgs/msg/Float64",
    ),
    "two valves": (
        lambda tmp: make_mcap(tmp / "a.mcap", [*good_messages("/tank_1/valve"), *good_messages("/tank_2/valve")]),
        "/tank_1/valve, /tank_2/valve.*--valve",
    ),
    "other joints": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", [*only_commands(), joint_state(MEASURED, EPOCH, (0.0, 0.0), names=("elbow", "wrist"))]
        ),
        "names elbow, wrist, expected pilot_plunger",
    ),
    "empty positions": (
        lambda tmp: make_mcap(tmp / "a.mcap", [*only_commands(), joint_state(MEASURED, EPOCH, ())]),
        "no finite pilot_plunger position",
    ),
    "all samples NaN": (
        lambda tmp: make_mcap(tmp / "a.mcap", [*only_commands(), joint_state(MEASURED, EPOCH, (np.nan, np.nan))]),
        "no finite pilot_plunger position",
    ),
    "all commands NaN": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", [*without(good_messages(), VOLTAGE), float_message(VOLTAGE, EPOCH + 10**9, np.nan)]
        ),
        "none of 1 commands is a finite voltage",
    ),
    "messages that are too short": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", [*only_commands(), Message(MEASURED, JOINT_STATE, EPOCH, b"\0\1\0\0\1\0\0\0")]
        ),
        "none of 1 messages can be read",
    ),
    "commands that share one time": (
        lambda tmp: make_mcap(
            tmp / "a.mcap", [own._replace(time=EPOCH) if own.topic == VOLTAGE else own for own in good_messages()]
        ),
        "all 2 commands have one time",
    ),
    "stamps too coarse": (
        lambda tmp: make_mcap(tmp / "a.mcap", restamped(lambda _, true: true - true % 1_000_000)),
        "have the stamp of another sample",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_refused_in_one_line_that_names_the_file_and_the_mend(kind: str, tmp_path: Path) -> None:
    make, expected = REFUSED[kind]
    path = make(tmp_path)
    with pytest.raises(TraceError, match=expected) as caught:
        read_trace(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    assert ";" in message, "what to do comes after a semicolon"


def check(path: Path, finding: str, least: int, most: int = 1000) -> None:
    """Read, look for the finding, and compare what was kept with the truth."""
    trace = read_trace(path)
    assert not finding or any(re.search(finding, text) for text in trace.findings), trace.findings
    assert least <= len(trace.times) <= most
    assert (np.diff(trace.times) > 0).all()
    truth = clean_trace()
    true_times = np.round((trace.epoch_ns - EPOCH) * 1e-9 + trace.times, 9)
    nearest = np.round(true_times * 10_000).astype(int)
    np.testing.assert_allclose(true_times, nearest / 10_000, atol=2e-9)
    np.testing.assert_array_equal(trace.pilot_position, truth.pilot_position[nearest])


def mcap_by_another_writer(path: Path, *, beside: bool = False, of_middleware: bool = False, **options: Any) -> Path:
    """Write the good messages as other recorders do: with checksums, small chunks, or none; others beside them."""
    name, kind = (r"rt/\1", r"\1::msg::dds_::\2_") if of_middleware else (r"/\1", r"\1/msg/\2")
    with path.open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE, **options)
        writer.start("ros2", "test")
        channels: dict[str, int] = {}
        for encoding in ("protobuf", "json") if beside else ():
            schema = writer.register_schema(f"lab.{encoding}", encoding, b"{}")
            writer.add_message(writer.register_channel(f"/{encoding}", encoding, schema), EPOCH, b"{}", EPOCH)
        for message in good_messages():
            if message.topic not in channels:
                schema = writer.register_schema(re.sub(r"(\w+)/msg/(\w+)", kind, message.type), "ros2msg", b"")
                topic = re.sub("^/(.*)", name, message.topic)
                channels[message.topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[message.topic], message.time, message.data, message.time)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def small_chunks(tmp: Path, flipped: int | None = None, **options: Any) -> Path:
    path = mcap_by_another_writer(tmp / "a.mcap", chunk_size=20_000, **options)
    data = bytearray(path.read_bytes())
    if flipped is not None:
        data[flipped % len(data)] ^= 0x10
    return write_bytes(path, bytes(data))


def folder(tmp: Path, share: float = 1.0, metadata: str | None = None, **options: Any) -> Path:
    """A rosbag2 folder whose only file is cut, with other metadata; none where this is empty."""
    path = make_folder(tmp / "bag", good_messages(), **options)
    cut(next(file for file in path.iterdir() if file.name.startswith("bag")), share)
    if metadata is not None:
        (path / "metadata.yaml").write_text(metadata)
    if metadata == "":
        (path / "metadata.yaml").unlink()
    return path


def with_another_file(tmp: Path, *, listed: bool) -> Path:
    """Beside the recording a file that metadata.yaml does not list, or a listed one that is not there."""
    path = folder(tmp)
    if listed:
        metadata = path / "metadata.yaml"
        metadata.write_text(re.sub(r"(\n *)- bag.mcap", r"\1- bag.mcap\1- bag_1.mcap", metadata.read_text()))
    else:
        make_mcap(path / "other.mcap", good_messages("/other"))
    return path


def split(tmp: Path) -> Path:
    messages = good_messages()
    first = make_folder(tmp / "bag", messages[:500])
    shutil.move(make_folder(tmp / "other", messages[500:]) / "other.mcap", first / "bag_1.mcap")
    (first / "metadata.yaml").unlink()
    return first


def with_an_empty_part(tmp: Path) -> Path:
    """A recorder that lost power had made the next file, and written nothing into it."""
    path = folder(tmp)
    (path / "bag_1.mcap").write_bytes(b"")
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(re.sub(r"( +- )bag.mcap\n", r"\1bag.mcap\n\1bag_1.mcap\n", text))
    return path


def unpacked_beside(tmp: Path) -> Path:
    """As playing a packed recording leaves it, here with half of the unpacked file."""
    path = folder(tmp, compression=CompressionMode.FILE)
    (packed,) = path.glob("*.zstd")
    packed.with_suffix("").write_bytes(unpack_zstd(packed.read_bytes())[: 1 << 16])
    return path


def with_write_ahead_log(tmp: Path) -> Path:
    """As a killed recorder leaves it: half of the messages are in the log beside the database."""
    path = folder(tmp, storage=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("PRAGMA journal_mode=WAL")
        rows = connection.execute("SELECT * FROM messages WHERE id > 500").fetchall()
        connection.execute("DELETE FROM messages WHERE id > 500")
        connection.commit()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        connection.commit()
        (tmp / "killed").mkdir()
        for name in (file.name, file.name + "-wal"):
            shutil.copy(path / name, tmp / "killed" / name)
    return tmp / "killed"


def with_journal(tmp: Path) -> Path:
    """As something that was changing the database leaves it when it is killed: half changed, with what undoes it."""
    path = folder(tmp, storage=StoragePlugin.SQLITE3)
    file = next(path.glob("*.db3"))
    (tmp / "killed").mkdir()
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        for command in ("PRAGMA journal_mode=DELETE", "PRAGMA cache_size=2", "BEGIN", "DELETE FROM messages"):
            connection.execute(command)
        for name in (file.name, file.name + "-journal"):
            shutil.copy(path / name, tmp / "killed" / name)
        connection.execute("ROLLBACK")
    return tmp / "killed"


def windows_metadata(tmp: Path) -> Path:
    path = folder(tmp)
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_bytes(text.replace("\n", "\r\n").encode())
    return path


def with_quality_of_service(tmp: Path, text: str) -> Path:
    path = folder(tmp, storage=StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as connection:
        connection.execute("UPDATE topics SET offered_qos_profiles = ?", (text,))
        connection.commit()
    return path


def other_metadata(tmp: Path) -> Path:
    path = folder(tmp)
    text = (path / "metadata.yaml").read_text()
    text = re.sub("version: 9", "version: 10", re.sub("storage_identifier: .*", "storage_identifier: ''", text))
    (path / "metadata.yaml").write_text(text)
    return path


WHOLE, NO_YAML, NO_METADATA = (1000, 1000), "rosbag2_bagfile_information: [", ""
ZSTD = CompressionMode.STORAGE
READ: dict[str, tuple[Callable[[Path], Path], str, tuple[int, int]]] = {
    "sound": (lambda tmp: make_mcap(tmp / "a.mcap", good_messages()), "", WHOLE),
    "half of a file": (
        lambda tmp: cut(make_mcap(tmp / "a.mcap", good_messages()), 0.5),
        r"a.mcap: damaged or unfinished \(.*\); kept \d+ messages, what followed is lost",
        (300, 900),
    ),
    "half of packed chunks": (
        lambda tmp: cut(make_mcap(tmp / "a.mcap", good_messages(), compression=ZSTD), 0.5),
        "what followed is lost",
        (300, 900),
    ),
    "without its last bytes": (lambda tmp: cut(make_mcap(tmp / "a.mcap", good_messages()), 0.9999), "", WHOLE),
    "a suffix in capitals": (lambda tmp: make_mcap(tmp / "a.mcap", good_messages()).rename(tmp / "A.MCAP"), "", WHOLE),
    "without chunks, cut": (
        lambda tmp: cut(mcap_by_another_writer(tmp / "a.mcap", use_chunking=False), 0.6),
        "what followed is lost",
        (500, 800),
    ),
    "without an index": (lambda tmp: small_chunks(tmp, index_types=IndexType.NONE), "", WHOLE),
    "with an index of chunks alone": (lambda tmp: small_chunks(tmp, index_types=IndexType.CHUNK), "", WHOLE),
    "channels not repeated": (lambda tmp: small_chunks(tmp, repeat_channels=False), "", WHOLE),
    "schemas not repeated": (lambda tmp: small_chunks(tmp, repeat_schemas=False), "", WHOLE),
    "other encodings beside": (lambda tmp: small_chunks(tmp, beside=True), "", WHOLE),
    "a damaged chunk": (lambda tmp: small_chunks(tmp, 100_000), "1 damaged chunk", (700, 950)),
    # The first chunk alone has the types of the topics, but for the end of the file, which repeats them.
    "a damaged first chunk": (lambda tmp: small_chunks(tmp, 2000), "1 damaged chunk", (700, 950)),
    "no metadata": (lambda tmp: folder(tmp, metadata=NO_METADATA), "metadata.yaml is missing .*kept 1002", WHOLE),
    "no metadata of a database": (
        lambda tmp: folder(tmp, metadata=NO_METADATA, storage=StoragePlugin.SQLITE3),
        "metadata.yaml is missing .*kept 1002",
        WHOLE,
    ),
    "lost power": (
        lambda tmp: folder(tmp, 0.5, NO_METADATA),
        "metadata.yaml is missing .*what followed is lost",
        (300, 700),
    ),
    "packed, no metadata": (
        lambda tmp: folder(tmp, metadata=NO_METADATA, storage=StoragePlugin.SQLITE3, compression=CompressionMode.FILE),
        "kept 1002",
        WHOLE,
    ),
    "packed messages, no metadata": (
        lambda tmp: folder(tmp, metadata=NO_METADATA, compression=CompressionMode.MESSAGE),
        "kept 1002",
        WHOLE,
    ),
    "metadata that are no YAML": (lambda tmp: folder(tmp, metadata=NO_YAML), "cannot be read.*kept 1002", WHOLE),
    "metadata of a later version": (other_metadata, "", WHOLE),
    "a listed file is missing": (lambda tmp: with_another_file(tmp, listed=True), "bag_1.mcap is missing", WHOLE),
    "a file that is not listed": (
        lambda tmp: with_another_file(tmp, listed=False),
        "other.mcap was not read: metadata.yaml does not list it",
        WHOLE,
    ),
    "several files": (split, "kept 1002", WHOLE),
    "an empty part": (with_an_empty_part, r"nothing of bag_1.mcap is valid\); kept 1002 messages, the rest is", WHOLE),
    "unpacked beside packed": (unpacked_beside, "", WHOLE),
    "names of topics without a slash": (
        lambda tmp: make_mcap(tmp / "a.mcap", [own._replace(topic=own.topic[1:]) for own in good_messages()]),
        "",
        WHOLE,
    ),
    "topics and types as the middleware has them": (
        lambda tmp: mcap_by_another_writer(tmp / "a.mcap", of_middleware=True),
        "",
        WHOLE,
    ),
    "a cut database": (
        lambda tmp: folder(tmp, 0.5, storage=StoragePlugin.SQLITE3),
        r"kept \d+ of 1002 messages, what followed is lost",
        (350, 500),
    ),
    "a write-ahead log": (with_write_ahead_log, "kept 1002 messages, the data reach their end", WHOLE),
    "an unfinished change": (with_journal, "kept 1002 messages, the data reach their end", WHOLE),
    "metadata written by Windows": (windows_metadata, "", WHOLE),
    "no quality of service": (lambda tmp: with_quality_of_service(tmp, ""), "", WHOLE),
    "an edited quality of service": (lambda tmp: with_quality_of_service(tmp, "- history: [keep"), "", WHOLE),
}


@pytest.mark.parametrize("kind", READ)
def test_what_is_whole_of_a_recording_is_read(kind: str, tmp_path: Path) -> None:
    make, finding, (least, most) = READ[kind]
    path = make(tmp_path)
    check(path, finding, least, most)
    assert finding or read_trace(path).findings == ()


def test_of_a_compressed_chunk_with_a_hole_what_comes_before_it_is_kept() -> None:
    """A frame of zstd is unpacked block by block, of 128 KiB each."""
    steps = np.random.default_rng(1).integers(0, 8, 50_000, dtype=np.uint32)
    whole = np.cumsum(steps, dtype=np.uint32).tobytes()
    frame = bytearray(zstandard.ZstdCompressor().compress(whole))
    hole = len(frame) * 9 // 10
    frame[hole : hole + 300] = bytes(300)
    found = unpack_zstd(bytes(frame))
    kept = 1 << 17
    assert found[:kept] == whole[:kept]


def logged_and_published(path: Path, logged: Callable[[Message], int], published: Callable[[Message], int]) -> Path:
    """The good messages, with times of the log and of publication by their own."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        channels: dict[str, int] = {}
        for message in good_messages():
            if message.topic not in channels:
                schema = writer.register_schema(message.type, "ros2msg", b"")
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            writer.add_message(channels[message.topic], logged(message), message.data, published(message))
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.parametrize(("ahead", "lateness"), [(0, 0.0), (2_000_000, 3.4e-3), (10**15, 3.4e-3)])
def test_messages_are_timed_by_their_publication_where_both_clocks_agree(
    ahead: int, lateness: float, tmp_path: Path
) -> None:
    """Commands that are logged 3.4 ms late; a publishers' clock that is so many ns ahead is another one."""
    path = logged_and_published(
        tmp_path / "a.mcap", lambda own: own.time + 3_400_000 * (own.topic == VOLTAGE), lambda own: own.time + ahead
    )
    trace, truth = read_trace(path), clean_trace()
    np.testing.assert_allclose(trace.drive.times - truth.drive.times, lateness, atol=1e-8)
    assert any("3.40 ms after they were published" in finding for finding in trace.findings) == (lateness == 0.0)


@pytest.mark.parametrize("step", [2_300_000, 10**19])
def test_messages_are_timed_by_their_publication_where_the_log_stands_still(step: int, tmp_path: Path) -> None:
    path = logged_and_published(tmp_path / "a.mcap", lambda own: own.time // step * step, lambda own: own.time)
    trace = read_trace(path)
    np.testing.assert_allclose(trace.drive.times, clean_trace().drive.times, atol=1e-8)
    assert "a.mcap: several messages were logged at one time" in trace.findings[0]


@pytest.mark.parametrize("ahead", [0, 2_000_000])
def test_of_samples_that_are_sent_in_bursts_nothing_follows_for_commands(ahead: int, tmp_path: Path) -> None:
    """The publishers' clock is that of the recorder, or another one; the log is fine."""
    path = logged_and_published(
        tmp_path / "a.mcap",
        lambda own: own.time + 12_345 if own.topic == VOLTAGE else (own.time // 2_300_000 + 1) * 2_300_000,
        lambda own: own.time + ahead,
    )
    trace = read_trace(path)
    np.testing.assert_allclose(trace.drive.times, clean_trace().drive.times, atol=2e-5)
    assert not any("at one time" in finding or "coarsely" in finding for finding in trace.findings)


def test_a_log_that_stands_still_without_a_publication_is_named(tmp_path: Path) -> None:
    path = logged_and_published(tmp_path / "a.mcap", *[lambda own: own.time // 2_300_000 * 2_300_000] * 2)
    assert "a.mcap: most messages were logged at the time of another" in read_trace(path).findings[0]


IDL = """\
{line}
IDL: lab_msgs/msg/Lift
#include "std_msgs/msg/Header.idl"
module lab_msgs {{ module msg {{
  struct Lift {{ std_msgs::msg::Header header; @unit (value="mm") double lift; }};
}}; }};
{line}
IDL: std_msgs/msg/Header
#include "builtin_interfaces/msg/Time.idl"
module std_msgs {{ module msg {{ struct Header {{ builtin_interfaces::msg::Time stamp; string frame_id; }}; }}; }};
{line}
IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{ module msg {{ struct Time {{ int32 sec; uint32 nanosec; }}; }}; }};
""".format(line="=" * 80)


def test_a_type_of_the_lab_is_read_by_its_definition_in_idl(tmp_path: Path) -> None:
    store, truth = get_typestore(Stores.ROS2_JAZZY), clean_trace()
    store.register(get_types_from_msg("std_msgs/Header header\nfloat64 lift\n", "lab_msgs/msg/Lift"))
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros2", "test")
        volts = writer.register_channel("/volts", "cdr", writer.register_schema(FLOAT, "ros2msg", b""))
        schema = writer.register_schema("lab_msgs/msg/Lift", "ros2idl", IDL.encode())
        lifts = writer.register_channel("/lift", "cdr", schema)
        for message in without(good_messages(), "/valve/measured/joint_states"):
            writer.add_message(volts, message.time, message.data, message.time)
        for time, lift in zip(truth.times.tolist(), truth.pilot_position.tolist(), strict=True):
            stamp = EPOCH + round(time * 1e9)
            message = store.types["lab_msgs/msg/Lift"](header(stamp), 1e3 * lift)
            writer.add_message(lifts, stamp, bytes(store.serialize_cdr(message, "lab_msgs/msg/Lift")), stamp)
        writer.finish()  # type: ignore[no-untyped-call]
    entries = {"command": "/volts", "position": {"topic": "/lift", "unit": "mm"}}
    found = read_trace(tmp_path / "a.mcap", None, map_from(entries, "map.yaml"))
    np.testing.assert_allclose(found.pilot_position, truth.pilot_position, atol=1e-15)


JAZZY = get_typestore(Stores.ROS2_JAZZY)


def as_second_version(message: Message, order: str, *, delimited: bool) -> Message:
    """A Float64, or a JointState of good messages, as XCDR2 writes it: numbers lie at multiples of 4 at most."""
    body = bytearray()

    def put(form: str, *values: Any) -> None:
        body.extend(b"\0" * (-len(body) % 4) + struct.pack(order + form, *values))

    def put_text(text: str) -> None:
        put(f"I{len(text) + 1}s", len(text) + 1, text.encode())

    @contextmanager
    def sized(*, wanted: bool = True) -> Iterator[None]:
        if wanted:
            put("I", 0)
        begin = len(body)
        yield
        if wanted:
            struct.pack_into(order + "I", body, begin - 4, len(body) - begin)

    plain: Any = JAZZY.deserialize_cdr(message.data, message.type)
    with sized(wanted=delimited):
        if message.type == FLOAT:
            put("d", plain.data)
        else:
            with sized(wanted=delimited):
                with sized(wanted=delimited):
                    put("iI", plain.header.stamp.sec, plain.header.stamp.nanosec)
                put_text(plain.header.frame_id)
            with sized():
                put("I", len(plain.name))
                for name in plain.name:
                    put_text(name)
            for numbers in (plain.position, plain.velocity, plain.effort):
                put(f"I{len(numbers)}d", len(numbers), *numbers)
    head = bytes([0, (8 if delimited else 6) + (order == "<"), 0, 0])
    return message._replace(data=head + bytes(body))


@pytest.mark.parametrize("delimited", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
def test_messages_of_the_second_version_of_cdr_are_read(order: str, delimited: bool, tmp_path: Path) -> None:
    messages = [as_second_version(message, order, delimited=delimited) for message in good_messages()]
    path = make_mcap(tmp_path / "a.mcap", messages)
    check(path, "", 1000)
    assert read_trace(path).findings == ()


def test_a_way_to_write_messages_that_is_not_read_is_named(tmp_path: Path) -> None:
    messages = [message._replace(data=b"\0\x0b" + message.data[2:]) for message in good_messages()]
    path = make_mcap(tmp_path / "a.mcap", messages)
    with pytest.raises(TraceError, match="JointState, they are written as PL_CDR2; set the middleware to write CDR"):
        read_trace(path)
    with pytest.raises(TraceError, match=r"coil_voltage none of 2 messages .* PL_CDR2.*; record while"):
        draft_map(path, ValveParameters(), "valve-sim map")


def test_bytes_after_a_joint_state_are_trimmed(tmp_path: Path) -> None:
    messages = [
        message._replace(data=message.data + b"\x7f" * (4 * (1 + number % 2)))
        if message.type == JOINT_STATE
        else message
        for number, message in enumerate(good_messages())
    ]
    check(make_mcap(tmp_path / "a.mcap", messages), "trimmed surplus bytes after 1000 of 1000 messages", 1000)


def test_joint_states_with_empty_last_arrays_and_rubbish(tmp_path: Path) -> None:
    messages = only_commands()
    for number in range(50):
        sample = joint_state(MEASURED, EPOCH + number * 100_000, (1e-6 * number, 0.0), filled=False)
        messages.append(sample._replace(data=sample.data + b"\x7f" * 8))
    trace = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    np.testing.assert_allclose(trace.pilot_position, 1e-6 * np.arange(50))
    assert any("trimmed surplus bytes after 50 of 50" in finding for finding in trace.findings)


def test_unreadable_messages_are_dropped(tmp_path: Path) -> None:
    messages = good_messages()
    place = next(place for place, message in enumerate(messages) if message.type == JOINT_STATE and place > 500)
    messages[place] = messages[place]._replace(data=messages[place].data[:40])
    messages[place + 1] = messages[place + 1]._replace(data=b"\xff" * 40)
    check(make_mcap(tmp_path / "a.mcap", messages), "dropped 2 of 1000 messages that cannot be read", 998)


def test_every_message_of_another_layout(tmp_path: Path) -> None:
    truth = clean_trace().pilot_position
    messages = [
        joint_state(MEASURED, EPOCH + n * 10**5, (0.0, x, 0.0), names=(f"n{n:05d}", "pilot_plunger", "main_plunger"))
        for n, x in enumerate(truth.tolist())
    ]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", [*only_commands(), *messages]))
    np.testing.assert_array_equal(trace.pilot_position, truth)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_samples_that_are_not_finite_are_dropped(value: float, tmp_path: Path) -> None:
    messages = changed(good_messages(), 300, positions=(value, 0.0))
    messages = changed(messages, 700, positions=(0.0, value))
    check(make_mcap(tmp_path / "a.mcap", messages), "dropped 1 of 1000 samples without a finite pilot_plunger", 998)


def test_readings_that_no_plunger_can_have_are_dropped(tmp_path: Path) -> None:
    messages = changed(good_messages(), 300, positions=(3e155, 0.0))
    messages = changed(messages, 700, positions=(0.0, -40.0))
    check(make_mcap(tmp_path / "a.mcap", messages), r"2 positions are none, such as 3e\+155 m", 998)


def test_positions_in_another_unit_are_kept_and_doubted(tmp_path: Path) -> None:
    messages = [
        joint_state(MEASURED, EPOCH + n * 10**5, (1e6 * x, 0.0)) for n, x in enumerate(clean_trace().pilot_position)
    ]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", [*only_commands(), *messages]))
    assert len(trace.times) == len(messages)
    assert any("positions must be in metres" in finding for finding in trace.findings)


def test_commands_that_are_not_finite_are_dropped(tmp_path: Path) -> None:
    messages = [*good_messages(), float_message(VOLTAGE, EPOCH + 10**8, np.nan)]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    assert trace.drive.volts.tolist() == [9.0, 0.0]
    assert any("dropped 1 of 3 commands" in finding for finding in trace.findings)


def test_main_plunger_that_is_never_measured_is_left_out(tmp_path: Path) -> None:
    messages = only_commands()
    messages += [joint_state(MEASURED, EPOCH + n * 10**5, (n * 1e-6,), names=("pilot_plunger",)) for n in range(50)]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    assert trace.main_position is None
    assert any("main_plunger has no position in 50 of 50" in finding for finding in trace.findings)


def test_duplicated_samples_are_dropped(tmp_path: Path) -> None:
    messages = good_messages()
    doubled = sorted([*messages, *samples_of(messages)[100:200]], key=lambda message: message.time)
    check(make_mcap(tmp_path / "a.mcap", doubled), "dropped 100 of 1100 samples that were recorded twice", 1000)


def test_two_samples_of_one_stamp_keep_the_first(tmp_path: Path) -> None:
    messages = restamped(lambda number, true: true - 100_000 * (number == 500))
    check(make_mcap(tmp_path / "a.mcap", messages), "dropped 1 of 1000 samples that differ", 999)


def test_reordered_samples_are_put_back(tmp_path: Path) -> None:
    messages = good_messages()
    samples = samples_of(messages)
    order = np.arange(1000)
    order[400:420] = order[400:420][::-1]
    late = [samples[place]._replace(time=samples[number].time) for number, place in enumerate(order)]
    check(
        make_mcap(tmp_path / "a.mcap", [*only_commands(), *late]), "19 of 1000 samples were recorded out of order", 1000
    )


def test_shuffled_samples_are_put_back(tmp_path: Path) -> None:
    samples = samples_of(good_messages())
    order = np.random.default_rng(5).permutation(1000)
    late = [samples[place]._replace(time=samples[number].time) for number, place in enumerate(order)]
    check(make_mcap(tmp_path / "a.mcap", [*only_commands(), *late]), "recorded out of order", 1000)


def test_single_stamps_that_jump_back_are_dropped(tmp_path: Path) -> None:
    messages = restamped(lambda number, true: true - 10_050_000 * (number in {300, 600}))
    check(make_mcap(tmp_path / "a.mcap", messages), "dropped 2 of 1000 samples whose stamps jump back", 998)


@pytest.mark.parametrize("stamp", [0, 2_100_000_000_000_000_000])
def test_stamps_of_another_time_are_dropped(stamp: int, tmp_path: Path) -> None:
    messages = restamped(lambda number, true: stamp if number in {0, 500} else true)
    check(make_mcap(tmp_path / "a.mcap", messages), "dropped 2 of 1000 samples whose stamps are of another time", 998)


@pytest.mark.parametrize("jump", [-20_030_000, -5_000_000_000, 300_000_000, 7_000_000_000])
@pytest.mark.parametrize("place", [300, 700])
def test_clock_that_was_set_keeps_the_longest_stretch_with_its_commands(jump: int, place: int, tmp_path: Path) -> None:
    messages = restamped(lambda number, true: true + jump * (number >= place))
    trace = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    assert any(re.search("clock was set|of another time", text) for text in trace.findings), trace.findings
    assert len(trace.times) == 700
    # Commands stay where they were beside the samples that are kept.
    truth = clean_trace()
    kept = slice(0, 700) if place == 700 else slice(300, 1000)
    np.testing.assert_array_equal(trace.pilot_position, truth.pilot_position[kept])
    lead = trace.times[0] - truth.times[kept][0]
    np.testing.assert_allclose(trace.drive.times - truth.drive.times, lead, atol=1e-8)


@pytest.mark.parametrize("begin", [5, 2000])
def test_a_recorder_that_stalls_is_no_clock_that_was_set(begin: int, tmp_path: Path) -> None:
    """Its last messages before it are noted 150 ms late, those of these 150 ms are lost."""
    samples, end = samples_of(good_messages(duration=0.5)), begin + 1500
    messages = [
        message._replace(time=samples[end].time - end + number) if begin - 5 <= number < begin else message
        for number, message in enumerate(samples)
        if not begin <= number < end
    ]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", sorted([*only_commands(), *messages], key=lambda m: m.time)))
    assert not [finding for finding in trace.findings if "was set" in finding]
    assert len(trace.times) == 3500


def test_model_time_beside_wall_time_is_aligned(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    messages = only_commands()
    trace = clean_trace()
    for time, pilot in zip(trace.times.tolist(), trace.pilot_position.tolist(), strict=True):
        arrival = EPOCH + round((time + rng.exponential(20e-6)) * 1e9)
        messages.append(joint_state(MEASURED, arrival, (pilot, 0.0), stamp=round(time * 1e9)))
    read = read_trace(make_mcap(tmp_path / "a.mcap", sorted(messages, key=lambda message: message.time)))
    assert any("two clocks" in finding for finding in read.findings)
    np.testing.assert_allclose(read.drive.times, trace.drive.times, atol=30e-6)
    assert read.clock == "header"


@pytest.mark.parametrize("rate", [0.4, 3.0])
def test_commands_are_moved_onto_the_clock_of_a_simulation(rate: float, tmp_path: Path) -> None:
    """A simulation that is slower or faster than real time stamps by its own clock."""
    truth, random = clean_trace(), np.random.default_rng(3)
    messages = [
        own._replace(time=EPOCH + round((own.time - EPOCH) / rate + random.exponential(20e3))) if own.topic == VOLTAGE
        else own._replace(time=EPOCH + round((own.time - EPOCH) / rate))
        for own in restamped(lambda _, true: 5 * 10**9 + true - EPOCH)
    ]  # fmt: skip
    trace = read_trace(make_mcap(tmp_path / "a.mcap", sorted(messages, key=lambda message: message.time)))
    assert any(f"clock advances by {rate:g} s in a second of bag time" in finding for finding in trace.findings)
    np.testing.assert_allclose(trace.drive.times - trace.drive.times[0], [0.0, 0.04], atol=100e-6 * rate)
    np.testing.assert_allclose(np.diff(trace.times), np.diff(truth.times), atol=1e-9)


def test_stamps_in_another_unit_give_way_to_bag_time(tmp_path: Path) -> None:
    """Microseconds, filled in as nanoseconds."""
    path = make_mcap(tmp_path / "a.mcap", restamped(lambda _, true: EPOCH + (true - EPOCH) // 1000))
    check(path, "header stamps advance by 0.001 s in a second of recording", 1000)
    assert read_trace(path).clock == "bag"


def test_computers_whose_clocks_differ_are_named(tmp_path: Path) -> None:
    messages = restamped(lambda _, true: true - 5_000_000_000)
    trace = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    assert any("bag times are 5.000 s from the stamps" in finding for finding in trace.findings)


def test_stamps_that_were_never_filled_give_way_to_bag_time(tmp_path: Path) -> None:
    path = make_mcap(tmp_path / "a.mcap", restamped(lambda *_: 0))
    assert read_trace(path).clock == "bag"
    check(path, "all header stamps are the same", 1000)


def test_gap_is_counted(tmp_path: Path) -> None:
    messages = good_messages()
    lost = {message.time for message in samples_of(messages)[200:250]}
    kept = [message for message in messages if message.type != JOINT_STATE or message.time not in lost]
    check(make_mcap(tmp_path / "a.mcap", kept), r"1 gaps in the samples, the longest 0.005100 s", 950)


def test_no_motion_is_said(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    still = rng.normal(0, 1e-6, 1000)
    messages = [joint_state(MEASURED, EPOCH + n * 10**5, (float(x), 0.0)) for n, x in enumerate(still)]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", [*only_commands(), *messages]))
    assert any("no motion" in finding for finding in trace.findings)


def test_voltage_that_stays_at_zero_is_said(tmp_path: Path) -> None:
    messages = [*without(good_messages(), VOLTAGE), float_message(VOLTAGE, EPOCH, 0.0)]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    assert any("never leaves 0 V" in finding for finding in trace.findings)


def test_output_of_a_node_stands_in_for_measurements(tmp_path: Path) -> None:
    messages = [*good_messages(measured="joint_states"), float_message("/valve/coil_current", EPOCH + 10**7, 0.5)]
    path = make_mcap(tmp_path / "a.mcap", messages)
    check(path, "measured/joint_states is not in the bag: /valve/joint_states", 1000)
    current = read_trace(path).coil_current
    assert current is not None
    assert current.values.tolist() == [0.5]


def test_optional_topic_of_the_wrong_type_is_left_out(tmp_path: Path) -> None:
    messages = [*good_messages(), joint_state("/valve/measured/coil_current", EPOCH, (1.0, 1.0))]
    check(make_mcap(tmp_path / "a.mcap", messages), "coil_current is sensor_msgs/msg/JointState, expected", 1000)


def test_one_of_several_valves_is_chosen_by_name(tmp_path: Path) -> None:
    path = make_mcap(tmp_path / "a.mcap", [*good_messages("/tank_1/valve"), *good_messages("/tank_2/valve")])
    assert list_valves(path) == ("/tank_1/valve", "/tank_2/valve")
    assert read_trace(path, "tank_2/valve/").source.endswith("(/tank_2/valve)")
    with pytest.raises(TraceError, match="no valve /tank_3/valve; it holds /tank_1/valve, /tank_2/valve"):
        read_trace(path, "/tank_3/valve")


def test_joints_are_found_by_name_in_any_order(tmp_path: Path) -> None:
    names = ("elbow", "main_plunger", "pilot_plunger")
    messages = [joint_state(MEASURED, EPOCH + n * 10**5, (9.0, n * 1e-6, n * 2e-6), names=names) for n in range(50)]
    trace = read_trace(make_mcap(tmp_path / "a.mcap", [*only_commands(), *messages]))
    np.testing.assert_allclose(trace.pilot_position, np.arange(50) * 2e-6)
    assert trace.main_position is not None
    np.testing.assert_allclose(trace.main_position, np.arange(50) * 1e-6)
