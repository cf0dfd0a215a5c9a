"""A monitor by the coil's current alone: `python -m benchmarks.sensorless.monitor --strokes 10000 --seeds 10`.

The plant of test/plants/coil_alone.py strokes at 7.5 to 14 V; its current is sampled at 5 kHz with 1 mA of noise, and
no position. Each seed has dampings, resistance, release and noise of its own; in every second one the voltage is
measured, and commands are stamped up to 3 ms late. `Monitor` stands beside it, faster than real time.

- Without fault: warnings in all strokes. Wanted: at most one in 1000.
- Coulomb friction that grows over 20 strokes to five detection limits and stays. Wanted: an alarm within 10 strokes of
  having got there, and its class named within 40, in 9 of 10 seeds. The detection limit is the friction whose change of
  the current in eight strokes stands out by 3.3 standard deviations when both dampings are refitted.

Needs no ROS.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from identification.test_current_alone import declared
from plants.coil_alone import Build, Course, simulate

from valve_sim.identification.monitoring.fault_isolation import FaultFinding, isolate_fault
from valve_sim.identification.monitoring.findings import StrokeState
from valve_sim.identification.monitoring.monitor import Monitor
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport

LEVELS: Final = (9.0, 12.0, 7.5, 14.0, 10.3, 8.4, 13.0, 11.2)
"""V, one stroke each, over and over."""
RATE, NOISE, VOLTAGE_NOISE = 5e3, 1e-3, 5e-3
"""Hz, A, V."""
COMMANDS: Final = np.array([0.020, 0.050])
PERIOD: Final = 0.100
LATEST: Final = 3e-3
"""s, all of them. At the end of a period no valve here has any current left: each stroke is simulated from rest."""
DETECTABLE: Final = 3.3
"""Standard deviations."""
LIMITS: Final = 5.0
"""Detection limits to which friction grows."""
COMMISSIONING, GROWING, STAYING = 25, 20, 40
"""Strokes: healthy ones first, of growth, and after it."""
ALARM_WITHIN: Final = 10


class Growth(NamedTuple):
    """One seed of growing friction.

    Attributes:
        force: N, at the end. alarmed_after: strokes from having got there until the alarm; 0 if it came before, None if
            never. names: what the last isolation named, or its kind; its class, and strokes until it. seconds: of a
            processor, of the longest isolation.
    """

    force: float
    alarmed_after: int | None
    names: str
    is_named: bool
    named_after: int | None
    seconds: float


def drawn(seed: int) -> Build:
    """A valve; without a droop of its supply, which only a measured voltage would show."""
    random = np.random.default_rng([seed, 20])
    resistance = float(random.uniform(6.0, 12.0))
    return Build(
        pilot_damping=float(random.uniform(0.5, 2.0)),
        main_damping=float(random.uniform(3.0, 6.0)),
        resistance=resistance,
        inductance=2.0e-3 * resistance,
        clamp_voltage=float(random.choice([0.0, 24.0])),
        eddy_resistance=50.0,
    )


@lru_cache(maxsize=64)
def course(build: Build, volts: float) -> Course:
    """One stroke of it, without noise."""
    return simulate(build, COMMANDS, np.array([volts, 0.0]), (np.arange(round(PERIOD * RATE)) + 0.37) / RATE)


def detection_limit(build: Build) -> float:
    """N of friction."""

    def currents(build: Build) -> np.ndarray:
        return np.concatenate([course(build, volts).current for volts in LEVELS])

    healthy, tangents = currents(build), []
    for name in ("pilot_damping", "main_damping"):
        value = getattr(build, name)
        ahead, behind = (currents(build._replace(**{name: factor * value})) for factor in (1.01, 0.99))
        tangents.append((ahead - behind) / (0.02 * value))
    base, _ = np.linalg.qr(np.column_stack(tangents))
    force = 2e-3
    for _ in range(4):
        change = currents(build._replace(friction=force)) - healthy
        force *= DETECTABLE * NOISE / float(np.linalg.norm(change - base @ (base.T @ change)))
    return force


class Coil:
    """Strokes one after another, handed to a monitor as they come."""

    def __init__(self, monitor: Monitor, seed: int) -> None:
        self._monitor = monitor
        self._has_voltage = seed % 2 == 0
        self._random = np.random.default_rng([seed, 21])
        self._strokes = 0

    def stroke(self, build: Build) -> list[StrokeReport]:
        """One stroke; reports of those that ended meanwhile."""
        volts, begin = LEVELS[self._strokes % len(LEVELS)], PERIOD * self._strokes
        shown, random = course(build, volts), self._random
        times = begin + shown.times
        current = shown.current + NOISE * random.standard_normal(len(times))
        voltage = shown.voltage + VOLTAGE_NOISE * random.standard_normal(len(times))
        received = begin + COMMANDS + self._has_voltage * LATEST * random.uniform(size=2)
        if not self._has_voltage:
            voltage[:] = math.nan
        edges = [0, *np.searchsorted(times, received), len(times)]
        reports = []
        for part, first in enumerate(edges[:-1]):
            if part:
                reports += self._monitor.command(float(received[part - 1]), (volts, 0.0)[part - 1])
            chosen = slice(first, edges[part + 1])
            reports += self._monitor.measure_currents(times[chosen], current[chosen], voltage[chosen])
        self._strokes += 1
        return reports

    def strokes(self, builds: Sequence[Build]) -> Iterator[StrokeReport]:
        """One of each."""
        for build in builds:
            yield from self.stroke(build)


def healthy(seed: int, strokes: int) -> tuple[int, int, float]:
    """Strokes watched, warnings among them, and s of a processor for a stroke."""
    build = drawn(seed)
    monitor = Monitor(declared(build), refit=False)
    coil = Coil(monitor, seed)
    [course(build, volts) for volts in LEVELS]
    watched, warnings, started = 0, 0, time.process_time()
    while watched < strokes:
        for report in coil.stroke(build):
            watched += report.state is StrokeState.WATCHING
            warnings += report.alarm is not None
            if report.alarm is not None:
                print(f"      seed {seed}, stroke {report.record.number}: {report.alarm.cause}", flush=True)
    return watched, warnings, (time.process_time() - started) / watched


def growth(seed: int) -> Growth:
    """One seed of friction that grows."""
    build = drawn(seed)
    monitor = Monitor(declared(build), refit=False)
    force = LIMITS * detection_limit(build)
    shares = [0.0] * COMMISSIONING + [(k + 1) / GROWING for k in range(GROWING)] + [1.0] * STAYING
    reached = COMMISSIONING + GROWING - 1
    alarmed: int | None = None
    last = Growth(force, None, "", False, None, 0.0)
    for report in Coil(monitor, seed).strokes([build._replace(friction=share * force) for share in shares]):
        number = report.record.number
        if report.alarm is not None and alarmed is None and number >= COMMISSIONING:
            alarmed = max(0, number - reached)
        evidence = monitor.stroke_monitor.take_evidence()
        if evidence and number >= reached:
            started = time.process_time()
            found = isolate_fault(evidence, monitor.stroke_monitor.with_present_scatter())
            seconds = max(last.seconds, time.process_time() - started)
            last = Growth(force, None, _words(found), _is_named(found), number - reached, seconds)
    return last._replace(alarmed_after=alarmed)


def _is_named(found: FaultFinding) -> bool:
    others = [name for names in found.verdict.confusable_with.values() for name in names]
    return found.verdict.kind == "effects" and "coulomb_friction" in {*found.verdict.effects, *others}


def _words(found: FaultFinding) -> str:
    return f"{found.verdict.kind} {' + '.join(found.verdict.effects)} {dict(found.verdict.confusable_with) or ''}"


def say(is_good: bool, words: str) -> bool:
    """A line that says whether a figure is as wanted."""
    print(f"{'ok   ' if is_good else 'SHORT'} {words}", flush=True)
    return is_good


def report_growth(seeds: Sequence[int]) -> bool:
    """Print the growing friction; whether it is as wanted."""
    rows = []
    for seed in seeds:
        rows.append(row := growth(seed))
        print(
            f"      seed {seed}: to {1e3 * row.force:.1f} mN, alarm after {row.alarmed_after}, {row.names.strip()} "
            f"after {row.named_after}, {row.seconds:.0f} s of a processor",
            flush=True,
        )
    soon = sum(row.alarmed_after is not None and row.alarmed_after <= ALARM_WITHIN for row in rows)
    named = sum(row.is_named for row in rows)
    return all([
        say(soon >= 0.9 * len(rows), f"alarm within {ALARM_WITHIN} strokes in {soon} of {len(rows)}"),
        say(named >= 0.9 * len(rows), f"its class named within {STAYING} strokes in {named} of {len(rows)}"),
    ])  # fmt: skip


def report_healthy(strokes: int, seeds: Sequence[int]) -> bool:
    """Print the healthy strokes; whether they are as wanted."""
    rows = [healthy(seed, -(-strokes // len(seeds))) for seed in seeds]
    total, warnings = sum(row[0] for row in rows), sum(row[1] for row in rows)
    cost = 1e3 * max(row[2] for row in rows)
    words = f"{warnings} warnings in {total} healthy strokes, {cost:.0f} ms of a processor a stroke"
    return say(warnings <= max(1.0, 1e-3 * total), words)


def main() -> int:
    """Run and print; 1 if anything falls short."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--strokes", type=int, default=10_000, help="healthy strokes in all; 0: none")
    parser.add_argument("--seeds", type=int, default=10, help="of growing friction, and of healthy valves")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--no-growth", action="store_true", help="healthy strokes only")
    chosen = parser.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    good = [report_healthy(chosen.strokes, seeds)] if chosen.strokes else []
    good += [] if chosen.no_growth else [report_growth(seeds)]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
