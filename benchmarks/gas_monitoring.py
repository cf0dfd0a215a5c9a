"""Does a monitor name a leak or a clogged pilot orifice that begins in service, and is its interval honest?

`python -m benchmarks.gas_monitoring --seeds 12` prints them.

The plant is test/plants/gas.py, which shares no line with the package. A valve before a demand strokes once a second,
at 9, 12 and 10.5 V by turns; its positions are sampled at 2 kHz with 2 µm of noise, its commands are stamped 20 µs off.
No pressure is measured. After ten healthy strokes, of which eight commission the monitor, a leak of 0.0002 to 0.002 mm²
opens (even seeds), or 50 to 90 % of the pilot orifice are left (odd ones). What the first isolation of the fault names
is compared with the truth. `--sizes` fits the size of the fault that there is, and looks for no other.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.intervals import Interval, profile_interval
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.monitoring.fault_isolation import isolate_fault, join
from valve_sim.identification.monitoring.lift_times import starts_by_lift
from valve_sim.identification.monitoring.monitor import Monitor
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.commissioned import CommissionedPlant
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Valve
from valve_sim.traces import Trace

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from model.gas.cases import gas_valve, independent

RATE, NOISE, JITTER = 2e3, 2e-6, 20e-6
"""Samples a second; m; s."""
PERIOD, OPEN_SECONDS, LEAD = 1.0, 0.45, 0.05
"""s: of a stroke, of its voltage, and of rest before it."""
LEVELS: Final = (9.0, 12.0, 10.5)
"""V."""
HEALTHY, FAULTY, COMMISSIONING = 10, 20, 8
"""Strokes before the fault, with it at most, and of commissioning."""


class Case(NamedTuple):
    """A valve and what goes wrong with it: the name that a fit frees, and its true value."""

    valve: Valve
    name: str
    truth: float
    words: str


class Found(NamedTuple):
    """What was isolated: strokes since the fault began, effects, the size where it was named right, CPU s."""

    strokes: int
    effects: tuple[str, ...]
    size: Interval | None
    seconds: float


def drawn(seed: int) -> Case:
    """A case; the same seed gives the same."""
    random = np.random.default_rng([seed, 21])
    pressure, volume = float(random.choice([20e6, 35e6, 70e6])), float(random.uniform(3e-6, 6e-6))
    valve = gas_valve(
        inlet_pressure=pressure, outlet_volume=volume, demand_orifice_diameter=float(random.uniform(5e-5, 7e-5))
    )
    words = f"{1e-6 * pressure:g} MPa, {1e6 * volume:.1f} cm³"
    if seed % 2:
        return Case(valve, "pilot_clogging.ratio", float(random.uniform(0.5, 0.9)), words)
    return Case(valve, "seat_leak.area", float(10.0 ** random.uniform(-9.7, -8.7)), words)


def strokes(case: Case, seed: int) -> Iterator[tuple[list[tuple[float, float]], Array, Array]]:
    """Stroke by stroke: its commands as stamped, and its samples' times and positions."""
    random = np.random.default_rng([seed, 22])
    plant = independent(case.valve)
    for number in range(HEALTHY + FAULTY):
        if number == HEALTHY:
            setattr(plant, "leak" if case.name.startswith("seat") else "clogging", case.truth)
        start = number * PERIOD
        times = start + np.arange(1, round(RATE * PERIOD) + 1) / RATE
        on, off = start + LEAD, start + LEAD + OPEN_SECONDS
        volts = LEVELS[number % len(LEVELS)]
        position, _, _ = plant.run([(on, volts), (off, 0.0)], times)
        late = JITTER * random.standard_normal(2)
        stamped = [(on + float(late[0]), volts), (off + float(late[1]), 0.0)]
        yield stamped, times, position + NOISE * random.standard_normal(len(times))


def sized(evidence: Sequence[Trace], baseline: Baseline, name: str) -> Interval:
    """The size of a fault of that name, as isolation fits it."""
    trace = join(evidence, baseline)
    plant = CommissionedPlant(trace, baseline.commissioned, baseline.scatter)
    start = starts_by_lift(trace, baseline.valve)[name.partition(".")[0]]
    return profile_interval(fit(Problem(plant), (name,), start, nuisances=plant.nuisances), name)[0]


def examined(seed: int, *, sizes: bool) -> tuple[Case, Found | None]:
    """Watch one valve until its fault is isolated; None where that never happens."""
    case = drawn(seed)
    monitor = Monitor(case.valve, MonitorSettings(commissioning_strokes=COMMISSIONING), refit=False)
    for commands, times, positions in strokes(case, seed):
        waiting = list(commands)
        for at, position in zip(times.tolist(), positions.tolist(), strict=True):
            while waiting and waiting[0][0] <= at:
                monitor.command(*waiting.pop(0))
            for report in monitor.measure(at, position):
                evidence = monitor.stroke_monitor.take_evidence()
                if evidence:
                    begun, after = time.process_time(), report.record.number - HEALTHY + 1
                    baseline = monitor.stroke_monitor.with_present_scatter()
                    if sizes:
                        effects: tuple[str, ...] = (case.name.partition(".")[0],)
                        known: Interval | None = sized(evidence, baseline, case.name)
                    else:
                        finding = isolate_fault(evidence, baseline)
                        effects, known = finding.verdict.effects, finding.parameters.get(case.name)
                    return case, Found(after, effects, known, time.process_time() - begun)
    return case, None


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--sizes", action="store_true", help="fit the fault that there is, and look for no other")
    options = parser.parse_args()
    right = covered = 0
    for seed in range(options.first, options.first + options.seeds):
        case, found = examined(seed, sizes=options.sizes)
        if found is None:
            print(f"{seed} | {case.words} | {case.name} {case.truth:.4g} | nothing isolated", flush=True)
            continue
        is_right, size = found.effects == (case.name.partition(".")[0],), found.size
        right += is_right
        covered += is_right and size is not None and size.low <= case.truth <= size.high
        of_size = f"{size.value:.6g}, {size.low:.6g} to {size.high:.6g}" if size is not None else "–"
        print(
            f"{seed} | {case.words} | {case.name} {case.truth:.6g} | after {found.strokes} strokes "
            f"{' + '.join(found.effects) or 'nothing'} | {of_size} | {found.seconds:.0f} s",
            flush=True,
        )
    verb = "sized" if options.sizes else "named"
    print(f"{verb} {right} of {options.seeds}; the interval of 95 % holds the truth in {covered} of these")


if __name__ == "__main__":
    main()
