"""The monitor's core by stamps, without ROS: strokes with their times, and what is rejected or begins anew."""

from __future__ import annotations

import math
from typing import Any

import pytest
from identification.live_strokes import LiveValve

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.findings import StrokeRecord
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeMonitor
from valve_sim.nodes.live_monitor import LiveMonitor
from valve_sim.nodes.realtime import NANOSECONDS

START = 1_800_000_000 * NANOSECONDS


class Heard:
    """A monitor, and what it hands on."""

    def __init__(self, *, by_current: bool = False) -> None:
        self.stamps, self.strokes, self.told = list[int](), list[StrokeRecord](), list[tuple[str, bool]]()
        self.made = LiveValve(seed=3, rate=1e3, jitter=0.0)
        valve, settings = default_valve(), MonitorSettings()
        self.live = LiveMonitor(
            valve, settings, StrokeMonitor(valve, settings), by_current=by_current,
            follow=lambda stamp, prediction: self.stamps.append(stamp), finished=self.strokes.append,
            warn=lambda *words: self.told.append(words),
        )  # fmt: skip

    def stroke(self, shift: float = 0.0) -> int:
        """One stroke, all stamps later by `shift`, s; the stamp of its opening command."""
        made = self.made.stroke()
        at = [(time, "command", volts) for time, volts in zip(made.command_times, made.volts, strict=True)]
        at += [(time, "position", position) for time, position in zip(made.times, made.position, strict=True)]
        for time, kind, value in sorted(at):
            stamp = self.stamp(time + shift)
            if kind == "command":
                self.live.command("/v", stamp, float(value))
            else:
                self.live.position("/s", stamp, float(value), 0)
        return self.stamp(float(made.command_times[0]) + shift)

    @staticmethod
    def stamp(seconds: float) -> int:
        return START + round(seconds * NANOSECONDS)


def test_each_stroke_is_handed_on_with_the_stamp_of_its_command_and_each_sample_with_its_own() -> None:
    heard = Heard()
    commands = [heard.stroke() for _ in range(3)]
    assert [stroke.stamp for stroke in heard.strokes] == pytest.approx(commands[:2], abs=2)
    assert all(stroke.opened and stroke.closed for stroke in heard.strokes)
    assert len(heard.stamps) == heard.live.input.samples and heard.stamps == sorted(heard.stamps)
    assert heard.live.input.commands == 6


@pytest.mark.parametrize("shift", [-3600.0, 3600.0])
def test_stamps_that_jump_begin_anew_with_the_valve_at_rest(shift: float) -> None:
    heard = Heard()
    heard.stroke()
    heard.stroke()
    command = heard.stroke(shift)
    heard.stroke(shift)
    ((words, is_frequent),) = heard.told
    assert words.startswith(f"the stamps jumped by {'-' if shift < 0.0 else '3'}") and is_frequent
    assert heard.strokes[-1].stamp == pytest.approx(command, abs=2)
    assert heard.live.input.rejected == 0


def test_what_cannot_be_is_rejected_with_its_topic() -> None:
    heard = Heard()
    live: Any = heard.live
    live.position("/s", START, 0.0, 0)
    for position, stamp in ((1.2, START + 1), (math.nan, START + 2), (0.0, START - 1)):
        live.position("/s", stamp, position, 0)
    live.command("/v", START, math.inf)
    assert (live.input.samples, live.input.rejected, live.input.commands) == (1, 4, 0)
    assert live.input.status(1.0, 0, "").message.startswith("4 rejected, the last: /v: inf V")


def test_by_the_current_alone_each_sample_of_the_coil_is_followed() -> None:
    heard = Heard(by_current=True)
    heard.live.coil("/c", START, 0.0, 0.0, 0)
    assert heard.stamps == [START] and not heard.told
