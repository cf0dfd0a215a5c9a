"""A plant on topics in simulated time, and monitor_node as a process beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Final

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from identification.live_strokes import LiveValve
from nodes.plant_on_topics import PlantOnTopics
from nodes.ros_process import Probe

from benchmarks.monitoring.rigs import Healthy, drawn_valve
from benchmarks.nodes.driver import program, ros, running, values_of
from valve_sim.identification.monitoring.settings import MonitorSettings

SLOWEST: Final = 500.0
"""Hz, of the healthy strokes: 40 samples each."""
ISOLATION_SECONDS: Final = 180.0
"""By the wall, for fault isolation to end after the last stroke."""


class Beside:
    """A monitor beside a plant, and what it says."""

    def __init__(self, probe: Probe, valve: LiveValve) -> None:
        self._probe = probe
        self._plant = PlantOnTopics(probe, valve)
        self._findings = probe.hear("/monitor/finding", DiagnosticArray, latched=True)
        self._diagnostics = probe.hear("/diagnostics", DiagnosticArray)
        self.reports: list[Any] = []
        self._made = 0
        self._plant.wait_for_monitor()

    def stroke(self, effects: Mapping[str, Mapping[str, float]] | None = None) -> None:
        """One stroke, and the report of the one before: a stroke is over when the next one begins."""
        self._plant.stroke(effects)
        self._made += 1
        assert self._probe.until(lambda: self._plant.told >= self._made - 1), "a stroke was not reported"
        self.reports += self._plant.take_reports()
        self._plant.forget()
        del self._diagnostics[:-1]

    def finding(self) -> tuple[str, ...]:
        """The effects of the last finding, once no isolation is under way."""
        del self._diagnostics[:]
        assert self._probe.until(self._says_idle, ISOLATION_SECONDS), "fault isolation does not end"
        if not self._findings:
            return ()
        names = values_of(self._findings[-1].status[0])["effects"]
        return tuple(names.split(", ")) if names else ()

    def _says_idle(self) -> bool:
        statuses = [status for message in self._diagnostics[-1:] for status in message.status]
        return any(status.name == "monitor: fault isolation" and status.message == "idle" for status in statuses)


@contextmanager
def beside(valve: LiveValve) -> Iterator[Beside]:
    """A monitor in a process of its own, ready."""
    names = ("measured:=measured/joint_states", "use_sim_time:=true", "max_rate:=1e5")
    with ros():
        probe = Probe("/valve")
        try:
            with running({"monitor": program("monitor_node", *names)}):
                yield Beside(probe, valve)
        finally:
            probe.close()


def healthy_on_topics(seeds: Sequence[int], strokes: int) -> list[Healthy]:
    """Strokes without fault of each seed, after commissioning."""
    rows = []
    for seed in seeds:
        with beside(drawn_valve(seed, 50e-6, 0.7 * (seed % 2), rate=SLOWEST)) as made:
            for _ in range(MonitorSettings().commissioning_strokes + strokes + 1):
                made.stroke()
        watched = [report for report in made.reports if report["state"] == "watching"]
        rows.append(Healthy(len(watched), sum(report["alarm"]["raised"] for report in watched), 1.0, 0.0))
    return rows


def growth_on_topics(
    seeds: Sequence[int], forces: Sequence[float], since: int
) -> list[tuple[int | None, tuple[str, ...], float]]:
    """Of each seed of these frictions, N: first alarm from stroke `since` on, what is named, residual over noise."""
    rows = []
    for seed in seeds:
        with beside(drawn_valve(seed, 0.0)) as made:
            for force in forces:
                made.stroke({"coulomb_friction": {"force": force}} if force else None)
            named = made.finding()
        raised = [one["stroke"] for one in made.reports if one["alarm"]["raised"] and one["stroke"] >= since]
        before = [one for one in made.reports if one["state"] == "watching" and one["stroke"] < since]
        ratio = float(np.mean([one["residual_rms_um"] / one["noise_um"] for one in before]))
        rows.append((raised[0] if raised else None, named, ratio))
    return rows
