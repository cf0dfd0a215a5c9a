"""Recordings made by the model, with the noise of sensors: to try things out, to test a fit, to draw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.channels import Signal
from valve_sim.files.data_tables import read_table
from valve_sim.files.tables import TableError
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model import Drive, Response, Valve, ValveError, simulate
from valve_sim.recordings.trace import Trace
from valve_sim.recordings.writing import CSV_COLUMNS

Array = NDArray[np.float64]

MOST_SAMPLES: Final = 20_000_000
"""Of one recording; beyond it memory runs short and the bag takes minutes to write."""

_PROFILE_COLUMNS: Final = {"time": ("time", "times", "t"), "volts": ("volts", "voltage", "coil_voltage", "v")}
_PROFILE_FORM: Final = "expected rows of time in s and volts, such as [[0.01, 9.0], [0.04, 0.0]]"


@dataclass(frozen=True)
class Sensor:
    """Errors of the sensors.

    Attributes:
        position_noise: standard deviation of white noise on both positions, m.
        quantisation: step that the noisy positions are rounded to, m; 0 for none.
        current_noise: standard deviation of white noise on the coil current, A.
        seed: of the noise; the same seed gives the same recording.
        voltage_noise: standard deviation of white noise on the coil's voltage, V; None where it is not measured.
        pressure_noise: standard deviation of white noise on the outlet's pressure, Pa, of a valve with gas.
        has_positions: whether there is a position sensor.
    """

    position_noise: float = 0.0
    quantisation: float = 0.0
    current_noise: float = 0.0
    seed: int = 0
    voltage_noise: float | None = None
    has_positions: bool = True
    pressure_noise: float = 0.0


class Recording(NamedTuple):
    """A simulated run: what the valve did, and what its sensors recorded of it."""

    response: Response
    trace: Trace

    def columns(self) -> dict[str, NDArray[Any]]:
        """The table of `CSV_COLUMNS`: channels as measured; velocity, phase, and with gas mass_flow, as they were.

        Positions that were not measured are NaN.
        """
        trace, response = self.trace, self.response
        assert trace.coil_current is not None
        nothing = np.full(len(response.time), np.nan)
        values: tuple[NDArray[Any], ...] = (
            response.time,
            trace.drive.at(response.time),
            trace.coil_current.values,
            trace.pilot_position if trace.has_positions else nothing,
            nothing if trace.main_position is None else trace.main_position,
            response.pilot_velocity,
            response.phase,
        )
        columns = dict(zip(CSV_COLUMNS, values, strict=True))
        columns |= {name: signal.values for name, signal in trace.signals().items() if name not in columns}
        return columns if response.mass_flow is None else {**columns, "mass_flow": response.mass_flow}


def record(valve: Valve, drive: Drive, duration: float, rate: float, sensor: Sensor) -> Recording:
    """Simulate a valve and measure it.

    Args:
        valve: what is simulated, at rest at time 0.
        drive: commanded voltage, times from 0 on, s.
        duration: s, of which samples k / rate are taken, k from 0 on, the end left out.
        rate: samples a second, Hz.
        sensor: the errors of the sensors.

    Raises:
        ValveError: no command, no sample, or too many of them fall into the duration.
        SimulationError: the run could not be carried to its end.
    """
    if not 1.5 <= duration * rate <= MOST_SAMPLES:
        raise ValveError(
            f"{duration:g} s at {rate:g} Hz are {duration * rate:.6g} samples; expected 2 to {MOST_SAMPLES}: change "
            "duration or rate"
        )
    inside = drive.times < duration
    if not inside.any():
        raise ValveError(
            f"the first command comes at {drive.times[0]:g} s; expected one before the end, {duration:g} s"
        )
    count = round(duration * rate)
    times = np.arange(count) / rate
    response = simulate(valve, drive, times, start_time=0.0)
    random = np.random.default_rng(sensor.seed)
    pilot = _measured(response.pilot_position, sensor, random)
    main = _measured(response.main_position, sensor, random)
    noise = {
        "coil_current": sensor.current_noise,
        "coil_voltage": sensor.voltage_noise,
        "outlet_pressure": sensor.pressure_noise,
    }
    signals = {
        name: Signal(times, clean + sigma * random.standard_normal(count))
        for name, sigma in noise.items()
        if sigma is not None and (clean := getattr(response, name)) is not None
    }
    commands = Drive(drive.times[inside], drive.volts[inside])
    seen = slice(None) if sensor.has_positions else slice(0)
    trace = Trace(
        "simulation", commands, times[seen], pilot[seen], main if sensor.has_positions else None,
        **signals,  # type: ignore[arg-type] # by the names that a trace has for them
    )  # fmt: skip
    return Recording(response, trace)


def read_profile(path: Path | str) -> Drive:
    """A commanded voltage from a file of rows time (s), volts (V), each held until the next; 0 V before the first.

    A .yaml or .yml file is a list of [time, volts], or of {time: , volts: }. Any other file is a CSV table (see
    `data_tables.read_table`) with the columns time and volts; coil_voltage will do, so that a CSV that `simulate` wrote
    can drive the next simulation.

    Raises:
        TableError: the file cannot be read, holds anything but numbers, or its times do not ascend from 0 on.
    """
    if Path(path).suffix.lower() in (".yaml", ".yml"):
        times, volts = _yaml_rows(path).T.copy()
    else:
        table = read_table(path, _PROFILE_COLUMNS)
        times, volts = table["time"], table["volts"]
    if times[0] < 0.0:
        raise TableError(f"{path}: row 1: found time {times[0]:g} s, expected times from 0 on")
    backward = np.flatnonzero(np.diff(times) <= 0.0)
    if len(backward):
        row = int(backward[0]) + 2
        raise TableError(f"{path}: row {row}: found time {times[row - 1]:g} s, expected one after {times[row - 2]:g} s")
    changes = np.diff(volts, prepend=np.nan) != 0.0
    return Drive(times[changes], volts[changes])


def _measured(clean: Array, sensor: Sensor, random: np.random.Generator) -> Array:
    noisy = clean + sensor.position_noise * random.standard_normal(len(clean))
    return np.round(noisy / sensor.quantisation) * sensor.quantisation if sensor.quantisation > 0.0 else noisy


def _yaml_rows(path: Path | str) -> Array:
    found = read_yaml(path, _PROFILE_FORM, TableError)
    if not isinstance(found, list) or not found:
        raise TableError(f"{path}: found {str(found)[:60]!r}; {_PROFILE_FORM}")
    return np.array([_yaml_row(path, number, row) for number, row in enumerate(found, start=1)])


def _yaml_row(path: Path | str, number: int, row: object) -> tuple[float, float]:
    pair = [row.get("time"), row.get("volts")] if isinstance(row, Mapping) else row
    if isinstance(pair, Sequence) and len(pair) == 2:
        try:
            time, volts = (float(str(value)) for value in pair)
        except ValueError:
            pass
        else:
            if np.isfinite([time, volts]).all():
                return time, volts
    raise TableError(f"{path}: row {number}: found {str(row)[:60]}; {_PROFILE_FORM}")
