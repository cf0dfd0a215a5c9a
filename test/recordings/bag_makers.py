"""Recordings built in code: a valve that opens and closes on a clean path, and messages to spoil one by one."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from valve_sim.model import Drive
from valve_sim.recordings import Trace

STORE = get_typestore(Stores.ROS2_JAZZY)
FLOAT = "std_msgs/msg/Float64"
JOINT_STATE = "sensor_msgs/msg/JointState"
EPOCH = 1_700_000_000_000_000_000
RATE = 10_000
GAP = 260e-6
STROKE = 1230e-6
COMMANDS = ((0.010, 9.0), (0.050, 0.0))
LEAVES, REACHES_MAIN, REACHES_STOP = 0.0120, 0.0160, 0.0200


class Message(NamedTuple):
    """One message of a recording."""

    topic: str
    type: str
    time: int
    data: bytes


def path_of_valve(times: np.ndarray) -> np.ndarray:
    """Rest, uniform acceleration to the gap, uniform speed to the stop; back in 5 ms from 0.055 s."""
    pilot = GAP * np.clip((times - LEAVES) / (REACHES_MAIN - LEAVES), 0, None) ** 2
    main = GAP + (STROKE - GAP) * (times - REACHES_MAIN) / (REACHES_STOP - REACHES_MAIN)
    opening = np.where(times < REACHES_MAIN, pilot, np.minimum(main, STROKE))
    return np.where(times < 0.055, opening, np.clip(STROKE * (1 - (times - 0.055) / 0.005), 0, None))


def clean_trace(duration: float = 0.1, noise: float = 1e-6, seed: int = 1) -> Trace:
    times = np.arange(round(duration * RATE)) / RATE
    position = path_of_valve(times) + np.random.default_rng(seed).normal(0, noise, len(times))
    drive = Drive(np.array([time for time, _ in COMMANDS]), np.array([volts for _, volts in COMMANDS]))
    return Trace("made", drive, times, position, np.maximum(position - GAP, 0), epoch_ns=EPOCH)


def header(stamp: int) -> Any:
    types = STORE.types
    return types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "valve")


def float_message(topic: str, time: int, value: float) -> Message:
    return Message(topic, FLOAT, time, bytes(STORE.serialize_cdr(STORE.types[FLOAT](value), FLOAT)))


def joint_state(
    topic: str,
    time: int,
    positions: tuple[float, ...],
    *,
    stamp: int | None = None,
    names: tuple[str, ...] = ("pilot_plunger", "main_plunger"),
    filled: bool = True,
) -> Message:
    rest = np.zeros(len(positions)) if filled else np.zeros(0)
    message = STORE.types[JOINT_STATE](
        header(time if stamp is None else stamp), list(names), np.array(positions), rest, rest
    )
    return Message(topic, JOINT_STATE, time, bytes(STORE.serialize_cdr(message, JOINT_STATE)))


def good_messages(
    valve: str = "/valve", duration: float = 0.1, measured: str = "measured/joint_states"
) -> list[Message]:
    """Commands and 1,000 samples of `clean_trace`, in time order."""
    trace = clean_trace(duration)
    messages = [float_message(f"{valve}/coil_voltage", EPOCH + round(time * 1e9), volts) for time, volts in COMMANDS]
    for time, pilot in zip(trace.times.tolist(), trace.pilot_position.tolist(), strict=True):
        main = max(0.0, pilot - GAP)
        messages.append(joint_state(f"{valve}/{measured}", EPOCH + round(time * 1e9), (pilot, main)))
    return sorted(messages, key=lambda message: message.time)


def make_folder(
    path: Path,
    messages: list[Message],
    *,
    storage: StoragePlugin = StoragePlugin.MCAP,
    compression: CompressionMode = CompressionMode.NONE,
    silent: tuple[tuple[str, str], ...] = (),
) -> Path:
    """Write a rosbag2 folder with rosbags alone; `silent` topics are announced without a message."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        topics = dict.fromkeys([*((message.topic, message.type) for message in messages), *silent])
        connections = {topic: writer.add_connection(*topic, typestore=STORE) for topic in topics}
        for message in messages:
            writer.write(connections[message.topic, message.type], message.time, message.data)
    return path


def make_mcap(path: Path, messages: list[Message], **options: Any) -> Path:
    """Write a bare .mcap file."""
    folder = make_folder(path.with_suffix(".folder"), messages, **options)
    next(folder.glob("*.mcap")).rename(path)
    return path


def changed(messages: list[Message], number: int, **changes: Any) -> list[Message]:
    """Return the messages with the sample `number` replaced by another."""
    places = [place for place, message in enumerate(messages) if message.type == JOINT_STATE]
    result = list(messages)
    old = result[places[number]]
    values: dict[str, Any] = {"topic": old.topic, "time": old.time, "positions": (0.0, 0.0)}
    result[places[number]] = joint_state(**(values | changes))
    return result
