"""The signed-off record of a valve's calibration: who, when, which part, with which sensors, and what was found.

A record carries a digest of itself, so that a change by hand shows. It is no signature by cryptography: keep records
where only those write who may sign. What is changed later is appended to a journal beside the record, each entry with
the digest of the one before.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, Final, NamedTuple

from valve_sim.files.json_text import finite_or_none, json_text
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.whole_files import write_whole
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model import Valve
from valve_sim.model.errors import ValveError

SCHEMA: Final = "valve_sim/calibration/2"
_JOURNAL: Final = "valve_sim/calibration_journal/1"
_SENSOR: Final = ("name", "serial_number", "certificate", "expires")
_SENSORS_FORM: Final = (
    "expected a list of sensors: [{name: laser, serial_number: L-12, certificate: DKD 1234, expires: 2027-05-01}]"
)


class Sensor(NamedTuple):
    """A sensor that the calibration rests on, with its own certificate; `expires` is its last day, YYYY-MM-DD."""

    name: str
    serial_number: str
    certificate: str
    expires: str


class Figure(NamedTuple):
    """A value with its standard error and 95 % interval, SI; None where it is not known."""

    name: str
    value: float | None
    stderr: float | None
    ci95: tuple[float | None, float | None]
    unit: str


class Source(NamedTuple):
    """A file that the record rests on: its name, and the SHA-256 of its bytes."""

    name: str
    sha256: str


class Record(NamedTuple):
    """A calibration.

    Attributes:
        serial_number: of the valve. signed_by: who is answerable. signed_at: when, ISO 8601 in UTC.
        valid_until: last day, YYYY-MM-DD: of the calibration, or of the sensor that expires first.
        sensors: that it rests on. parameters, report: the files. declared: every number of the parameter file, by name.
        figures: what was found. note: of the person.
    """

    serial_number: str
    signed_by: str
    signed_at: str
    valid_until: str
    sensors: tuple[Sensor, ...]
    parameters: Source
    report: Source
    declared: dict[str, float | None]
    figures: tuple[Figure, ...]
    note: str = ""

    @property
    def digest(self) -> str:
        """SHA-256 of the content, as the file has it."""
        return _digest(self._content())

    def _content(self) -> dict[str, Any]:
        found = json.loads(json_text({"schema": SCHEMA, **self._asdict()}))
        assert isinstance(found, dict)
        return found

    def to_json(self) -> dict[str, Any]:
        """The content of the file, its digest last."""
        return {**self._content(), "digest": self.digest}

    def remarks(self, now: datetime, parameters: bytes | None = None) -> list[str]:
        """What speaks against using it: expired, signed in the future, or made for other parameters; empty if nothing.

        Args:
            now: in UTC. parameters: the bytes of the parameter file in use; None where that is not to be compared.
        """
        found = []
        if f"{now:%Y-%m-%dT%H:%M:%SZ}" < self.signed_at:
            found.append(
                f"the calibration of {self.serial_number} was signed at {self.signed_at}, which this machine's clock "
                "has not reached: set the clock"
            )
        if now.date().isoformat() > self.valid_until:
            found.append(f"the calibration of {self.serial_number} expired on {self.valid_until}; calibrate it anew")
        found += [
            f"the certificate {sensor.certificate} of the sensor {sensor.name} expired on {sensor.expires}"
            for sensor in self.sensors
            if now.date().isoformat() > sensor.expires
        ]
        if parameters is not None and hashlib.sha256(parameters).hexdigest() != self.parameters.sha256:
            found.append(f"the parameter file is not the one that was signed off ({self.parameters.name})")
        return found


def sign(
    report: Path, parameters: Path, sensors: Sequence[Sensor], *,
    serial_number: str, signed_by: str, now: datetime, days: int, units: Mapping[str, str], note: str = "",
) -> Record:  # fmt: skip
    """A record of what a report found.

    Args:
        report: identify.json, or report.json of a diagnosis. parameters: the file that is signed off.
        sensors: that measured. serial_number, signed_by, note: as `Record` has them.
        now: in UTC. days: for which it is valid, unless a sensor expires before. units: of figures, by name.

    Raises:
        ValveError: a file cannot be read, is no such report, or a sensor's certificate has expired.
    """
    figures = _figures(report, units)
    for sensor in sensors:
        if sensor.expires < now.date().isoformat():
            raise ValveError(
                f"sensors: {sensor.name}: its certificate {sensor.certificate} expired on {sensor.expires}; have it "
                "calibrated before it calibrates a valve"
            )
    last = (now + timedelta(days=days)).date().isoformat()
    until = min([last, *(sensor.expires for sensor in sensors)])
    stamp = now.astimezone(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
    sources = _source(parameters), _source(report)
    declared = declared_numbers(load_valve(parameters))
    return Record(serial_number, signed_by, stamp, until, tuple(sensors), *sources, declared, figures, note)


def declared_numbers(valve: Valve) -> dict[str, float | None]:
    """Every number of a valve as a parameter file has it, by name such as effects.stiction.force; None for infinity."""
    return {name: finite_or_none(value) for name, value in _numbers(valve.to_mapping(), "")}


def _numbers(found: Any, name: str) -> Iterator[tuple[str, float]]:
    if isinstance(found, Mapping):
        for key, value in found.items():
            yield from _numbers(value, f"{name}.{key}" if name else str(key))
    elif isinstance(found, Sequence) and not isinstance(found, str):
        for index, value in enumerate(found):
            yield from _numbers(value, f"{name}[{index}]")
    elif isinstance(found, int | float):
        yield name, float(found)


def save_record(path: Path, record: Record) -> None:
    """Write a record, whole or not at all.

    Raises:
        ValveError: it cannot be written.
    """
    write_whole(path, json_text(record.to_json()), durable=True)


def load_record(path: Path) -> Record:
    """A record as it was signed.

    Raises:
        ValveError: it cannot be read, is no record, or was changed after it was signed.
    """
    found = _read_json(path)
    digest = found.pop("digest", None)
    if found.get("schema") != SCHEMA:
        raise ValveError(f"{path}: schema: found {found.get('schema')!r}, expected {SCHEMA}; give a calibration record")
    if digest != _digest(found):
        raise ValveError(f"{path}: was changed after it was signed; restore it, or calibrate and sign anew")
    values = {name: found[name] for name in Record._fields}
    values["sensors"] = tuple(Sensor(**sensor) for sensor in found["sensors"])
    values["parameters"], values["report"] = Source(**found["parameters"]), Source(**found["report"])
    values["figures"] = tuple(Figure(**{**figure, "ci95": tuple(figure["ci95"])}) for figure in found["figures"])
    return Record(**values)


class Change(NamedTuple):
    """A change of a parameter after the calibration: when (ISO 8601, UTC), by whom, which, from what, to what."""

    at: str
    by: str
    parameter: str
    before: float | None
    after: float | None


def journal_path(record: Path) -> Path:
    """Where the journal of a record is."""
    return record.with_suffix(".journal.json")


def append_changes(record: Path, new: Sequence[Change]) -> None:
    """Append changes to the journal of a record, all of them or none.

    Raises:
        ValveError: the record or its journal cannot be used or written.
    """
    with _locked(record):
        _append(record, new)


def _append(record: Path, new: Sequence[Change]) -> None:
    base, changes = load_record(record), load_changes(record)
    entries, previous = [], base.digest
    for entry in (*changes, *new):
        content = {**entry._asdict(), "previous": previous}
        previous = _digest(content)
        entries.append({**content, "digest": previous})
    text = json_text({"schema": _JOURNAL, "record": base.digest, "changes": entries})
    write_whole(journal_path(record), text, durable=True)


def load_changes(record: Path) -> tuple[Change, ...]:
    """The changes after a calibration, in order; none where there is no journal.

    Raises:
        ValveError: the journal cannot be read, belongs to another record, or was changed by hand.
    """
    path = journal_path(record)
    if not path.exists():
        return ()
    found = _read_json(path)
    mend = "restore it, or calibrate and sign anew"
    previous = load_record(record).digest
    if found.get("schema") != _JOURNAL or found.get("record") != previous:
        raise ValveError(f"{path}: is not the journal of {record.name}; {mend}")
    changes = []
    for number, entry in enumerate(found["changes"], start=1):
        digest = entry.pop("digest", None)
        if entry.get("previous") != previous or digest != _digest(entry):
            raise ValveError(f"{path}: entry {number} was changed or taken out after it was written; {mend}")
        previous = digest
        entry.pop("previous")
        changes.append(Change(**entry))
    return tuple(changes)


def note_changes(
    record: Path,
    declared: Mapping[str, float | None],
    by: str,
    now: datetime,
    known: Mapping[str, float | None] | None = None,
) -> tuple[Change, ...]:
    """Append to the journal in what a valve's declared numbers differ from those that are known.

    Several processes may do so at once: each waits for the one before.

    Args:
        record: the file. declared: see `declared_numbers`. by: who uses them. now: in UTC.
        known: what the same user declared before; None: what the record and its journal say.

    Returns:
        what was appended; nothing where nothing differs.

    Raises:
        ValveError: the record or its journal cannot be used or written.
    """
    with _locked(record):
        if known is None:
            journal = {change.parameter: change.after for change in load_changes(record)}
            known = {**load_record(record).declared, **journal}
        at = now.astimezone(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
        new = tuple(
            Change(at, by, name, known.get(name), declared.get(name))
            for name in {**known, **declared}
            if known.get(name) != declared.get(name)
        )
        if new:
            _append(record, new)
    return new


@contextlib.contextmanager
def _locked(record: Path) -> Iterator[None]:
    """Nobody else appends to the journal meanwhile."""
    try:
        file = record.open("rb")
    except OSError as error:
        raise ValveError(f"{record}: cannot be read ({error.strerror}); give another file") from error
    with file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def read_sensors(path: Path) -> tuple[Sensor, ...]:
    """Sensors of a YAML file.

    Raises:
        ValveError: it cannot be read, or an entry is not complete.
    """
    found = read_yaml(path, _SENSORS_FORM, ValveError)
    if not isinstance(found, list) or not found:
        raise ValveError(f"{path}: found {str(found)[:60]!r}; {_SENSORS_FORM}")
    sensors = []
    for number, entry in enumerate(found, start=1):
        if not isinstance(entry, Mapping) or set(entry) != set(_SENSOR):
            raise ValveError(f"{path}: sensor {number}: found {str(entry)[:60]}; {_SENSORS_FORM}")
        expires = str(entry["expires"])
        try:
            datetime.strptime(expires, "%Y-%m-%d")
        except ValueError as error:
            raise ValveError(
                f"{path}: sensor {number}: expires: found {expires!r}, expected a day such as 2027-05-01"
            ) from error
        sensors.append(Sensor(str(entry["name"]), str(entry["serial_number"]), str(entry["certificate"]), expires))
    return tuple(sensors)


def _figures(report: Path, units: Mapping[str, str]) -> tuple[Figure, ...]:
    found = _read_json(report)
    after = found.get("after")
    parameters = after.get("parameters") if isinstance(after, Mapping) else found.get("parameters")
    if not isinstance(parameters, Mapping) or not parameters:
        raise ValveError(f"{report}: holds no estimated parameters; give identify.json, or report.json of a diagnosis")
    figures = []
    for name, entry in parameters.items():
        try:
            low, high = entry["ci95"]
            figures.append(Figure(name, entry["value"], entry["stderr"], (low, high), units.get(name, "")))
        except (KeyError, TypeError, ValueError) as error:
            raise ValveError(
                f"{report}: parameters.{name}: found {str(entry)[:60]}, expected value, stderr and ci95"
            ) from error
    return tuple(figures)


def _source(path: Path) -> Source:
    try:
        return Source(path.name, hashlib.sha256(path.read_bytes()).hexdigest())
    except OSError as error:
        raise ValveError(f"{path}: cannot be read ({error.strerror}); give the file that is signed off") from error


def _digest(content: Mapping[str, Any]) -> str:
    text = json.dumps(content, sort_keys=True, ensure_ascii=False, separators=(",", ":"))
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _read_json(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ValveError(f"{path}: cannot be read ({error.strerror}); give another file") from error
    except ValueError as error:
        raise ValveError(f"{path}: is no JSON ({' '.join(str(error).split())}); give another file") from error
    if not isinstance(found, dict):
        raise ValveError(f"{path}: found {str(found)[:60]!r}, expected a JSON object; give another file")
    return found
