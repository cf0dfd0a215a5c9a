"""Traces to recordings: .mcap files, rosbag2 folders and CSV, whole or not at all."""

from __future__ import annotations

import csv
import math
import os
import shutil
import sqlite3
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, NoReturn

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from valve_sim.files.channels import COIL, COIL_STATE, FLOAT, JOINT_STATE, MAIN, PILOT, SIGNALS
from valve_sim.files.whole_files import atomic_write
from valve_sim.recordings.cdr import encode_messages, typestore
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.layout import COMMAND, MEASURED
from valve_sim.recordings.trace import TraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from os import PathLike
    from types import TracebackType

    from numpy.typing import ArrayLike, NDArray
    from rosbags.interfaces import Connection

    from valve_sim.recordings.trace import Trace

    Storage = Literal["mcap", "sqlite3"]

CSV_COLUMNS = ("time", "coil_voltage", "coil_current", "pilot_position", "main_position", "pilot_velocity", "phase")
_UNKNOWN = ("temperature", "charge", "capacity", "design_capacity", "percentage")
_NO_BATTERY = {**dict.fromkeys(_UNKNOWN, (math.nan,)), "present": (1.0,)}
"""What a coil's message says of a battery, which there is not."""
AT_ONCE = 2**15
"""Messages of the longest topic that are encoded together."""


class BagRecorder:
    """Writes messages as they come; the recording appears under its name when it is complete.

    Use it as a context manager: an exception inside leaves nothing behind.

    Args:
        path: Ends with .mcap for a bare file (one that exists is replaced), otherwise a rosbag2 folder, a new one.
        storage: What a folder holds: "mcap" or "sqlite3".
        compressed: Pack with zstd: chunks of an MCAP, messages of a SQLite3 bag.

    Raises:
        TraceError: The place cannot be written to.
    """

    def __init__(self, path: str | PathLike[str], *, storage: Storage = "mcap", compressed: bool = False) -> None:
        """Open the recording under a temporary name; see the class."""
        self.path = Path(path)
        self._bare = self.path.suffix == ".mcap"
        name = self.path.stem if self._bare else self.path.name
        # os.path says False of names that cannot be, where Path raises; writing then says what is wrong with them.
        if os.path.isdir(self.path) or (os.path.exists(self.path) and not self._bare):  # noqa: PTH110, PTH112
            raise TraceError(f"{self.path}: exists already; choose another name or remove it")
        self._workshop = self.path.with_name(f".{self.path.name}.{os.getpid()}.partial")
        plugin = StoragePlugin.MCAP if self._bare or storage == "mcap" else StoragePlugin.SQLITE3
        with self._or_nothing():
            shutil.rmtree(self._workshop, ignore_errors=True)
            self._workshop.mkdir(parents=True)
            self._writer = Writer(self._workshop / name, version=9, storage_plugin=plugin)
            if compressed:
                mode = CompressionMode.STORAGE if plugin == StoragePlugin.MCAP else CompressionMode.MESSAGE
                self._writer.set_compression(mode, CompressionFormat.ZSTD)
            self._writer.open()
        self._connections: dict[str, Connection] = {}
        self._types: dict[str, str] = {}

    def add_topic(self, topic: str, message_type: str) -> None:
        """Announce a topic, even if no message follows.

        Args:
            topic: Its full name.
            message_type: "std_msgs/msg/Float64".

        Raises:
            TraceError: The type is unknown, the topic has another one, or the disk is full.
        """
        if message_type not in typestore().fielddefs:
            raise TraceError(
                f"{self.path}: topic {topic}: type {message_type} is unknown; record common ROS 2 types only"
            )
        if self._types.setdefault(topic, message_type) != message_type:
            raise TraceError(
                f"{self.path}: topic {topic} is {self._types[topic]}, not {message_type}; use another name"
            )
        if topic not in self._connections:
            with self._or_nothing():
                self._connections[topic] = self._writer.add_connection(topic, message_type, typestore=typestore())

    def write(self, topic: str, message_type: str, payload: bytes, time_ns: int) -> None:
        """Write one serialized (CDR) message that came at `time_ns`, ns of the recorder's clock.

        Raises:
            TraceError: It cannot be written; nothing is left behind.
        """
        if self._types.get(topic) != message_type:
            self.add_topic(topic, message_type)
        try:
            self._writer.write(self._connections[topic], time_ns, payload)
        except (OSError, sqlite3.Error) as error:
            self._refuse(error)

    def close(self) -> None:
        """Finish the recording and move it to its name.

        Raises:
            TraceError: It cannot be written; nothing is left behind.
        """
        with self._or_nothing():
            self._writer.close()
            if self._bare:
                (self._writer.path / self.path.name).replace(self.path)
            else:
                self._writer.path.rename(self.path)
        shutil.rmtree(self._workshop, ignore_errors=True)

    def discard(self) -> None:
        """Give the recording up and leave nothing behind."""
        # A disk that is full, or a file that was never opened, cannot be finished either.
        with suppress(Exception):
            self._writer.abort()
        shutil.rmtree(self._workshop, ignore_errors=True)

    @contextmanager
    def _or_nothing(self) -> Iterator[None]:
        """What cannot be written leaves nothing behind."""
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            self._refuse(error)

    def _refuse(self, error: OSError | sqlite3.Error) -> NoReturn:
        self.discard()
        why = error.strerror if isinstance(error, OSError) else error
        raise TraceError(f"{self.path}: cannot be written ({why}); choose another place") from error

    def __enter__(self) -> BagRecorder:
        """Return the open recorder."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Finish, or after an exception discard."""
        if kind is None:
            self.close()
        else:
            self.discard()


def write_bag(
    path: str | PathLike[str],
    trace: Trace,
    *,
    valve: str = "/valve",
    storage: Storage = "mcap",
    compressed: bool = False,
) -> None:
    """Write a trace below the name of its valve; see `write_bags`."""
    write_bags(path, {valve: trace}, storage=storage, compressed=compressed)


def write_bags(
    path: str | PathLike[str], traces: Mapping[str, Trace], *, storage: Storage = "mcap", compressed: bool = False
) -> None:
    """Write traces, by the names in front of their topics, with the topics of measured data; bag times are the stamps.

    Args:
        path: Ends with .mcap for a bare file, otherwise a rosbag2 folder that must not exist.
        traces: What to write.
        storage: What a folder holds: "mcap" or "sqlite3".
        compressed: Pack with zstd.

    Raises:
        TraceError: The place cannot be written to, or stamps are before 1970.
    """
    topics: dict[str, _Messages] = {}
    for valve, trace in traces.items():
        if trace.epoch_ns + SECOND * min(float(trace.drive.times.min(initial=0.0)), float(trace.sample_times[0])) < 0:
            raise TraceError(f"{path}: stamps before 0 cannot be stored in a bag; start the trace at 0 or later")
        prefix = "/" + valve.strip("/") if valve.strip("/") else ""
        topics |= {f"{prefix}/{name}": found for name, found in _measured_topics(trace).items()}
    with BagRecorder(path, storage=storage, compressed=compressed) as recorder:
        for topic, messages in topics.items():
            recorder.add_topic(topic, messages.message_type)
        for parts in _in_time(list(topics.values())):
            times = np.concatenate([messages.times[own] for messages, own in parts])
            encoded = [
                (topic, messages.message_type, payload)
                for topic, (messages, own) in zip(topics, parts, strict=True)
                for payload in messages.encoded(own)
            ]
            order = np.argsort(times, kind="stable")
            for message, time in zip(order.tolist(), times[order].tolist(), strict=True):
                topic, message_type, payload = encoded[message]
                recorder.write(topic, message_type, payload, time)


class _Messages(NamedTuple):
    """The messages of a topic.

    Attributes:
        message_type: Theirs.
        times: When each was taken, ns, shape (n,).
        columns: Their numbers, (n,) or (n, k), by the field's path.
        constants: Numbers that are the same in each, (k,), likewise.
    """

    message_type: str
    times: NDArray[np.int64]
    columns: Mapping[str, Sequence[NDArray[np.float64]]]
    constants: Mapping[str, Sequence[float]] = {}

    def encoded(self, own: slice) -> list[bytes]:
        """Return some of them, serialized, with header stamps where the type has a header."""
        stamps = self.times[own]
        columns = {path: np.column_stack([column[own] for column in field]) for path, field in self.columns.items()}
        columns |= {path: np.tile(values, (len(stamps), 1)) for path, values in self.constants.items()}
        if self.message_type != FLOAT:
            seconds, nanoseconds = np.divmod(stamps, SECOND)
            columns |= {"header.stamp.sec": seconds, "header.stamp.nanosec": nanoseconds}
        return encode_messages(_blank(self.message_type), self.message_type, columns, len(stamps))


def _in_time(topics: Sequence[_Messages]) -> Iterator[list[tuple[_Messages, slice]]]:
    """Return all messages of topics in parts, one after another in time: of a long recording all at once are large."""
    if all((np.diff(messages.times) >= 0).all() for messages in topics):
        longest = max(topics, key=lambda messages: len(messages.times)).times
        edges = np.unique(longest[::AT_ONCE])[1:]
    else:
        edges = np.empty(0, dtype=np.int64)
    cuts = [[0, *np.searchsorted(messages.times, edges).tolist(), len(messages.times)] for messages in topics]
    for part in range(len(edges) + 1):
        yield [(messages, slice(*own[part : part + 2])) for messages, own in zip(topics, cuts, strict=True)]


def _measured_topics(trace: Trace) -> dict[str, _Messages]:
    """Return the messages of each topic."""
    topics = {COMMAND: _Messages(FLOAT, _nanoseconds(trace, trace.drive.times), {"data": [trace.drive.volts]})}
    if trace.has_positions:
        topics[MEASURED] = _joint_states(trace)
    beside = _current_beside(trace)
    if trace.coil_voltage is not None:
        voltage = trace.coil_voltage
        nothing = np.broadcast_to(np.nan, len(voltage.times))
        columns = {"voltage": [voltage.values], "current": [nothing if beside is None else beside]}
        topics[COIL] = _Messages(COIL_STATE, _nanoseconds(trace, voltage.times), columns, _NO_BATTERY)
    recorded = trace.signals()
    for channel in SIGNALS.values():
        place, signal = channel.own_topic, recorded.get(channel.name)
        if place is not None and signal is not None and not (channel.key == "current" and beside is not None):
            times, columns = _nanoseconds(trace, signal.times), {place.field: [signal.values]}
            topics[place.topic] = _Messages(place.message_type, times, columns, place.constants)
    return topics


def _current_beside(trace: Trace) -> NDArray[np.float64] | None:
    """The current, A, where it was sampled together with the voltage: both go into one message."""
    current, voltage = trace.coil_current, trace.coil_voltage
    if current is None or voltage is None or not np.array_equal(current.times, voltage.times):
        return None
    return current.values


def _nanoseconds(trace: Trace, times: NDArray[np.float64]) -> NDArray[np.int64]:
    return trace.epoch_ns + np.rint(np.asarray(times) * SECOND).astype(np.int64)


def _joint_states(trace: Trace) -> _Messages:
    """Return JointStates with all arrays filled: rclpy adds rubbish to those whose last arrays are empty."""
    unknown = np.broadcast_to(np.nan, (len(trace.times), 2))
    main = trace.main_position if trace.main_position is not None else unknown[:, 0]
    columns = {
        "position": [trace.pilot_position, main],
        "velocity": [unknown],
        "effort": [unknown],
    }
    return _Messages(JOINT_STATE, _nanoseconds(trace, trace.times), columns)


def _blank(message_type: str) -> Any:
    """Return a message of zeros and, for a JointState, with this package's joints."""
    store, values = typestore(), {}
    detail: Any  # its shape depends on the kind, which the library types as a union
    for name, (kind, detail) in store.fielddefs[message_type][1]:
        if kind == Nodetype.NAME:
            values[name] = _blank(detail)
        elif kind == Nodetype.BASE:
            values[name] = "" if detail[0] == "string" else 0
        else:
            (inner, what), length = detail
            count = length if kind == Nodetype.ARRAY else 0
            is_number = inner == Nodetype.BASE and what[0] != "string"
            values[name] = np.zeros(count, what[0]) if is_number else []
    if message_type == JOINT_STATE:
        values |= {"name": [PILOT, MAIN], **dict.fromkeys(("position", "velocity", "effort"), np.zeros(2))}
    return store.types[message_type](**values)


def write_csv(path: str | PathLike[str], columns: Mapping[str, ArrayLike]) -> None:
    """Write a table in SI units with the columns of `CSV_COLUMNS`, and then what else is given.

    Args:
        path: The file; one that exists is replaced.
        columns: Each column's values, shape (n,); phase as on the topic (0 closed ... 4 open).

    Raises:
        TraceError: The place cannot be written to.
        KeyError: A column is missing.
    """
    names = [*CSV_COLUMNS, *(name for name in columns if name not in CSV_COLUMNS)]
    table = [np.asarray(columns[name]).tolist() for name in names]
    with atomic_write(Path(path), TraceError) as partial, partial.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(zip(*table, strict=True))
