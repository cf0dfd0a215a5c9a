"""Strokes of which a busy machine loses or delays messages, made by hand: they are not judged, and raise no alarm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from identification.live_strokes import LiveStroke, LiveValve

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.commissioning import Commissioning
from valve_sim.identification.monitoring.findings import StrokeState, Unusable
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor, StrokeReport
from valve_sim.nodes.live_monitor import LiveMonitor
from valve_sim.nodes.realtime import NANOSECONDS

START = 1_800_000_000 * NANOSECONDS
SETTINGS = MonitorSettings(commissioning_strokes=8, noise=1e-6)
RATE = 493.0
"""Hz: no command comes with a sample."""
OPENING, CLOSING = 0, 1
AT_OPENING = (2e-3, 12e-3)
"""s after the command: the valve opens within."""


@dataclass(frozen=True)
class Loss:
    """What of a stroke is lost or late.

    Attributes:
        commands: that are lost. samples, coil: s after the opening command, from when until when they are lost.
        late: s by which commands, and samples on their way, are late. batch: s of samples that come in together.
    """

    commands: tuple[int, ...] = ()
    samples: tuple[float, float] = (0.0, 0.0)
    coil: tuple[float, float] = (0.0, 0.0)
    late: float = 0.0
    batch: float = 0.0


NOTHING = Loss()


class Machine:
    """A valve, and a monitor that hears it."""

    def __init__(self, seed: int, *, hears_coil: bool, commissioning: Commissioning | None = None) -> None:
        self._valve = LiveValve(seed, rate=RATE, levels=(9.0,), jitter=0.0)
        self._random, self._hears_coil = np.random.default_rng(seed), hears_coil
        valve = default_valve().exact()
        self.strokes, self.reports = StrokeMonitor(valve, SETTINGS), list[StrokeReport]()
        if commissioning is not None:
            self.strokes.use(commissioning)
        self._live = LiveMonitor(
            valve, SETTINGS, self.strokes, by_current=False, follow=lambda stamp, prediction: None,
            finished=lambda record: self.reports.append(self.strokes.assess(record, refit=False)),
            warn=lambda words, is_frequent: None,
        )  # fmt: skip

    def stroke(self, loss: Loss = NOTHING, effects: Mapping[str, Mapping[str, float]] | None = None) -> None:
        """A stroke and a rest, of which this is lost."""
        made, rest = self._valve.stroke(effects), self._valve.rest(0.1)
        begin = float(made.command_times[0])
        heard = [
            (time + loss.late + self._random.exponential(0.2e-3), 0, volts)
            for index, (time, volts) in enumerate(zip(made.command_times, made.volts, strict=True))
            if index not in loss.commands
        ]
        for time, position in zip([*made.times, *rest.times], [*made.position, *rest.position], strict=True):
            if not loss.samples[0] <= time - begin < loss.samples[1]:
                heard.append((time, 2, position))
        steps = [moment for time in made.command_times for moment in (time - 1e-9, time)] if self._hears_coil else []
        for time in sorted([*steps, *(made.times if self._hears_coil else ())]):
            if not loss.coil[0] <= time - begin < loss.coil[1]:
                heard.append((time, 1, self._voltage(made, time)))
        for time, kind, value in sorted(heard):
            stamp = START + round(time * NANOSECONDS)
            sent = (math.floor(time / loss.batch) + 1.0) * loss.batch if loss.batch else time
            received = START + round((sent + loss.late + 0.2e-3) * NANOSECONDS)
            if kind == 0:
                self._live.command("/v", stamp, float(value))
            elif kind == 1:
                self._live.coil("/c", stamp, 0.0, float(value), received)
            else:
                self._live.position("/p", stamp, float(value), received)

    @staticmethod
    def _voltage(made: LiveStroke, time: float) -> float:
        index = int(np.searchsorted(made.command_times, time, side="right")) - 1
        return 0.0 if index < 0 else float(made.volts[index])


@pytest.fixture(scope="module", params=[True, False], ids=["with coil", "without"])
def commissioned(request: pytest.FixtureRequest) -> tuple[bool, Commissioning]:
    """Whether the coil is heard, and what commissioning has found."""
    machine = Machine(1, hears_coil=request.param)
    while machine.strokes.commissioning is None:
        machine.stroke()
    return request.param, machine.strokes.commissioning


LOSSES = {
    "closing": (Loss((CLOSING,)), {Unusable.COMMANDS_UNSEEN, Unusable.UNCOMMANDED}),
    "opening": (Loss((OPENING,)), {Unusable.COMMANDS_UNSEEN, Unusable.UNCOMMANDED}),
    "samples": (Loss(samples=AT_OPENING), {Unusable.SAMPLES_MISSING}),
    "a sample": (Loss(samples=(6e-3, 8e-3)), set[Unusable]()),
    "coil": (Loss(coil=(-math.inf, math.inf), late=5e-3), {Unusable.COMMANDS_UNSEEN}),
    "a step": (Loss(coil=(-8e-3, 6e-3), late=5e-3), {Unusable.COMMANDS_UNSEEN}),
    "all late": (Loss(late=0.2), {Unusable.UNCOMMANDED, Unusable.HEARD_LATE, Unusable.COMMANDS_UNSEEN}),
}


@pytest.mark.parametrize("name", LOSSES)
def test_a_stroke_whose_messages_are_lost_or_late_is_not_judged(
    commissioned: tuple[bool, Commissioning], name: str
) -> None:
    (hears_coil, commissioning), (loss, expected) = commissioned, LOSSES[name]
    if loss.coil[1] and not hears_coil:
        pytest.skip("there is no coil to be lost")
    machine = Machine(2, hears_coil=hears_coil, commissioning=commissioning)
    for index in range(15):
        machine.stroke(loss if index % 3 == 2 else NOTHING)
    remarks = [report.remark for report in machine.reports]
    assert machine.strokes.alarms == 0
    assert not any(report.record.fault for report in machine.reports)
    assert {remark for remark in remarks if remark not in (None, Unusable.NOT_AT_REST)} <= expected
    assert all(report.is_incomplete for report in machine.reports if report.remark in expected)
    assert sum(remark is not None for remark in remarks) >= (4 if expected else 0)
    judged = [report.state for report in machine.reports if report.remark is None]
    assert len(judged) >= 4
    assert StrokeState.WATCHING in judged


def test_a_fault_is_found_all_the_same(commissioned: tuple[bool, Commissioning]) -> None:
    hears_coil, commissioning = commissioned
    machine = Machine(3, hears_coil=hears_coil, commissioning=commissioning)
    for index in range(12):
        machine.stroke(Loss((CLOSING,)) if index % 3 == 2 else NOTHING, {"coulomb_friction": {"force": 0.3}})
    assert machine.strokes.alarms


def test_a_valve_that_drops_out_again_and_again_is_an_alarm_where_messages_come_in_time(
    commissioned: tuple[bool, Commissioning],
) -> None:
    hears_coil, commissioning = commissioned
    if hears_coil:
        pytest.skip("its voltage would show why")
    machine = Machine(4, hears_coil=hears_coil, commissioning=commissioning)
    for _ in range(8):
        machine.stroke(Loss((CLOSING,)))  # nobody has said so: it closed by itself
        machine.stroke(Loss((OPENING,)))
    assert machine.strokes.alarms
    first = next(index for index, report in enumerate(machine.reports) if report.alarm)
    assert [report.remark for report in machine.reports[:first]].count(Unusable.UNCOMMANDED) == 4


@pytest.mark.parametrize("batch", [0.0, 0.15])
def test_commissioning_leaves_out_strokes_that_came_late_and_not_those_of_a_driver_that_sends_batches(
    batch: float,
) -> None:
    machine = Machine(5, hears_coil=False)
    for index in range(12):
        machine.stroke(Loss(batch=0.6 if index in (4, 5) else batch))
    assert Unusable.HEARD_LATE in [report.remark for report in machine.reports]
    assert [report.state for report in machine.reports].count(StrokeState.COMMISSIONING) == 8
    assert machine.strokes.commissioning is not None
    assert machine.strokes.command_scatter < 1e-3
