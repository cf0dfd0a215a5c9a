"""A monitor beside a valve: strokes by independent plants, seen by the position, by the coil's current, or with gas."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from identification.live_coil import NOISE, LiveCoil, course
from identification.live_strokes import LiveValve, feed, hand_over
from identification.one_thread import Monitor
from identification.test_current_alone import declared as declared_coil
from model.gas.cases import gas_valve, independent
from plants.coil_alone import Build
from plants.recording import LEVELS

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.fault_isolation import FaultFinding, isolate_fault
from valve_sim.identification.monitoring.findings import StrokeState
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.identification.reporting.monitor_messages import finding_words


class Rig(Protocol):
    """A valve that strokes beside its monitor."""

    monitor: Monitor

    def stroke(self, fault: Any = None) -> list[StrokeReport]:
        """One stroke, with a fault or none; reports of the strokes that ended meanwhile."""
        ...


class Healthy(NamedTuple):
    """Strokes watched, alarms among them, mean of residual over noise, and CPU s of monitor and plant."""

    strokes: int
    alarms: int
    ratio: float
    seconds: float


class Isolated(NamedTuple):
    """What one isolation of a fault said: after which stroke, what, in words, and CPU s for it."""

    stroke: int
    finding: FaultFinding
    words: str
    seconds: float

    def has_named(self, name: str, *, alone: bool) -> bool:
        """Whether it names this and nothing else, or, if not `alone`, whether this is in the class."""
        verdict = self.finding.verdict
        alike = {other for others in verdict.confusable_with.values() for other in others}
        if verdict.kind != "effects":
            return False
        return verdict.effects == (name,) if alone else name in {*verdict.effects, *alike}


class Watched(NamedTuple):
    """Strokes with a fault: the stroke of the first alarm, None if there was none, and each isolation."""

    alarmed: int | None
    isolated: list[Isolated]


def watch_healthy(rig: Rig, strokes: int) -> Healthy:
    """So many strokes after commissioning."""
    begun, ratios, watched = time.process_time(), list[float](), 0
    while watched < strokes:
        for report in rig.stroke():
            if report.state is StrokeState.WATCHING:
                watched += 1
                ratios.append(report.rms / report.noise)
    seconds = time.process_time() - begun
    return Healthy(watched, rig.monitor.stroke_monitor.alarms, float(np.nanmean(ratios)), seconds)


def watch(rig: Rig, faults: Iterable[Any], since: int, *, isolates: bool = True, once: bool = False) -> Watched:
    """A stroke with each of these faults; alarms count from stroke `since` on, and isolations where they are asked for.

    `once`: no more strokes than the first isolation takes, or the first alarm where nothing is isolated.
    """
    watching, alarmed, isolated = rig.monitor.stroke_monitor, None, list[Isolated]()
    for fault in faults:
        for report in rig.stroke(fault):
            number = report.record.number
            if (report.alarm is not None or report.record.fault) and alarmed is None and number >= since:
                alarmed = number
            evidence = watching.take_evidence() if isolates else []
            if evidence and watching.baseline is not None and number >= since:
                isolated.append(isolate(evidence, rig, number))
        if once and (isolated or (alarmed is not None and not isolates)):
            break
    return Watched(alarmed, isolated)


def isolate(evidence: Sequence[Any], rig: Rig, number: int) -> Isolated:
    """What is the matter in these strokes, timed."""
    begun = time.process_time()
    found = isolate_fault(evidence, rig.monitor.stroke_monitor.with_present_scatter())
    return Isolated(number, found, finding_words(found), time.process_time() - begun)


def rising(force: float, healthy: int, growing: int, staying: int) -> list[float]:
    """A force of each stroke: none, then growing, then all of it."""
    return [0.0] * healthy + [force * (k + 1) / growing for k in range(growing)] + [force] * staying


# --- by the position --------------------------------------------------------------------------------------------------


class PositionRig:
    """A live valve whose position is seen; a fault is a friction, N."""

    def __init__(self, live: LiveValve) -> None:
        self.live, self.monitor = live, Monitor(default_valve().exact(), refit=False)

    def stroke(self, fault: float | None = None) -> list[StrokeReport]:
        """One stroke."""
        effects = {"coulomb_friction": {"force": fault}} if fault else {}
        return list(feed(self.monitor, self.live.stroke(effects)))


def drawn_rig(seed: int, jitter: float, *, colours: bool = False, **errors: float) -> PositionRig:
    """A valve with dampings of its own, N·s/m.

    Args:
        seed: of all that is drawn. jitter: s, of each command's stamp. colours: whether noise is coloured in odd seeds.
        errors: rate, variation, drift and hum, as of a `LiveValve`.
    """
    random = np.random.default_rng([seed, 2])
    dampings = {"pilot_damping": float(random.uniform(0.7, 1.5)), "main_damping": float(random.uniform(2.5, 6.0))}
    offset, colour = float(random.normal(0.0, 50e-6)), 0.7 * (seed % 2) * colours
    return PositionRig(LiveValve(seed, dampings, jitter=jitter, colour=colour, offset=offset, **errors))  # type: ignore[arg-type]


# --- by the coil's current --------------------------------------------------------------------------------------------

PERIOD: Final = 0.100
"""s. At the end of a period no valve here has any current left: each stroke begins at rest."""
DETECTABLE: Final = 3.3
"""Standard deviations."""


class CoilRig:
    """A valve of which only the coil is seen; a fault is a friction, N.

    In every second seed the voltage is measured, and commands are stamped up to 3 ms late.
    """

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng([seed, 20])
        resistance = float(random.uniform(6.0, 12.0))
        self.build = Build(
            pilot_damping=float(random.uniform(0.5, 2.0)),
            main_damping=float(random.uniform(3.0, 6.0)),
            resistance=resistance,
            inductance=2.0e-3 * resistance,
            clamp_voltage=float(random.choice([0.0, 24.0])),
            eddy_resistance=50.0,
        )
        self.monitor = Monitor(declared_coil(self.build), refit=False)
        random = np.random.default_rng([seed, 21])
        self._coil = LiveCoil(self.monitor, random, LEVELS, PERIOD, has_voltage=seed % 2 == 0)

    def stroke(self, fault: float | None = None) -> list[StrokeReport]:
        """One stroke."""
        return self._coil.stroke(self.build if fault is None else self.build._replace(friction=fault))

    def detection_limit(self) -> float:
        """N of friction whose change of eight strokes' current stands out when both dampings are refitted."""

        def currents(build: Build) -> np.ndarray:
            return np.concatenate([course(build, volts, PERIOD).current for volts in LEVELS])

        healthy, tangents = currents(self.build), []
        for name in ("pilot_damping", "main_damping"):
            value = getattr(self.build, name)
            ahead, behind = (currents(self.build._replace(**{name: factor * value})) for factor in (1.01, 0.99))
            tangents.append((ahead - behind) / (0.02 * value))
        base, _ = np.linalg.qr(np.column_stack(tangents))
        force = 2e-3
        for _ in range(4):
            change = currents(self.build._replace(friction=force)) - healthy
            force *= DETECTABLE * NOISE / float(np.linalg.norm(change - base @ (base.T @ change)))
        return force


# --- with gas ---------------------------------------------------------------------------------------------------------


class GasRig:
    """A valve before a demand that strokes once a second, 2 kHz with 2 µm of noise; any fault is the seed's own.

    Even seeds get a leak of 0.0002 to 0.002 mm², odd ones keep 50 to 90 % of their pilot orifice.
    """

    PERIOD, OPEN, LEAD, RATE, NOISE, JITTER = 1.0, 0.45, 0.05, 2e3, 2e-6, 20e-6
    LEVELS = (9.0, 12.0, 10.5)

    def __init__(self, seed: int, commissioning: int) -> None:
        random = np.random.default_rng([seed, 21])
        pressure, volume = float(random.choice([20e6, 35e6, 70e6])), float(random.uniform(3e-6, 6e-6))
        valve = gas_valve(
            inlet_pressure=pressure, outlet_volume=volume, demand_orifice_diameter=float(random.uniform(5e-5, 7e-5))
        )
        self.words = f"{1e-6 * pressure:g} MPa, {1e6 * volume:.1f} cm³"
        self.name, self.truth = "seat_leak.area", float(10.0 ** random.uniform(-9.7, -8.7)) if seed % 2 == 0 else 0.0
        if seed % 2:
            self.name, self.truth = "pilot_clogging.ratio", float(random.uniform(0.5, 0.9))
        self.monitor = Monitor(valve, MonitorSettings(commissioning_strokes=commissioning), refit=False)
        self._plant, self._random, self._strokes = independent(valve), np.random.default_rng([seed, 22]), 0

    def stroke(self, fault: object = None) -> list[StrokeReport]:
        """One stroke."""
        if fault:
            setattr(self._plant, "leak" if self.name.startswith("seat") else "clogging", self.truth)
        start = self._strokes * self.PERIOD
        times = start + np.arange(1, round(self.RATE * self.PERIOD) + 1) / self.RATE
        on, off = start + self.LEAD, start + self.LEAD + self.OPEN
        volts = self.LEVELS[self._strokes % len(self.LEVELS)]
        position, _, _ = self._plant.run([(on, volts), (off, 0.0)], times)
        late = self.JITTER * self._random.standard_normal(2)
        waiting = [(on + float(late[0]), volts), (off + float(late[1]), 0.0)]
        shown = position + self.NOISE * self._random.standard_normal(len(times))
        self._strokes += 1
        return [report for reports in hand_over(self.monitor, waiting, times, shown) for report in reports]
