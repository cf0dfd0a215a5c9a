"""How fast is the model core? `python -m benchmarks.speed` prints the table; everything is measured in that one run.

One opening: 15 ms at 9 V, 150 outputs, relative tolerance 1e-8, against SciPy RK45 with events and, where it is
installed, scikit-sundae CVODE with root finding. Ours twice: in the core, as a fit or a batch runs it (per valve of
1000 in a row on one thread), and as one call of `simulate`, which also gives velocity, current, attraction, phase and
events as Python objects. Many: 10,000 valves on one and on two threads. Medians after warm-up. SciPy and CVODE solve
the same equations written as plain Python functions, as their users write them.
"""

from __future__ import annotations

import importlib.util
import itertools
import statistics
import time
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.integrate import solve_ivp

from valve_sim.model import Drive, EventKind, Valve, simulate
from valve_sim.model.core.simulation import run_numbers

TIMES: Final = np.linspace(1e-4, 15e-3, 150)
DRIVE: Final = Drive.of([0.0], [9.0])
TOLERANCE: Final = 1e-8
MANY: Final = 10_000
ROW: Final = 1_000
CALLS: Final = 100
"""Of `simulate` in a turn, in which `ROW` valves are simulated by the core."""
TURNS: Final = 100
DECLARED: Final = Valve().with_values(a0=3.0336, coil_time_constant=0.9934e-3)
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


def median_time(work: Callable[[], object], repeats: int) -> float:
    """Median duration of a call, s, after one call for warm-up."""
    work()
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        durations.append(time.perf_counter() - start)
    return statistics.median(durations)


def times_in_turn(works: Sequence[Callable[[], object]], turns: int) -> Any:
    """(turns, k) durations of each call, s, one after the other, after a turn for warm-up."""
    durations = np.empty((turns + 1, len(works)))
    for turn, index in itertools.product(range(turns + 1), range(len(works))):
        start = time.perf_counter()
        works[index]()
        durations[turn, index] = time.perf_counter() - start
    return durations[1:]


def equations(valve: Valve, moving_main: bool, unseated: float) -> Callable[[float, Any], list[float]]:
    """Rates of [x, v, u, w] while opening, in plain Python."""
    d, effects = valve.declared(), valve.effects
    friction = effects.get("coulomb_friction", {}).get("force", 0.0)
    drag = effects.get("quadratic_drag", {}).get("coefficient", 0.0)
    eddy = effects.get("eddy_lag", {}).get("time_constant", 0.0)
    pressure = effects.get("pressure_force", {"force": 0.0, "equalisation_time": 1.0})
    knee = effects.get("magnetic_saturation", {}).get("current", float("inf")) ** -2

    def rates(t: float, y: Any) -> list[float]:
        x, v, u, w = y
        square = (w if eddy else u) ** 2
        square *= (1.0 + knee) / (1.0 + square * knee)
        force = square * (d["a0"] + x * (d["a1"] + x * (d["a2"] + x * d["a3"]))) - friction - drag * v * abs(v)
        if moving_main:
            force -= d["spring_preload"] + d["spring_rate"] * x + d["main_damping"] * v
            if pressure["force"]:
                force -= pressure["force"] * np.exp(-(t - unseated) / pressure["equalisation_time"])
            acceleration = force / d["moving_mass"]
        else:
            acceleration = (force - d["pilot_damping"] * v) / d["pilot_mass"]
        return [v, acceleration, (1.0 - u) / d["coil_time_constant"], (u - w) / eddy if eddy else 0.0]

    return rates


def unseating(valve: Valve) -> tuple[float, Any]:
    """Time, s, and [x, v, u, w] at which the pull exceeds dry friction: SciPy on the coil alone, as RK45 users do."""
    friction = valve.effects.get("coulomb_friction", {}).get("force", 0.0)
    if friction == 0.0:
        return 0.0, np.zeros(4)
    moving = equations(valve, False, 0.0)

    def closed(t: float, y: Any) -> list[float]:
        return [0.0, 0.0, *moving(t, y)[2:]]

    def lift(t: float, y: Any) -> float:
        return moving(t, y)[1]

    lift.terminal = True  # type: ignore[attr-defined]
    solution = solve_ivp(closed, (0.0, TIMES[-1]), np.zeros(4), rtol=TOLERANCE, atol=TOLERANCE * 1e-2, events=lift)
    return float(solution.t_events[0][0]), solution.y_events[0][0]


def scipy_opening(valve: Valve) -> tuple[float, float]:
    """Times of pick-up and stop, s, by SciPy RK45 with two terminal events."""
    start, y, found = *unseating(valve), []
    unseated = start
    for moving_main, contact in ((False, valve.parameters.pilot_gap), (True, valve.parameters.stroke)):

        def reach(_t: float, y: Any, contact: float = contact) -> float:
            return float(y[0] - contact)

        reach.terminal = True  # type: ignore[attr-defined]
        solution = solve_ivp(
            equations(valve, moving_main, unseated), (start, TIMES[-1]), y, method="RK45", rtol=TOLERANCE,
            atol=TOLERANCE * np.array([1e-5, 1e-2, 1e-2, 1e-2]), events=reach, t_eval=TIMES[start < TIMES],
        )  # fmt: skip
        start, y = float(solution.t_events[0][0]), solution.y_events[0][0]
        found.append(start)
    return found[0], found[1]


def _sundae_functions(rates: Callable[[float, Any], list[float]], contact: float) -> tuple[Any, Any]:
    # CVODE counts arguments, defaults too: what differs is closed over here.
    def fill(t: float, y: Any, dy: Any) -> None:
        dy[:] = rates(t, y)

    def reach(_t: float, y: Any, values: Any) -> None:
        values[0] = y[0] - contact

    reach.terminal = [True]  # type: ignore[attr-defined]
    return fill, reach


def sundae_opening(valve: Valve) -> tuple[float, float]:
    """t1 and t2 of the opening by SUNDIALS CVODE with root finding."""
    from sksundae.cvode import CVODE  # an optional extra of this benchmark only

    start, y, found = *unseating(valve), []
    unseated = start
    for moving_main, contact in ((False, valve.parameters.pilot_gap), (True, valve.parameters.stroke)):
        fill, reach = _sundae_functions(equations(valve, moving_main, unseated), contact)
        solver = CVODE(
            fill, rtol=TOLERANCE, atol=TOLERANCE * np.array([1e-5, 1e-2, 1e-2, 1e-2]), eventsfn=reach, num_events=1,
        )  # fmt: skip
        solution = solver.solve(np.concatenate([[start], TIMES[start < TIMES]]), y)
        start, y = float(solution.t_events[0]), solution.y_events[0].copy()
        found.append(start)
    return found[0], found[1]


def event_error(valve: Valve, found: tuple[float, float]) -> float:
    """Largest error of the two event times against the core at 1e-13, s."""
    exact = simulate(valve, DRIVE, TIMES, tolerance=1e-13)
    return max(abs(found[0] - exact.first(EventKind.PICKED_UP)), abs(found[1] - exact.first(EventKind.REACHED_STOP)))


def core_opening(valve: Valve) -> tuple[float, float]:
    """t1 and t2 of the opening by the model core."""
    response = simulate(valve, DRIVE, TIMES, tolerance=TOLERANCE)
    return response.first(EventKind.PICKED_UP), response.first(EventKind.REACHED_STOP)


def add_openings(table: Table, name: str, valve: Valve, wanted: float) -> None:
    """Four rows: the core, one call of `simulate`, and the two others, on the same opening.

    They are timed in turns, and a ratio is the median of those of each turn: machines change their speed by two within
    seconds.
    """
    numbers = np.tile(valve.numbers(), (ROW, 1))
    works: dict[str, Callable[[], object]] = {
        "valve_sim, core": lambda: run_numbers(valve, numbers, DRIVE, TIMES, tolerance=TOLERANCE, threads=1),
        "valve_sim, simulate()": lambda: [simulate(valve, DRIVE, TIMES, tolerance=TOLERANCE) for _ in range(CALLS)],
        "SciPy RK45": lambda: scipy_opening(valve),
    }
    openings, wanted_of = {"valve_sim, core": core_opening, "SciPy RK45": scipy_opening}, {"SciPy RK45": wanted}
    if importlib.util.find_spec("sksundae"):
        works["CVODE"] = lambda: sundae_opening(valve)
        openings["CVODE"], wanted_of["CVODE"] = sundae_opening, 200.0
    times = times_in_turn(list(works.values()), TURNS) / [ROW, CALLS, *[1] * (len(works) - 2)]
    for index, what in enumerate(works):
        ratio = f"{np.median(times[:, index] / times[:, 0]):.0f}"
        error = f"{event_error(valve, openings[what](valve)):.1e}" if what in openings else ""
        least = f"≥ {wanted_of[what]:.0f}" if what in wanted_of else ""
        table.add_row(f"{name}: {what}", f"{1e6 * np.median(times[:, index]):.1f} µs", ratio, least, error)


def add_many(table: Table) -> None:
    """Two rows: ten thousand valves on one and two threads."""
    random = np.random.default_rng(1)
    names, numbers = DECLARED.plan().parameters, np.tile(DECLARED.numbers(), (MANY, 1))
    numbers[:, names.index("pilot_damping")] = random.uniform(0.5, 2.0, MANY)
    numbers[:, names.index("main_damping")] = random.uniform(2.0, 8.0, MANY)
    durations = [
        median_time(lambda n=n: run_numbers(DECLARED, numbers, DRIVE, TIMES, tolerance=TOLERANCE, threads=n), 5)  # type: ignore[misc]
        for n in (1, 2)
    ]
    for threads, duration, wanted in zip((1, 2), durations, ("", "≥ 1.8"), strict=True):
        table.add_row(
            f"{MANY} valves, {threads} thread(s), each", f"{duration / MANY * 1e6:.1f} µs",
            f"{durations[0] / duration:.2f}", wanted, "",
        )  # fmt: skip


def main() -> None:
    """Measure and print."""
    table = Table("what", "time", "ratio", "wanted", "event error, s", title="15 ms opening, 150 outputs, 1e-8")
    add_openings(table, "declared", DECLARED, 300.0)
    add_openings(table, "five effects", FIVE, 150.0)
    add_many(table)
    Console().print(table)


if __name__ == "__main__":
    main()
