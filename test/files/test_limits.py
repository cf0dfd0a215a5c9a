"""What is larger than anything that a reader expects, or never ends: one line, two seconds, half a gigabyte."""

from __future__ import annotations

import json
import os
import re
import sqlite3
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter

ZEROS = 2_000_000_000
MEGABYTES, SECONDS = 500.0, 2.0
MAP = "time: {column: t, unit: s}\nvoltage: {column: u}\nposition: {column: x, unit: mm}\n"
JOINT_STATE = "sensor_msgs/msg/JointState"


def packed_zeros(compression: str) -> bytes:
    """2 GB, or what becomes of 200 MB in the looser of the two forms."""
    if compression == "zstd":  # blocks that repeat one byte
        count = ZEROS >> 17
        blocks = [struct.pack("<I", (1 << 17 << 3) | 2 | (number == count - 1))[:3] + b"\0" for number in range(count)]
        return b"\x28\xb5\x2f\xfd\x00\x38" + b"".join(blocks)
    frame, piece = lz4.frame.LZ4FrameCompressor(), bytes(1 << 20)
    return frame.begin() + b"".join(frame.compress(piece) for _ in range(200)) + frame.flush()


def chunk_of_zeros(compression: str, claimed: int) -> Callable[[Path], Path]:
    """An MCAP file without index whose only chunk claims so many bytes."""

    def make(tmp: Path) -> Path:
        data, name = packed_zeros(compression), compression.encode()
        body = struct.pack("<QQQII", 0, 1, claimed, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
        (tmp / "a.mcap").write_bytes(b"\x89MCAP0\r\n" + struct.pack("<BQ", 6, len(body)) + body)
        return tmp / "a.mcap"

    return make


def message_of_zeros(tmp: Path) -> Path:
    with (tmp / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE)
        writer.start("ros2", "test")
        for topic, kind in (("measured/joint_states", JOINT_STATE), ("coil_voltage", "std_msgs/msg/Float64")):
            schema = writer.register_schema(kind, "ros2msg", b"")
            channel = writer.register_channel(f"/valve/{topic}", "cdr", schema)
            writer.add_message(channel, 1, packed_zeros("zstd"), 1)
        writer.finish()  # type: ignore[no-untyped-call]
    return tmp / "a.mcap"


def nested_definition(tmp: Path) -> Path:
    """Arrays of arrays of messages of no bytes."""
    parts = ["lab/L1[1000] own", *(f"{'=' * 80}\nMSG: lab/L{n}\nlab/L{n + 1}[1000] own" for n in range(1, 6))]
    text = "\n".join([*parts, "=" * 80, "MSG: lab/L6", ""])
    with (tmp / "a.mcap").open("wb") as stream:
        writer = McapWriter(stream, compression=CompressionType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema("lab/msg/L0", "ros2msg", text.encode())
        writer.add_message(writer.register_channel("/lab", "cdr", schema), 1, b"\0\1\0\0" + bytes(2000), 1)
        writer.finish()  # type: ignore[no-untyped-call]
    return tmp / "a.mcap"


def endless_view(tmp: Path) -> Path:
    with sqlite3.connect(tmp / "a.db3") as connection:
        connection.execute("CREATE TABLE topics (id, name, type, serialization_format, offered_qos_profiles)")
        connection.execute(
            "CREATE VIEW messages AS WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "
            "SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(1000) AS data FROM n"
        )
    connection.close()
    return tmp / "a.db3"


def packed_file(tmp: Path) -> Path:
    (tmp / "bag").mkdir()
    (tmp / "bag" / "bag_0.mcap.zstd").write_bytes(packed_zeros("zstd"))
    return tmp / "bag"


def text(content: str, name: str = "a.csv") -> Callable[[Path], Path]:
    def make(tmp: Path) -> Path:
        (tmp / name).write_text(content)
        return tmp / name

    return make


def sparse(name: str, head: bytes = b"", size: int = 1_000_000_000) -> Callable[[Path], Path]:
    """So many zeros that take no room on the disk."""

    def make(tmp: Path) -> Path:
        with (tmp / name).open("wb") as stream:
            stream.write(head)
            stream.truncate(size)
        return tmp / name

    return make


def pipe(name: str) -> Callable[[Path], Path]:
    def make(tmp: Path) -> Path:
        os.mkfifo(tmp / name)
        return tmp / name

    return make


def packed_matlab(tmp: Path) -> Path:
    """A matrix of 2 GB zeros."""
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    shape = struct.pack("<IIii", 5, 8, ZEROS // 8, 1)
    name = struct.pack("<HHI", 1, 1, ord("x"))
    head = flags + shape + name + struct.pack("<II", 9, ZEROS)
    packer = zlib.compressobj(9)
    data = packer.compress(struct.pack("<II", 14, len(head) + ZEROS) + head)
    data += b"".join(packer.compress(bytes(1 << 20)) for _ in range(40)) + packer.flush()
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<HH", 0x0100, 0x4D49)
    (tmp / "a.mat").write_bytes(header + struct.pack("<II", 15, len(data)) + data)
    return tmp / "a.mat"


def parquet_of_zeros(tmp: Path) -> Path:
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    column = pyarrow.array(np.zeros(2_000_000))
    with parquet.ParquetWriter(tmp / "a.parquet", pyarrow.schema([("t", column.type)]), compression="zstd") as writer:
        for _ in range(10):
            writer.write_table(pyarrow.table({"t": column}))
    return tmp / "a.parquet"


BOMB = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
    f"a{n}: &a{n} [{', '.join(8 * [f'*a{n - 1}'])}]\n" for n in range(1, 12)
)
RECORDINGS: dict[str, tuple[Callable[[Path], Path], str]] = {
    "a chunk of 2 GB zeros, zstd": (
        chunk_of_zeros("zstd", ZEROS),
        "unpacks to 2000 MB, expected at most 134 MB",
    ),
    "a chunk of 2 GB zeros, lz4": (chunk_of_zeros("lz4", ZEROS), "unpacks to 2000 MB, expected at most 134 MB"),
    "a chunk that says that it is small": (chunk_of_zeros("zstd", 1000), "no message could be saved"),
    "messages of 2 GB zeros": (message_of_zeros, "a message of .* unpacks to more than 134 MB"),
    "a file of 2 GB zeros": (packed_file, "unpacks to more than .* MB"),
    "arrays of arrays of nothing": (nested_definition, "no valve in it"),
    "a view that never ends": (endless_view, "no message could be saved"),
    "a gigabyte of zeros for a bag": (sparse("a.mcap", b"\x89MCAP0\r\n"), "no message could be saved"),
    "200,000 columns": (text(",".join(map(str, range(200_000)))), "expected at most 4096|more than 1000000 bytes"),
    "200,000 short columns": (text("\n".join(3 * ["1," * 200_000])), "has 200001 columns, expected at most 4096"),
    "a line of 1 GB": (sparse("a.csv", b"t,u,x\n0,0,0\n1,0,0\n"), "has a line of more than 1000000 bytes"),
    "three gigabytes of a table": (sparse("a.csv", size=3_000_000_000), "is 3000 MB large, expected at most 2000 MB"),
    "a matrix of 2 GB zeros": (packed_matlab, "unpacks to 2000 MB|is not a MATLAB file"),
    "20 million rows of zeros": (parquet_of_zeros, "unpacks to 160 MB, expected at most"),
    "a pipe for a bag": (pipe("a.mcap"), "is a device or a pipe"),
    "a pipe for a table": (pipe("a.csv"), "is not a recording|is a device or a pipe"),
    "a device for a bag": (lambda tmp: Path("/dev/zero"), "is not a recording"),
}
YAML: dict[str, tuple[Callable[[Path], Path], str]] = {
    "a device": (lambda tmp: Path("/dev/zero"), "is a device or a pipe, expected a file"),
    "a pipe": (pipe("a.yaml"), "is a device or a pipe, expected a file"),
    "an integer of 20,000 digits": (text(f"position: {'1' * 20_000}\n", "a.yaml"), "4300 digits.*expected valid YAML"),
    "aliases of aliases": (text(BOMB, "a.yaml"), "more than 20000 values, by aliases, expected valid YAML"),
    "an alias of itself": (text("a: &a [*a]\n", "a.yaml"), "by aliases, expected valid YAML|recursive"),
    "brackets": (text("[" * 100_000, "a.yaml"), "expected valid YAML"),
    "a gigabyte": (sparse("a.yaml"), "is 1000 MB large, expected at most 1 MB"),
    "many values": (text("[" + "1," * 30_000 + "]", "a.yaml"), "more than 20000 values, expected valid YAML"),
    "a list for a key": (text("? [1, 2]\n: 3\n", "a.yaml"), "expected valid YAML"),
    "a date that is none": (text("position: 2001-99-99\n", "a.yaml"), "expected valid YAML"),
}


FRESH = """
import json, resource, signal, sys
from click.testing import CliRunner
from valve_sim.cli import main

run, usage = CliRunner().invoke, lambda: resource.getrusage(resource.RUSAGE_SELF)
peak = lambda: next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM")) / 1024
run(main, ["info", "bags/friction"])
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
for line in sys.stdin:
    signal.alarm(600)
    before = usage()
    result = run(main, json.loads(line))
    signal.alarm(0)
    after = usage()
    trouble = "" if result.exception is None or isinstance(result.exception, SystemExit) else repr(result.exception)
    seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    print(json.dumps([result.exit_code, result.stderr[-2000:] + trouble, seconds, peak()]), flush=True)
"""
"""Runs one command after another, and says after each what it cost and the peak of its memory.

It is a process of its own. That of the tests holds what other tests have needed, and how far that grows says little:
what they have given back is used again and does not count, and a copy of it begins without its libraries. The peak of
one process that reads all is no less than that of a process that reads one, which is what a user pays. (The peak that
getrusage knows is no less than what the parent had when it started the process.)
"""


@pytest.fixture(scope="module")
def fresh() -> Iterator[subprocess.Popen[str]]:
    words = [sys.executable, "-c", FRESH]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield process


def check(fresh: subprocess.Popen[str], arguments: list[object], words: str) -> None:
    assert fresh.stdin is not None and fresh.stdout is not None
    fresh.stdin.write(json.dumps([str(own) for own in arguments]) + "\n")
    fresh.stdin.flush()
    answer = fresh.stdout.readline()
    assert answer, "it was killed, by this file or by one before"
    code, found, seconds, megabytes = json.loads(answer)
    assert code == 2, found
    assert found.startswith("valve-sim: ")
    assert found.count("\n") == 1, found
    assert re.search(words, found), found
    assert seconds < SECONDS
    assert megabytes < MEGABYTES


pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="measures memory as Linux does")


@pytest.mark.parametrize("kind", RECORDINGS)
def test_a_recording_without_end_is_refused(fresh: subprocess.Popen[str], kind: str, tmp_path: Path) -> None:
    make, words = RECORDINGS[kind]
    (tmp_path / "map.yaml").write_text(MAP)
    path = make(tmp_path)
    check(
        fresh,
        ["info", path, *(["--map", tmp_path / "map.yaml"] if path.suffix in (".csv", ".parquet", ".mat") else [])],
        words,
    )


@pytest.mark.parametrize("option", ["--map", "--params"])
@pytest.mark.parametrize("kind", YAML)
def test_a_file_of_names_without_end_is_refused(
    fresh: subprocess.Popen[str], kind: str, option: str, tmp_path: Path
) -> None:
    make, words = YAML[kind]
    check(fresh, ["info", "bags/friction", option, make(tmp_path)], words)
