"""The columns of a table, which share the times of its rows or have a column of times each."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from valve_sim.files.tables import RowTimes
from valve_sim.model.drives import Drive
from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.open_recording import Readings
from valve_sim.recordings.trace import DriveErrors, TraceError
from valve_sim.recordings.voltage_steps import held_between, held_steps

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import Source, TimeAxis
    from valve_sim.files.tables import DataTable

    Array = NDArray[np.float64]


class TableColumns:
    """A table as `OpenRecording` has it.

    Args:
        table, axis: the file, and which of its columns say when its rows were taken.
        where: the map that names its columns, for messages. sources: the columns, which may have times of their own.
    """

    is_table = True

    def __init__(self, table: DataTable, axis: TimeAxis, where: str, sources: Iterable[Source]) -> None:
        self.path, self.findings, self._table, self._where = table.path, list(table.findings), table, where
        self._has_clocks, self._times_of = any(source.time for source in sources), dict[str, RowTimes]()
        self.clock = "time column" if axis.columns else "rate"
        self.timed_by = f"the rate of {axis.rate:.6g} Hz in {where}"
        if axis.columns:
            self.timed_by = f"column{'s' if len(axis.columns) > 1 else ''} {' and '.join(axis.columns)}"
        self._axis, self._samples, self._from_first = axis, np.empty(0), False

    @property
    def _rows(self) -> RowTimes:
        return self._rows_by("")

    def _rows_by(self, clock: str) -> RowTimes:
        """When its rows were taken by a column, the map's where none is named.

        It is read after the first column of values, so that what is wrong with that is said first.
        """
        if clock not in self._times_of:
            axis = self._axis
            if clock:
                axis = replace(axis, columns=(clock,), units=axis.units[:1], rate=0.0)
            for column in axis.columns:
                self._check("time", column)
            found = self._times_of[clock] = self._table.row_times(axis, may_end=self._has_clocks)
            if found.repeated:
                by = f"column {clock}" if clock else self.timed_by
                self.findings.append(f"{by}: dropped {found.repeated} rows with the time of the row before")
        return self._times_of[clock]

    def _times(self, clock: str) -> Array:
        """(n,) s of the rows that have a time by a column; once it is known whether the first row is the beginning."""
        rows, first = self._rows_by(clock), self._rows
        times = rows.times[rows.kept] + (rows.origin - first.origin)
        return times - first.times[first.kept][0] if self._from_first else times

    def _check(self, key: str, column: str) -> None:
        if not self._table.has(column):
            names = self._table.names
            listed = ", ".join(names[:40]) + (f" and {len(names) - 40} more" if len(names) > 40 else "")
            where = f"{self._where}: {key}.column"
            raise TraceError(f"{where}: column {column} is not in {self.path}; it has {listed}; name one of these")

    @property
    def epoch_ns(self) -> int:
        """See `OpenRecording`; 0 where nothing says the day."""
        start, origin = float(self._rows.times[self._rows.kept][0]), self._rows.origin
        return max(0, round(origin) * SECOND + round((start + origin - round(origin)) * SECOND))

    def are_beside(self, first: Source, other: Source) -> bool:
        """See `OpenRecording`."""
        return first.time == other.time

    def rows(self, key: str, source: Source) -> Array:
        """See `OpenRecording`; rows that have the time of another are left out."""
        self._check(key, source.column)
        return self._table.column(source.column)[self._rows_by(source.time).kept]

    def ordered(self, key: str, source: Source, use: NDArray[np.bool_], columns: Sequence[Array]) -> Sequence[Array]:
        """See `OpenRecording`."""
        self._from_first = True
        self._samples = self._times(source.time)[use]
        return [column[use] for column in columns]

    @property
    def sample_times(self) -> Array:
        """See `OpenRecording`."""
        return self._samples

    def begin(self, sources: Iterable[tuple[str, Source]]) -> None:
        """See `OpenRecording`."""

    def readings(self, key: str, source: Source) -> Readings:
        """See `OpenRecording`."""
        values = self.rows(key, source)
        return Readings(self._times(source.time), values)

    def commands(self, source: Source, logs: Sequence[str]) -> tuple[Drive, DriveErrors]:
        """See `OpenRecording`: each holds until a row has another."""
        times, volts, _ = self.readings("command", source)
        volts = held_between(volts)
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
