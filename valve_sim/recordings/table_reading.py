"""Tables of a data logger to traces: all columns share the clock of the rows."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from valve_sim.files.channels import CHANNELS, JUDGED, SIGNALS, Signal
from valve_sim.files.data_tables import TABLE_SUFFIXES, open_table
from valve_sim.files.recording_map import RecordingMap, Source, TimeAxis
from valve_sim.files.tables import DataTable, RowTimes
from valve_sim.model.drives import Drive
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.trace import DriveErrors, Trace, TraceError
from valve_sim.recordings.trouble import find_problems
from valve_sim.recordings.voltage_steps import NoStepError, find_steps, held_steps

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

OWN_COLUMNS = {key: channel.column or channel.name for key, channel in CHANNELS.items() if key != "voltage"}
"""By key, of the CSV that `valve-sim simulate` writes; its voltage is the commanded one."""
ALWAYS = ("command", "position", "main_position", "current")
"""The keys of those that every such CSV has."""


def is_table(path: Path) -> bool:
    """Whether a path is that of a table, by its suffix."""
    return path.suffix.lower() in TABLE_SUFFIXES and path.is_file()


def has_own_columns(path: Path) -> bool:
    """Whether a table has the columns of `valve-sim simulate`.

    Raises:
        ValveError: it cannot be read.
    """
    return {"time", *(OWN_COLUMNS[key] for key in ALWAYS)} <= set(open_table(path).names)


def standard_map(path: Path) -> RecordingMap:
    """The map of a table with the columns of `valve-sim simulate`.

    Raises:
        ValveError: It is a table of other columns: nobody knows which is what.
    """
    names = open_table(path).names
    if not has_own_columns(path):
        listed = ", ".join(names[:12])
        raise TraceError(
            f"{path}: is not a recording of ROS topics but a table ({listed}); say with --map which column is what, "
            f"valve-sim map {path} writes a first map"
        )
    sources = {key: Source(column=column) for key, column in OWN_COLUMNS.items() if column in names}
    return RecordingMap(str(path), {"/valve": sources}, TimeAxis(("time",)))


def read_table_trace(path: Path, valve: str | None, recording_map: RecordingMap) -> Trace:
    """Read one valve out of a table.

    Args:
        path: One of `TABLE_SUFFIXES`.
        valve: Which one of the map's; None takes the only one.
        recording_map: Which column is what.

    Raises:
        ValveError: The table or the map cannot be used; one line that names file, column and mend.
    """
    name, sources = recording_map.choose(valve)
    if recording_map.time is None:
        topic = next(iter(sources.values())).topic
        raise TraceError(
            f"{recording_map.path}: names the topic {topic}, but {path} is a table; give column: in its place"
        )
    table = open_table(path)
    return _TableAssembly(path, table, sources, recording_map).trace(name)


class _TableAssembly:
    """One reading of one table: collects findings on the way to a trace."""

    def __init__(
        self, path: Path, table: DataTable, sources: Mapping[str, Source], recording_map: RecordingMap
    ) -> None:
        self.path = path
        self.table = table
        self.sources = sources
        self.map = recording_map
        self.findings = list(table.findings)
        self.voltage: Signal | None = None
        """Measured, where it is the input without any command, and its steps do not say all of it."""

    def trace(self, valve: str) -> Trace:
        """Put the trace together."""
        judged, pilot = self.judged()
        times, kept, origin, _ = self.times()
        finite = np.isfinite(pilot)
        if not (finite & kept).any():
            raise TraceError(f"{self.path}: {self.sources[judged].name}: no finite {judged}; name another column")
        beyond = int(np.isinf(pilot).sum())
        if beyond:
            self.findings.append(f"{self.sources[judged].name}: left out {beyond} clipped readings (∞)")
        if not finite.all():
            dropped = int((~finite).sum())
            self.findings.append(f"{self.sources[judged].name}: dropped {dropped} of {len(pilot)} rows without it")
        use = finite & kept
        start = float(times[kept][0])
        epoch = max(0, round(origin) * SECOND + round((start + origin - round(origin)) * SECOND))
        times = times - start
        has_main = judged == "position" and "main_position" in self.sources
        main = self.column("main_position")[use] if has_main else None
        if main is not None and not np.isfinite(main).all():
            self.findings.append(f"{self.sources['main_position'].name}: has empty cells and was left out")
            main = None
        signals = {own.name: self.signal(key, times, kept) for key, own in SIGNALS.items() if key != self.input}
        if judged != "position":
            use = np.zeros_like(use)
        drive, errors = self.drive(times, kept)
        trace = Trace(
            source=f"{self.path} ({valve})",
            drive=drive,
            drive_errors=errors,
            times=times[use],
            pilot_position=pilot[use],
            main_position=main,
            epoch_ns=epoch,
            origins={"time": self.timed_by, **{key: source.name for key, source in self.sources.items()}},
            units={key: source.unit for key, source in self.sources.items() if source.unit},
            clock="time column" if self.axis.columns else "rate",
            **{**signals, "coil_voltage": signals.get("coil_voltage") or self.voltage},  # type: ignore[arg-type] # by name
        )
        trouble = find_problems(trace, self.sources[judged].name, self.sources[self.input].name)
        return replace(trace, findings=(*self.findings, *trouble))

    def judged(self) -> tuple[str, Array]:
        """What the valve is judged by, and its numbers.

        A CSV of this package has an empty column where no position was measured: it is then the next.
        """
        recorded = [key for key in JUDGED if key in self.sources]
        for key in recorded if self.map.path == str(self.path) else recorded[:1]:
            values = self.column(key)
            if np.isfinite(values).any():
                return key, values
        raise TraceError(f"{self.path}: {self.sources[recorded[0]].name}: no finite {recorded[0]}; name another column")

    @property
    def input(self) -> str:
        return "command" if "command" in self.sources else "voltage"

    @property
    def axis(self) -> TimeAxis:
        assert self.map.time is not None
        return self.map.time

    @property
    def timed_by(self) -> str:
        """What dates the rows, for messages."""
        axis = self.axis
        if axis.rate:
            return f"the rate of {axis.rate:.6g} Hz in {self.map.path}"
        return f"column{'s' if len(axis.columns) > 1 else ''} {' and '.join(axis.columns)}"

    def column(self, quantity: str) -> Array:
        """A quantity in SI, NaN where a cell is empty."""
        source = self.sources[quantity]
        self.check_column(quantity, source.column)
        return source.to_si(self.table.column(source.column), CHANNELS[quantity].dimension)

    def check_column(self, key: str, column: str) -> None:
        """Refuse a column that the table does not have, with the map's key."""
        if not self.table.has(column):
            raise TraceError(
                f"{self.map.path}: {key}: column {column} is not in {self.path}; it has "
                f"{', '.join(self.table.names)}; name one of these"
            )

    def times(self) -> RowTimes:
        """When each row was taken, and which rows to keep."""
        for column in self.axis.columns:
            self.check_column("time", column)
        found = self.table.row_times(self.axis)
        if found.repeated:
            self.findings.append(f"{self.timed_by}: dropped {found.repeated} rows with the time of the row before")
        return found

    def drive(self, times: Array, kept: NDArray[np.bool_]) -> tuple[Drive, DriveErrors]:
        """The voltage as commands, and how well they are known."""
        name = self.sources[self.input].name
        volts = self.column(self.input)
        use = kept & np.isfinite(volts)
        if not use.any():
            raise TraceError(f"{self.path}: {name}: holds no finite voltage; name another column")
        times, volts = times[use], volts[use]
        if self.input == "voltage":
            try:
                steps = find_steps(times, volts)
            except NoStepError as error:
                raise TraceError(f"{self.path}: {name}: {error}") from None
            self.findings += steps.findings(name)
            self.voltage = None if steps.are_input else Signal(times, volts)
            return Drive(steps.times, steps.volts), DriveErrors(steps.time_errors, steps.volt_errors)
        if not np.ptp(volts) and not volts[0]:
            raise TraceError(f"{self.path}: {name}: is 0 V in all rows: there is no command; name another column")
        changes = np.diff(volts, prepend=np.nan) != 0.0
        if changes.mean() > 0.5 and changes.sum() > 100:
            raise TraceError(
                f"{self.path}: {name}: changes in {changes.sum()} of {len(volts)} rows, as a measured voltage does; "
                "name it voltage: in place of command:"
            )
        steps = held_steps(times, volts)
        return Drive(steps.times, steps.volts), DriveErrors(steps.time_errors, steps.volt_errors)

    def signal(self, quantity: str, times: Array, kept: NDArray[np.bool_]) -> Signal | None:
        """An optional quantity where its cells are filled."""
        if quantity not in self.sources:
            return None
        values = self.column(quantity)
        use = kept & np.isfinite(values)
        if not use.any():
            self.findings.append(f"{self.sources[quantity].name}: holds no finite number and was left out")
            return None
        return Signal(times[use], values[use])
