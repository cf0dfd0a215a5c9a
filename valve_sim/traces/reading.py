"""Recordings to traces: one valve's commands and samples, checked at the edge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.model import Drive
from valve_sim.traces.cdr import Decoded, decode_messages
from valve_sim.traces.clocks import SECOND, clock_offset, find_gaps, order_samples
from valve_sim.traces.errors import TraceError
from valve_sim.traces.storage import RawTopic, Recording, read_recording
from valve_sim.traces.strokes import largest_travel, motion_threshold
from valve_sim.traces.trace import Signal, Trace

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from numpy.typing import NDArray

FLOAT = "std_msgs/msg/Float64"
JOINT_STATE = "sensor_msgs/msg/JointState"
COMMAND = "coil_voltage"
MEASURED = "measured/joint_states"
LIVE = "joint_states"
PILOT = "pilot_plunger"
MAIN = "main_plunger"

MOST_REPEATED = 0.05
"""Share of samples that may have another sample's stamp; beyond it nobody can say which is right."""

LARGEST_POSITION = 0.1
"""m; a solenoid valve's plunger moves millimetres: beyond this the unit is most likely not metres."""
BROKEN_READING = 1.0
"""m; what is beyond this among metres is no position, and what is a million times beyond it is none in any unit."""
MICROMETRES = 1e6
"""In a metre."""


class Channel(NamedTuple):
    """An optional quantity: where it is recorded, as what, and under which field."""

    topic: str
    message_type: str
    path: str


CHANNELS = {
    "coil_current": Channel("measured/coil_current", FLOAT, "data"),
    "acceleration": Channel("measured/acceleration", "sensor_msgs/msg/Imu", "linear_acceleration.x"),
    "inlet_pressure": Channel("measured/inlet_pressure", "sensor_msgs/msg/FluidPressure", "fluid_pressure"),
    "coil_temperature": Channel("measured/coil_temperature", "sensor_msgs/msg/Temperature", "temperature"),
}
LIVE_CURRENT = Channel("coil_current", FLOAT, "data")


class Samples(NamedTuple):
    """Checked messages of one topic: stamps and bag times in ns, values (n, columns)."""

    stamps: NDArray[np.int64]
    bag_times: NDArray[np.int64]
    values: NDArray[np.float64]

    def take(self, chosen: NDArray[np.intp] | NDArray[np.bool_]) -> Samples:
        """Return some of the samples."""
        return Samples(self.stamps[chosen], self.bag_times[chosen], self.values[chosen])


def list_valves(path: str | PathLike[str]) -> tuple[str, ...]:
    """Return the valves of a recording, "/valve" for topics under /valve/, in alphabetical order.

    Raises:
        TraceError: The recording cannot be read.
    """
    return _valves_among(read_recording(Path(path), lambda _: ()).types)


def _valves_among(types: Mapping[str, str]) -> tuple[str, ...]:
    """A valve is known by its command or its measured positions; joint states alone may be anybody's."""
    names = {topic[: -len(end) - 1] for topic in types for end in (COMMAND, MEASURED) if topic.endswith("/" + end)}
    return tuple(sorted(name or "/" for name in names))


def read_trace(path: str | PathLike[str], valve: str | None = None) -> Trace:
    """Read one valve's commands and measured samples.

    Args:
        path: A rosbag2 folder (MCAP or SQLite3, zstd too) or a bare .mcap or .db3 file, whole or damaged.
        valve: Its name ("/tank_1/valve"); None takes the only one.

    Raises:
        TraceError: The recording cannot be used; one line says why and what to do.
    """
    path = Path(path)
    chosen: list[str] = []

    def select(types: Mapping[str, str]) -> list[str]:
        chosen[:] = [_choose_valve(path, valve, types)]
        return _check_topics(path, chosen[0], types)

    recording = read_recording(path, select)
    return _Assembly(path, chosen[0], recording).trace()


def _choose_valve(path: Path, valve: str | None, types: Mapping[str, str]) -> str:
    valves = _valves_among(types)
    if not valves:
        found = ", ".join(sorted(types)[:8]) or "none"
        raise TraceError(
            f"{path}: no valve in it: no topic ends with /{COMMAND} or /{MEASURED}; topics: {found}; record those two"
        )
    if valve is None:
        if len(valves) > 1:
            raise TraceError(f"{path}: holds several valves ({', '.join(valves)}); choose one with --valve")
        return valves[0]
    name = "/" + valve.strip("/")
    if name not in valves:
        raise TraceError(f"{path}: holds no valve {name}; it holds {', '.join(valves)}; choose one with --valve")
    return name


def _topic(valve: str, name: str) -> str:
    return f"{valve.rstrip('/')}/{name}"


def _check_topics(path: Path, valve: str, types: Mapping[str, str]) -> list[str]:
    """Return the topics to read, after a look at the types of those that must be there."""
    command, measured, live = (_topic(valve, name) for name in (COMMAND, MEASURED, LIVE))
    if command not in types:
        raise TraceError(
            f"{path}: topic {command} is missing: without the commanded voltage nothing can be fitted; record it"
        )
    positions = measured if measured in types else live
    if positions not in types:
        raise TraceError(f"{path}: neither {measured} nor {live} is in it; record the measured positions")
    for topic, expected in ((command, FLOAT), (positions, JOINT_STATE)):
        if types[topic] != expected:
            raise TraceError(f"{path}: topic {topic} is {types[topic]}, expected {expected}; publish it as that")
    channels = [*CHANNELS.values(), LIVE_CURRENT]
    return [command, positions, *(topic for entry in channels if (topic := _topic(valve, entry.topic)) in types)]


class _Assembly:
    """One reading of one valve: collects findings on the way from raw topics to a trace."""

    def __init__(self, path: Path, valve: str, recording: Recording) -> None:
        self.path = path
        self.valve = valve
        self.recording = recording
        self.findings = list(recording.findings)
        self.live = _topic(valve, MEASURED) not in recording.types
        self.positions_topic = _topic(valve, LIVE if self.live else MEASURED)

    def trace(self) -> Trace:
        """Put the trace together."""
        samples, clock = self.samples()
        samples, shift = self.in_order(samples)
        offset, findings = clock_offset(samples.stamps, samples.bag_times + shift, self.positions_topic)
        self.findings += findings
        command_times, volts = self.commands()
        command_times = command_times - offset + shift
        epoch = int(min(command_times[0], samples.stamps[0]))
        times = (samples.stamps - epoch) / SECOND
        signals = self.signals(epoch, offset - shift)
        pilot, main = samples.values.T
        trace = Trace(
            source=f"{self.path} ({self.valve})",
            drive=Drive((command_times - epoch) / SECOND, volts),
            times=times,
            pilot_position=np.ascontiguousarray(pilot),
            main_position=None if np.isnan(main).any() else np.ascontiguousarray(main),
            epoch_ns=epoch,
            clock=clock,
            coil_current=signals["coil_current"],
            acceleration=signals["acceleration"],
            inlet_pressure=signals["inlet_pressure"],
            coil_temperature=signals["coil_temperature"],
        )
        self.look_at(trace)
        return replace(trace, findings=tuple(self.findings))

    def raw(self, topic: str) -> RawTopic:
        """Return a topic's messages, of which there must be some."""
        raw = self.recording.topics.get(topic)
        if raw is None or len(raw.times) == 0:
            raise TraceError(f"{self.path}: topic {topic} holds no message; record it while the valve works")
        return raw

    def decode(self, topic: str, message_type: str) -> tuple[RawTopic, Decoded]:
        """Read a topic's messages, at least one of which must be readable."""
        raw = self.raw(topic)
        decoded = decode_messages(raw.payloads, message_type)
        if not decoded.batches:
            raise TraceError(
                f"{self.path}: topic {topic}: none of {len(raw.times)} messages can be read as {message_type}; "
                "record it again"
            )
        if decoded.malformed:
            self.findings.append(
                f"{topic}: dropped {decoded.malformed} of {len(raw.times)} messages that cannot be read"
            )
        if decoded.trimmed:
            self.findings.append(f"{topic}: trimmed surplus bytes after {decoded.trimmed} of {len(raw.times)} messages")
        return raw, decoded

    def samples(self) -> tuple[Samples, str]:
        """Return the positions of pilot and main plunger (NaN where the main one is not recorded) and their clock."""
        topic = self.positions_topic
        if self.live:
            self.findings.append(
                f"{_topic(self.valve, MEASURED)} is not in the bag: {topic} (a node's output) was taken instead"
            )
        raw, decoded = self.decode(topic, JOINT_STATE)
        values = np.full((len(raw.times), 2), np.nan)
        stamps = np.zeros(len(raw.times), dtype=np.int64)
        unnamed: tuple[str, ...] | None = None
        for batch in decoded.batches:
            names = batch.layout.texts["name"]
            positions = batch.column("position")
            stamps[batch.places] = _stamps(batch.column("header.stamp.sec"), batch.column("header.stamp.nanosec"))
            if PILOT not in names:
                unnamed = names
            for column, name in enumerate((PILOT, MAIN)):
                if name in names and names.index(name) < positions.shape[1]:
                    values[batch.places, column] = positions[:, names.index(name)]
        broken = self._broken(values)
        if broken.any():
            self.findings.append(f"{topic}: {broken.sum()} positions are none, such as {values[broken][0]:.3g} m")
            values = np.where(broken, np.nan, values)
        finite = np.isfinite(values[:, 0])
        if not finite.any():
            raise TraceError(self._no_positions(topic, len(values), unnamed))
        if not finite.all():
            self.findings.append(
                f"{topic}: dropped {(~finite).sum()} of {len(values)} samples without a finite {PILOT} position"
            )
        values = self._main_positions(topic, values)
        finite &= np.isfinite(values[:, 1]) | np.isnan(values[:, 1]).all()
        if not finite.any():
            raise TraceError(
                f"{self.path}: topic {topic}: no sample has finite positions of {PILOT} and {MAIN}; record both"
            )
        samples = Samples(stamps[finite], raw.times[finite], values[finite])
        if len(samples.stamps) > 1 and (samples.stamps == samples.stamps[0]).all():
            self.findings.append(f"{topic}: all header stamps are the same: samples are timed by bag time")
            return samples._replace(stamps=samples.bag_times), "bag"
        return samples, "header"

    def _broken(self, values: NDArray[np.float64]) -> NDArray[np.bool_]:
        """(n, 2) readings that no plunger can have, as broken messages hold; other units than metres are no break."""
        sizes = np.abs(np.where(np.isfinite(values), values, 0.0))
        is_metres = float(np.median(sizes[:, 0])) <= LARGEST_POSITION
        return np.asarray(sizes > (BROKEN_READING if is_metres else BROKEN_READING * MICROMETRES))

    def _no_positions(self, topic: str, count: int, names: tuple[str, ...] | None) -> str:
        if names is not None:
            listed = ", ".join(names) or "no joint"
            return f"{self.path}: topic {topic} names {listed}, expected {PILOT} (and {MAIN}); name the joints so"
        return f"{self.path}: topic {topic}: no finite {PILOT} position in {count} samples; fill the position array"

    def _main_positions(self, topic: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Drop the main plunger where too little of it is there; a few bad samples of it go with the sample."""
        finite = np.isfinite(values[:, 1])
        if finite.all():
            return values
        missing = int((~finite).sum())
        if missing > len(values) / 2:
            self.findings.append(
                f"{topic}: {MAIN} has no position in {missing} of {len(values)} samples and was left out"
            )
            return np.column_stack([values[:, 0], np.full(len(values), np.nan)])
        self.findings.append(f"{topic}: dropped {missing} of {len(values)} samples without a finite {MAIN} position")
        return values

    def in_order(self, samples: Samples) -> tuple[Samples, int]:
        """Return samples with strictly ascending stamps, and how far their clock leads that of the commands, ns."""
        topic = self.positions_topic
        ordered = order_samples(samples.stamps, samples.bag_times, np.nan_to_num(samples.values), topic)
        self.findings += ordered.findings
        if len(ordered.places) == 0:
            raise TraceError(
                f"{self.path}: topic {topic}: none of {len(samples.stamps)} samples has a stamp that can be believed; "
                "stamp them with the time of sampling"
            )
        samples = samples.take(ordered.places)
        fresh = np.concatenate([[True], np.diff(samples.stamps) > 0])
        repeated = int((~fresh).sum())
        if repeated > MOST_REPEATED * len(fresh):
            raise TraceError(
                f"{self.path}: topic {topic}: {repeated} of {len(fresh)} samples have the stamp of another sample but "
                "another position; two publishers, a clock set back or coarse stamps; record one, finely stamped"
            )
        if repeated:
            self.findings.append(
                f"{topic}: dropped {repeated} of {len(fresh)} samples that differ from another sample of the same stamp"
            )
        return samples.take(fresh), ordered.shift

    def commands(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return command times, ns, bag clock, strictly ascending, and volts."""
        topic = _topic(self.valve, COMMAND)
        raw, decoded = self.decode(topic, FLOAT)
        volts = np.full(len(raw.times), np.nan)
        for batch in decoded.batches:
            volts[batch.places] = batch.column("data")[:, 0]
        finite = np.isfinite(volts)
        if not finite.any():
            raise TraceError(
                f"{self.path}: topic {topic}: none of {len(volts)} commands is a finite voltage; record it again"
            )
        if not finite.all():
            self.findings.append(f"{topic}: dropped {(~finite).sum()} of {len(volts)} commands that are not finite")
        times, volts = raw.times[finite], volts[finite]
        last = np.concatenate([np.diff(times) > 0, [True]])
        if not last.all():
            self.findings.append(f"{topic}: {(~last).sum()} commands were replaced by another at the same time")
        return times[last], volts[last]

    def signals(self, epoch: int, offset: int) -> dict[str, Signal | None]:
        """Return the optional quantities; what is wrong with one is a finding, never the end of the reading."""
        channels = dict(CHANNELS)
        if self.live and _topic(self.valve, channels["coil_current"].topic) not in self.recording.types:
            channels["coil_current"] = LIVE_CURRENT
        return {name: self.signal(channel, epoch, offset) for name, channel in channels.items()}

    def signal(self, channel: Channel, epoch: int, offset: int) -> Signal | None:
        """Return one optional quantity, None where it is not recorded or cannot be used."""
        topic = _topic(self.valve, channel.topic)
        found = self.recording.types.get(topic)
        if found is None:
            return None
        if found != channel.message_type:
            self.findings.append(f"{topic} is {found}, expected {channel.message_type}: it was left out")
            return None
        try:
            raw, decoded = self.decode(topic, channel.message_type)
        except TraceError:
            self.findings.append(f"{topic} holds no message that can be read: it was left out")
            return None
        times = raw.times - offset
        values = np.full(len(times), np.nan)
        for batch in decoded.batches:
            values[batch.places] = batch.column(channel.path)[:, 0]
            if "header.stamp.sec" in batch.layout.fields:
                stamps = _stamps(batch.column("header.stamp.sec"), batch.column("header.stamp.nanosec"))
                times[batch.places] = np.where(stamps == 0, times[batch.places], stamps)
        times, first = np.unique(times, return_index=True)
        values = values[first]
        finite = np.isfinite(values)
        dropped = len(raw.times) - int(finite.sum())
        if dropped:
            self.findings.append(
                f"{topic}: dropped {dropped} of {len(raw.times)} messages (not finite, or twice there)"
            )
        return Signal((times[finite] - epoch) / SECOND, values[finite]) if finite.any() else None

    def look_at(self, trace: Trace) -> None:
        """Note what makes a sound trace hard to use: gaps, no command, no motion, doubtful units."""
        gaps = find_gaps(trace.times)
        if len(gaps):
            longest = float(np.diff(trace.times).max())
            self.findings.append(
                f"{self.positions_topic}: {len(gaps)} gaps in the samples, the longest {longest:.6f} s"
            )
        if not trace.drive.volts.any():
            self.findings.append(f"{_topic(self.valve, COMMAND)} never leaves 0 V")
        reach = float(np.abs(trace.pilot_position).max())
        if reach > LARGEST_POSITION:
            self.findings.append(f"{self.positions_topic}: {PILOT} reaches {reach:.6g} m: positions must be in metres")
        travel = largest_travel(trace.pilot_position)
        if travel <= motion_threshold(trace.pilot_position):
            self.findings.append(f"{self.positions_topic}: no motion: {PILOT} stays within {travel * 1e6:.3g} µm")
        elif trace.drive.times[0] > trace.times[-1] or trace.drive.times[-1] < 2 * trace.times[0] - trace.times[-1]:
            self.findings.append(f"{_topic(self.valve, COMMAND)}: no command falls into the time of the samples")


def _stamps(seconds: NDArray[np.int32], nanoseconds: NDArray[np.uint32]) -> NDArray[np.int64]:
    return seconds[:, 0].astype(np.int64) * SECOND + nanoseconds[:, 0].astype(np.int64)
