"""Commands that come in when they can, beside a coil whose voltage says when the valve received them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np
import pytest

from identification.live_strokes import LiveStroke, LiveValve
from identification.one_thread import Monitor
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.findings import StrokeState
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.recordings import Signal
from valve_sim.recordings.command_times import within_steps

RATE = 500.0
"""Hz, of a station's valves."""
LATE = 2e-3
"""s, mean of the time after which a command is heard; no two are equally late."""
SETTINGS = MonitorSettings(commissioning_strokes=8, settle=10e-3)
"""A valve that rests open for longer than it settles: its samples are not kept then."""


class Busy:
    """A valve whose commands are heard late by a monitor that hears its coil, or does not."""

    def __init__(self, seed: int, *, hears_coil: bool, has_stamped_steps: bool = True) -> None:
        self._random = np.random.default_rng(seed)
        self._valve = LiveValve(seed, rate=RATE, levels=(9.0,), jitter=0.0)
        self._hears_coil, self._has_stamped_steps = hears_coil, has_stamped_steps
        self.monitor = Monitor(default_valve().exact(), SETTINGS, refit=False)

    def strokes(self, count: int, effects: Mapping[str, Mapping[str, float]] | None = None) -> list[StrokeReport]:
        """Reports of so many strokes, each with a rest behind it."""
        return [
            report
            for _ in range(count)
            for part in (self._valve.stroke(effects), self._valve.rest(0.05))
            for report in self._feed(part)
        ]

    def _feed(self, made: LiveStroke) -> Iterator[StrokeReport]:
        late = self._random.exponential(LATE, len(made.volts))
        heard = list(zip(made.command_times + late, made.volts, strict=True))
        steps = made.command_times.tolist()
        for time, position, current in zip(made.times, made.position, made.current, strict=True):
            while heard and heard[0][0] <= time:
                yield from self.monitor.command(*map(float, heard.pop(0)))
            while self._hears_coil and self._has_stamped_steps and steps and steps[0] <= time:
                at = steps.pop(0)
                for moment in (at - 1e-9, at):
                    yield from self.monitor.measure_current(moment, current, self._voltage(made, moment))
            if self._hears_coil:
                yield from self.monitor.measure_current(float(time), current, self._voltage(made, float(time)))
            yield from self.monitor.measure(float(time), float(position))

    @staticmethod
    def _voltage(made: LiveStroke, time: float) -> float:
        index = int(np.searchsorted(made.command_times, time, side="right")) - 1
        return 0.0 if index < 0 else float(made.volts[index])


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_voltage_that_is_heard_leaves_no_scatter_of_commands(seed: int) -> None:
    valve = Busy(seed, hears_coil=True)
    reports = valve.strokes(20)
    assert {report.state for report in reports[10:]} == {StrokeState.WATCHING}
    assert not any(report.alarm for report in reports)
    assert reports[-1].command_scatter < 0.1e-3
    assert reports[-1].rms == pytest.approx(1e-6, rel=0.3)


@pytest.mark.long
def test_without_it_delays_are_not_judged_and_voltages_at_samples_alone_are_better_than_nothing() -> None:
    deaf = Busy(1, hears_coil=False).strokes(20)[-1].command_scatter
    sampled = Busy(1, hears_coil=True, has_stamped_steps=False).strokes(20)[-1].command_scatter
    assert sampled < 0.5 * deaf


@pytest.mark.long
def test_what_a_busy_machine_hid_is_found() -> None:
    fault = {"coulomb_friction": {"force": 0.02}}
    for hears_coil in (True, False):
        valve = Busy(3, hears_coil=hears_coil)
        valve.strokes(10)
        assert any(report.alarm for report in valve.strokes(10, fault)) is hears_coil


TIMES = np.arange(0.0, 0.1, 2e-3)


def voltage(*steps: float, stamped: bool = False) -> Signal:
    """At each sample, and just before and after each step where they are stamped."""
    times = np.sort(
        np.concatenate([TIMES, [] if not stamped else np.array([[step - 1e-9, step] for step in steps]).ravel()])
    )
    return Signal(times, np.where((times >= steps[0]) & (times < steps[-1]), 9.0, 0.0))


@pytest.mark.parametrize(("late", "expected"), [(0.5e-3, 0.5e-3), (9e-3, 1e-3), (-4e-3, -1e-3), (0.0, 0.0)])
def test_a_command_is_no_earlier_and_no_later_than_its_samples_allow(late: float, expected: float) -> None:
    truth = np.array([0.021, 0.061])
    found = within_steps(truth + late, np.array([9.0, 0.0]), voltage(*truth))
    assert found is not None
    assert found - truth == pytest.approx([expected] * 2, abs=1e-12)
    exact = within_steps(truth + late, np.array([9.0, 0.0]), voltage(*truth, stamped=True))
    assert exact == pytest.approx(truth, abs=1.1e-9)


def test_a_voltage_that_lacks_a_step_dates_none() -> None:
    assert within_steps(np.array([0.02, 0.06]), np.array([9.0, 0.0]), voltage(0.021, math.inf)) is None
