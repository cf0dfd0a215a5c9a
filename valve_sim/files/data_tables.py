"""Files of data loggers as columns by name: text, Parquet, MATLAB, spreadsheets, TDMS."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.bounded import LARGEST_TEXT, check_expanded, check_file
from valve_sim.files.recording_map import TimeAxis
from valve_sim.files.tables import DataTable, TableError
from valve_sim.files.text_tables import MOST_COLUMNS, TextTable
from valve_sim.model.errors import ValveError

Array = NDArray[np.float64]

TEXT_SUFFIXES: Final = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm", ".log", ".prn")
PARQUET_SUFFIXES: Final = (".parquet", ".pq")
SHEET_SUFFIXES: Final = (".xlsx", ".xlsm")
TABLE_SUFFIXES: Final = (*TEXT_SUFFIXES, *PARQUET_SUFFIXES, ".mat", *SHEET_SUFFIXES, ".tdms")

_LEAST_ROWS: Final = 0.01
"""Share of the rows of the longest vector that another one has, which is not of settings."""
OTHER_KINDS: Final = {
    b"PK\x03\x04": ("an Excel file or a zip archive", "name it .xlsx, or unpack it"),
    b"\xd0\xcf\x11\xe0": ("an Excel file of before 2007", "save it as .xlsx"),
    b"\x1f\x8b": ("packed by gzip", "unpack it"),
    b"\x28\xb5\x2f\xfd": ("packed by zstd", "unpack it"),
    b"PAR1": ("a Parquet file", "name it .parquet"),
    b"MATLAB 5": ("a MATLAB file", "name it .mat"),
    b"TDSm": ("a TDMS file", "name it .tdms"),
}
"""How files begin that are no text, what they are, and the mend."""


def is_table(path: Path) -> bool:
    """Whether a path is that of a table, by its suffix."""
    return path.suffix.lower() in TABLE_SUFFIXES and path.is_file()


def open_table(path: Path) -> DataTable:
    """Open a table by its suffix, one of `TABLE_SUFFIXES`.

    Raises:
        TableError: it cannot be read as its suffix says; one line with the remedy.
    """
    suffix = path.suffix.lower()
    openers = dict.fromkeys(PARQUET_SUFFIXES, _open_parquet) | dict.fromkeys(SHEET_SUFFIXES, _open_sheet)
    openers |= {".mat": _open_mat, ".tdms": _open_tdms}
    try:
        check_file(path, LARGEST_TEXT, TableError)
        if suffix not in openers:
            _refuse_other_kinds(path)
        return openers.get(suffix, TextTable)(path)
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror or error}); give a file of a data logger") from error


def _refuse_other_kinds(path: Path) -> None:
    """Refuse what is no text, whatever its suffix says."""
    with path.open("rb") as stream:
        head = stream.read(8)
    for mark, (what, mend) in OTHER_KINDS.items():
        if head.startswith(mark):
            raise TableError(f"{path}: is {what}, expected text; {mend}")


def read_table(path: Path | str, columns: Mapping[str, Sequence[str]], otherwise: str = "") -> dict[str, Array]:
    """Columns of finite numbers from a small table.

    A line of names selects the columns and may name others; without it, columns are in the order of `columns`.

    Args:
        path: the file, a text whatever its suffix says.
        columns: the columns to read, each with the names that a header may give it.
        otherwise: what else would do where the header has none of these names, for the message.

    Returns:
        by the same keys, (n,) each.

    Raises:
        TableError: the file cannot be read, a column is missing, or a cell is not a finite number.
    """
    path = Path(path)
    try:
        table = open_table(path) if path.suffix.lower() in TABLE_SUFFIXES else TextTable(path)
    except OSError as error:
        raise TableError(f"{path}: cannot be read ({error.strerror}); expected a CSV file") from error
    for finding in table.findings:
        raise TableError(f"{path}: {finding}; correct the line or take it out")
    named = {name.lower(): name for name in (*table.others, *table.names)}
    is_counted = table.names == tuple(str(number + 1) for number in range(len(table.names)))
    found = {}
    for place, (key, names) in enumerate(columns.items()):
        name = str(place + 1) if is_counted else next((named[own] for own in names if own in named), "")
        if not name or (is_counted and place >= len(table.names)):
            expected = ", ".join(filter(None, (" or ".join(names), otherwise)))
            raise TableError(f"{path}: has the columns {', '.join(table.names)}; expected one named {expected}")
        values = table.column(name)
        if not np.isfinite(values).all():
            where = table.place(int(np.argmin(np.isfinite(values))))
            raise TableError(f"{path}: {where}: column {name}: found no finite number; correct the line or take it out")
        found[key] = values
    return found


# --- what is in memory already ---


class _ArrayTable(DataTable):
    """Columns that are in memory already."""

    def __init__(self, path: Path, columns: Mapping[str, Any], units: Mapping[str, str] | None = None) -> None:
        super().__init__(path, list(columns), units or {})
        self._columns = [np.asarray(column) for column in columns.values()]

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return len(self._columns[0]) if self._columns else 0

    def _are_stamps(self, places: Sequence[int], axis: TimeAxis) -> bool:
        kinds = {self._columns[place].dtype.kind for place in places}
        return "M" in kinds or (not kinds <= set("biuf") and super()._are_stamps(places, axis))

    def _seconds(self, places: Sequence[int], axis: TimeAxis) -> tuple[Array, float]:
        if self._columns[places[0]].dtype.kind != "M":
            return super()._seconds(places, axis)
        stamps = self._columns[places[0]].astype("datetime64[ns]").astype(np.int64)
        origin = int(stamps[0]) // 10**9 if len(stamps) else 0
        return np.asarray(1e-9 * (stamps - origin * 10**9), dtype=np.float64), float(origin)

    def _numbers(self, place: int) -> Array:
        found = self._columns[place]
        if found.dtype.kind == "M":  # times of day: seconds since 1970
            return np.asarray(found.astype("datetime64[ns]").astype(np.int64) * 1e-9)
        return np.asarray(found, dtype=np.float64) if found.dtype.kind in "biuf" else super()._numbers(place)

    def _cells(self, place: int, most: int | None = None) -> list[str | None]:
        return ["" if value is None else str(value) for value in self._columns[place][:most].tolist()]


def _missing(path: Path, kind: str, package: str, extra: str) -> TableError:
    return TableError(
        f"{path}: {kind} files need {package}, which is not installed; pip install {package} (valve_sim's extra "
        f"{extra}), or export it as CSV"
    )


def _whole(path: Path, columns: Mapping[str, NDArray[Any]], units: Mapping[str, str] | None = None) -> DataTable:
    """The columns, of which those that end before others have empty cells; much shorter ones are settings."""
    rows = max((len(values) for values in columns.values()), default=0)
    if rows < 2:
        raise TableError(f"{path}: holds no column of numbers; save the measured vectors by their names")
    of_rows = {name: np.asarray(values) for name, values in columns.items() if _LEAST_ROWS * rows < len(values)}
    return _ArrayTable(path, {name: _padded(values, rows) for name, values in of_rows.items()}, units)


def _padded(values: NDArray[Any], rows: int) -> NDArray[Any]:
    nothing = {"M": np.datetime64("NaT"), **dict.fromkeys("biuf", np.nan)}.get(values.dtype.kind)
    return values if len(values) == rows else np.append(values, [nothing] * (rows - len(values)))


def _open_parquet(path: Path) -> DataTable:
    try:
        import pyarrow.parquet
        from pyarrow.lib import ArrowException
    except ImportError as error:
        raise _missing(path, "Parquet", "pyarrow", "parquet") from error
    try:
        about = pyarrow.parquet.ParquetFile(path).metadata
        if about.num_columns > MOST_COLUMNS:
            raise TableError(f"{path}: has {about.num_columns} columns, expected at most {MOST_COLUMNS}; export fewer")
        check_expanded(path, 8.0 * about.num_rows * about.num_columns, TableError)
        table = pyarrow.parquet.read_table(path)
    except ArrowException as error:
        raise TableError(
            f"{path}: is not a Parquet file ({' '.join(str(error).split())[:120]}); export it again"
        ) from error
    return _ArrayTable(path, {name: table.column(name).to_numpy() for name in table.column_names})


def _open_mat(path: Path) -> DataTable:
    from scipy.io import loadmat, whosmat

    try:
        check_expanded(path, 8.0 * sum(math.prod(shape) for _, shape, _ in whosmat(str(path))), TableError)
        found = loadmat(str(path), squeeze_me=True, struct_as_record=False)
    except NotImplementedError as error:
        raise TableError(f"{path}: is a MATLAB 7.3 file, which is not read; save it with: save(file, '-v7')") from error
    except ValveError:
        raise
    except Exception as error:  # SciPy raises what it stumbles over
        raise TableError(
            f"{path}: is not a MATLAB file ({' '.join(str(error).split())[:120]}); save it again"
        ) from error
    columns = {}
    for name, value in found.items():
        if not name.startswith("__"):
            columns.update(_mat_columns(name, value))
    return _whole(path, columns)


def _mat_columns(name: str, value: Any) -> dict[str, NDArray[Any]]:
    """Vectors by their dotted names; a matrix's columns, and structs in an array, by their numbers: data[1]."""
    if hasattr(value, "_fieldnames"):
        inner: dict[str, NDArray[Any]] = {}
        for field in value._fieldnames:
            inner.update(_mat_columns(f"{name}.{field}", getattr(value, field)))
        return inner
    values = np.asarray(value)
    if values.ndim == 1 and values.dtype == object:  # Simulink's signals: an array of structs
        columns = [
            _mat_columns(f"{name}[{number + 1}]", own)
            for number, own in enumerate(values)
            if hasattr(own, "_fieldnames")
        ]
        return {inner: found for own in columns for inner, found in own.items()}
    if values.ndim == 1 and values.dtype.kind in "biuf":
        return {name: values}
    if values.ndim == 2 and values.dtype.kind in "biuf":
        across = values if values.shape[0] >= values.shape[1] else values.T
        return {f"{name}[{number + 1}]": across[:, number] for number in range(across.shape[1])}
    return {}


# --- spreadsheets and TDMS ---


def _open_sheet(path: Path) -> DataTable:
    """The first sheet with a table. Its dates are days since 1899, as it has them: read with the unit d."""
    try:
        import openpyxl
    except ImportError as error:
        raise _missing(path, "Excel", "openpyxl", "tables") from error
    trouble: TableError | None = None
    try:
        with zipfile.ZipFile(path) as parts:
            check_expanded(path, sum(part.file_size for part in parts.infolist()), TableError)
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        book._date_formats = set()  # openpyxl rounds dates to milliseconds
        for sheet in book.worksheets:
            lines = ["\t".join(map(_sheet_cell, row)) for row in sheet.iter_rows(values_only=True)]
            try:
                return TextTable(path, lines)
            except TableError as error:
                trouble = trouble or error
    except ValveError:
        raise
    except Exception as error:  # the library raises what it stumbles over
        raise TableError(
            f"{path}: is not an Excel file ({' '.join(str(error).split())[:120]}); save it again"
        ) from error
    raise trouble or TableError(f"{path}: has no sheet; save it again")


def _sheet_cell(value: object) -> str:
    return "" if value is None else " ".join(str(value).split())


def _open_tdms(path: Path) -> DataTable:
    """Channels by their names, with their group where that tells them apart, behind the times of their waveforms."""
    try:
        import nptdms
    except ImportError as error:
        raise _missing(path, "TDMS", "nptdms", "tables") from error
    try:
        about = nptdms.TdmsFile.read_metadata(path)
        channels = [channel for group in about.groups() for channel in group.channels()]
        check_expanded(path, 8.0 * sum(len(channel) for channel in channels), TableError)
        file = nptdms.TdmsFile.read(path)
        once = {channel.name for channel in channels if sum(own.name == channel.name for own in channels) == 1}
        clocks: dict[tuple[float, ...], dict[str, NDArray[Any]]] = {(): {}}
        units: dict[str, str] = {}
        for channel in (channel for group in file.groups() for channel in group.channels()):
            name = channel.name if channel.name in once else f"{channel.group_name}/{channel.name}"
            if unit := channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription"):
                units[name] = str(unit)
            every, start = (float(channel.properties.get(f"wf_{own}", 0.0)) for own in ("increment", "start_offset"))
            key = (every, start, len(channel)) if every > 0.0 and "time" not in once else ()
            if key not in clocks:
                clock = "time" if len(clocks) == 1 else f"time_{len(clocks)}"
                clocks[key], units[clock] = {clock: np.asarray(channel.time_track())}, "s"
            clocks[key][name] = np.asarray(channel[:])
    except ValveError:
        raise
    except Exception as error:  # the library raises what it stumbles over
        raise TableError(f"{path}: is not a TDMS file ({' '.join(str(error).split())[:120]}); save it again") from error
    return _whole(path, {name: own for columns in clocks.values() for name, own in columns.items()}, units)
