"""monitor_node as a process, a real valve on topics: `python -m benchmarks.shadow --strokes 10000 --seeds 10`.

What `benchmarks.monitoring` measures of the monitor by itself, here with ROS between: the independent plant of
test/plants is published by this process on /clock, coil_voltage and measured/joint_states, in simulated time and as
fast as the monitor takes it. Dampings, noise of 1 µm and 20 commissioning strokes are each seed's own.

- Without fault, 500 Hz, commands' stamps off by 50 µs: warnings in all strokes, at most one in 1000.
- Coulomb friction that grows over 50 strokes to 7.5 mN, five detection limits, and stays, at 20 kHz: an alarm within 5
  strokes of that, the right name within 20, in nine of ten seeds. Residual over noise of the healthy strokes: within
  10 % of 1.
- Seconds by the wall are less than the simulated ones.

Exit code 1 where that falls short. Needs ROS 2.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.monitoring import ALARM_FORCE, COMMISSIONING, GROWING, STAYING, STROKE_SECONDS, say, valve_of
from valve_sim.identification.monitoring.settings import MonitorSettings

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from identification.live_strokes import LiveValve
from nodes.plant_on_topics import PlantOnTopics
from nodes.ros_process import Probe, running

SOON, NAMED_WITHIN = 5, STAYING
"""Strokes after the full force."""
SLOWEST = 500.0
"""Hz, of the healthy strokes: 40 samples each."""
ISOLATION_SECONDS = 180.0
"""By the wall, for fault isolation to end after the last stroke."""


class HealthyRun(NamedTuple):
    """Strokes that were watched, and alarms in them."""

    strokes: int
    alarms: int


class Growth(NamedTuple):
    """One seed of growing friction.

    Attributes:
        alarmed_after: strokes from having got to the full force until the first alarm; 0 before, None for never.
        named: effects of the last finding. ratio: residual over noise while healthy.
    """

    alarmed_after: int | None
    named: tuple[str, ...]
    ratio: float


class Beside:
    """A monitor beside a plant, and what it says."""

    def __init__(self, probe: Probe, valve: LiveValve) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self._probe = probe
        self.plant = PlantOnTopics(probe, valve)
        self._findings = probe.hear("/monitor/finding", DiagnosticArray, latched=True)
        self._diagnostics = probe.hear("/diagnostics", DiagnosticArray)
        self.reports: list[Any] = []
        self._made = 0

    def stroke(self, effects: Mapping[str, Mapping[str, float]] | None = None) -> None:
        """One stroke, and the report of the one before: a stroke is over when the next one begins."""
        self.plant.stroke(effects)
        self._made += 1
        assert self._probe.until(lambda: self.plant.told >= self._made - 1), "a stroke was not reported"
        self.reports += self.plant.take_reports()
        del self._diagnostics[:-1]

    def finding(self) -> tuple[str, ...]:
        """The effects of the last finding, once no isolation is under way."""
        del self._diagnostics[:]
        assert self._probe.until(self._says_idle, ISOLATION_SECONDS), "fault isolation does not end"
        if not self._findings:
            return ()
        values = {item.key: item.value for item in self._findings[-1].status[0].values}
        return tuple(values["effects"].split(", ")) if values["effects"] else ()

    def _says_idle(self) -> bool:
        statuses = [status for message in self._diagnostics[-1:] for status in message.status]
        return any(status.name == "monitor: fault isolation" and status.message == "idle" for status in statuses)


@contextmanager
def beside(valve: LiveValve, folder: Path) -> Iterator[Beside]:
    """A monitor in a process of its own, ready."""
    probe = Probe("/valve")
    names = ("measured:=measured/joint_states", "use_sim_time:=true", "max_rate:=1e5")
    arguments = ["--ros-args", *(word for name in names for word in ("-p", name))]
    try:
        with running(folder, arguments, "monitor_node"):
            made = Beside(probe, valve)
            made.plant.wait_for_monitor()
            yield made
    finally:
        probe.close()


def healthy(seed: int, strokes: int, folder: Path) -> HealthyRun:
    """One seed without fault."""
    valve = valve_of(seed, 50e-6, 0.7 * (seed % 2))
    valve.rate = SLOWEST
    with beside(valve, folder) as made:
        for _ in range(MonitorSettings().commissioning_strokes + strokes + 1):
            made.stroke()
            made.plant.forget()
        watched = [report for report in made.reports if report["state"] == "watching"]
        return HealthyRun(len(watched), sum(report["alarm"]["raised"] for report in watched))


def growth(seed: int, folder: Path) -> Growth:
    """One seed of friction that grows."""
    forces = [0.0] * COMMISSIONING
    forces += [ALARM_FORCE * (k + 1) / GROWING for k in range(GROWING)] + [ALARM_FORCE] * (NAMED_WITHIN + 1)
    with beside(valve_of(seed, 0.0), folder) as made:
        for force in forces:
            made.stroke({"coulomb_friction": {"force": force}} if force else None)
            made.plant.forget()
        named = made.finding()
    reached = COMMISSIONING + GROWING - 1
    raised = [r["stroke"] for r in made.reports if r["alarm"]["raised"] and r["stroke"] >= COMMISSIONING]
    before = [r for r in made.reports if r["state"] == "watching" and r["stroke"] < COMMISSIONING]
    ratio = float(np.mean([report["residual_rms_um"] / report["noise_um"] for report in before]))
    return Growth(max(0, raised[0] - reached) if raised else None, named, ratio)


def report_healthy(strokes: int, seeds: int, folder: Path) -> bool:
    """Print the healthy strokes; whether they are as wanted."""
    begin = time.perf_counter()
    rows = [healthy(seed, -(-strokes // seeds), folder) for seed in range(seeds)]
    took = time.perf_counter() - begin
    total, alarms = sum(row.strokes for row in rows), sum(row.alarms for row in rows)
    simulated = total * STROKE_SECONDS
    are_few, is_fast = alarms <= max(1.0, 1e-3 * total), took < simulated
    say(are_few, f"{alarms} warnings in {total} healthy strokes (at most {max(1.0, 1e-3 * total):g})")
    say(is_fast, f"{took:.0f} s by the wall for {simulated:.0f} s of strokes")
    return are_few and is_fast


def report_growth(seeds: int, folder: Path) -> bool:
    """Print the growing friction; whether it is as wanted."""
    rows = [growth(seed, folder) for seed in range(seeds)]
    after = [row.alarmed_after for row in rows]
    soon = sum(value is not None and value <= SOON for value in after)
    right = sum(row.named == ("coulomb_friction",) for row in rows)
    worst = max(abs(row.ratio - 1.0) for row in rows)
    wanted = 0.9 * seeds
    say(
        soon >= wanted,
        f"friction to {1e3 * ALARM_FORCE:g} mN: alarm within {SOON} strokes in {soon} of {seeds}: {after}",
    )
    say(right >= wanted, f"the right name within {NAMED_WITHIN} strokes in {right} of {seeds}")
    say(worst < 0.1, f"residual over noise: within {worst:.1%} of 1 in each seed (10 %)")
    return soon >= wanted and right >= wanted and worst < 0.1


def main() -> int:
    """Run and print; 1 if anything falls short."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strokes", type=int, default=10_000, help="healthy strokes in all; 0: none")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--no-growth", action="store_true", help="the healthy strokes only")
    chosen = parser.parse_args()
    import rclpy

    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    rclpy.init()
    with tempfile.TemporaryDirectory() as name:
        good = [report_healthy(chosen.strokes, chosen.seeds, Path(name))] if chosen.strokes else []
        good += [] if chosen.no_growth else [report_growth(chosen.seeds, Path(name))]
    rclpy.try_shutdown()
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
