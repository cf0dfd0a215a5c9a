"""The pressure from which the model of a stroke starts: as it was heard, or else as the model has it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.identification.monitoring.findings import StrokeRecord, Unusable
from valve_sim.identification.monitoring.line_pressure import LONGEST, LinePressure
from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive, Stepper, Valve
from valve_sim.recordings import Trace

COMMAND = 0.5
"""s after a trace's beginning."""
STROKE = Trace("a stroke", Drive.of([COMMAND, 0.6], [9.0, 0.0]), np.array([0.0, 1.0]), np.zeros(2))
TANK = load_valve(config_path("gas_tank_2.yaml"))
STEP = 2e-3
"""s between samples."""


def start(line: LinePressure, opening: float) -> float | None:
    """The pressure at the beginning of the stroke whose first command was then."""
    return line.before(STROKE, opening).outlet_start


def test_what_was_heard_goes_before_what_the_model_has() -> None:
    line = LinePressure()
    for time in (0.0, 1.0):
        line.note(time, 1e5)
        line.hear(time, 2e6 + 1e6 * time)
    line.keep(1.0)
    assert start(line, 0.25 + COMMAND) == pytest.approx(2.25e6, rel=1e-12)


def test_the_model_stands_in_for_a_sensor_that_is_missing_or_silent() -> None:
    line = LinePressure()
    assert start(line, 1.0) is None
    line.hear(0.0, 5e6)
    line.note(0.0, 1e5)
    line.note(LONGEST + 0.1, 3e5)
    line.keep(COMMAND)
    assert start(line, LONGEST + 0.1 + COMMAND) == 3e5


@pytest.mark.parametrize("sample", [(math.nan, 6e6), (0.2, math.nan), (0.2, math.inf), (0.1, 6e6), (-1.0, 6e6)])
def test_what_cannot_be_used_is_left_out(sample: tuple[float, float]) -> None:
    line = LinePressure()
    line.hear(0.1, 5e6)
    line.hear(*sample)
    line.keep(COMMAND)
    assert start(line, 0.2 + COMMAND) == 5e6


def strokes_of(valve: Valve, openings: Sequence[float], *, is_heard: bool = True) -> list[StrokeRecord]:
    """Strokes as the monitor of the second tank's valve cuts them out; the pressure is heard at 100 Hz, or not."""
    plant, segmenter = Stepper(valve), StrokeSegmenter(TANK, MonitorSettings())
    commands = [command for opening in openings for command in ((opening, 9.0), (opening + 0.15, 0.0))]
    for index in range(1, round((openings[-1] + 0.3) / STEP)):
        time = index * STEP
        while commands and commands[0][0] < time:
            plant.command(*commands[0])
            segmenter.command(*commands.pop(0))
        reading = plant.advance(time)
        if is_heard and index % 5 == 0:
            segmenter.line.hear(time, reading.outlet_pressure)
        segmenter.measure(time, reading.pilot_position)
    return segmenter.take_finished()


def with_gas(**gas: float) -> Valve:
    """The second tank's valve with other numbers of gas."""
    assert TANK.gas is not None
    return replace(TANK, gas=TANK.gas._replace(**gas))  # type: ignore[arg-type]


def test_a_stroke_begins_at_the_measured_pressure_and_the_model_then_explains_it() -> None:
    for stroke in strokes_of(with_gas(outlet_pressure=25e6), (0.35, 0.65)):
        shown = ValvePlant([stroke.trace], TANK.exact()).predict({})[0]
        assert np.max(np.abs(shown - stroke.trace.pilot_position)) < 200e-6
        other = ValvePlant([replace(stroke.trace, outlet_start=None)], TANK.exact()).predict({})[0]
        assert np.max(np.abs(other - stroke.trace.pilot_position)) > 500e-6


def test_the_pressures_at_both_ends_are_known_to_the_model_and_to_the_stroke() -> None:
    """Of a valve whose tank and line are not as declared, and change when it opens: else it looks faulty."""
    gas = {"inlet_pressure": 25.5e6, "demand_pressure": 3e6}
    line = [(0.1 * index, 3e6 + 5e6 * min(0.1 * index, 0.6)) for index in range(8)]
    for is_heard in (True, False):
        plant, segmenter = Stepper(with_gas(**gas)), StrokeSegmenter(TANK, MonitorSettings())
        segmenter.line.hear(0.0, 14e6)
        if is_heard:
            segmenter.line.hear_end("inlet_pressure", 0.0, 25.5e6)
        due, commands = list(line), [(0.35, 9.0), (0.5, 0.0)]
        for index in range(1, 400):
            time = index * STEP
            while due and due[0][0] < time:
                plant.set_demand_pressure(*due[0])
                if is_heard:
                    segmenter.line.hear_end("demand_pressure", *due[0])
                due.pop(0)
            while commands and commands[0][0] < time:
                plant.command(*commands[0])
                segmenter.command(*commands.pop(0))
            reading = plant.advance(time)
            segmenter.line.hear(time, reading.outlet_pressure)
            prediction = segmenter.measure(time, reading.pilot_position)
        (stroke,) = segmenter.take_finished()
        assert prediction is not None
        shown = ValvePlant([stroke.trace], TANK.exact()).predict({})[0]
        furthest = float(np.max(np.abs(shown - stroke.trace.pilot_position)))
        if is_heard:
            assert furthest < 20e-6
            assert prediction.reading.outlet_pressure == pytest.approx(reading.outlet_pressure, rel=5e-3)
        else:
            assert furthest > 300e-6


@pytest.mark.parametrize(
    ("heard_from", "remark"), [(0.0, None), (0.2, Unusable.PRESSURE_UNKNOWN), (0.4, Unusable.PRESSURE_UNKNOWN)]
)
def test_a_stroke_before_which_the_line_was_not_heard_is_not_compared(
    heard_from: float, remark: Unusable | None
) -> None:
    """What is held before the first sample of a line's pressure that comes with the stroke, nobody knows."""
    plant, segmenter = Stepper(TANK), StrokeSegmenter(TANK, MonitorSettings())
    commands = [(0.35, 9.0), (0.5, 0.0)]
    for index in range(1, 400):
        time = index * STEP
        if index % 25 == 0 and time > heard_from:
            segmenter.line.hear_end("demand_pressure", time - STEP, 14e6 + 1e4 * index)
        if index == 1 and heard_from == 0.0:
            segmenter.line.hear_end("demand_pressure", 0.0, 14e6)
        while commands and commands[0][0] < time:
            plant.command(*commands[0])
            segmenter.command(*commands.pop(0))
        segmenter.measure(time, plant.advance(time).pilot_position)
    (stroke,) = segmenter.take_finished()
    assert stroke.remark is remark


def test_with_gas_a_stroke_that_began_before_the_first_sample_is_not_compared() -> None:
    plant, segmenter = Stepper(TANK), StrokeSegmenter(TANK, MonitorSettings())
    plant.command(0.0, 9.0)
    segmenter.command(0.0, 9.0)
    for index in range(1, 400):
        if index == 150:
            plant.command(0.3, 0.0)
            segmenter.command(0.3, 0.0)
        segmenter.measure(index * STEP, plant.advance(index * STEP).pilot_position)
    (stroke,) = segmenter.take_finished()
    assert stroke.remark is Unusable.PRESSURE_UNKNOWN
