"""A stroke live is a stroke in a recording: the segmenter cuts commands as they come in where `stroke_starts` does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.findings import StrokeRecord
from valve_sim.identification.monitoring.segmenter import StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.model import Drive, simulate
from valve_sim.recordings import command_strokes, stroke_starts

EXACT_VALVE = default_valve().exact()

Commands = Sequence[tuple[float, float]]
VALVE = EXACT_VALVE
NEXT = 0.2
"""s after the last command, at which another stroke begins and ends the one before, which may still be closing."""

COMMANDS = st.lists(
    st.tuples(
        st.integers(min_value=0, max_value=120).map(lambda milliseconds: 1e-3 * milliseconds),
        st.sampled_from([0.0, 0.0, -0.0, 9.0, 9.0, 12.0, -9.0, 2.0]),
    ),
    min_size=1,
    max_size=12,
)
"""Each so many seconds after the one before: repeats, holds, reversals, rests long enough to end a stroke or not."""


def absolute(commands: Commands) -> list[tuple[float, float]]:
    times = np.cumsum([after for after, _ in commands])
    return [(float(time), volts) for time, (_, volts) in zip(times, commands, strict=True)]


def cut_live(commands: Commands, late: float) -> list[StrokeRecord]:
    """The strokes that come out when commands arrive `late`, s, among samples of a resting sensor."""
    segmenter = StrokeSegmenter(VALVE, MonitorSettings(stroke_timeout=100.0))
    end = commands[-1][0]
    waiting = [*commands, (end, 0.0), (end + NEXT, 9.0)]
    for time in np.arange(0.0, end + NEXT + late + 2e-3, 1e-3).tolist():
        while waiting and waiting[0][0] + late <= time:
            segmenter.command(*waiting.pop(0))
        segmenter.measure(time, 0.0)
    return segmenter.take_finished()


def cut_recorded(commands: Commands) -> list[list[tuple[float, float]]]:
    """The commands of each stroke that change the voltage, as a recording of them is cut."""
    drive = Drive.of(*zip(*commands, strict=True))
    edges = [*stroke_starts(drive).tolist(), len(commands)]
    changes = np.diff(drive.volts, prepend=0.0) != 0.0
    return [
        [commands[index] for index in range(first, stop) if changes[index]] for first, stop in itertools.pairwise(edges)
    ]


@seed(0)
@settings(max_examples=60)
@given(commands=COMMANDS.map(absolute), late=st.sampled_from([0.0, 3e-3, 20e-3]))
def test_live_and_recorded_commands_are_cut_alike(commands: list[tuple[float, float]], late: float) -> None:
    records = cut_live(commands, late)
    expected = cut_recorded([*commands, (commands[-1][0], 0.0)])
    assert [record.number for record in records] == list(range(len(expected)))
    assert [record.time for record in records] == [stroke[0][0] for stroke in expected]
    for record, stroke in zip(records, expected, strict=True):
        start = record.time - float(record.trace.drive.times[0])
        times = (record.trace.drive.times + start).tolist()
        np.testing.assert_allclose(times, [time for time, _ in stroke], rtol=0.0, atol=1e-9)
        assert record.trace.drive.volts.tolist() == [volts for _, volts in stroke]


@seed(1)
@settings(max_examples=30)
@given(commands=COMMANDS.map(absolute))
def test_a_live_stroke_is_one_stroke_of_its_own_trace(commands: list[tuple[float, float]]) -> None:
    """Whoever cuts a live stroke again, as a recording, finds it whole: the trace of one holds no other's command."""
    for record in cut_live(commands, 0.0):
        assert stroke_starts(record.trace.drive).tolist() == [0]
        assert set(command_strokes(record.trace.drive)) == {(-np.inf, np.inf)}


@pytest.mark.parametrize("closed", [0.08, 0.4])
@pytest.mark.parametrize("by_current", [False, True])
def test_a_stroke_begins_with_its_rest_however_soon_it_follows(closed: float, *, by_current: bool) -> None:
    commands = [(0.1, 9.0), (0.2, 0.0), (0.2 + closed, 9.0), (0.3 + closed, 0.0)]
    times = np.arange(0.0, 0.8 + closed, 1e-3)
    shown = simulate(VALVE, Drive.of(*zip(*commands, strict=True)), times)
    segmenter = StrokeSegmenter(VALVE, MonitorSettings())
    if by_current:
        segmenter.go_by_current()
    for time, position, current in zip(times.tolist(), shown.pilot_position, shown.coil_current, strict=True):
        while commands and commands[0][0] <= time:
            segmenter.command(*commands.pop(0))
        if by_current:
            segmenter.measure_current(time, current)
        else:
            segmenter.measure(time, position)
    _, second = segmenter.take_finished()
    before = second.trace.sample_times < second.trace.drive.times[0]
    assert np.count_nonzero(before) > 20
    assert np.max(np.abs(second.trace.primary_samples.values[before])) < (1e-3 if by_current else 1e-5)
