"""How exact are the events and the derivatives of the model? `python -m benchmarks.accuracy`, or with `--sets 100`.

valves: random valves under a pulse, two thirds of them with one to three effects, at the core's tolerance: when each
event happens, against an independent reference (test/model/reference.py: SciPy's DOP853 at 1e-13).
releases: valves whose current freewheels until a diode blocks, in closed form, by the same reference.
derivatives: of positions and currents at a tolerance of 1e-11, to all that a trace depends on, against central
differences of fourth order at 1e-13, over the largest value of each.
jumps: valves whose friction falls with speed and whose forces jump: events and derivatives as above.
gas: twenty valves with gas against test/plants/gas.py: event times, pressure, and what the tolerance leaves of times.

Exits 1 where events are others, the largest difference is above 1e-11 s (1e-10 s for currents that freewheel), a
derivative is off by 1e-6, or gas is off by more than 5 µs + 0.1 % or 0.2 % of pressure.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import Final

import numpy as np
from model import jumps
from model.derivatives import ACCURACY, errors_of
from model.derivatives import random_case as random_derivatives
from model.flux_cases import differences as differences_of_release
from model.flux_cases import random_release
from model.gas.cases import CASES, Case, compared, ours
from model.random_valves import TIMES, random_valve
from model.reference import reference

from benchmarks.common import parser, say, show
from valve_sim.model import TOLERANCE, EventKind, simulate

FINEST: Final = 3e-13
"""Tolerance of a step, for comparison."""
LARGEST: Final = 1e-11
"""s, that an event may be off."""
LARGEST_OF_RELEASE: Final = 1e-10
"""s, likewise where the current freewheels: plungers that the core takes back at once amplify what was off before."""


def summary(words: str, errors: Iterable[float], most: float, trouble: list[int]) -> bool:
    """Print how far off so many figures are, and whether all are as wanted; `trouble`: seeds with other events."""
    off = np.array([*errors])
    middle, tail, worst = (float(np.quantile(off, share)) for share in (0.5, 0.99, 1.0))
    is_good = worst <= most and not trouble
    return say(
        is_good,
        f"{len(off)} {words}: median {middle:.1e}, 99 of 100 {tail:.1e}, largest {worst:.1e} (at most {most:g}); "
        f"other events: seeds {trouble or 'none'}",
    )


def valves(sets: int, tolerance: float) -> bool:
    """Events of random valves."""
    off: dict[bool, list[float]] = {False: [], True: []}
    others: dict[bool, list[int]] = {False: [], True: []}
    for seed in range(sets):
        valve, drive = random_valve(seed)
        ours = simulate(valve, drive, TIMES, tolerance=tolerance).events
        theirs = reference(valve.declared(), valve.effects, drive, TIMES).events
        has_effects = bool(valve.effects)
        if [event.kind.name for event in ours] != [kind for _, kind in theirs]:
            others[has_effects].append(seed)
            continue
        off[has_effects] += [abs(event.time - when) for event, (when, _) in zip(ours, theirs, strict=True)]
    named = {True: "events of valves with effects, s", False: "events of valves without, s"}
    return all([summary(named[has], off[has], LARGEST, others[has]) for has in named])


def releases(sets: int, tolerance: float) -> bool:
    """Events of valves whose current freewheels; those without that the reference comes to no end with."""
    late, others = list[float](), list[int]()
    for seed in range(sets):
        try:
            _, moment, _, same = differences_of_release(seed, tolerance, random_release)
        except RuntimeError:
            continue
        late.append(moment)
        others += [] if same else [seed]
    return summary("valves whose current freewheels, worst event, s", late, LARGEST_OF_RELEASE, others)


def derivatives(sets: int, tolerance: float) -> bool:
    """The worst derivative of each valve, over its largest value; a valve of which none is known counts as trouble."""
    worst, unknown, seed = list[float](), list[int](), 0
    while len(worst) < sets:
        if (found := random_derivatives(seed)) is not None:
            errors = list(errors_of(*found).values())
            unknown += [seed] if any(not of_one for of_one in errors) else []
            worst.append(max((min(of_one) for of_one in errors if of_one), default=0.0))
        seed += 1
    return summary("valves, worst derivative", worst, ACCURACY, unknown)


def jumping(sets: int, tolerance: float) -> bool:
    """Events and the worst derivative of random valves whose friction falls with speed and whose forces jump.

    Without those that the reference comes to no end with.
    """
    late, others, worst, unknown = list[float](), list[int](), list[float](), list[int]()
    with jumps.registered():
        for seed in range(sets):
            case = jumps.random_case(seed)
            try:
                theirs = jumps.events_of(case)
            except RuntimeError:
                continue
            ours = simulate(case.valve, case.drive, case.times, tolerance=tolerance, start_time=0.0).events
            if [event.kind.name for event in ours] != [kind for _, kind in theirs]:
                others.append(seed)
                continue
            late += [abs(event.time - when) for event, (when, _) in zip(ours, theirs, strict=True)]
            errors = list(errors_of(case, case.names()).values())
            unknown += [seed] if any(not of_one for of_one in errors) else []
            worst.append(max((min(of_one) for of_one in errors if of_one), default=0.0))
    is_late = summary("events of valves whose forces jump, s", late, LARGEST, others)
    return all([is_late, summary("such valves, worst derivative", worst, ACCURACY, unknown)])


# --- valves with gas --------------------------------------------------------------------------------------------------

OF_FLOW: Final = (EventKind.FLOW_CHOKED, EventKind.FLOW_SUBSONIC, EventKind.FLOW_REVERSED)


def row_of(case: Case) -> tuple[bool, list[str]]:
    """Whether a case agrees with the independent plant, and its row of the table."""
    found = compared(case)
    finest = ours(case, found.times, FINEST).events
    of_step = max((abs(a.time - b.time) for a, b in zip(found.run.events, finest, strict=False)), default=0.0)
    of_motion = sum(event.kind not in OF_FLOW for event in found.run.events)
    counted = f"{len(found.run.events)}" if found.is_same else f"{len(found.run.events)} / {len(found.events)}"
    figures = [f"{of_motion}", f"{1e6 * found.late:.2f}", f"{1e6 * found.off:.2f}", f"{1e9 * of_step:.3f}"]
    return found.is_good, [case.name, counted, *figures, "yes" if found.is_good else "NO"]


def gas(sets: int, tolerance: float) -> bool:
    """The first of `CASES` beside the independent plant."""
    rows = [row_of(case) for case in CASES[:sets]]
    headings = ("case", "events", "of motion", "late, µs", "pressure, ppm", "of the tolerance, ns", "within")
    show("valves with gas", headings, [row for _, row in rows])
    return all(is_good for is_good, _ in rows)


PARTS: Final = {
    "valves": (valves, 1000), "releases": (releases, 1200), "derivatives": (derivatives, 300), "jumps": (jumping, 2000),
    "gas": (gas, len(CASES)),
}  # fmt: skip
"""What is measured, and on how many."""


def main() -> int:
    """Print the figures; 1 if one is off by more than wanted."""
    known = parser("accuracy", __doc__)
    known.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)} (default: all)")
    known.add_argument("--sets", type=int, help="at most so many of each")
    known.add_argument("--tolerance", type=float, default=TOLERANCE, help="of the events of valves without gas")
    options = known.parse_args()
    if unknown := [name for name in options.parts if name not in PARTS]:
        known.error(f"{unknown[0]}: expected some of {', '.join(PARTS)}")
    chosen = {name: PARTS[name] for name in options.parts or PARTS}
    most = max(count for _, count in PARTS.values()) if options.sets is None else options.sets
    return 0 if all([measure(min(most, count), options.tolerance) for measure, count in chosen.values()]) else 1


if __name__ == "__main__":
    sys.exit(main())
