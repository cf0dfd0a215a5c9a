"""The columns of a table, which share the times of its rows."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

import numpy as np

from valve_sim.model.drives import Drive
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.open_recording import Readings
from valve_sim.recordings.trace import DriveErrors, TraceError
from valve_sim.recordings.voltage_steps import held_steps

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import Source, TimeAxis
    from valve_sim.files.tables import DataTable, RowTimes

    Array = NDArray[np.float64]


class TableColumns:
    """A table as `OpenRecording` has it; `where` is the map that names its columns, for messages."""

    is_table = True

    def __init__(self, table: DataTable, axis: TimeAxis, where: str) -> None:
        self.path, self.findings, self._table, self._where = table.path, list(table.findings), table, where
        self.clock = "time column" if axis.columns else "rate"
        self.timed_by = f"the rate of {axis.rate:.6g} Hz in {where}"
        if axis.columns:
            self.timed_by = f"column{'s' if len(axis.columns) > 1 else ''} {' and '.join(axis.columns)}"
        self._axis, self._use, self._from_first = axis, np.empty(0, dtype=bool), False

    @functools.cached_property
    def _rows(self) -> RowTimes:
        """When its rows were taken: read after the first column, so that what is wrong with that is said first."""
        for column in self._axis.columns:
            self._check("time", column)
        found = self._table.row_times(self._axis)
        if found.repeated:
            self.findings.append(f"{self.timed_by}: dropped {found.repeated} rows with the time of the row before")
        return found

    @functools.cached_property  # once it is known whether the first row is the beginning
    def _times(self) -> Array:
        times = self._rows.times[self._rows.kept]
        return times - times[0] if self._from_first else times

    def _check(self, key: str, column: str) -> None:
        if not self._table.has(column):
            names = self._table.names
            listed = ", ".join(names[:40]) + (f" and {len(names) - 40} more" if len(names) > 40 else "")
            where = f"{self._where}: {key}.column"
            raise TraceError(f"{where}: column {column} is not in {self.path}; it has {listed}; name one of these")

    @property
    def epoch_ns(self) -> int:
        """As of `OpenRecording`; 0 where nothing says the day."""
        start, origin = float(self._rows.times[self._rows.kept][0]), self._rows.origin
        return max(0, round(origin) * SECOND + round((start + origin - round(origin)) * SECOND))

    def are_beside(self, first: Source, other: Source) -> bool:
        """As of `OpenRecording`."""
        return True

    def rows(self, key: str, source: Source) -> Array:
        """As of `OpenRecording`; rows that have the time of another are left out."""
        self._check(key, source.column)
        return self._table.column(source.column)[self._rows.kept]

    def ordered(self, key: str, source: Source, use: NDArray[np.bool_], columns: Sequence[Array]) -> Sequence[Array]:
        """As of `OpenRecording`."""
        self._use, self._from_first = use, True
        return [column[use] for column in columns]

    @property
    def sample_times(self) -> Array:
        """As of `OpenRecording`."""
        return self._times[self._use]

    def begin(self, sources: Iterable[tuple[str, Source]]) -> None:
        """As of `OpenRecording`."""

    def readings(self, key: str, source: Source) -> Readings:
        """As of `OpenRecording`."""
        return Readings(self._times, self.rows(key, source))

    def commands(self, source: Source, logs: Sequence[str]) -> tuple[Drive, DriveErrors]:
        """As of `OpenRecording`: each holds until a row has another."""
        times, volts, _ = self.readings("command", source)
        use = np.isfinite(volts)
        if not use.any():
            raise TraceError(f"{self.path}: {source.name}: holds no finite voltage; name another column")
        times, volts = times[use], source.to_si(volts[use], "voltage")
        if not volts.any():
            raise TraceError(
                f"{self.path}: {source.name}: is 0 V in all rows: there is no command; name another column"
            )
        changes = np.diff(volts, prepend=np.nan) != 0.0
        if changes.mean() > 0.5 and changes.sum() > 100:
            raise TraceError(
                f"{self.path}: {source.name}: changes in {changes.sum()} of {len(volts)} rows, as a measured voltage "
                "does; name it voltage: in place of command:"
            )
        steps = held_steps(times, volts)
        return Drive(steps.times, steps.volts), DriveErrors(steps.time_errors, steps.volt_errors)
