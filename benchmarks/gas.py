"""A valve with gas: the core against an independent implicit integration, its cost, and random sets that must end.

`python -m benchmarks.gas` prints 20 cases: events, differences of event times and pressure from test/plants/gas.py, and
what the tolerance leaves of event times. `--random 1000` simulates as many random valves and counts those that do not
end. `--cost` prints the CPU time of each case, with derivatives, too.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import TOLERANCE, Drive, EventKind, Response, SimulationError, Valve, simulate
from valve_sim.model.core.runs import Directions, Run
from valve_sim.model.core.simulation import commands_of
from valve_sim.model.gas import GasParameters

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from plants.gas import GasValve

OPENING: Final = ((0.0, 9.0),)
STROKE: Final = ((0.0, 9.0), (0.1, 0.0))
BASE: Final = GasParameters(
    inlet_pressure=35e6, outlet_volume=1e-5, pilot_orifice_diameter=0.2e-3, main_orifice_diameter=3e-3,
    seat_diameter=4e-3,
)  # fmt: skip
FINEST: Final = 3e-13
"""Tolerance of a step, for comparison."""
DERIVATIVES: Final = (
    "pilot_damping", "main_damping", "spring_rate", "spring_preload", "a0", "a1", "a2", "a3", "pilot_mass",
    "moving_mass", "coil_time_constant", "seat_load", "gas.outlet_volume", "gas.pilot_orifice_diameter",
    "gas.discharge_coefficient", "gas.inlet_pressure",
)  # fmt: skip
OF_FLOW: Final = (EventKind.FLOW_CHOKED, EventKind.FLOW_SUBSONIC, EventKind.FLOW_REVERSED)


class Case(NamedTuple):
    """One run: a name, what differs from `BASE`, commands (s, V), how long (s), leak (m²), and clogging."""

    name: str
    gas: dict[str, float]
    drive: tuple[tuple[float, float], ...] = OPENING
    end: float = 0.6
    leak: float = 0.0
    clogging: float = 1.0


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


def valve_of(case: Case) -> Valve:
    """The default valve with a seat load, the case's gas, and its leak and clogging."""
    effects = {"seat_leak": {"area": case.leak}} if case.leak else {}
    if case.clogging != 1.0:
        effects["pilot_clogging"] = {"ratio": case.clogging}
    return replace(default_valve().exact().with_values(seat_load=0.3), gas=BASE._replace(**case.gas), effects=effects)


def drive_of(case: Case) -> Drive:
    """Its commands."""
    return Drive.of(*zip(*case.drive, strict=True))


def ours(case: Case, times: Any, tolerance: float = TOLERANCE) -> Response:
    """Run the core."""
    return simulate(valve_of(case), drive_of(case), times, start_time=0.0, tolerance=tolerance)


def theirs(case: Case, times: Any) -> tuple[list[tuple[float, str]], Any]:
    """Run the independent plant."""
    valve = valve_of(case)
    assert valve.gas is not None
    gas = {name: value for name, value in valve.gas._asdict().items() if name != "fluid"}
    plant = GasValve(valve.parameters._asdict(), gas, case.leak, case.clogging)
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
    row = [case.name, counted, *figures, "yes" if is_good else "NO"]
    if not same:
        print(case.name, found, expected, sep="\n  ")
    return is_good, row


def random_case(seed: int) -> Case:
    """A valve with gas of any size, that opens and closes, or does neither."""
    draw = np.random.default_rng(seed)
    inlet = 10.0 ** draw.uniform(5.5, 8.0)
    pilot = 10.0 ** draw.uniform(-4.3, -2.8)
    gas = {
        "inlet_pressure": inlet,
        "outlet_pressure": inlet * draw.choice([draw.uniform(0.01, 1.5), 1.0, 1.0 - 1e-6]),
        "outlet_volume": 10.0 ** draw.uniform(-6.5, -3.0),
        "pilot_orifice_diameter": pilot,
        "main_orifice_diameter": pilot * draw.uniform(1.0, 20.0),
        "seat_diameter": pilot * draw.uniform(1.0, 30.0),
        "demand_orifice_diameter": draw.choice([0.0, 10.0 ** draw.uniform(-5.0, -2.5)]),
        "demand_pressure": inlet * draw.choice([draw.uniform(0.001, 1.2), 1.0]),
    }
    volts = draw.uniform(5.0, 16.0)
    return Case(
        f"{seed}", gas, ((0.0, volts), (draw.uniform(0.01, 0.5), 0.0)), 1.0, draw.choice([0.0, 1e-9]),
        draw.uniform(0.3, 1.0),
    )  # fmt: skip


def random_sets(count: int, first: int = 0) -> None:
    """Simulate random valves; say which do not end, and the most events of one."""
    failed, most, started = [], 0, time.process_time()
    for seed in range(first, first + count):
        try:
            run = ours(random_case(seed), np.linspace(0.01, 1.0, 100))
        except SimulationError as error:
            failed.append((seed, str(error)))
            continue
        most = max(most, len(run.events))
        assert run.outlet_pressure is not None
        if not np.isfinite(run.outlet_pressure).all():
            failed.append((seed, "not finite"))
    spent = time.process_time() - started
    print(f"{count} random sets of 1 s: {len(failed)} did not end {failed[:5]}; at most {most} events")
    print(f"{1e3 * spent / count:.2f} ms of CPU each")


def cost() -> None:
    """CPU time of every case without samples inside, and of one with derivatives."""
    for case in CASES:
        valve, commands = valve_of(case), commands_of(drive_of(case))
        spent = [
            least(valve, commands, case.end, along)
            for along in (None, *(Directions.of(valve, drive_of(case), DERIVATIVES[:k]) for k in (4, 16)))
        ]
        print(f"{case.name:46s} {spent[0]:8.0f} µs; with 4 derivatives {spent[1]:.0f}, with 16 {spent[2]:.0f} µs")


def least(valve: Valve, commands: Any, end: float, along: Directions | None) -> float:
    """The least CPU time of some runs, µs."""
    spent = []
    for _ in range(10):
        run = Run(valve, 0.0, tolerance=TOLERANCE, directions=along)
        began = time.process_time()
        run.piece(commands, end, np.array([end]))
        spent.append(time.process_time() - began)
    return 1e6 * min(spent)


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--random", type=int, default=0, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--cost", action="store_true")
    arguments = parser.parse_args()
    if arguments.random:
        random_sets(arguments.random, arguments.first)
    if arguments.cost:
        cost()
    if arguments.random or arguments.cost:
        return
    table = Table("case", "events", "of motion", "late, µs", "pressure, ppm", "of tolerance, ns", "within")
    good = 0
    for case in CASES:
        is_good, row = compare(case)
        good += is_good
        table.add_row(*row)
    Console(width=140).print(table)
    print(f"{good} of {len(CASES)} within 5 µs + 0.1 % and 0.2 % of pressure")


if __name__ == "__main__":
    main()
