"""A recording that was put together in Python is checked once, where an identification, a diagnosis or a replay begins.

Recordings that were read from files have been checked by their readers; this takes them a fraction of a millisecond.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from valve_sim.files.channels import JUDGED, SIGNALS, Signal
from valve_sim.model import Drive
from valve_sim.recordings.trace import Trace, TraceError

FEWEST: Final = 3
"""Samples of what a valve is judged by: fewer have no rate and no noise."""


def check_traces(traces: Sequence[Trace]) -> None:
    """Recordings that identification can use.

    Raises:
        TraceError: one cannot; one line says which column, what was found and where.
    """
    if isinstance(traces, Trace):
        raise TraceError(f"{traces.source}: found one recording, expected a list of them: [trace]")
    if not len(traces):
        raise TraceError("no recording was given, expected at least one")
    for index, trace in enumerate(traces):
        if not isinstance(trace, Trace):
            raise TraceError(f"recording {index + 1}: found {type(trace).__name__}, expected a valve_sim Trace")
        _check_trace(trace)


def _check_trace(trace: Trace) -> None:
    where = f"{trace.source}: "
    if not isinstance(trace.drive, Drive):
        raise TraceError(f"{where}drive: found {type(trace.drive).__name__}, expected a valve_sim.model.Drive")
    _check_series(f"{where}drive.times", trace.drive.times, f"{where}drive.volts", trace.drive.volts)
    if not len(trace.drive.times):
        raise TraceError(f"{where}drive: found no command, expected at least one, or nothing moves the valve")
    _check_series(f"{where}times", trace.times, f"{where}pilot_position", trace.pilot_position, rises=True)
    if trace.main_position is not None:
        _check_series(f"{where}times", trace.times, f"{where}main_position", trace.main_position, rises=True)
    for name, signal in trace.signals().items():
        if not isinstance(signal, Signal):
            raise TraceError(f"{where}{name}: found {type(signal).__name__}, expected a valve_sim.recordings.Signal")
        _check_series(f"{where}{name}.times", signal.times, f"{where}{name}.values", signal.values)
    others = [SIGNALS[key].name for key in JUDGED[1:]]
    if not trace.has_positions and not set(others) & set(trace.signals()):
        raise TraceError(f"{where}found neither positions nor {' nor '.join(others)}, expected one of them")
    if len(trace.sample_times) < FEWEST:
        raise TraceError(
            f"{where}found {len(trace.sample_times)} samples of the {trace.primary_signal}, expected {FEWEST}"
        )


def _check_series(of_times: str, times: object, of_values: str, values: object, *, rises: bool = False) -> None:
    """Times and values of one length, finite, and in order of time; strictly where they rise."""
    for name, column in ((of_times, times), (of_values, values)):
        if not isinstance(column, np.ndarray):
            raise TraceError(
                f"{name}: found {type(column).__name__}, expected a numpy array of shape (n,) and dtype float64"
            )
        if column.ndim != 1:
            raise TraceError(f"{name}: found shape {column.shape}, expected (n,)")
        if not np.issubdtype(column.dtype, np.floating):
            raise TraceError(f"{name}: found dtype {column.dtype}, expected float64")
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            raise TraceError(
                f"{name}: found {column[bad[0]]} at index {bad[0]} ({len(bad)} in all), expected finite numbers"
            )
    assert isinstance(times, np.ndarray)
    assert isinstance(values, np.ndarray)
    if len(times) != len(values):
        raise TraceError(f"{of_values}: found {len(values)} values, expected {len(times)}, one for each of the times")
    steps = np.diff(times)
    back = np.flatnonzero(steps <= 0.0 if rises else steps < 0.0)
    if len(back):
        at = int(back[0]) + 1
        raise TraceError(
            f"{of_times}: found {times[at]:.9g} s after {times[at - 1]:.9g} s at index {at}, expected "
            f"{'strictly ' if rises else ''}ascending times"
        )
