"""The front door for Python: `import valve_sim as vs`.

These functions do what the command line does. Their results can be shown in a notebook: `table()`, `residual()`,
`plot()`, `print` and an HTML view. The machine is the valve, or one that a plant file describes (`load_plant`).
"""

from __future__ import annotations

import html
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, replace
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valve_sim.files.data_tables import is_table
from valve_sim.files.parameter_files import default_valve
from valve_sim.files.plant_files import PlantFile
from valve_sim.files.recording_map import MapError, RecordingMap, is_of_valve, map_from
from valve_sim.files.yaml_files import read_yaml
from valve_sim.identification.diagnosis import identify as fitting
from valve_sim.identification.diagnosis import outcome, run
from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.identification.plants.protocol import primary_channels
from valve_sim.identification.validation import replay
from valve_sim.identification.validation.own_plant import validate_plant
from valve_sim.model import Drive, Response, Valve, published_times
from valve_sim.model import simulate as run_valve
from valve_sim.model.errors import ParameterError
from valve_sim.recordings import (
    Trace,
    TraceError,
    another_valve,
    columns,
    left_out_finding,
    read_trace,
    refuse_doubtful_units,
)
from valve_sim.recordings.columns import Columns
from valve_sim.recordings.reading import is_own_table

if TYPE_CHECKING:
    from valve_sim.identification.reporting.figures import Picture

__all__ = [
    "Diagnosis",
    "Identification",
    "Residual",
    "Simulation",
    "Validation",
    "diagnose",
    "identify",
    "read",
    "simulate",
    "validate",
]

Progress = Callable[[str, float], None]
Given = Trace | Columns | str | PathLike[str]
"""A recording, or where it is: `read` then reads it, without a map."""
Recordings = Given | Sequence[Given]


class Residual(NamedTuple):
    """The residual of a model, measured less simulated, for each sample.

    Attributes:
        times: (n,) s, from the beginning of the recording on.
        values: (n,) measured less shown by the model, in `unit`; errors of the recording that were estimated along,
            such as an offset between clocks, are part of what the model shows.
        sigma: standard deviation of the sensor's noise, in `unit`.
        unit: SI: m where a position was recorded, else A or Pa.
    """

    times: NDArray[np.float64]
    values: NDArray[np.float64]
    sigma: float
    unit: str

    @property
    def rms(self) -> float:
        """Root mean square of the values, in `unit`."""
        return float(np.sqrt(np.mean(np.square(self.values))))


@dataclass(frozen=True, repr=False)
class Simulation(Response):
    """A simulated response: the arrays of `valve_sim.model.Response`, with the valve and the drive that were simulated.

    Attributes:
        valve: what was simulated. drive: the commanded voltage.
    """

    valve: Valve = field(default_factory=Valve)
    drive: Drive = field(default_factory=lambda: Drive.of([], []))

    def __repr__(self) -> str:
        """Simulation(4000 samples, 4 events: t1 7.03 ms, t2 9.17 ms)."""
        t1, t2 = published_times(self)
        return f"Simulation({len(self.time)} samples, {len(self.events)} events: t1 {_ms(t1)}, t2 {_ms(t2)})"

    def _repr_html_(self) -> str:
        """The events as a table."""
        return _html_table(repr(self), self.table_of_events())

    def table(self) -> Any:
        """The samples, SI units: a pandas DataFrame where pandas is installed, else a list of dicts."""
        columns: dict[str, Iterable[Any]] = {
            "time": self.time,
            "coil_voltage": self.coil_voltage,
            "coil_current": self.coil_current,
            "pilot_position": self.pilot_position,
            "main_position": self.main_position,
            "pilot_velocity": self.pilot_velocity,
            "attraction": self.attraction,
            "phase": self.phase,
        }
        if self.outlet_pressure is not None and self.mass_flow is not None:
            columns |= {"outlet_pressure": self.outlet_pressure, "mass_flow": self.mass_flow}
        rows = zip(*(np.asarray(column).tolist() for column in columns.values()), strict=True)
        return _table([dict(zip(columns, row, strict=True)) for row in rows])

    def table_of_events(self) -> list[dict[str, Any]]:
        """The events in order: kind, time in s, position in m, and velocity before the event in m/s."""
        return [
            {
                "event": event.kind.name.lower(),
                "time": event.time,
                "position": event.position,
                "velocity": event.velocity,
            }
            for event in self.events
        ]

    def plot(self) -> Picture:
        """Displacement, velocity, current and phase; a Matplotlib figure, which `savefig` writes."""
        from valve_sim.identification.reporting.figures import draw_simulation

        return draw_simulation(self, self.drive, self.valve, "simulated valve")


@dataclass(frozen=True, repr=False)
class Identification(fitting.Identification):
    """Refitted parameters: the fields of `valve_sim.identification.diagnosis.identify.Identification`.

    `print` shows what `valve-sim identify` prints, and `valve` is the identified valve.
    """

    def __str__(self) -> str:
        """The report for a terminal."""
        from valve_sim.identification.reporting.identification_document import identification_document

        return identification_document(self).to_text()

    def _repr_html_(self) -> str:
        """The refitted parameters as a table, with what was found beside it."""
        from valve_sim.identification.reporting.finding_sentences import remarks

        said = "".join(f"<p>{html.escape(words)}</p>" for words in remarks(self.findings))
        return _html_table(f"{len(self.intervals)} parameters refitted", self._rows()) + said

    def _rows(self) -> list[dict[str, Any]]:
        return [
            {
                "parameter": name,
                "value": own.value,
                "stderr": own.stderr,
                "low": own.low,
                "high": own.high,
                "declared": self.plant.declared(name),
                "unit": self.plant.parameter(name).unit,
            }
            for name, own in self.intervals.items()
        ]

    def table(self) -> Any:
        """Each refitted parameter, its standard error and 95 % interval: a pandas DataFrame, or a list of dicts."""
        return _table(self._rows())

    def residual(self) -> Residual:
        """The residual of the refitted model, measured less simulated."""
        return _residual(self.fit)

    def plot(self) -> Picture:
        """The residual beside the sensor's noise; a Matplotlib figure, which `savefig` writes."""
        return _plot_of(self.fit, "refitted")

    def write(self, folder: Path | str) -> tuple[Path, ...]:
        """Write identify.json and identified.yaml; returns their paths.

        Raises:
            ValveError: a file cannot be written.
        """
        from valve_sim.identification.reporting.files import write_identification

        return write_identification(self, folder, "made in Python by valve_sim.identify")


@dataclass(frozen=True, repr=False)
class Diagnosis(outcome.Diagnosis):
    """A diagnosis: the fields of `valve_sim.identification.diagnosis.outcome.Diagnosis`.

    `print` shows what `valve-sim diagnose` prints, and `valve` is the corrected valve.
    """

    def __str__(self) -> str:
        """The report for a terminal."""
        from valve_sim.identification.reporting.diagnosis_document import diagnosis_document

        return diagnosis_document(self).to_text()

    def _repr_html_(self) -> str:
        """The verdict in a sentence, and the most probable sets of effects as a table."""
        from valve_sim.identification.reporting.claims import summarise

        return _html_table(summarise(self), self._rows()[:5])

    def _rows(self) -> list[dict[str, Any]]:
        return [
            {
                "effects": " + ".join(candidate.effects),
                "probability": candidate.probability,
                "probability_beside_unnamed": candidate.unnamed,
                "delta_bic": candidate.delta_bic,
                "train_rmse": candidate.train_rmse,
                "holdout_rmse": candidate.holdout_rmse,
            }
            for candidate in self.candidates
        ]

    def table(self) -> Any:
        """Each set of effects that was fitted, the most probable first: a pandas DataFrame, or a list of dicts."""
        return _table(self._rows())

    def residual(self, *, before: bool = False) -> Residual:
        """The residual of the corrected model in the fitted strokes; `before`: of the refitted declared model."""
        return _residual((self.before if before else self.after).fit)

    def plot(self) -> Picture:
        """The strokes that the declared model misses most, before and after; a Matplotlib figure."""
        from valve_sim.identification.reporting.figures import draw_diagnosis

        return draw_diagnosis(self)

    def write(self, folder: Path | str) -> tuple[Path, ...]:
        """Write report.json, report.html, corrected.yaml and, where it helps, record_next.yaml; returns their paths.

        Raises:
            ValveError: a file cannot be written.
        """
        from valve_sim.identification.reporting.files import write_diagnosis

        return write_diagnosis(self, folder, "made in Python by valve_sim.diagnose")


@dataclass(frozen=True, repr=False)
class Validation(replay.Validation):
    """A replay: the fields of `valve_sim.identification.validation.replay.Validation`, such as `passed`.

    `print` shows what `valve-sim validate` prints.
    """

    def __str__(self) -> str:
        """The report for a terminal."""
        from valve_sim.identification.reporting.validation_document import validation_document

        return validation_document(self).to_text()


def simulate(valve: Valve, drive: Drive, times: ArrayLike, *, start_time: float | None = None) -> Simulation:
    """Simulate a valve that rests until its first command.

    Args:
        valve: what is simulated, such as `default_valve()`.
        drive: the commanded voltage, such as `Drive.of([0.01, 0.04], [9.0, 0.0])`: 9 V from 10 to 40 ms.
        times: (n,) s, ascending: when the sensors are read.
        start_time: s; the valve rests closed until then. Default: the first command or sample.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    found = run_valve(valve, drive, times, start_time=start_time)
    return Simulation(**_fields_of(found), valve=valve, drive=drive)


def read(
    path: PathLike[str] | str,
    recording_map: RecordingMap | Mapping[str, Any] | PathLike[str] | str | None = None,
    plant: PlantFile | None = None,
    *,
    valve: str | None = None,
) -> Trace | Columns:
    """Read a recording: of a valve as a `Trace`, of another machine as `Columns`.

    Args:
        path: a rosbag2 folder, an .mcap or .db3 file, or a table (CSV, Parquet, MATLAB).
        recording_map: what is where: a file, its content, or what `load_map` returns; default: the topics of this
            package, or a table's columns by their own names.
        plant: the machine, from `load_plant`; default: the valve, unless the map names what no valve has.
        valve: its name where several were recorded ("/tank_1/valve").

    Raises:
        ValveError: the recording or the map cannot be used; one line says why and what to do.
    """
    if isinstance(recording_map, RecordingMap):
        if plant is not None:
            raise MapError(f"{recording_map.path}: was loaded as a valve's map; give its path with a plant")
        return read_trace(path, valve, recording_map)
    if plant is not None:
        return columns.read(path, recording_map)
    if recording_map is None:
        return read_trace(path, valve) if not is_table(Path(path)) or is_own_table(Path(path)) else columns.read(path)
    where = "map" if isinstance(recording_map, Mapping) else str(recording_map)
    found = recording_map if isinstance(recording_map, Mapping) else read_yaml(where, "expected a map", MapError)
    if isinstance(found, Mapping) and not is_of_valve(found):
        return columns.read(path, recording_map)
    return read_trace(path, valve, map_from(found, where))


@contextmanager
def _few_threads() -> Iterator[None]:
    """Linear algebra on as many threads as the environment says, also where NumPy was loaded before it did."""
    with ExitStack() as stack:
        if find_spec("threadpoolctl"):  # which has no rosdep key
            from threadpoolctl import threadpool_limits

            asked = os.environ.get("OPENBLAS_NUM_THREADS", "")
            stack.enter_context(threadpool_limits(max(1, int(asked)) if asked.isdecimal() else 1, "blas"))
        yield


@_few_threads()
def identify(
    recordings: Recordings,
    machine: Valve | PlantFile | None = None,
    free: Sequence[str] | None = None,
    *,
    progress: Progress | None = None,
) -> Identification:
    """Refit parameters of a declared machine to recordings.

    Args:
        recordings: from `read`, or paths that need no map: one, or several of the same machine.
        machine: as it is declared: a valve, or what `load_plant` returns; default: the shipped valve.
        free: names to refit, such as "main_damping", "gas.outlet_volume" or "stiction.force"; default: the dampings of
            a valve, and of a plant file what it declares `free`.
        progress: told what is being done, and the fraction done.

    Raises:
        ParameterError: a name that cannot be freed.
        SimulationError: the declared machine cannot be simulated.
        TraceError: a recording cannot be used, say because its positions are in mm and taken for m.
    """
    if isinstance(machine, PlantFile):
        found = fitting.identify_plant(OwnPlant(machine, _columns(recordings, machine)), free, progress)
    else:
        declared = _declared(machine)
        found = fitting.identify(_usable(recordings, declared), declared, free, progress)
    return Identification(**_fields_of(found))


@_few_threads()
def diagnose(
    recordings: Recordings,
    machine: Valve | PlantFile | None = None,
    holdout: Recordings = (),
    *,
    budget: Budget | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the effect that a declared machine lacks.

    Args:
        recordings: from `read`, or paths that need no map: one, or several of the same machine: what is fitted.
        machine: as it is declared: a valve, or what `load_plant` returns; default: the shipped valve.
        holdout: recordings that are predicted and take no part in the fit; default: parts of `recordings` are held out.
        budget: how much may be simulated, such as `Budget.of_seconds(120)`; default: as much as it takes.
        progress: told what is being tried, and the fraction done.

    Raises:
        SimulationError: the declared machine cannot be simulated.
        TraceError: a recording cannot be used, say because its positions are in mm and taken for m.
    """
    if isinstance(machine, PlantFile):
        others = _columns(holdout, machine)
        plants = OwnPlant(machine, _columns(recordings, machine)), OwnPlant(machine, others) if others else None
        return Diagnosis(**_fields_of(run.diagnose_plant(*plants, progress, budget)))
    declared = _declared(machine)
    found = run.diagnose(_usable(recordings, declared), _usable(holdout, declared), declared, progress, budget)
    return Diagnosis(**_fields_of(found))


@_few_threads()
def validate(
    recordings: Recordings,
    machine: Valve | PlantFile | None = None,
    tolerance: float | None = None,
    *,
    progress: Progress | None = None,
) -> Validation:
    """Replay recordings on a declared machine, and compare.

    Args:
        recordings: from `read`, or paths that need no map: one, or several of the same machine.
        machine: as it is declared: a valve, or what `load_plant` returns; default: the shipped valve.
        tolerance: root mean square of the error that a stroke may have, of a valve's position in m; default: three
            times the standard deviation of what is predicted.
        progress: told what is being done, and the fraction done; of valves.

    Raises:
        SimulationError: the declared machine cannot be simulated.
        TraceError: a recording cannot be used, say because its positions are in mm and taken for m.
    """
    if isinstance(machine, PlantFile):
        found = validate_plant(OwnPlant(machine, _columns(recordings, machine)), tolerance)
    else:
        declared = _declared(machine)
        found = replay.validate(_usable(recordings, declared), declared, tolerance, progress=progress)
    return Validation(**_fields_of(found))


def _listed(recordings: Recordings, plant: PlantFile | None = None) -> list[Trace | Columns]:
    """One recording or several, those that are paths as `read` reads them."""
    one = (Trace, Columns, str, PathLike)
    given = list(recordings) if isinstance(recordings, Iterable) and not isinstance(recordings, one) else [recordings]
    for own in given:
        if not isinstance(own, one):
            raise TraceError(f"recordings: found {type(own).__name__}, expected one from vs.read, or its path")
    return [read(own, None, plant) if isinstance(own, (str, PathLike)) else own for own in given]


def _declared(machine: Valve | None) -> Valve:
    if machine is not None and not isinstance(machine, Valve):
        raise ParameterError(
            f"machine: found {type(machine).__name__}, expected a valve from vs.load_valve, or a machine from "
            "vs.load_plant"
        )
    return machine or default_valve()


def _columns(recordings: Recordings, plant: PlantFile) -> list[Columns]:
    """Recordings of a machine that is no valve.

    Raises:
        TraceError: one was read as that of a valve.
    """
    found = []
    for recording in _listed(recordings, plant):
        if isinstance(recording, Trace):
            raise TraceError(
                f"{recording.source}: was read as a valve's; read it with vs.read(path, map, plant) for {plant.path}"
            )
        found.append(recording)
    return found


def _usable(recordings: Recordings, valve: Valve) -> list[Trace]:
    """Recordings of a valve as fits take them; what makes one doubtful is a warning.

    Raises:
        TraceError: its numbers are in another unit, or it is another machine's.
    """
    found = []
    for trace in _listed(recordings):
        if isinstance(trace, Columns):
            raise TraceError(
                f"{trace.source}: is not read as a valve's; read it with a map, or give its machine, from vs.load_plant"
            )
        refuse_doubtful_units(trace, valve.parameters)
        for finding in (*left_out_finding(trace), *another_valve(trace, valve.parameters)):
            warnings.warn(f"{trace.source}: {finding}", stacklevel=3)
        # No fit asks for the main plunger, and of a long recording it is large.
        found.append(replace(trace, main_position=None))
    return found


def _fields_of(result: Any) -> dict[str, Any]:
    """The fields of a dataclass by name, as they are."""
    return {own.name: getattr(result, own.name) for own in fields(result)}


def _residual(found: Fit) -> Residual:
    problem = found.problem
    index = primary_channels(problem.plant)[0]
    channel = problem.plant.channels[index]
    is_fitted = problem.weight(index) > 0.0
    left_out = problem.left_out(index)
    if left_out is not None:
        is_fitted &= ~left_out
    left = (channel.data - found.shown()[index])[is_fitted]
    return Residual(channel.times[is_fitted], left, problem.noise_of(index).sigma, channel.unit)


def _plot_of(found: Fit, title: str) -> Picture:
    from valve_sim.identification.reporting.figures import draw_residual

    times, values, sigma, _ = _residual(found)
    plant = found.problem.plant
    scale, unit = plant.channels[primary_channels(plant)[0]].readable
    return draw_residual(times, values, sigma, scale, unit, title)


def _table(rows: list[dict[str, Any]]) -> Any:
    """A pandas DataFrame where pandas is installed, else the rows."""
    if find_spec("pandas") is None:
        return rows
    from pandas import DataFrame

    return DataFrame(rows)


def _html_table(title: str, rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a notebook shows them."""
    head = "".join(f"<th>{html.escape(name)}</th>" for name in (rows[0] if rows else ()))
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(_shown(value))}</td>" for value in row.values()) + "</tr>" for row in rows
    )
    return f"<p><b>{html.escape(title)}</b></p><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _shown(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _ms(time: float) -> str:
    return "not reached" if np.isnan(time) else f"{1e3 * time:.2f} ms"
