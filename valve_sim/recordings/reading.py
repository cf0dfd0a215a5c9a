"""Recordings to traces: one valve's commands and samples, validated."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valve_sim.files.channels import CHANNELS, COIL_STATE, MAIN, PILOT, SIGNALS, Signal
from valve_sim.files.recording_map import DeclaredSensor, Source
from valve_sim.model.drives import Drive
from valve_sim.recordings.clocks import SECOND, clock_offset
from valve_sim.recordings.command_times import Commands, commands_by_logs, dates_by_voltage
from valve_sim.recordings.layout import (
    INPUTS,
    MEASURED,
    POSITIONS,
    Plan,
    mapped_plan,
    standard_plan,
    topic_of,
    valves_among,
)
from valve_sim.recordings.samples import Readings, Samples, in_order, is_broken
from valve_sim.recordings.storage import read_recording
from valve_sim.recordings.table_reading import is_table, read_table_trace, standard_map
from valve_sim.recordings.trace import DriveErrors, Trace, TraceError
from valve_sim.recordings.trouble import find_problems
from valve_sim.recordings.voltage_steps import NoStepError, find_steps

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import RecordingMap
    from valve_sim.recordings.storage import Fields, Recording
    from valve_sim.recordings.topics import Batch, Topic

ZERO_ERROR = 10e-6
"""m: how well the zero of a sensor is known that was brought to 0 by a map's offset."""


def list_valves(path: str | PathLike[str], recording_map: RecordingMap | None = None) -> tuple[str, ...]:
    """Return the valves of a recording, "/valve" for topics under /valve/, in alphabetical order; or those of a map.

    Raises:
        TraceError: The recording cannot be read.
    """
    if recording_map is not None:
        return tuple(sorted(recording_map.valves))
    if is_table(Path(path)):
        return tuple(standard_map(Path(path)).valves)
    return valves_among(read_recording(Path(path), lambda _: {}).types)


def read_trace(path: str | PathLike[str], valve: str | None = None, recording_map: RecordingMap | None = None) -> Trace:
    """Read one valve's commands and measured samples.

    Args:
        path: A rosbag2 folder (MCAP or SQLite3, zstd too) or a bare .mcap or .db3 file, whole or damaged; or a table.
        valve: Its name ("/tank_1/valve"); None takes the only one.
        recording_map: What is where; None: the topics of this package, or the columns of a CSV that `simulate` wrote.

    Raises:
        ValveError: The recording or the map cannot be used; one line says why and what to do.
    """
    path = Path(path)
    trace = _read(path, valve, recording_map)
    if recording_map is None:
        return trace
    sensor = recording_map.sensors.get(recording_map.choose(valve)[0], DeclaredSensor())
    return replace(trace, zero_error=ZERO_ERROR, averaging=sensor.averaging, bandwidth=sensor.bandwidth)


def _read(path: Path, valve: str | None, recording_map: RecordingMap | None) -> Trace:
    if is_table(path):
        return read_table_trace(path, valve, standard_map(path) if recording_map is None else recording_map)
    plans: list[Plan] = []

    def select(types: Mapping[str, str]) -> Fields:
        if recording_map is None:
            plans[:] = [standard_plan(path, valve, types)]
        else:
            plans[:] = [mapped_plan(path, valve, recording_map, types)]
        return plans[0].fields

    return _Assembly(path, read_recording(path, select), plans[0]).trace()


class _Assembly:
    """One reading of one valve: collects findings on the way from raw topics to a trace."""

    def __init__(self, path: Path, recording: Recording, plan: Plan) -> None:
        self.path = path
        self.plan = plan
        self.recording = recording
        self.findings = list(recording.findings)
        self._reported: set[str] = set()
        self._levels_are_input = True
        self.samples_topic = plan.sources[plan.primary_signal].topic

    def trace(self) -> Trace:
        """Put the trace together."""
        samples, clock = self.samples() if self.plan.has_positions else self.in_their_place(self.plan.primary_signal)
        samples, shift, findings = in_order(samples, f"{self.path}: topic {self.samples_topic}", self.samples_topic)
        self.findings += findings
        offset, findings = clock_offset(samples.delays + shift if shift else samples.delays, self.samples_topic)
        self.findings += findings
        samples = self.with_main_from_elsewhere(samples, offset - shift)
        command_times, volts, errors = self.commands(offset - shift)
        epoch = int(min(command_times[0], samples.stamps[0]))
        times, pilot, main = (samples.stamps - epoch) / SECOND, samples.pilot, samples.main
        signals = {name: found and found.beside(times) for name, found in self.signals(epoch, offset - shift).items()}
        outlet = signals["outlet_pressure"]
        # Of a node's output nothing has to be estimated; a sensor's first sample would be an error of the start.
        start = None if outlet is None or not self.plan.is_live else float(outlet.values[0])
        if not self.plan.has_positions:
            signals[SIGNALS[self.plan.primary_signal].name] = Signal(times, pilot)
            times, pilot, main = np.empty((3, 0))
        trace = Trace(
            source=f"{self.path} ({self.plan.valve})",
            drive=Drive((command_times - epoch) / SECOND, volts),
            drive_errors=errors,
            times=times,
            pilot_position=pilot,
            main_position=None if not len(main) or np.isnan(main).any() else main,
            epoch_ns=epoch,
            clock=clock,
            outlet_start=start,
            origins={key: source.name for key, source in self.plan.sources.items()},
            units={key: source.unit for key, source in self.plan.sources.items() if source.unit},
            **signals,  # type: ignore[arg-type] # by the names that a trace has for them
        )
        trouble = find_problems(trace, self.samples_topic, self.input.topic)
        return replace(trace, findings=(*self.findings, *trouble))

    def topic(self, source: Source) -> Topic:
        """Return the topic of a source, of which at least one message must be readable."""
        name, topic = source.topic, self.recording.topic(self.path, source.topic)
        if name not in self._reported:
            self._reported.add(name)
            if topic.malformed:
                self.findings.append(f"{name}: dropped {topic.malformed} of {topic.size} messages that cannot be read")
            if topic.trimmed:
                self.findings.append(f"{name}: trimmed surplus bytes after {topic.trimmed} of {topic.size} messages")
        return topic

    def readings(self, quantity: str, source: Source | None = None) -> Readings:
        """Return what one source recorded, in SI; by default the first place of the quantity."""
        source = source or self.plan.sources[quantity]
        topic, values = self.topic(source), self.values(quantity, source)
        # Model time begins at 0, where a sample may be; in other messages, 0 means that they were not stamped.
        stamps = topic.stamps(source.clock, may_be_zero=quantity in POSITIONS)
        if self.plan.map_path and source.clock == "header" and not stamps.is_stamped.any():
            raise TraceError(
                f"{self.plan.map_path}: {quantity}: clock: header, but the messages of {source.topic} "
                f"({self.recording.types[source.topic]}) have no stamp; use clock: bag"
            )
        return Readings(*stamps, values)

    def values(self, quantity: str, source: Source) -> NDArray[np.float64]:
        """Return the numbers of one source alone, (n,) in SI, NaN where a message has none; not to be changed."""
        values, without = self.topic(source).values(source)
        if without is not None and np.isnan(values).all():
            raise TraceError(self._no_field(source, without))
        return source.to_si(values, CHANNELS[quantity].dimension)

    def _no_field(self, source: Source, batch: Batch) -> str:
        found = batch.what_lacks(source)
        if self.plan.map_path:
            return f"{self.plan.map_path}: topic {source.topic} of {self.path} {found}"
        if "names" not in found or source.joint in batch.joints:
            return f"{self.path}: topic {source.topic}: no finite {source.joint} position; fill the position array"
        return f"{self.path}: topic {source.topic} {found} (and {MAIN}); name the joints so"

    def samples(self) -> tuple[Samples, str]:
        """Return the positions of pilot and main plunger (NaN where the main one is not recorded) and their clock."""
        topic = self.samples_topic
        if self.plan.is_live:
            self.findings.append(
                f"{topic_of(self.plan.valve, MEASURED)} is not in the bag: {topic} (a node's output) was taken instead"
            )
        pilot = self.readings("position")
        source = self.plan.sources.get("main_position")
        is_recorded = source is not None and source.topic == topic
        count, delays = len(pilot.values), pilot.delays
        samples = Samples(pilot.stamps, delays, pilot.values, np.broadcast_to(np.nan, count))
        if is_recorded:
            samples = samples._replace(main=self.main_beside_pilot())
        broken = is_broken(samples.pilot, samples.main)
        if broken.any():
            where = int(np.argmax(broken.any(axis=0)))
            first = (samples.pilot if broken[0, where] else samples.main)[where]
            self.findings.append(f"{topic}: {broken.sum()} positions are none, such as {first:.3g} m")
            without = (np.where(of_one, np.nan, column) for of_one, column in zip(broken, samples[2:], strict=True))
            samples = Samples(pilot.stamps, delays, *without)
        finite = np.isfinite(samples.pilot)
        if not finite.any():
            raise TraceError(
                f"{self.path}: topic {topic}: no finite {PILOT} position in {count} samples; fill the position array"
            )
        if not finite.all():
            self.findings.append(
                f"{topic}: dropped {(~finite).sum()} of {count} samples without a finite {PILOT} position"
            )
        if is_recorded:
            samples = samples._replace(main=self._main_positions(topic, samples.main))
        is_left_out = np.isnan(samples.main)
        finite &= True if is_left_out.all() else np.isfinite(samples.main)
        if not finite.any():
            raise TraceError(
                f"{self.path}: topic {topic}: no sample has finite positions of {PILOT} and {MAIN}; record both"
            )
        samples = samples.take(finite)
        if not pilot.is_stamped.any() and self.plan.map_path:
            return samples, "bag"
        if len(samples.stamps) > 1 and (samples.stamps == samples.stamps[0]).all():
            self.findings.append(f"{topic}: all header stamps are the same: samples are timed by bag time")
            nothing = np.zeros_like(samples.stamps)
            return samples._replace(stamps=samples.stamps + samples.delays, delays=nothing), "bag"
        return samples, "header"

    def in_their_place(self, quantity: str) -> tuple[Samples, str]:
        """Return the current, or the outlet's pressure, in the place of positions not recorded, and its clock."""
        if self.plan.ignored:
            self.findings.append(
                f"{self.plan.ignored} is a node's output beside a measured coil: it was not taken for positions"
            )
        places = [self.plan.sources[quantity]]
        places += [self.plan.others[quantity]] if quantity in self.plan.others else []
        what = quantity.replace("_", " ")
        for source in places:
            found = self.readings(quantity, source)
            finite = np.isfinite(found.values)
            if finite.any():
                break
        else:
            raise TraceError(
                f"{self.path}: topic {source.topic}: no finite {what} in {len(found.values)} samples, and no position "
                f"is recorded; fill {what}"
            )
        self.samples_topic = source.topic
        if not finite.all():
            self.findings.append(
                f"{source.topic}: dropped {(~finite).sum()} of {len(finite)} samples without a finite {what}"
            )
        samples = Samples(found.stamps, found.delays, found.values, np.broadcast_to(np.nan, len(finite)))
        return samples.take(finite), "header" if found.is_stamped.any() else "bag"

    def main_beside_pilot(self) -> NDArray[np.float64]:
        """Return the main plunger's positions in the messages that hold the pilot's; NaN where they do not."""
        try:
            return self.values("main_position", self.plan.sources["main_position"])
        except TraceError:
            if self.plan.map_path:
                raise
            return np.full(self.recording.topics[self.samples_topic].size, np.nan)

    def with_main_from_elsewhere(self, samples: Samples, offset: int) -> Samples:
        """Return samples with a main plunger that another topic has, by straight lines between its samples."""
        main = self.plan.sources.get("main_position")
        if main is None or main.topic == self.samples_topic or not self.plan.has_positions:
            return samples
        signal = self.signal("main_position", int(samples.stamps[0]), offset)
        if signal is None:
            return samples
        times = (samples.stamps - samples.stamps[0]) / SECOND
        self.findings.append(f"{main.topic}: {MAIN} was interpolated at the samples of {self.samples_topic}")
        return samples._replace(main=np.interp(times, signal.times, signal.values))

    def _main_positions(self, topic: str, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Drop the main plunger where too little of it is there; a few bad samples of it go with the sample."""
        missing = int(np.count_nonzero(~np.isfinite(values)))
        if missing > len(values) / 2:
            self.findings.append(
                f"{topic}: {MAIN} has no position in {missing} of {len(values)} samples and was left out"
            )
            return np.broadcast_to(np.nan, len(values))
        if missing:
            words = f"dropped {missing} of {len(values)} samples without a finite {MAIN} position"
            self.findings.append(f"{topic}: {words}")
        return values

    def commands(self, offset: int) -> tuple[NDArray[np.int64], NDArray[np.float64], DriveErrors | None]:
        """Return when the voltage changed, ns, samples' clock, strictly ascending, volts, and errors of a measured one.

        Args:
            offset: What to take from bag times to get the samples' clock, ns.
        """
        topic = self.input.topic
        is_command = "command" in self.plan.sources
        found = self.readings("command" if is_command else "voltage")
        times, volts = found.times(offset), found.values
        what = "commands" if is_command else "samples"
        finite = np.isfinite(volts)
        if not finite.any():
            raise TraceError(
                f"{self.path}: topic {topic}: none of {len(volts)} {what} is a finite voltage; record it again"
            )
        if not finite.all():
            self.findings.append(f"{topic}: dropped {(~finite).sum()} of {len(volts)} {what} that are not finite")
        order = np.argsort(times[finite], kind="stable")
        times, volts = times[finite][order], volts[finite][order]
        if is_command and self.plan.logs:
            times, volts = self.sent(Commands(times, volts), offset)
        last = np.concatenate([np.diff(times) > 0, [True]])
        if not last.all():
            self.findings.append(f"{topic}: {(~last).sum()} {what} were replaced by another at the same time")
        times, volts = times[last], volts[last]
        if is_command:
            return self.dated(Commands(times, volts), offset)
        try:
            steps = find_steps((times - times[0]) / SECOND, volts)
        except NoStepError as error:
            raise TraceError(f"{self.path}: topic {topic}: {error}") from None
        self.findings += steps.findings(topic)
        self._levels_are_input = steps.are_input
        when = times[0] + np.rint(SECOND * steps.times).astype(np.int64)
        return when, steps.volts, DriveErrors(steps.time_errors, steps.volt_errors)

    def dated(
        self, commands: Commands, offset: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], DriveErrors | None]:
        """Return commands as the measured voltage dates them, where it was recorded and says other than their times."""
        epoch = int(commands.times[0])
        voltage = self.signal("voltage", epoch, offset)
        found = (
            None if voltage is None else dates_by_voltage((commands.times - epoch) / SECOND, commands.volts, voltage)
        )
        if found is None:
            return commands.times, commands.volts, None
        self.findings.append(f"{self.input.topic}: {found.finding} ({self.plan.sources['voltage'].topic})")
        times = epoch + np.rint(SECOND * found.times).astype(np.int64)
        return times, found.volts, DriveErrors(found.errors, np.zeros(len(times)))

    def sent(self, recorded: Commands, offset: int) -> Commands:
        """Return commands as they were sent, as far as who sent them logged it; else as they were recorded."""
        logs = []
        for topic in self.plan.logs:
            messages = self.recording.topics.get(topic)
            if messages is None or not messages.batches:
                continue
            stamps, _, is_stamped = messages.stamps(may_be_zero=True)
            stamps, volts = stamps[is_stamped], messages.values(Source(topic, "voltage"))[0][is_stamped]
            order = np.argsort(stamps, kind="stable")
            # The node's clock is the samples' clock, or the recorder's.
            logs += [Commands(stamps[order] - late, volts[order]) for late in {0, offset}]
        found = commands_by_logs(recorded, logs)
        if found is None and len(valves_among(self.recording.types)) == 1:
            names = ", ".join(self.plan.logs)
            self.findings.append(f"{self.input.topic}: timed as recorded, for {names} logs other commands")
        return recorded if found is None else found

    @property
    def input(self) -> Source:
        """Where the voltage is recorded."""
        return next(self.plan.sources[key] for key in INPUTS if key in self.plan.sources)

    def signals(self, epoch: int, offset: int) -> dict[str, Signal | None]:
        """Return the optional quantities by their names in a trace."""
        found = {channel.name: self.signal(key, epoch, offset) for key, channel in SIGNALS.items()}
        if self.plan.map_path and "command" not in self.plan.sources and self._levels_are_input:
            found["coil_voltage"] = None  # its steps are all that is used of it
        return found

    def signal(self, quantity: str, epoch: int, offset: int) -> Signal | None:
        """Return one optional quantity, None where it is not recorded or cannot be used.

        What is wrong with one of this package's own topics is a finding; what a map names must be there.
        """
        source, other = self.plan.sources.get(quantity), self.plan.others.get(quantity)
        if source is None:
            return None
        signal = self.signal_of(source, quantity, epoch, offset)
        return signal if signal is not None or other is None else self.signal_of(other, quantity, epoch, offset)

    def signal_of(self, source: Source, quantity: str, epoch: int, offset: int) -> Signal | None:
        """Return the same from one of its places."""
        topic, found = source.topic, self.recording.types[source.topic]
        if source.type and found != source.type:
            self.findings.append(f"{topic} is {found}, expected {source.type}: it was left out")
            return None
        try:
            readings = self.readings(quantity, source)
        except TraceError:
            if self.plan.map_path:
                raise
            self.findings.append(f"{topic} holds no message that can be read: it was left out")
            return None
        times, values = readings.without_repeated(offset)
        finite = np.isfinite(values)
        dropped = len(readings.values) - int(finite.sum())
        if source.type == COIL_STATE and not finite.any():
            return None  # which its NaN says
        if dropped:
            self.findings.append(
                f"{topic}: dropped {dropped} of {len(readings.values)} messages (not finite, or twice there)"
            )
        if not finite.all():
            times, values = times[finite], values[finite]
        return Signal((times - epoch) / SECOND, np.ascontiguousarray(values)) if len(times) else None
