"""Derivatives of what the sensors of a recorded valve show, by the model's variational equations.

What a run is made of (the valve's record, commands, clocks) follows from the values by simple rules, so that a
difference quotient of these rules is exact to seven digits and costs no simulation; what the valve makes of it is the
model's to differentiate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from valve_sim.identification.plants.protocol import Array, Direction, Sensitivities
from valve_sim.identification.plants.recording_errors import drive_with, is_of_recording, lateness_with, zero_with
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.identification.plants.valve_sensors import FIT_TOLERANCE, prepared
from valve_sim.model import Drive
from valve_sim.model.sensitivities import Tangent, has_sensitivities, numbers_of, rated_slope, run_tangents
from valve_sim.model.simulation import rated_current
from valve_sim.traces import Trace


class _Recording(NamedTuple):
    """What a recording adds to a run: commands, how late samples are stamped, and a sensor's zero."""

    drive: Drive
    lateness: float
    zero: float


def sensitivities(
    model: ValveModel, traces: Sequence[Trace], values: Mapping[str, float], directions: Sequence[Direction]
) -> Sensitivities:
    """Derivatives of the channels of all traces.

    Args:
        model: the valve. traces: its recordings.
        values: as of a plant's `predict`. directions: along which to differentiate.

    Raises:
        SimulationError: the simulation could not be carried to its end.
    """
    record = model.record(values)
    numbers = numbers_of(record)
    moved = [_moved(values, direction) for direction in directions]
    slopes = [
        (numbers_of(model.record(there)) - numbers) / direction.step
        if not all(is_of_recording(name) for name in direction.slopes)
        else np.zeros(len(numbers))
        for direction, there in zip(directions, moved, strict=True)
    ]
    known = np.array([has_sensitivities(record, slope) for slope in slopes])
    columns: list[Array] = []
    if not known.any():
        return Sensitivities([np.empty((0, len(directions)))], known)
    for index, trace in enumerate(traces):
        at = _recording(trace, index, values)
        recordings = [
            _recording(trace, index, there) if any(is_of_recording(name) for name in direction.slopes) else at
            for direction, there in zip(directions, moved, strict=True)
        ]
        tangents = [
            _tangent(at, there, slope, direction.step)
            for there, slope, direction in zip(recordings, slopes, directions, strict=True)
        ]
        state, samples = prepared(trace, at.drive, at.lateness)
        positions, currents = run_tangents(record, state, at.drive, samples, tangents, FIT_TOLERANCE)
        zeros = [(there.zero - at.zero) / way.step for there, way in zip(recordings, directions, strict=True)]
        if any(zeros):
            positions += zeros
        columns.append(positions)
        if trace.coil_current is not None:
            rated = [rated_slope(record, slope) for slope in slopes]
            columns.append(rated_current(record) * currents + np.outer(samples.currents, rated))
    return Sensitivities(columns, known)


def _moved(values: Mapping[str, float], direction: Direction) -> dict[str, float]:
    """The values a step further along a direction."""
    there = dict(values)
    for name, slope in direction.slopes.items():
        there[name] = there.get(name, 0.0) + direction.step * slope
    return there


def _recording(trace: Trace, index: int, values: Mapping[str, float]) -> _Recording:
    return _Recording(drive_with(trace, index, values), lateness_with(index, values), zero_with(index, values))


def _tangent(at: _Recording, there: _Recording, numbers: Array, step: float) -> Tangent:
    times = (there.drive.times - at.drive.times) / step
    volts = (there.drive.volts - at.drive.volts) / step
    return Tangent(numbers, times, volts, -(there.lateness - at.lateness) / step)
