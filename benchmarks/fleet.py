"""What a fleet costs, and which valves it names: `python -m benchmarks.fleet --seeds 10`.

--seeds: bags of a station over 100 days, recorded by the independent plant of test/plants, each valve a little
different within its tolerances; in two of them friction grows, in one the spring tires. Wanted: all three are named as
drifting, and none of the others. Drifts are looked for in the refitted declared valve, so that no effect need be
searched for; --search does.

--nothing: so many units of nothing on an embedded cluster of two processes. Wanted: at most 10 ms for each, ten times
as many take ten times as long, and the scheduler, which shares this process, stays within 1 GB.

--workers: the same units on an embedded cluster of one process and of two. On a machine that others use, too, walls say
nothing; what is compared is the processor's time of everything, useful or not. Wanted: two workers at least 1.85 times
as fast as one, and a worker's memory that does not grow over 1,000 units.

Needs the extra `fleet`, and no ROS. A bag is one stroke at 10 kHz; 2,000 of them are 0.2 GB in a temporary folder.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, Recording, record, train_bags, write_bag

from benchmarks.common import parser, resident
from valve_sim.fleet.cluster import Cluster, run_batches
from valve_sim.fleet.run import examine_with
from valve_sim.fleet.sources import find_bags
from valve_sim.fleet.units import Options, ParameterChoice, Unit, plan
from valve_sim.fleet.work import Examined, examine_units, survey_bags

DAYS, DAY_NS = 100, 86_400_000_000_000
RECORDER = Recorder(quantisation=0.1e-6, command_jitter=20e-6, sample_rate=10e3)
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


class Taken(NamedTuple):
    """A recording, its number and its valve's, and when it begins, ns."""

    number: int
    valve: int
    start: int
    recording: Recording

    @property
    def name(self) -> str:
        """Of the valve in the bag."""
        return f"/line_{self.valve}/valve"


def recordings(bags: int, valves: int, seed: int) -> Iterator[Taken]:
    """The recordings of a station, in the order in which they are taken."""
    random = np.random.default_rng(seed)
    own = [
        {name: CAMPAIGN_VALVE[name] + sigma * random.standard_normal() for name, sigma in TOLERANCES.items()}
        for _ in range(valves)
    ]
    profiles = train_bags(8)
    for number in range(bags):
        valve, share = number % valves, number / bags
        values = {**CAMPAIGN_VALVE, **own[valve]}
        if valve == TIRING:
            for name in ("spring_rate", "spring_preload"):
                values[name] *= 1.0 - (1.0 - TIRED) * share
        friction = MOST_FRICTION * share if valve in GROWING else 0.0
        plant = DeclaredPlant({"coulomb_friction": {"force": friction}} if friction else {}, values)
        made = record(plant, profiles[int(random.integers(8))], RECORDER, int(random.integers(2**31)))
        yield Taken(number, valve, BAG_START_NS + round(share * DAYS * DAY_NS), made)


def make_station(folder: Path, taken: Iterable[Taken]) -> None:
    """Write recordings as bags."""
    for one in taken:
        write_bag(one.recording, folder / f"line_{one.valve}" / f"bag_{one.number:05d}", one.name, one.start)


def named(seed: int, bags: int, valves: int, options: Options) -> Named:
    """Make a station and examine it."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        make_station(folder / "bags", recordings(bags, valves, seed))
        begun, before = time.perf_counter(), _processor()
        with Cluster() as cluster:
            outcome = examine_with(cluster.client, [str(folder / "bags")], folder / "out", options=options)
        for words in outcome.drifting:
            print(f"  {words}")
    found = {int(one.partition("/valve")[0].rpartition("_")[2]) for one in outcome.drifting}
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


class Spent(NamedTuple):
    """What units took on so many workers: s of a processor in units, in all workers, and in client and scheduler."""

    workers: int
    units: float
    of_workers: float
    of_client: float
    wall: float
    memory: list[float]
    """MB of the largest worker, after each tenth of the units."""


def spent(folder: Path, workers: int, count: int) -> Spent:
    """Examine the bags of a folder over and over, so many units in all, on so many workers."""
    units = [
        unit
        for bag in find_bags([str(folder)])
        for unit in plan([(bag, survey_bags([bag])[0].survey)], ParameterChoice(), Options(search=False), []).units
    ]
    repeated = [units[number % len(units)] for number in range(count)]
    with Cluster(workers=workers) as cluster:
        client = cluster.client()
        # Once before: what a process learns is not counted.
        list(run_batches(cluster.client, _examined, repeated[: 4 * workers], _seconds))
        before, begun, mine = sum(client.run(time.process_time).values()), time.perf_counter(), time.process_time()
        useful, done, memory = 0.0, 0, list[float]()
        for batch in run_batches(cluster.client, _examined, repeated, _seconds):
            useful += sum(map(_seconds, batch.answers))
            done += len(batch.answers)
            if done >= count * (len(memory) + 1) / 10:
                memory.append(max(client.run(resident).values()))
        wall = time.perf_counter() - begun
        of_workers = sum(client.run(time.process_time).values()) - before
        return Spent(workers, useful, of_workers, time.process_time() - mine, wall, memory)


def _examined(units: Sequence[Unit]) -> list[Examined]:
    return examine_units(units, Path())


def _seconds(answer: Examined) -> float:
    return answer.seconds


def one_and_two(count: int) -> None:
    """Print what one worker and two take for the same units, and how large they get."""
    with tempfile.TemporaryDirectory() as place:
        make_station(Path(place), recordings(40, 20, 1))
        one, two = (spent(Path(place), workers, count) for workers in (1, 2))
    for own in (one, two):
        rest = own.of_workers - own.units
        print(
            f"{count} units, workers: {own.workers}; {1e3 * own.units / count:.1f} ms of a "
            f"processor each, {1e3 * rest / count:.2f} ms more in the worker, {1e3 * own.of_client / count:.2f} ms in "
            f"client and scheduler; wall {own.wall:.0f} s"
        )
        print(f"  a worker's memory, MB: {', '.join(f'{size:.0f}' for size in own.memory)}")
    # Two processors have to do all of it; with one worker the client has the other processor.
    faster = 2.0 * one.of_workers / one.units / ((two.of_workers + two.of_client) / two.units)
    walls = one.wall / two.wall
    print(f"two workers on two processors of their own: {faster:.2f} times as fast as one; walls here {walls:.2f}")


def main() -> None:
    """Print the tables."""
    known = parser("fleet", __doc__)
    known.add_argument("--seeds", type=int, default=0, help="stations (default: 0)")
    known.add_argument("--first", type=int, default=1, help="the first seed")
    known.add_argument("--bags", type=int, default=2000)
    known.add_argument("--valves", type=int, default=20)
    known.add_argument("--search", action="store_true", help="search for effects, too")
    known.add_argument("--budget", type=float, default=120.0, help="s of a processor for one unit that is searched")
    known.add_argument("--nothing", type=int, nargs="*", default=[], help="numbers of units")
    known.add_argument("--workers", type=int, default=0, metavar="UNITS", help="so many units on one worker and on two")
    chosen = known.parse_args()
    if chosen.workers:
        one_and_two(chosen.workers)
    if chosen.nothing:
        overhead(chosen.nothing)
    for seed in range(chosen.first, chosen.first + chosen.seeds):
        options = Options(budget=chosen.budget, search=chosen.search)
        one = named(seed, chosen.bags, chosen.valves, options)
        print(
            f"seed {seed}: {len(one.found & one.wanted)} of {len(one.wanted)} that drift named, "
            f"{len(one.found - one.wanted)} of {chosen.valves - len(one.wanted)} others; "
            f"{one.processor:.0f} s of a processor, {one.wall:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
