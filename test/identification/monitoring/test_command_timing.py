"""A monitor on a busy machine: commands come in when they can, and no healthy valve is accused of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from identification.live_strokes import LiveValve, feed
from identification.one_thread import Monitor
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.command_timing import (
    CommandScatter,
    StrokeTiming,
)
from valve_sim.identification.monitoring.fault_isolation import isolate_fault
from valve_sim.identification.monitoring.findings import (
    DidNotClose,
    DidNotOpen,
    StrokeRecord,
    StrokeState,
    TimingTooUncertain,
)
from valve_sim.identification.monitoring.segmenter import CONFIRMED, StrokeSegmenter
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.identification.reporting.monitor_messages import finding_words, remark_words

EXACT_VALVE = default_valve().exact()

HEALTHY = {"pilot_damping": 1.3, "main_damping": 3.5}
COMMISSIONING = 10
QUIET, BUSY = 0.05e-3, 5e-3
"""s: by how much commands come in here sooner or later than the valve obeys them."""
STICTION = {"stiction": {"force": 0.5, "breakaway": 0.0, "stribeck_velocity": 0.02}}


def watched(
    scatter: float, count: int, effects: Mapping[str, Mapping[str, float]] | None = None, commissioned: float = QUIET
) -> tuple[Monitor, list[StrokeReport]]:
    """A monitor commissioned with one scatter of commands, and its reports of `count` strokes with another."""
    monitor = Monitor(EXACT_VALVE, MonitorSettings(commissioning_strokes=COMMISSIONING), refit=False)
    valve = LiveValve(11, HEALTHY, rate=1e3, levels=(9.0, 12.0), jitter=commissioned)
    for _ in range(COMMISSIONING + 1):
        list(feed(monitor, valve.stroke()))
    valve.jitter = scatter
    return monitor, [report for _ in range(count) for report in feed(monitor, valve.stroke(effects))]


@pytest.mark.parametrize("commissioned", [QUIET, pytest.param(BUSY, marks=pytest.mark.long)])
def test_a_healthy_valve_on_a_busy_machine_is_not_accused(commissioned: float) -> None:
    monitor, reports = watched(BUSY, 20, commissioned=commissioned)
    assert len(reports) == 20
    assert monitor.stroke_monitor.alarms == 0
    assert not [report.record.fault for report in reports if report.record.fault]
    assert {report.state for report in reports[1:]} == {StrokeState.TIMING_UNCERTAIN}
    assert monitor.stroke_monitor.is_timing_uncertain
    assert reports[-1].command_scatter == pytest.approx(BUSY, rel=0.5)


@pytest.mark.long
def test_on_a_quiet_machine_delays_are_judged_and_a_fault_is_found_as_before() -> None:
    monitor, reports = watched(QUIET, 20)
    assert {report.state for report in reports} == {StrokeState.WATCHING}
    assert {"opening delay", "closing delay"} <= reports[-1].scores.keys()
    assert monitor.stroke_monitor.alarms == 0
    monitor, reports = watched(QUIET, 6, STICTION)
    assert next(report for report in reports if report.alarm).record.number < COMMISSIONING + 5


@pytest.mark.long
def test_what_changes_the_shape_of_a_stroke_is_found_on_a_busy_machine_too() -> None:
    monitor, reports = watched(BUSY, 12, STICTION)
    assert next(report for report in reports if report.alarm).record.number < COMMISSIONING + 6
    finding = isolate_fault(monitor.stroke_monitor.evidence(), monitor.stroke_monitor.with_present_scatter())
    assert {"coulomb_friction", "stiction", "asymmetric_friction"} & set(finding.verdict.effects), finding
    assert "0.5" in finding_words(finding) or "0.49" in finding_words(finding)


def timed(*shifts: float, volts: float = 9.0, arrival: float = math.nan) -> list[StrokeTiming]:
    return [StrokeTiming(volts, (shift, shift), arrival) for shift in shifts]


def test_a_lasting_delay_is_no_scatter_and_one_that_comes_and_goes_is() -> None:
    baseline = timed(*np.random.default_rng(1).normal(0.0, QUIET, 20).tolist())
    established, coming = CommandScatter(QUIET, baseline), CommandScatter(QUIET, baseline)
    for shift in [2e-3] * 10:
        established.add(timed(shift)[0])
    assert established.sigma == pytest.approx(QUIET, rel=0.5)
    # The first one after the change may have been chance.
    assert CommandScatter(QUIET, baseline).add(timed(2e-3)[0]) > 5 * QUIET
    for shift in [2e-3, 0.0] * 5:
        coming.add(timed(shift)[0])
    assert 0.4e-3 < coming.sigma < 3e-3


def test_a_lasting_delay_is_no_scatter_at_any_of_several_voltages() -> None:
    levels = (9.0, 12.0, 7.5, 14.0)
    random = np.random.default_rng(2)
    scatter = CommandScatter(QUIET, [timed(float(random.normal(0.0, QUIET)), volts=volts)[0] for volts in 5 * levels])
    sigmas = [scatter.add(timed(12 * QUIET, volts=volts)[0]) for volts in levels]
    # The first one may have been chance; the second one is as late, although its voltage has not been seen since.
    assert sigmas[0] > 2.0 * QUIET
    assert sigmas[1:] == [QUIET] * 3
    # Delays that come and go are scatter at several voltages, too.
    shifts = zip([0.0, 2e-3] * 4, 2 * levels, strict=True)
    coming = [scatter.add(timed(shift, volts=volts)[0]) for shift, volts in shifts]
    assert min(coming[1:]) > 4.0 * QUIET


def stuck(segmenter: StrokeSegmenter, begin: float, hold: float, position: float, late: float) -> StrokeRecord:
    """One stroke of a valve that stays where it is, each second sample late; its record."""
    commands = [(begin + 0.02, 9.0), (begin + 0.02 + hold, 0.0)]
    for index, time in enumerate(np.arange(begin, begin + 1.0, 1e-3).tolist()):
        while commands and commands[0][0] <= time:
            segmenter.command(*commands.pop(0))
        segmenter.measure(time, position, time + late * (index % 2))
    (record,) = segmenter.take_finished()
    return record


@pytest.mark.parametrize("late", [0.0, 0.1])
def test_a_short_stroke_is_believed_on_a_quiet_machine_and_on_a_busy_one_when_it_comes_again(late: float) -> None:
    segmenter = StrokeSegmenter(EXACT_VALVE, MonitorSettings())
    records = [stuck(segmenter, float(number), 0.05, 0.0, late) for number in range(CONFIRMED)]
    said = [bool(record.fault) for record in records]
    assert said == ([True] * CONFIRMED if late == 0.0 else [False] * (CONFIRMED - 1) + [True])
    assert late == 0.0 or all(isinstance(record.remark, TimingTooUncertain) for record in records[:-1])
    assert isinstance(segmenter.fault, DidNotOpen)


@pytest.mark.parametrize(("late", "is_said"), [(0.0, True), (0.3, False)])
def test_a_valve_that_closes_late_is_in_time_where_samples_are_as_late(late: float, is_said: bool) -> None:
    segmenter = StrokeSegmenter(EXACT_VALVE, MonitorSettings())
    segmenter.command(0.1, 9.0)
    for index, time in enumerate(np.arange(0.0, 1.0, 1e-3).tolist()):
        if index == 500:
            segmenter.command(time, 0.0)
        segmenter.measure(time, 1.23e-3 if 0.11 < time < 0.75 else 0.0, time + late * (index % 2))
        if segmenter.fault:
            break
    assert isinstance(segmenter.fault, DidNotClose) == bool(segmenter.fault) == is_said


def test_a_valve_that_obeys_before_its_command_comes_in_is_judged_from_its_rest_on() -> None:
    valve = LiveValve(3, HEALTHY, rate=2e3, levels=(9.0,), jitter=0.0)
    monitor = Monitor(EXACT_VALVE, refit=False)
    for _ in range(3):
        made = valve.stroke()
        reports = list(feed(monitor, made._replace(command_times=made.command_times + 0.008)))
    (report,) = reports
    assert not report.remark
    trace = report.record.trace
    assert trace.pilot_position[0] < 10e-6
    assert trace.drive.times[0] - trace.times[0] > 0.008
    assert trace.pilot_position[-1] < 10e-6


def test_a_valve_that_is_told_to_close_when_it_has_hardly_begun_to_open_is_not_judged() -> None:
    """Both commands were held up, the first one by more: the valve may or may not reach its stop."""
    monitor = Monitor(EXACT_VALVE, MonitorSettings(commissioning_strokes=8), refit=False)
    valve = LiveValve(11, rate=2e3, levels=(9.0,), jitter=1e-3)
    made = valve.stroke(open_seconds=0.014)
    list(feed(monitor, made._replace(command_times=made.command_times - np.array([0.016, 0.0]))))
    (first,) = list(feed(monitor, valve.stroke()))
    assert first.state is StrokeState.NOT_JUDGED
    for _ in range(9):
        list(feed(monitor, valve.stroke()))
    valve.jitter = 0.0
    reports = []
    for early in (0.0, 0.016, 0.016, 0.0):
        made = valve.stroke(open_seconds=0.03 - early)
        heard = made._replace(command_times=made.command_times - np.array([early, 0.0]))
        reports += list(feed(monitor, heard))
    together = [report for report in reports if report.remark]
    assert [report.state for report in together] == [StrokeState.NOT_JUDGED] * 2
    assert all(remark_words(report.remark).startswith("timing too uncertain") for report in together)
    assert not any(report.record.fault for report in reports)
    assert monitor.stroke_monitor.alarms == 0
