"""Measured data of a plant: sampled, made noisy, quantised and stamped as a recorder would, and written as a bag."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from .common import FloatArray, Plant, PlantRun

SAMPLE_RATE = 20e3  # Hz
NANOSECONDS = 1e9
LEVELS = (9.0, 12.0, 7.5, 14.0, 10.3, 8.4, 13.0, 11.2)
"""V, of eight strokes in the order in which they are made."""
BAG_START_NS = 1_700_000_000_000_000_000


class Profile(NamedTuple):
    """Commands: times in s (ascending), volts held from each on, and the length of the recording in s."""

    times: FloatArray
    volts: FloatArray
    duration: float


def _profile(commands: list[tuple[float, float]], duration: float) -> Profile:
    times, volts = np.array(commands, dtype=np.float64).T.copy()
    return Profile(times, volts, duration)


def train_profile() -> Profile:
    """Eight full strokes at 7.5 to 14 V with their releases, in 0.5 s."""
    held = (0.030, 0.026, 0.033, 0.024, 0.031, 0.028, 0.025, 0.029)
    starts = [0.010 + 0.060 * stroke for stroke in range(len(LEVELS))]
    commands = [
        command
        for start, volts, length in zip(starts, LEVELS, held, strict=True)
        for command in ((start, volts), (start + length, 0.0))
    ]
    return _profile(commands, 0.5)


def train_bags(count: int = 4) -> tuple[Profile, ...]:
    """The strokes of `train_profile` in as many bags (1, 2, 4 or 8), each from rest."""
    whole = train_profile()
    strokes = 8 // count
    bags = []
    for first in range(0, 8, strokes):
        inside = slice(2 * first, 2 * (first + strokes))
        start = 0.060 * first
        bags.append(Profile(whole.times[inside] - start, whole.volts[inside], 0.060 * strokes + 0.005))
    return tuple(bags)


def holdout_profile() -> Profile:
    """Other voltages and lengths than in training, a peak-and-hold stroke and two pulses that lift it partly."""
    commands = [
        (0.0083, 8.1),
        (0.0352, 0.0),
        (0.0657, 13.4),
        (0.0857, 6.0),
        (0.1012, 0.0),
        (0.1309, 9.6),
        (0.1360, 0.0),
        (0.1694, 11.6),
        (0.1943, 0.0),
        (0.2247, 12.6),
        (0.2281, 0.0),
        (0.2601, 9.9),
        (0.2935, 0.0),
    ]
    return _profile(commands, 0.33)


def single_opening() -> Profile:
    """One opening at 9 V, never released."""
    return _profile([(0.010, 9.0)], 0.040)


def three_strokes() -> Profile:
    """Two full strokes and one that lifts the valve partly, all at 12 V."""
    return _profile([(0.010, 12.0), (0.038, 0.0), (0.070, 12.0), (0.0735, 0.0), (0.110, 12.0), (0.138, 0.0)], 0.17)


@dataclass(frozen=True)
class Recorder:
    """What measuring does to the truth; the default is 1 µm of white noise and perfect clocks.

    `position_noise` (m) and `current_noise` (A) are standard deviations; `colour` is the AR(1) coefficient of the
    position noise, whose standard deviation it leaves alone; `quantisation` (m) rounds the noisy position, 0 is off.
    Every command's stamp is late by `clock_offset` (s) and by an own draw of N(0, `command_jitter`) (s).
    """

    position_noise: float = 1e-6
    colour: float = 0.0
    quantisation: float = 0.0
    command_jitter: float = 0.0
    clock_offset: float = 0.0
    with_current: bool = False
    current_noise: float = 1e-3
    sample_rate: float = SAMPLE_RATE


@dataclass(frozen=True)
class Recording:
    """Measured data (times in s since the first sample, SI) and, under `truth`, what no recorder knows."""

    command_times: FloatArray  # (k,) as stamped
    volts: FloatArray  # (k,)
    times: FloatArray  # (n,)
    pilot_position: FloatArray  # (n,)
    main_position: FloatArray  # (n,)
    coil_current: FloatArray | None  # (n,)
    true_command_times: FloatArray  # (k,)
    truth: PlantRun


def _coloured(random: np.random.Generator, count: int, sigma: float, colour: float) -> FloatArray:
    """Stationary AR(1) noise of standard deviation sigma."""
    noise = random.standard_normal(count)
    if colour == 0.0:
        return sigma * noise
    noise[1:] *= np.sqrt(1.0 - colour**2)
    for sample in range(1, count):
        noise[sample] += colour * noise[sample - 1]
    return sigma * noise


def _measured(clean: FloatArray, recorder: Recorder, random: np.random.Generator) -> FloatArray:
    noisy = clean + _coloured(random, clean.size, recorder.position_noise, recorder.colour)
    if recorder.quantisation > 0.0:
        noisy = recorder.quantisation * np.round(noisy / recorder.quantisation)
    return noisy


def record(plant: Plant, profile: Profile, recorder: Recorder, seed: int) -> Recording:
    """Run the plant through the profile and measure it; the same seed gives the same recording."""
    random = np.random.default_rng(seed)
    times = np.arange(round(profile.duration * recorder.sample_rate)) / recorder.sample_rate
    run = plant.simulate(profile.times, profile.volts, times)
    stamps = profile.times + recorder.clock_offset
    # Drawn even when unused, so that recordings of one seed differ in nothing but what was asked for.
    stamps = stamps + recorder.command_jitter * random.standard_normal(profile.times.size)
    pilot = _measured(run.pilot_position, recorder, random)
    main = _measured(run.main_position, recorder, random)
    current = run.coil_current + recorder.current_noise * random.standard_normal(times.size)
    return Recording(
        stamps, profile.volts, times, pilot, main, current if recorder.with_current else None, profile.times, run
    )


@cache
def _typestore() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def _stamps_ns(times: FloatArray, start_ns: int) -> list[int]:
    return [start_ns + round(time * NANOSECONDS) for time in times.tolist()]


def _joint_states(recording: Recording, stamps: list[int]) -> list[bytes]:
    """Serialised sensor_msgs/JointState with both positions, stamped with the sample times."""
    types = _typestore().types
    joint_state, header, time = (
        types["sensor_msgs/msg/JointState"],
        types["std_msgs/msg/Header"],
        types["builtin_interfaces/msg/Time"],
    )
    positions = np.column_stack((recording.pilot_position, recording.main_position))
    names, nothing = ["pilot_plunger", "main_plunger"], np.zeros(0)
    messages = []
    for stamp, position in zip(stamps, positions, strict=True):
        seconds, rest = divmod(stamp, 1_000_000_000)
        message = joint_state(header(time(seconds, rest), ""), names, position, nothing, nothing)
        messages.append(bytes(_typestore().serialize_cdr(message, "sensor_msgs/msg/JointState")))
    return messages


def _floats(values: FloatArray) -> list[bytes]:
    """Serialised std_msgs/Float64."""
    message = _typestore().types["std_msgs/msg/Float64"]
    return [bytes(_typestore().serialize_cdr(message(value), "std_msgs/msg/Float64")) for value in values.tolist()]


def write_bag(recording: Recording, folder: Path, valve: str = "/valve", start_ns: int = BAG_START_NS) -> Path:
    """Write a new rosbag2 folder with MCAP storage and return it; WriterError when it exists already.

    Samples carry their time in the header and as bag time, commands and currents as bag time, all on one clock.
    """
    return write_bags({valve: recording}, folder, start_ns)


def write_bags(recordings: dict[str, Recording], folder: Path, start_ns: int = BAG_START_NS) -> Path:
    """Write several valves, by namespace, into one bag; otherwise as `write_bag`."""
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        messages = []
        for valve, recording in recordings.items():
            sampled = _stamps_ns(recording.times, start_ns)
            channels = [
                (
                    "coil_voltage",
                    "std_msgs/msg/Float64",
                    _stamps_ns(recording.command_times, start_ns),
                    _floats(recording.volts),
                ),
                ("measured/joint_states", "sensor_msgs/msg/JointState", sampled, _joint_states(recording, sampled)),
            ]
            if recording.coil_current is not None:
                channels.append(
                    ("measured/coil_current", "std_msgs/msg/Float64", sampled, _floats(recording.coil_current))
                )
            for topic, kind, stamps, contents in channels:
                connection = writer.add_connection(f"{valve}/{topic}", kind, typestore=_typestore())
                messages += [(stamp, connection, content) for stamp, content in zip(stamps, contents, strict=True)]
        for stamp, connection, content in sorted(messages, key=lambda message: message[0]):
            writer.write(connection, stamp, content)
    return folder
