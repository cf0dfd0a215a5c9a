"""Recordings to traces: one valve's commands and measured samples, checked and on one clock."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from valve_sim.files.channels import CHANNELS, COIL_STATE, MAIN, SIGNALS, Signal
from valve_sim.files.data_tables import is_table, open_table
from valve_sim.files.recording_map import DeclaredSensor
from valve_sim.model.drives import Drive
from valve_sim.recordings.bag_columns import BagColumns
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.command_times import dates_by_voltage
from valve_sim.recordings.layout import (
    MEASURED,
    Plan,
    has_own_columns,
    mapped_plan,
    standard_plan,
    table_plan,
    topic_of,
    valves_among,
)
from valve_sim.recordings.storage import read_recording
from valve_sim.recordings.table_columns import TableColumns
from valve_sim.recordings.trace import DriveErrors, Trace, TraceError
from valve_sim.recordings.trouble import LARGEST_POSITION, find_problems
from valve_sim.recordings.voltage_steps import NoStepError, find_steps

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import RecordingMap, Source
    from valve_sim.recordings.open_recording import OpenRecording
    from valve_sim.recordings.storage import Fields

    Array = NDArray[np.float64]

ZERO_ERROR: Final = 10e-6
"""m: how well the zero of a sensor is known that was brought to 0 by a map's offset."""
BROKEN_READING: Final = 1.0
"""m; what is beyond this among metres is no position, and what is a million times beyond it is none in any unit."""
MICROMETRES: Final = 1e6
"""In a metre."""


def list_valves(path: str | PathLike[str], recording_map: RecordingMap | None = None) -> tuple[str, ...]:
    """Return the valves of a recording, "/valve" for topics under /valve/, in alphabetical order; or those of a map.

    Raises:
        TraceError: The recording cannot be read.
    """
    if recording_map is not None:
        return tuple(sorted(recording_map.valves))
    path = Path(path)
    if is_table(path):
        return (table_plan(path, open_table(path).names, None, None)[0].valve,)
    return valves_among(read_recording(path, lambda _: {}).types)


def is_own_table(path: Path) -> bool:
    """Whether a path is that of a table with the columns of `valve-sim simulate`.

    Raises:
        ValveError: it cannot be read.
    """
    return is_table(path) and has_own_columns(open_table(path).names)


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
    trace = _Assembly(*_opened(path, valve, recording_map)).trace()
    if recording_map is None:
        return trace
    sensor = recording_map.sensors.get(recording_map.choose(valve)[0], DeclaredSensor())
    return replace(trace, zero_error=ZERO_ERROR, averaging=sensor.averaging, bandwidth=sensor.bandwidth)


def _opened(path: Path, valve: str | None, recording_map: RecordingMap | None) -> tuple[OpenRecording, Plan]:
    if is_table(path):
        table = open_table(path)
        plan, axis = table_plan(path, table.names, valve, recording_map)
        return TableColumns(table, axis, plan.map_path or str(path), plan.sources.values()), plan
    plans: list[Plan] = []

    def select(types: Mapping[str, str]) -> Fields:
        if recording_map is None:
            plans[:] = [standard_plan(path, valve, types)]
        else:
            plans[:] = [mapped_plan(path, valve, recording_map, types)]
        return plans[0].fields

    recording = read_recording(path, select)
    return BagColumns(path, recording, plans[0].map_path), plans[0]


class _Assembly:
    """One reading of one valve: collects findings on the way from columns to a trace."""

    def __init__(self, recorded: OpenRecording, plan: Plan) -> None:
        self.recorded, self.plan, self.findings = recorded, plan, recorded.findings
        self._levels_are_input = True

    def fail(self, source: Source, words: str) -> TraceError:
        """An error of what one place holds, to be raised."""
        return TraceError(f"{self.recorded.path}: {'topic ' if source.topic else ''}{_label(source)}: {words}")

    def trace(self) -> Trace:
        """Put the trace together."""
        if self.plan.is_live:
            wanted, taken = topic_of(self.plan.valve, MEASURED), self.plan.sources[self.plan.judged[0]].topic
            self.findings.append(f"{wanted} is not in the bag: {taken} (a node's output) was taken instead")
        if self.plan.ignored:
            self.findings.append(
                f"{self.plan.ignored} is a node's output beside a measured coil: it was not taken for positions"
            )
        key, source, values = self.judged()
        (pilot, *beside), command = self.samples(key, source, values), self.plan.input
        self.recorded.begin([(command, self.plan.sources[command])])
        times = self.recorded.sample_times
        main = beside[0] if beside else self.main_elsewhere(key, source, times)
        drive, errors = self.drive()
        signals = {own.name: self.signal(quantity) for quantity, own in SIGNALS.items()}
        if self.plan.map_path and command == "voltage" and self._levels_are_input:
            signals["coil_voltage"] = None  # its steps are all that is used of it
        first = float(min(drive.times[0], times[0]))
        if first:
            drive, times = Drive(drive.times - first, drive.volts), times - first
            signals = {name: own and Signal(own.times - first, own.values) for name, own in signals.items()}
        signals = {name: own and own.beside(times) for name, own in signals.items()}
        outlet = signals["outlet_pressure"]
        if key != "position":
            signals[SIGNALS[key].name] = Signal(times, pilot)
            times, pilot = np.empty((2, 0))
        trace = Trace(
            source=f"{self.recorded.path} ({self.plan.valve})",
            drive=drive,
            drive_errors=errors,
            times=times,
            pilot_position=pilot,
            main_position=main,
            epoch_ns=self.recorded.epoch_ns + round(SECOND * first),
            clock=self.recorded.clock,
            # Of a node's output nothing has to be estimated; a sensor's first sample would be an error of the start.
            outlet_start=float(outlet.values[0]) if outlet is not None and self.plan.is_live else None,
            origins={
                **({"time": self.recorded.timed_by} if self.recorded.timed_by else {}),
                **{quantity: own.name for quantity, own in self.plan.sources.items()},
            },
            units={quantity: own.unit for quantity, own in self.plan.sources.items() if own.unit},
            **signals,  # type: ignore[arg-type] # by the names that a trace has for them
        )
        trouble = find_problems(trace, _label(source), _label(self.plan.sources[command]))
        return replace(trace, findings=(*self.findings, *trouble))

    def judged(self) -> tuple[str, Source, Array]:
        """What the valve is judged by, where it is, and its numbers, SI: the first place with a finite one."""
        places = [(key, source) for key in self.plan.judged for source in self.plan.places(key)]
        for key, source in places:
            values = source.to_si(self.recorded.rows(key, source), CHANNELS[key].dimension)
            if np.isfinite(values).any():
                return key, source, values
        key, source = places[0]
        what = " ".join(filter(None, (source.joint, key.replace("_", " "))))
        alone = "" if key == "position" else ", and no position is recorded"
        raise self.fail(
            source, f"no finite {what} in {len(values)} samples{alone}; fill it, or name another with --map"
        )

    def samples(self, key: str, source: Source, values: Array) -> list[Array]:
        """What the valve is judged by, and the main plunger's positions beside it, if they are there: in order."""
        where, what = _label(source), " ".join(filter(None, (source.joint, key.replace("_", " "))))
        columns, main = [values], self.plan.sources.get("main_position")
        if key == "position" and main is not None and self.recorded.are_beside(source, main):
            columns.append(self.main_beside(main, values))
        if key == "position" and not self.recorded.is_table:
            columns = self.without_broken(where, columns)
        if beyond := int(np.isinf(columns[0]).sum()):
            self.findings.append(f"{where}: left out {beyond} clipped readings (∞)")
        use = np.isfinite(columns[0])
        if not use.any():
            raise self.fail(source, f"no finite {what} in {len(use)} samples; fill it, or name another with --map")
        if not use.all():
            self.findings.append(f"{where}: dropped {(~use).sum()} of {len(use)} samples without a finite {what}")
        for column in columns[1:]:
            is_there = np.isfinite(column)
            missing = int((~is_there).sum())
            if missing > len(use) / 2:
                self.findings.append(
                    f"{where}: {MAIN} has no position in {missing} of {len(use)} samples and was left out"
                )
                columns = columns[:1]
            elif missing:
                self.findings.append(
                    f"{where}: dropped {missing} of {len(use)} samples without a finite {MAIN} position"
                )
                use = use & is_there
        if not use.any():
            raise self.fail(source, "no sample has finite positions of both plungers; record both")
        return list(self.recorded.ordered(key, source, use, columns))

    def main_beside(self, source: Source, values: Array) -> Array:
        """The main plunger's positions in the messages or rows that hold the pilot's; NaN where they do not."""
        try:
            return source.to_si(self.recorded.rows("main_position", source), "length")
        except TraceError:
            if self.plan.map_path:
                raise
            return np.full_like(values, np.nan)

    def without_broken(self, where: str, columns: list[Array]) -> list[Array]:
        """Positions, NaN where no plunger can be, as broken messages have it; another unit than m is no break."""
        sizes = np.nan_to_num(np.abs(np.stack(columns)), posinf=0.0)
        if sizes.max(initial=0.0) <= BROKEN_READING:
            return columns
        is_metres = np.median(sizes[0]) <= LARGEST_POSITION
        broken = sizes > BROKEN_READING * (1.0 if is_metres else MICROMETRES)
        if not broken.any():
            return columns
        row = int(np.argmax(broken.any(axis=0)))
        first = next(column[row] for column, of_one in zip(columns, broken, strict=True) if of_one[row])
        self.findings.append(f"{where}: {broken.sum()} positions are none, such as {first:.3g} m")
        return [np.where(of_one, np.nan, column) for of_one, column in zip(broken, columns, strict=True)]

    def main_elsewhere(self, key: str, source: Source, times: Array) -> Array | None:
        """The main plunger's positions that another topic has, by straight lines between its samples."""
        main = self.plan.sources.get("main_position")
        if key != "position" or main is None or self.recorded.are_beside(source, main):
            return None
        signal = self.signal("main_position")
        if signal is None:
            return None
        self.findings.append(f"{_label(main)}: {MAIN} was interpolated at the samples of {_label(source)}")
        return np.interp(times, signal.times, signal.values)

    def drive(self) -> tuple[Drive, DriveErrors | None]:
        """The voltage as commands, V, and how well they are known; None where they are as they were recorded."""
        source = self.plan.sources[self.plan.input]
        if self.plan.input == "voltage":
            return self.stepped(source)
        drive, errors = self.recorded.commands(source, self.plan.logs)
        voltage = None if errors is not None else self.signal("voltage")
        dated = None if voltage is None else dates_by_voltage(drive.times, drive.volts, voltage)
        if dated is None:
            return drive, errors
        self.findings.append(f"{_label(source)}: {dated.finding} ({_label(self.plan.sources['voltage'])})")
        return Drive(dated.times, dated.volts), DriveErrors(dated.errors, np.zeros(len(dated.times)))

    def stepped(self, source: Source) -> tuple[Drive, DriveErrors]:
        """Commands by the steps of a measured voltage."""
        times, volts, _ = self.recorded.readings("voltage", source)
        volts = source.to_si(volts, "voltage")
        use = np.isfinite(volts)
        if not use.any():
            words = f"none of {len(volts)} samples is a finite voltage; name another with --map, or record it again"
            raise self.fail(source, words)
        if not use.all():
            self.findings.append(f"{_label(source)}: dropped {(~use).sum()} of {len(use)} samples that are not finite")
            times, volts = times[use], volts[use]
        try:
            steps = find_steps(times, volts)
        except NoStepError as error:
            raise self.fail(source, str(error)) from None
        self.findings += steps.findings(_label(source))
        self._levels_are_input = steps.are_input
        return Drive(steps.times, steps.volts), DriveErrors(steps.time_errors, steps.volt_errors)

    def signal(self, key: str) -> Signal | None:
        """One optional quantity from the first of its places that has one, None where it cannot be used.

        What is wrong with one of this package's own topics is a finding; what a map names must be there.
        """
        for source in self.plan.places(key):
            if (found := self.signal_of(key, source)) is not None:
                return found
        return None

    def signal_of(self, key: str, source: Source) -> Signal | None:
        """The same from one of its places."""
        where = _label(source)
        try:
            times, values, repeated = self.recorded.readings(key, source)
        except TraceError as error:
            if self.plan.map_path:
                raise
            why = str(error).removeprefix(f"{self.recorded.path}: ").removeprefix("topic ").partition(";")[0]
            self.findings.append(f"{why}: it was left out")
            return None
        values = source.to_si(values, CHANNELS[key].dimension)
        finite = np.isfinite(values)
        dropped = repeated + int((~finite).sum())
        if not finite.any():
            if source.type != COIL_STATE:  # whose NaN says that
                self.findings.append(f"{where}: holds no finite number and was left out")
            return None
        if dropped and not self.recorded.is_table:
            count = len(values) + repeated
            self.findings.append(f"{where}: dropped {dropped} of {count} messages (not finite, or twice there)")
        if not finite.all():
            times, values = times[finite], values[finite]
        return Signal(times, np.ascontiguousarray(values))


def _label(source: Source) -> str:
    """Where a quantity is, as findings have it."""
    return source.topic or source.name
