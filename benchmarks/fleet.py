"""What a fleet costs, and which valves it names: `python -m benchmarks.fleet --valves 20 --bags 2000 --seeds 10`.

--seeds: bags of a station over 100 days, recorded by the independent plant of test/plants, each valve a little
different within its tolerances; in two of them friction grows, in one the spring tires. Wanted: all three are named as
drifting, and none of the others.

--nothing: so many units of nothing on an embedded cluster of two processes. Wanted: at most 10 ms for each, ten times
as many take ten times as long, and the scheduler, which shares this process, stays within 1 GB.

Needs the extra `fleet`, and no ROS. A station of 2,000 bags is 0.7 GB in a temporary folder, and takes most of an hour
of a processor: where friction has grown, every bag is searched for what is missing (--budget).
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from valve_sim.fleet.cluster import Cluster, run_batches
from valve_sim.fleet.run import examine_with
from valve_sim.fleet.units import Options

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, record, train_bags, write_bag

DAYS, DAY_NS = 100, 86_400_000_000_000
RECORDER = Recorder(quantisation=0.1e-6, command_jitter=20e-6)
TOLERANCES = {"spring_rate": 12.8, "spring_preload": 0.076, "stroke": 2.9e-6, "pilot_gap": 2.9e-6}
"""Standard deviations between valves, those of the shipped parameter file."""
MOST_FRICTION = 0.4
"""N at the end."""
TIRED = 0.85
"""Spring rate and preload at the end, of those at the start."""
GROWING, TIRING = (3, 8), 12
"""Numbers of the valves that drift."""


class Named(NamedTuple):
    """Which valves a run named, and what it took."""

    seed: int
    found: set[int]
    wanted: set[int]
    processor: float
    wall: float


def make_station(folder: Path, bags: int, valves: int, seed: int) -> None:
    """Record the bags of a station."""
    random = np.random.default_rng(seed)
    own = [
        {name: CAMPAIGN_VALVE[name] + sigma * random.standard_normal() for name, sigma in TOLERANCES.items()}
        for _ in range(valves)
    ]
    for number in range(bags):
        valve, share = number % valves, number / bags
        values = {**CAMPAIGN_VALVE, **own[valve]}
        if valve == TIRING:
            for name in ("spring_rate", "spring_preload"):
                values[name] *= 1.0 - (1.0 - TIRED) * share
        friction = MOST_FRICTION * share if valve in GROWING else 0.0
        plant = DeclaredPlant({"coulomb_friction": {"force": friction}} if friction else {}, values)
        made = record(plant, train_bags(4)[int(random.integers(4))], RECORDER, int(random.integers(2**31)))
        start = BAG_START_NS + round(share * DAYS * DAY_NS)
        write_bag(made, folder / f"line_{valve}" / f"bag_{number:05d}", f"/line_{valve}/valve", start)


def named(seed: int, bags: int, valves: int, budget: float) -> Named:
    """Make a station and examine it."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        make_station(folder / "bags", bags, valves, seed)
        begun, before = time.perf_counter(), _processor()
        with Cluster() as cluster:
            options = Options(budget=budget)
            outcome = examine_with(cluster.client, [str(folder / "bags")], folder / "out", options=options)
        found = {int(words.partition("/valve")[0].rpartition("_")[2]) for words in outcome.drifting}
        for words in outcome.drifting:
            print(f"  {words}")
    wanted = {*GROWING, TIRING} & set(range(valves))
    return Named(seed, found, wanted, _processor() - before, time.perf_counter() - begun)


def _processor() -> float:
    """S of this process and of its children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def nothing(items: Sequence[int]) -> list[int]:
    """An answer for each."""
    return list(items)


def overhead(counts: Sequence[int]) -> None:
    """Units of nothing: what each takes, and the memory of this process, in which the scheduler is."""
    with Cluster(workers=2) as cluster:
        cluster.client()
        for count in counts:
            begun, before = time.perf_counter(), time.process_time()
            done = sum(
                len(batch.answers) for batch in run_batches(cluster.client, nothing, range(count), lambda _: 0.0)
            )
            wall, spent = time.perf_counter() - begun, time.process_time() - before
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
            print(
                f"{done} units of nothing: {1e3 * wall / count:.3f} ms each ({1e3 * spent / count:.3f} ms of a "
                f"processor for client and scheduler), largest memory {memory:.0f} MB"
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--seeds", type=int, default=0)
    parser.add_argument("--bags", type=int, default=2000)
    parser.add_argument("--valves", type=int, default=20)
    parser.add_argument("--budget", type=float, default=120.0, help="s of a processor for one unit")
    parser.add_argument("--nothing", type=int, nargs="*", default=[], help="numbers of units")
    chosen = parser.parse_args()
    if chosen.nothing:
        overhead(chosen.nothing)
    for seed in range(1, chosen.seeds + 1):
        one = named(seed, chosen.bags, chosen.valves, chosen.budget)
        print(
            f"seed {seed}: {len(one.found & one.wanted)} of {len(one.wanted)} that drift named, "
            f"{len(one.found - one.wanted)} of {chosen.valves - len(one.wanted)} others; "
            f"{one.processor:.0f} s of a processor, {one.wall:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
