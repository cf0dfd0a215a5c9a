"""What a fleet costs, and which valves it names: `python -m benchmarks.fleet --seeds 10`.

Bags of a station over 100 days, recorded by the independent plant of test/plants, each valve a little
different within its tolerances; in two of them friction grows, in one the spring tires. Wanted: all three are named as
drifting, and none of the others. Drifts are looked for in the refitted declared valve, so that no effect need be
searched for; --search does.

Needs the extra `fleet`, and no ROS. A bag is one stroke at 10 kHz; 2,000 of them are 0.2 GB in a temporary folder.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, Recording, record, train_bags, write_bag

from benchmarks.common import parser
from valve_sim.fleet.run import dask_client, examine_fleet
from valve_sim.fleet.units import Options

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
        with dask_client(None, None) as client:
            outcome = examine_fleet([str(folder / "bags")], folder / "out", client, options=options)
        for words in outcome.drifting:
            print(f"  {words}")
    found = {int(one.partition("/valve")[0].rpartition("_")[2]) for one in outcome.drifting}
    wanted = {*GROWING, TIRING} & set(range(valves))
    return Named(seed, found, wanted, _processor() - before, time.perf_counter() - begun)


def _processor() -> float:
    """S of this process and of its children that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def main() -> None:
    """Print the tables."""
    known = parser("fleet", __doc__)
    known.add_argument("--seeds", type=int, default=10, help="stations (default: 10)")
    known.add_argument("--first", type=int, default=1, help="the first seed")
    known.add_argument("--bags", type=int, default=2000)
    known.add_argument("--valves", type=int, default=20)
    known.add_argument("--search", action="store_true", help="search for effects, too")
    known.add_argument("--budget", type=float, default=120.0, help="s of a processor for one unit that is searched")
    chosen = known.parse_args()
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
