"""How fast are the model and the commands? `python -m benchmarks.speed` prints all tables, or those named.

core: runs at a tolerance of 1e-8 on one thread, per run; then 10,000 openings on one and on two threads. The best of
the turns is shown, as machines change their speed by two within seconds.
solvers: one opening (15 ms at 9 V, 150 outputs) in the core, by one call of `simulate`, and by SciPy RK45 with
events, in turns; a ratio is the median of those of each turn.
live: steps of 1 ms of the live valve.
whole: `identify` and `diagnose` on shipped recordings as new processes, CPU time.

Exits 1 where a figure falls short.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.common import parser, show
from benchmarks.other_solvers import TIMES, TOLERANCE, scipy_opening
from valve_sim.model import Drive, EventKind, Valve, simulate
from valve_sim.model.live import Live
from valve_sim.model.runs import Directions, Run
from valve_sim.model.simulation import commands_of, run_numbers

Work = Callable[[], object]
DRIVE: Final = Drive.of([0.0], [9.0])
STROKE: Final = Drive.of([0.0, 15e-3], [9.0, 0.0])
STROKES: Final = Drive.of(np.arange(16) * 20e-3, [9.0, 0.0] * 8)
SAMPLES: Final = np.arange(1, 601) * 5e-5
ROW, CALLS, MANY = 200, 100, 10_000
"""Valves that are simulated one after the other in a turn; calls of `simulate` in one; openings of a batch."""
DECLARED: Final = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
SEATED: Final = DECLARED.with_values(seat_load=0.3)
FIVE: Final = Valve(
    DECLARED.parameters,
    {
        "coulomb_friction": {"force": 0.05},
        "quadratic_drag": {"coefficient": 2.0},
        "eddy_lag": {"time_constant": 2e-4},
        "pressure_force": {"force": 0.2, "equalisation_time": 5e-3},
        "magnetic_saturation": {"current": 5.0},
    },
)
FLUX: Final = Valve(
    DECLARED.with_values(a0=6.0, coil_time_constant=2.5e-3).parameters, {"motional_emf": {"share": 1.0}}
)
HEATING: Final = Valve(DECLARED.parameters, {"coil_heating": {"temperature_rate": 100.0, "cooling_time_constant": 1.0}})
SIXTEEN: Final = (
    "pilot_damping", "main_damping", "spring_rate", "spring_preload", "a0", "a1", "a2", "a3", "pilot_mass",
    "moving_mass", "pilot_gap", "stroke", "coil_time_constant", "reference_voltage", "pickup_velocity_ratio",
    "seat_load",
)  # fmt: skip


class Row(NamedTuple):
    """One line: cells, and whether the figure is as wanted, None where nothing is."""

    cells: tuple[str, ...]
    is_met: bool | None = None


class Part(NamedTuple):
    """A table: its title and headings, and what measures its rows."""

    title: str
    headings: tuple[str, ...]
    measure: Callable[[argparse.Namespace], Sequence[Row]]


def times_in_turn(works: Sequence[Work], turns: int) -> Any:
    """(turns, k) durations of each call, s, one after the other, after a turn for warm-up."""
    durations = np.empty((turns + 1, len(works)))
    for turn, index in itertools.product(range(turns + 1), range(len(works))):
        start = time.perf_counter()
        works[index]()
        durations[turn, index] = time.perf_counter() - start
    return durations[1:]


def wanted(name: str, value: float, most: float, unit: str = "µs") -> Row:
    """A row of a figure that may be at most so large; 0: nothing is wanted."""
    return Row((name, f"{value:.2f} {unit}", f"{most:g}" if most else ""), value <= most if most else None)


# --- the model --------------------------------------------------------------------------------------------------------


def batch(valve: Valve, drive: Drive, times: Any, count: int = ROW, threads: int = 1) -> Work:
    """A run of equal valves, one after the other on each thread."""
    numbers = np.tile(valve.numbers(), (count, 1))
    return lambda: run_numbers(valve, numbers, drive, times, tolerance=TOLERANCE, threads=threads)


def sloped() -> Work:
    """Eight strokes of 100 samples with derivatives by sixteen parameters, once."""
    directions, times = Directions.of(SEATED, STROKES, SIXTEEN), np.linspace(1e-4, 0.32, 100)
    return lambda: Run(SEATED, 0.0, directions=directions).piece(commands_of(STROKES), times[-1], times)


def core(options: argparse.Namespace) -> list[Row]:
    """Runs of the core, µs each, and of a batch."""
    eight = batch(SEATED, STROKES, np.linspace(1e-4, 0.32, 100))
    cases: Mapping[str, tuple[Work, int, float]] = {
        "opening, 150 samples": (batch(DECLARED, DRIVE, TIMES), ROW, 5.0),
        "simulate(), all outputs": (
            lambda: [simulate(DECLARED, DRIVE, TIMES, tolerance=TOLERANCE) for _ in range(ROW)], ROW, 15.0,
        ),
        "five effects": (batch(FIVE, DRIVE, TIMES), ROW, 6.5),
        "flux": (batch(FLUX, DRIVE, TIMES), ROW, 9.5),
        "heating": (batch(HEATING, DRIVE, TIMES), ROW, 0.0),
        "stroke, 600 samples": (batch(DECLARED, STROKE, SAMPLES), ROW, 12.0),
        "eight strokes, 100 samples": (eight, ROW, 0.0),
        "  with 16 derivatives": (sloped(), 1, 350.0),
        "10,000 openings, one thread": (batch(DECLARED, DRIVE, TIMES, MANY), MANY, 2.0),
        "  two threads": (batch(DECLARED, DRIVE, TIMES, MANY, 2), MANY, 0.0),
    }  # fmt: skip
    durations = times_in_turn([work for work, _, _ in cases.values()], options.turns)
    rows = [
        wanted(name, own.min() / count * 1e6, most)
        for (name, (_, count, most)), own in zip(cases.items(), durations.T, strict=True)
    ]
    ratio = float(np.median(durations[:, -2] / durations[:, -1]))
    return [*rows, Row(("  one over two threads", f"{ratio:.2f}", "≥ 1.8"), ratio >= 1.8)]


def event_times(valve: Valve, tolerance: float = TOLERANCE) -> tuple[float, float]:
    """When the opening valve's pilot takes up the main plunger and when both reach the stop, s."""
    response = simulate(valve, DRIVE, TIMES, tolerance=tolerance)
    return response.first(EventKind.PICKED_UP), response.first(EventKind.REACHED_STOP)


def solvers(options: argparse.Namespace) -> list[Row]:
    """One opening beside other solvers: time, ratio to the core, and the error of both events against 1e-13."""
    rows = []
    for name, valve, least in (("declared", DECLARED, 1000.0), ("five effects", FIVE, 0.0)):
        others: dict[str, Callable[[Valve], tuple[float, float]]] = {"SciPy RK45": scipy_opening}
        works: list[Work] = [
            batch(valve, DRIVE, TIMES),
            lambda valve=valve: [simulate(valve, DRIVE, TIMES, tolerance=TOLERANCE) for _ in range(CALLS)],
            *(partial(opening, valve) for opening in others.values()),
        ]  # fmt: skip
        times = times_in_turn(works, options.turns) / [ROW, CALLS, *[1] * len(others)]
        found = {"core": event_times, "simulate()": event_times, **others}
        exact = event_times(valve, 1e-13)
        for index, (what, opening) in enumerate(found.items()):
            ratio = float(np.median(times[:, index] / times[:, 0]))
            error = max(abs(a - b) for a, b in zip(opening(valve), exact, strict=True))
            cells = (f"{name}: {what}", f"{1e6 * np.median(times[:, index]):.1f}", f"{ratio:.0f}", f"{error:.1e}")
            is_judged = what == "SciPy RK45" and least > 0.0
            rows.append(Row((*cells, f"≥ {least:g}" if is_judged else ""), ratio >= least if is_judged else None))
    return rows


def live(options: argparse.Namespace) -> list[Row]:
    """Steps of 1 ms by the raw entry, µs each."""
    rows = []
    for name, every, most in (("idle", 0, 0.8), ("a stroke every 50 ms", 25, 1.2), ("a command every ms", 1, 3.4)):
        best = float("inf")
        for _ in range(7):
            valve, volts, steps = Live.at_rest(DECLARED, 0.0, TOLERANCE), 0.0, 5000
            start = time.perf_counter()
            for step in range(steps):
                if every and step % every == 0:
                    volts = 9.0 - volts
                    valve._command(step * 1e-3, volts)  # the raw entry, which takes the time
                else:
                    valve.advance(step * 1e-3)
            best = min(best, (time.perf_counter() - start) / steps * 1e6)
        rows.append(wanted(name, best, most))
    return rows


SHIPPED: Final = Path(__file__).parents[1]


def whole(options: argparse.Namespace) -> list[Row]:
    """CPU seconds of commands on shipped recordings: with an empty cache of compiled code, and with a full one."""
    rows = []
    for name in ("identify bags/eight_strokes.mcap", "diagnose bags/eight_strokes.mcap", "diagnose bags/friction"):
        with tempfile.TemporaryDirectory(prefix="valve_sim-") as place:
            command, bag = name.split()
            words = [command, str(SHIPPED / bag), "--output", f"{place}/results"]
            with patch.dict(os.environ, {"VALVE_SIM_CACHE": f"{place}/cache"}):
                empty, full = (run(words, Path(place) / "log") for _ in range(2))
        rows.append(Row((name, f"{empty:.1f}", f"{full:.1f}"), None))
    return rows


def run(command: Sequence[str], log: Path) -> float:
    """CPU time, s, of `valve-sim` in a new process; SystemExit with its words where it fails."""
    with log.open("w") as words:
        process = os.posix_spawn(
            sys.executable,
            [sys.executable, "-m", "valve_sim", *command],
            os.environ,
            file_actions=[(os.POSIX_SPAWN_DUP2, words.fileno(), number) for number in (1, 2)],
        )
    _, status, usage = os.wait4(process, 0)
    if status != 0:
        raise SystemExit(f"valve-sim {' '.join(command)} failed:\n{log.read_text()[-2000:]}")
    return float(usage.ru_utime + usage.ru_stime)


PARTS: Final[Mapping[str, Part]] = {
    "core": Part("runs at 1e-8, one thread", ("what", "each", "wanted"), core),
    "solvers": Part("15 ms opening, 150 outputs, 1e-8", ("what", "µs", "ratio", "event error, s", "wanted"), solvers),
    "live": Part("live steps of 1 ms", ("what", "each", "wanted"), live),
    "whole": Part("whole commands, CPU s", ("command", "nothing compiled", "compiled"), whole),
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; 1 if a figure falls short."""
    known = parser("speed", __doc__)
    known.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join(PARTS)} (default: all)")
    known.add_argument("--turns", type=int, default=30, help="of what is timed in turns (default: 30)")
    options = known.parse_args(arguments)
    if unknown := [name for name in options.parts if name not in PARTS]:
        known.error(f"{unknown[0]}: expected some of {', '.join(PARTS)}")
    is_good = True
    for name in options.parts or PARTS:
        part = PARTS[name]
        rows = part.measure(options)
        verdicts = {None: "", True: "good", False: "SHORT"}
        show(part.title, (*part.headings, ""), [(*row.cells, verdicts[row.is_met]) for row in rows])
        is_good = is_good and all(row.is_met is not False for row in rows)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
