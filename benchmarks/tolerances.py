"""Declared values within their tolerances: do intervals cover, is nothing blamed, and what does it cost?

Each seed is a valve whose declared numbers are off as data sheets allow (test/plants/tolerances.py), and whose
dampings are drawn from the ranges of benchmarks.coverage, recorded by the independent plant of test/plants.
`identify` refits it: a 95 % interval of each damping, and estimate ± 1.96 standard errors of each declared
value, must contain the truth in 92 to 98 % of the recordings. `diagnose` must find nothing missing, with a
held-out error of the noise; and its CPU is compared with that of the same valve without deviations and without
tolerances.

    python -m benchmarks.tolerances --seeds 100 --diagnoses 20
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from benchmarks.coverage import accepted_coverage, as_trace, true_dampings
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.estimation.declared_values import out_of_tolerance
from valve_sim.model import Valve
from valve_sim.traces import Trace

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))

from plants.declared import DeclaredPlant
from plants.recording import Recorder, holdout_profile, record, train_profile
from plants.tolerances import SHEET_VALVE, declared_tolerances, deviated, drawn_deviations

HELD_OUT_SEED: Final = 10_000
"""Added to a seed for its held-out recording."""
FURTHER: Final = {"reference_voltage": 0.05, "coil_resistance": 0.1, "pickup_velocity_ratio": 0.01}
"""Tolerances that bring their number to 16, with the polynomial's four: the truth has these values as declared."""


class Recorded(NamedTuple):
    """A valve with its recordings: the truth by name, what training and held-out strokes were."""

    truth: Mapping[str, float]
    training: Trace
    held_out: Trace


def declared_valve(tolerances: Mapping[str, float | list[float]]) -> Valve:
    """What the data sheet says."""
    polynomial = list(np.asarray(SHEET_VALVE["attraction_polynomial"], dtype=np.float64))
    content = {"valve": {**SHEET_VALVE, "attraction_polynomial": polynomial}, "tolerances": dict(tolerances)}
    return Valve.from_mapping(content, "the data sheet")


def recorded(seed: int, deviations: Mapping[str, float]) -> Recorded:
    """One valve that is off by so many tolerances."""
    entries = {**deviated(SHEET_VALVE, deviations), **true_dampings(seed)}
    plant = DeclaredPlant(parameters=entries)
    training = record(plant, train_profile(), Recorder(), seed)
    held_out = record(plant, holdout_profile(), Recorder(), HELD_OUT_SEED + seed)
    truth = {name: float(value) for name, value in entries.items() if isinstance(value, float)}
    return Recorded(truth, as_trace(training, f"seed {seed}"), as_trace(held_out, f"seed {seed}, held out"))


def drawn(seed: int) -> Recorded:
    """One valve whose numbers are off as the data sheet allows."""
    return recorded(seed, drawn_deviations(np.random.default_rng([seed, 2])))


def covered(seed: int, valve: Valve) -> dict[str, bool]:
    """Of one valve, which truths lie within their intervals."""
    of_valve = drawn(seed)
    result = identify([of_valve.training], valve)
    found = {name: own.low <= of_valve.truth[name] <= own.high for name, own in result.intervals.items()}
    for own in result.declared:
        if own.name in of_valve.truth:
            found[own.name] = abs(own.estimate - of_valve.truth[own.name]) <= 1.96 * own.stderr
    return found


def print_coverage(seeds: int, valve: Valve) -> bool:
    """A line for each value; whether all are within what is wanted."""
    hits: dict[str, list[bool]] = defaultdict(list)
    for seed in range(seeds):
        for name, is_in in covered(seed, valve).items():
            hits[name].append(is_in)
    low, high = accepted_coverage(seeds)
    print(f"coverage of 95 % intervals, {seeds} seeds; accepted of each: {low:.3f} to {high:.3f}")
    for name, found in hits.items():
        print(f"  {name:<24}{statistics.fmean(found):.3f}")
    everything = [is_in for found in hits.values() for is_in in found]
    print(f"  {'all together':<24}{statistics.fmean(everything):.3f}")
    return all(low <= statistics.fmean(found) <= high for found in hits.values())


class Timed(NamedTuple):
    """A diagnosis and the CPU that it took, s."""

    result: Diagnosis
    seconds: float


def timed(of_valve: Recorded, valve: Valve) -> Timed:
    """Diagnose."""
    begun = time.process_time()
    result = diagnose([of_valve.training], [of_valve.held_out], valve)
    return Timed(result, time.process_time() - begun)


def print_diagnoses(seeds: int, valve: Valve, exact: Valve) -> bool:
    """How many find nothing missing, the held-out error over the noise, and the CPU with and without tolerances."""
    of_tolerances = [timed(drawn(seed), valve) for seed in range(seeds)]
    of_exact = [timed(recorded(seed, {}), exact) for seed in range(seeds)]
    clean = [found.result.verdict.kind == "none" for found in of_tolerances]
    ratios = [found.result.after.holdout_rmse / found.result.before.fit.problem.noise.sigma for found in of_tolerances]
    said = [name for found in of_tolerances for name in out_of_tolerance(found.result.declared)]
    with_them, without = (statistics.fmean(f.seconds for f in found) for found in (of_tolerances, of_exact))
    count = len(valve.tolerances.declared) + 4
    print(f"diagnoses, nothing missing: {sum(clean)} of {seeds} none; said to be out of tolerance: {said or 'nothing'}")
    print(f"  held-out error over noise {min(ratios):.3f} to {max(ratios):.3f}")
    print(f"  CPU {with_them:.2f} s with {count} tolerances, {without:.2f} s without: ratio {with_them / without:.2f}")
    return statistics.fmean(clean) >= 0.97


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all; 1 if it is short of what is wanted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tolerances", description=__doc__)
    parser.add_argument("--seeds", type=int, default=100, help="valves that are refitted (default: 100)")
    parser.add_argument("--diagnoses", type=int, default=20, help="valves that are diagnosed (default: 20)")
    chosen = parser.parse_args(arguments)
    if min(chosen.seeds, chosen.diagnoses) < 2:
        parser.error("expected at least 2 of each")
    tolerances = declared_tolerances(SHEET_VALVE)
    is_covered = print_coverage(chosen.seeds, declared_valve(tolerances))
    is_clean = print_diagnoses(chosen.diagnoses, declared_valve({**tolerances, **FURTHER}), declared_valve({}))
    return 0 if is_covered and is_clean else 1


if __name__ == "__main__":
    raise SystemExit(main())
