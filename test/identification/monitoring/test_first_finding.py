"""What is said first of a valve that changes: the change, or nothing; and nothing of a delay that is no fault."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from identification.live_strokes import LiveValve, feed
from identification.one_thread import Monitor
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import Verdict
from valve_sim.identification.monitoring.agreement import Agreement
from valve_sim.identification.monitoring.command_timing import StrokeTiming
from valve_sim.identification.monitoring.cusum import likeliest_change
from valve_sim.identification.monitoring.fault_isolation import FaultFinding, isolate_fault
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.shared_delay import SharedDelay
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport

HEALTHY = {"pilot_damping": 1.3, "main_damping": 3.5}
COMMISSIONING = 10
JITTER = 50e-6
SHIFT = 0.55e-3
"""s, by which samples and commands without stamps shift against each other as the load of a machine changes."""
FRICTION = {"coulomb_friction": {"force": 0.3}}


class Watched:
    """A valve and its monitor, commissioned."""

    def __init__(self, seed: int) -> None:
        settings = MonitorSettings(commissioning_strokes=COMMISSIONING)
        self.monitor = Monitor(default_valve().exact(), settings, refit=False)
        self.valve = LiveValve(seed, HEALTHY, rate=1e3, levels=(9.0, 12.0), jitter=JITTER)
        self.strokes(COMMISSIONING + 4)

    def strokes(self, count: int, effects: Mapping[str, Mapping[str, float]] | None = None) -> list[StrokeReport]:
        return [report for _ in range(count) for report in feed(self.monitor, self.valve.stroke(effects))]


def test_a_delay_that_strokes_share_is_no_alarm_and_a_fault_beside_it_is() -> None:
    watched = Watched(11)
    shared = watched.monitor.stroke_monitor
    for offset in (-SHIFT, 0.0, SHIFT):
        watched.valve.offset = offset
        watched.strokes(6)
        assert shared.shared_delay == pytest.approx(offset, abs=2.0 * JITTER)
        assert shared.alarms == 0
    watched.strokes(6, FRICTION)
    assert shared.alarms > 0


def test_the_strokes_of_a_fault_are_isolated_without_those_before_it() -> None:
    watched = Watched(12)
    first = watched.monitor.segmenter.strokes
    sizes = []
    for number in range(14):
        watched.strokes(1, FRICTION)
        if evidence := watched.monitor.stroke_monitor.take_evidence():
            sizes.append(len(evidence))
            assert len(evidence) <= number + 1, f"strokes since {first} alone"
    assert sizes[:2] == [6, 8]


def test_the_likeliest_change_of_random_scores_is_within_a_stroke_of_the_true_one() -> None:
    random, misses = np.random.default_rng(5), 0
    for _ in range(200):
        healthy, changed = random.normal(0.0, 1.0, 5), random.normal(5.0, 1.0, 6)
        misses += abs(likeliest_change([*healthy.tolist(), *changed.tolist()]) - 5) > 1
    assert misses < 4


def found(kind: str, *effects: str, alike: Mapping[str, tuple[str, ...]] | None = None) -> FaultFinding:
    return FaultFinding(Verdict(kind, effects, alike or {}, 0.95, 0.01, 0.9, 8), {}, {}, {}, 8)


def test_nothing_is_said_before_two_windows_agree_and_what_was_said_is_corrected() -> None:
    said = Agreement()
    assert said.add(found("unknown", "squeeze_film")) is None
    friction = found("effects", "coulomb_friction", alike={"coulomb_friction": ("stiction",)})
    assert said.add(friction) is None
    stiction = found("effects", "stiction", alike={"stiction": ("coulomb_friction",)})
    assert said.add(stiction) is stiction, "a look-alike of what was found before"
    coil = found("effects", "drive_gain")
    assert said.add(coil) is None and said.said is stiction
    assert said.add(coil) is coil and said.said is coil
    said.forget()
    assert said.add(coil) is None and said.said is None


def test_a_shared_delay_is_of_both_commands_of_strokes_in_a_row_and_none_where_the_coil_is_heard() -> None:
    def late(opening: float, closing: float) -> StrokeTiming:
        return StrokeTiming(9.0, (opening, closing), np.nan)

    healthy = [late(0.1e-3, -0.1e-3)] * 8
    shared = SharedDelay(JITTER, healthy)
    assert [shared.add(late(0.7e-3, 0.5e-3), is_dated=False) for _ in range(2)] == [0.0, pytest.approx(0.6e-3)]
    assert shared.add(late(0.1e-3, -0.1e-3), is_dated=False) == 0.0, "as commissioned again"
    for opening, closing, is_dated in ((0.7e-3, 0.0, False), (0.7e-3, 0.5e-3, True)):
        shared = SharedDelay(JITTER, healthy)
        assert [shared.add(late(opening, closing), is_dated=is_dated) for _ in range(4)] == [0.0] * 4


@pytest.mark.long
@pytest.mark.parametrize("seed", [21, 22, 23])
def test_the_first_finding_after_friction_appears_is_friction_or_none(seed: int) -> None:
    """Beside the fault, samples and commands shift against each other, as on a machine whose load changes."""
    watched, said = Watched(seed), Agreement()
    watched.strokes(seed % 3)
    watched.valve.offset = SHIFT
    for _ in range(14):
        watched.strokes(1, FRICTION)
        monitor = watched.monitor.stroke_monitor
        if (evidence := monitor.take_evidence()) and said.add(isolate_fault(evidence, monitor.with_present_scatter())):
            break
    assert said.said is not None
    assert said.said.verdict.kind == "effects"
    assert "coulomb_friction" in {*said.said.verdict.effects, *said.said.verdict.confusable_with}
