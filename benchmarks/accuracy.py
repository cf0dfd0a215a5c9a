"""How exact the model core is: `python -m benchmarks.accuracy`, or with `--sets 100` for a first look.

Random valves under a pulse, a third of them without an effect and the others with one to three, at the tolerance of the
core by default: when each event happens, against an independent reference (test/model/reference.py: SciPy's DOP853 with
a relative tolerance of 1e-13, its steps at most 0.1 ms). Printed are the median, the 99th percentile and the largest
difference, with effects and without.

Then 1,200 random valves whose current freewheels until a diode blocks, in closed form, by the same reference.

Then the derivatives of positions and currents of 300 such valves, at a tolerance of 1e-11, to all that a trace depends
on, as far as they are known without difference quotients: how far each is off central differences of fourth order at
1e-13, over its largest value. Exits 1 where events are others, the largest difference is above 1e-11 s (1e-10 s for
currents that freewheel), or a derivative is off by 1e-6.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console
from rich.table import Table

from valve_sim.model import simulate
from valve_sim.model.simulation import TOLERANCE

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from model.derivatives import ACCURACY, TIGHT, errors_of, random_case
from model.flux_cases import differences as differences_of_release
from model.flux_cases import random_release
from model.random_valves import TIMES, random_valve
from model.reference import reference

LARGEST: Final = 1e-11
"""s, that an event may be off."""
LARGEST_OF_RELEASE: Final = 1e-10
"""s, likewise where the current freewheels: plungers that the core takes back at once amplify what was off before."""


def differences(seed: int, tolerance: float) -> tuple[bool, list[float] | None]:
    """Whether the valve has effects, and how far each event is off, s; None where other events happen."""
    valve, drive = random_valve(seed)
    ours = simulate(valve, drive, TIMES, tolerance=tolerance).events
    theirs = reference(valve.declared(), valve.effects, drive, TIMES).events
    if [event.kind.name for event in ours] != [kind for _, kind in theirs]:
        return bool(valve.effects), None
    return bool(valve.effects), [abs(event.time - when) for event, (when, _) in zip(ours, theirs, strict=True)]


def releases_are_good(sets: int, tolerance: float) -> bool:
    """Print how exact the events of so many valves are whose current freewheels, and whether as exact as wanted."""
    late: list[float] = []
    others, lost = [], []
    for seed in range(sets):
        try:
            _, moment, _, same = differences_of_release(seed, tolerance, random_release)
        except RuntimeError:
            lost.append(seed)
            continue
        late.append(moment)
        if not same:
            others.append(seed)
    print(
        f"{len(late)} valves whose current freewheels: event times off by a median of {np.median(late):.1e} s, "
        f"99 of 100 by {np.quantile(late, 0.99):.1e} s, the largest by {max(late):.1e} s; other events: "
        f"{others or 'none'}; the reference came to no end: {lost or 'none'}"
    )
    return not others and max(late) <= LARGEST_OF_RELEASE


def derivatives_are_good(sets: int) -> bool:
    """Print how exact the derivatives of so many random valves are, and whether all are as exact as wanted."""
    worst: list[float] = []
    count = unknown = seed = 0
    while len(worst) < sets:
        if (found := random_case(seed)) is not None:
            errors = list(errors_of(*found).values())
            count, unknown = count + len(errors), unknown + sum(not of_one for of_one in errors)
            worst.append(max((min(of_one) for of_one in errors if of_one), default=0.0))
        seed += 1
    print(
        f"{count} derivatives of {sets} valves at {TIGHT:g}, {unknown} of them beside other events; the worst of each "
        f"valve, over the largest value: median {np.median(worst):.1e}, largest {max(worst):.1e} (at most {ACCURACY:g})"
    )
    return unknown == 0 and max(worst) < ACCURACY


def main() -> int:
    """Print the table; 1 if an event or a derivative is off by more than wanted."""
    parser = argparse.ArgumentParser(description="Event times of the core against a tight DOP853.")
    parser.add_argument("--sets", type=int, default=1000)
    parser.add_argument("--tolerance", type=float, default=TOLERANCE)
    parser.add_argument("--derivatives", type=int, default=300, help="valves whose derivatives are looked at")
    parser.add_argument("--releases", type=int, default=1200, help="valves whose current freewheels")
    chosen = parser.parse_args()
    off: dict[bool, list[float]] = {False: [], True: []}
    others, worst = [], (0.0, -1)
    for seed in range(chosen.sets):
        has_effects, found = differences(seed, chosen.tolerance)
        if found is None:
            others.append(seed)
            continue
        off[has_effects] += found
        worst = max(worst, (max(found, default=0.0), seed))
    table = Table("effects", "events", "median, s", "99 of 100, s", "largest, s", "beyond 1e-11 s")
    for has_effects, found in off.items():
        if found:
            sizes = [float(np.quantile(found, share)) for share in (0.5, 0.99, 1.0)]
            beyond = sum(one > LARGEST for one in found)
            table.add_row(
                "on" if has_effects else "off", str(len(found)), *(f"{size:.1e}" for size in sizes), str(beyond)
            )
    Console().print(table)
    print(f"tolerance {chosen.tolerance:g}; other events: {others or 'none'}; the largest is of seed {worst[1]}")
    are_good = releases_are_good(chosen.releases, chosen.tolerance) if chosen.releases else True
    are_good &= derivatives_are_good(chosen.derivatives) if chosen.derivatives else True
    return 0 if not others and worst[0] <= LARGEST and are_good else 1


if __name__ == "__main__":
    raise SystemExit(main())
