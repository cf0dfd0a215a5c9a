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
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from model import jumps
from model.derivatives import ACCURACY, errors_of
from model.derivatives import random_case as random_derivatives
from model.flux_cases import differences as differences_of_release
from model.flux_cases import random_release
from model.gas.cases import gas_valve
from model.random_valves import TIMES, random_valve
from model.reference import reference
from plants.gas import GasValve

from benchmarks.common import parser, say, show
from valve_sim.model import TOLERANCE, Drive, EventKind, Response, Valve, simulate

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

OPENING: Final = ((0.0, 9.0),)
STROKE: Final = ((0.0, 9.0), (0.1, 0.0))
OF_FLOW: Final = (EventKind.FLOW_CHOKED, EventKind.FLOW_SUBSONIC, EventKind.FLOW_REVERSED)


class Case(NamedTuple):
    """One run: a name, what differs from `gas_valve()`, commands (s, V), how long (s), leak (m²), and clogging."""

    name: str
    gas: dict[str, float]
    drive: tuple[tuple[float, float], ...] = OPENING
    end: float = 0.6
    leak: float = 0.0
    clogging: float = 1.0

    @property
    def valve(self) -> Valve:
        """The default valve with a seat load and this gas."""
        return gas_valve(**self.gas)


CASES: Final = (
    Case("2 MPa, 10 cm³, dead end", {"inlet_pressure": 2e6}),
    Case("10 MPa, 10 cm³, dead end", {"inlet_pressure": 10e6}),
    Case("35 MPa, 10 cm³, dead end", {}),
    Case("50 MPa, 10 cm³, dead end", {"inlet_pressure": 50e6}),
    Case("70 MPa, 10 cm³, dead end", {"inlet_pressure": 70e6}),
    Case("87.5 MPa, 0.18 mm, dead end", {"inlet_pressure": 87.5e6, "pilot_orifice_diameter": 0.18e-3}),
    Case("35 MPa, 50 cm³, 0.25 mm", {"outlet_volume": 5e-5, "pilot_orifice_diameter": 0.25e-3}, end=1.8),
    Case("35 MPa, 200 cm³", {"outlet_volume": 2e-4}, end=2.0),
    Case("2 MPa, demand 0.1 mm", {"inlet_pressure": 2e6, "demand_orifice_diameter": 0.1e-3}),
    Case("35 MPa, demand 0.05 mm", {"demand_orifice_diameter": 0.05e-3}, end=0.8),
    Case("35 MPa, demand too large to lift", {"demand_orifice_diameter": 0.2e-3}),
    Case("70 MPa, too weak to leave the seat", {"inlet_pressure": 70e6, "pilot_orifice_diameter": 0.23e-3}, end=0.1),
    Case("too weak to lift: spring and gas win at 5.5 V", {"inlet_pressure": 5e6}, ((0.0, 5.5),), 0.4),
    Case("released while it waits", {}, STROKE, 0.3),
    Case("released while it flows", {
        "inlet_pressure": 2e6, "demand_orifice_diameter": 0.5e-3, "pilot_orifice_diameter": 1e-3}, STROKE, 0.3),
    Case("flows back, 2 to 3 MPa", {"inlet_pressure": 2e6, "outlet_pressure": 3e6}, end=0.2),
    Case("flows back choked, 2 to 20 MPa", {"inlet_pressure": 2e6, "outlet_pressure": 20e6}, end=0.3),
    Case("nearly equal from the start", {"outlet_pressure": 35e6 - 100.0}, end=0.1),
    Case("leak of 0.1 mm", {"inlet_pressure": 10e6}, end=0.3, leak=7.85e-9),
    Case("pilot clogged to 60 %", {}, end=0.9, clogging=0.6),
)  # fmt: skip


def ours(case: Case, times: Any, tolerance: float = TOLERANCE) -> Response:
    """Run the core; SimulationError where it comes to no end."""
    effects = {"seat_leak": {"area": case.leak}, "pilot_clogging": {"ratio": case.clogging}}
    drive = Drive.of(*zip(*case.drive, strict=True))
    return simulate(replace(case.valve, effects=effects), drive, times, start_time=0.0, tolerance=tolerance)


def theirs(case: Case, times: Any) -> tuple[list[tuple[float, str]], Any]:
    """Run the independent plant."""
    valve = case.valve
    assert valve.gas is not None
    sizes = {name: value for name, value in valve.gas._asdict().items() if name != "fluid"}
    plant = GasValve(valve.parameters._asdict(), sizes, case.leak, case.clogging)
    pressure = plant.run(case.drive, times)[1]
    return sorted(plant.events), pressure


def compare(case: Case) -> tuple[bool, list[str]]:
    """Whether a case is within its bounds, and its row of the table."""
    times = np.linspace(case.end / 400, case.end, 400)
    run, finest = ours(case, times), ours(case, times, FINEST)
    expected, pressure = theirs(case, times)
    found = sorted((event.time, event.kind.name) for event in run.events)
    same = [kind for _, kind in found] == [kind for _, kind in expected]
    pairs = list(zip(found, expected, strict=False))
    worst = max((abs(a - b) / (5e-6 + 1e-3 * b) for (a, _), (b, _) in pairs), default=0.0)
    late = max((abs(a - b) for (a, _), (b, _) in pairs), default=0.0)
    off = float(np.abs(run.outlet_pressure / pressure - 1.0).max())
    of_step = max((abs(a.time - b.time) for a, b in zip(run.events, finest.events, strict=False)), default=0.0)
    of_motion = sum(event.kind not in OF_FLOW for event in run.events)
    is_good = same and worst <= 1.0 and off <= 2e-3
    counted = f"{len(found)}" if same else f"{len(found)} / {len(expected)}"
    figures = [f"{of_motion}", f"{1e6 * late:.2f}", f"{1e6 * off:.2f}", f"{1e9 * of_step:.3f}"]
    return is_good, [case.name, counted, *figures, "yes" if is_good else "NO"]


def gas(sets: int, tolerance: float) -> bool:
    """The first of `CASES` beside the independent plant."""
    rows = [compare(case) for case in CASES[:sets]]
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
