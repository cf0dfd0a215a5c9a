"""How fast is the core? `python -m benchmarks.core` prints the tables.

At a tolerance of 1e-8; the time that is shown is the best of the turns, as machines change their speed by two within
seconds. Then follow the live stepper, the start, and how far events of random valves are off those at 1e-13.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.speed import DECLARED, DRIVE, FIVE, TIMES, times_in_turn
from valve_sim.model import Drive, Valve, simulate
from valve_sim.model.core.live import Live
from valve_sim.model.core.runs import Directions, run_sloped
from valve_sim.model.core.simulation import run_numbers

TOLERANCE: Final = 1e-8
ROW: Final = 200
"""Valves that are simulated one after the other in a turn."""
MANY: Final = 10_000
STROKE: Final = Drive.of([0.0, 15e-3], [9.0, 0.0])
STROKES: Final = Drive.of(np.arange(16) * 20e-3, [9.0, 0.0] * 8)
SAMPLES: Final = np.arange(1, 601) * 5e-5
FLUX: Final = Valve(
    DECLARED.with_values(a0=6.0, coil_time_constant=2.5e-3).parameters, {"motional_emf": {"share": 1.0}}
)
HEATING: Final = Valve(DECLARED.parameters, {"coil_heating": {"temperature_rate": 100.0, "cooling_time_constant": 1.0}})
SIXTEEN: Final = (
    "pilot_damping", "main_damping", "spring_rate", "spring_preload", "a0", "a1", "a2", "a3", "pilot_mass",
    "moving_mass", "pilot_gap", "stroke", "coil_time_constant", "reference_voltage", "pickup_velocity_ratio",
    "seat_load",
)  # fmt: skip
BY_HAND: Final = 2.5
"""µs that hand-written C takes for the opening: the scale of the targets."""


def batch(valve: Valve, drive: Drive, times: Any) -> Callable[[], object]:
    """A run of `ROW` equal valves on one thread."""
    numbers = np.tile(valve.numbers(), (ROW, 1))
    return lambda: run_numbers(valve, numbers, drive, times, tolerance=TOLERANCE, threads=1)


def derivatives(count: int, samples: int) -> Callable[[], object]:
    """Eight strokes with derivatives by so many parameters, once."""
    times, valve = np.linspace(1e-4, 0.32, samples), DECLARED.with_values(seat_load=0.3)
    directions = Directions.of(valve, STROKES, SIXTEEN[:count])
    return lambda: run_sloped(valve, STROKES, times, directions, tolerance=TOLERANCE)


def measure(turns: int) -> Table:
    """The times of runs, one after the other."""
    eight = batch(DECLARED.with_values(seat_load=0.3), STROKES, np.linspace(1e-4, 0.32, 100))
    cases: Mapping[str, tuple[Callable[[], object], int, str]] = {
        "opening, 150 samples": (batch(DECLARED, DRIVE, TIMES), ROW, "5"),
        "simulate(), all outputs": (
            lambda: [simulate(DECLARED, DRIVE, TIMES, tolerance=TOLERANCE) for _ in range(ROW)], ROW, "15",
        ),
        "five effects": (batch(FIVE, DRIVE, TIMES), ROW, "6.5"),
        "flux": (batch(FLUX, DRIVE, TIMES), ROW, "9.5"),
        "heating": (batch(HEATING, DRIVE, TIMES), ROW, ""),
        "stroke, 600 samples": (batch(DECLARED, STROKE, SAMPLES), ROW, "12"),
        "eight strokes, 100 samples": (eight, ROW, ""),
        "  with 4 derivatives": (derivatives(4, 100), 1, "250"),
        "  with 16 derivatives": (derivatives(16, 100), 1, "350"),
    }  # fmt: skip
    table = Table("what", "µs", "wanted, µs", title="at 1e-8, one thread")
    durations = times_in_turn([work for work, _, _ in cases.values()], turns)
    for (name, (_, count, wanted)), own in zip(cases.items(), durations.T, strict=True):
        table.add_row(name, f"{own.min() / count * 1e6:.2f}", wanted)
    return table


def many(turns: int) -> Table:
    """Ten thousand valves on one and two threads."""
    random = np.random.default_rng(1)
    valve = DECLARED
    names = valve.plan().parameters
    numbers = np.tile(valve.numbers(), (MANY, 1))
    numbers[:, names.index("pilot_damping")] = random.uniform(0.5, 2.0, MANY)
    numbers[:, names.index("main_damping")] = random.uniform(2.0, 8.0, MANY)
    works = [lambda n=n: run_numbers(valve, numbers, DRIVE, TIMES, tolerance=TOLERANCE, threads=n) for n in (1, 2)]
    durations = times_in_turn(works, turns) / MANY * 1e6
    table = Table("10,000 openings", "µs each", "ratio", "wanted", title="batch")
    table.add_row("one thread", f"{durations[:, 0].min():.2f}", "", "2 µs")
    table.add_row(
        "two threads", f"{durations[:, 1].min():.2f}", f"{np.median(durations[:, 0] / durations[:, 1]):.2f}", "≥ 1.8"
    )
    return table


def live(steps: int) -> Table:
    """Live steps of 1 ms by the raw entry."""
    table = Table("live steps of 1 ms", "µs", "wanted, µs", title="raw entry")
    for name, every, wanted in (
        ("idle", 0, "0.38"),
        ("a stroke every 50 ms", 25, "0.73"),
        ("a command every ms", 1, "2.9"),
    ):
        best = float("inf")
        for _ in range(7):
            valve, volts = Live.at_rest(DECLARED, 0.0, TOLERANCE), 0.0
            advance, command = valve.advance, valve._command
            start = time.perf_counter()
            for step in range(steps):
                if every and step % every == 0:
                    volts = 9.0 - volts
                    command(step * 1e-3, volts)
                else:
                    advance(step * 1e-3)
            best = min(best, (time.perf_counter() - start) / steps * 1e6)
        table.add_row(name, f"{best:.2f}", wanted)
    return table


START: Final = """
import time
begin = time.process_time()
from valve_sim.model import Valve, simulate
from valve_sim.model.drives import step
imported = time.process_time()
simulate(Valve(effects={effects}), step(9.0), [0.01])
print(imported - begin, time.process_time() - imported)
"""


def starts() -> Table:
    """Processor time of the first result of a process, with an empty cache and with a full one."""
    table = Table("start", "imports, s", "first result, s", "then, s", title="processor time")
    sets: Mapping[str, dict[str, dict[str, float]]] = {
        "default": {}, "one effect": {"coulomb_friction": {"force": 0.1}},
        "five effects": {key: dict(values) for key, values in FIVE.effects.items()},
    }  # fmt: skip
    for name, effects in sets.items():
        with tempfile.TemporaryDirectory() as folder:
            environment = {**os.environ, "VALVE_SIM_CACHE": f"{folder}/cache"}
            found = [
                subprocess.run(
                    [sys.executable, "-c", START.replace("{effects}", repr(effects))], env=environment, check=True,
                    capture_output=True, text=True,
                ).stdout.split()
                for _ in range(2)
            ]  # fmt: skip
        table.add_row(name, f"{float(found[0][0]):.2f}", f"{float(found[0][1]):.2f}", f"{float(found[1][1]):.3f}")
    return table


def accuracy(count: int) -> Table:
    """How far events of random valves are off those at 1e-13, at the default tolerance."""
    sys.path.insert(0, "test")
    from model.core.cases import drawn

    table = Table(
        "random valves", "events", "worst, s", "median of the worst, s", "other events", title="accuracy at 1e-8"
    )
    for kind in ("random", "flux", "release"):
        worst, events, other = [], 0, 0
        for seed in range(count):
            valve, drive, _ = drawn(kind, seed)
            found, exact = (simulate(valve, drive, [0.05], tolerance=t).events for t in (TOLERANCE, 1e-13))
            if [event.kind for event in found] != [event.kind for event in exact]:
                other += 1
                continue
            events += len(exact)
            worst.append(max((abs(a.time - b.time) for a, b in zip(found, exact, strict=True)), default=0.0))
        table.add_row(kind, str(events), f"{max(worst):.1e}", f"{np.median(worst):.1e}", str(other))
    return table


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=30)
    parser.add_argument("--valves", type=int, default=300)
    asked = parser.parse_args()
    console = Console()
    for table in (
        lambda: measure(asked.turns), lambda: many(5), lambda: live(5000), starts, lambda: accuracy(asked.valves),
    ):  # fmt: skip
        console.print(table())


if __name__ == "__main__":
    main()
