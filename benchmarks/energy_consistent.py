"""The paper's two event times with a coil that conserves energy: what the rated power leaves of the other values.

`python -m benchmarks.energy_consistent` solves, for each rated power at the reference voltage, for the attraction at
rest and the coil's time constant with which t1 and t2 are as measured (config/paper_events.yaml), all else as
published; then for a few powers with other dampings. It prints what else the valve does then.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import root

from benchmarks.common import show
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.model import EventKind, SimulationError, Valve, published_times, simulate
from valve_sim.model.drives import step

T1, T2 = 5.3e-3, 9.9e-3
"""s: published."""
POWERS: Final = (
    1e4, 200.0, 100.0, 60.0, 40.0, 30.0, 25.0, 20.0, 16.0, 14.0, 12.0, 11.0, 10.0, 9.5, 9.0, 8.6, 8.3, 8.1, 7.9,
)  # fmt: skip
"""W, falling: each solution is the start of the next."""
DAMPINGS: Final = ((0.0, 0.0), (0.0, 8.0), (3.0, 0.0), (3.0, 8.0), (10.0, 8.0))
LATEST: Final = 0.06
"""s: what has not opened by then never does."""
CLOSE: Final = 1e-9
"""s."""


class Solution(NamedTuple):
    """What closes the table at a rated power, W: attraction at rest, N; time constant, s; the valve."""

    power: float
    a0: float
    time_constant: float
    valve: Valve


def declared(power: float, dampings: tuple[float, float], a0: float, time_constant: float) -> Valve:
    """The published valve with `motional_emf`."""
    printed = load_valve(config_path("published.yaml"))
    valve = printed.with_values(
        a0=a0, coil_time_constant=time_constant, coil_resistance=printed.parameters.reference_voltage**2 / power,
        pilot_damping=dampings[0], main_damping=dampings[1],
    )  # fmt: skip
    return Valve(valve.parameters, {"motional_emf": {"share": 1.0}})


def solve(power: float, start: tuple[float, float], dampings: tuple[float, float] = (1.0, 4.0)) -> Solution | None:
    """What closes the table at a rated power, W, searched from a start (N, s); None where nothing does."""

    def misses(logarithms: np.ndarray) -> np.ndarray:
        a0, time_constant = np.exp(logarithms).tolist()
        try:
            response = simulate(declared(power, dampings, a0, time_constant), step(9.0), [LATEST])
        except SimulationError:
            return np.array([1.0, 1.0])
        t1, t2 = np.nan_to_num(published_times(response), nan=LATEST)
        return 1e3 * np.array([t1 - T1, t2 - t1 - (T2 - T1)])

    found = root(misses, np.log(start), options={"eps": 1e-4, "xtol": 1e-10})
    if np.abs(misses(found.x)).max() > 1e3 * CLOSE:
        return None
    a0, time_constant = np.exp(found.x).tolist()
    return Solution(power, a0, time_constant, declared(power, dampings, a0, time_constant))


def row(solution: Solution) -> tuple[str, ...]:
    """A line of the table."""
    power, a0, time_constant, valve = solution
    response = simulate(valve, step(9.0), np.linspace(0.0, 30e-3, 601))
    opened = response.first(EventKind.REACHED_STOP)
    opening = response.time < opened
    current = response.coil_current * 9.0 / power
    largest = float(np.max(current[response.time < T1 + 1.5e-3]))
    released = simulate(valve, step(9.0, 0.0, LATEST), np.linspace(LATEST, 2.0 * LATEST, 3))
    closed = released.first(EventKind.SEATED, EventKind.BOUNCED_AT_SEAT) - LATEST
    static = float(sum(valve.declared()[f"a{order}"] * valve.parameters.stroke**order for order in range(4)))
    return (
        f"{power:g}", f"{81.0 / power:.2f}", f"{a0:.3f}", f"{1e3 * time_constant:.3f}",
        f"{largest:.2f} to {current[opening][-1]:.2f}", f"{static:.1f}", f"{np.max(response.attraction[opening]):.1f}",
        f"{1e3 * closed:.1f}",
    )  # fmt: skip


def main() -> None:
    """Solve and print."""
    headings = (
        "P, W", "R, Ω", "a0, N", "time constant, ms", "current dips from", "pull at the core, N",
        "largest while opening, N", "closes after, ms",
    )  # fmt: skip
    start, found, rows = (3.04, 1e-3), dict[float, tuple[float, float]](), []
    for power in POWERS:
        solution = solve(power, start)
        if solution is not None:
            start = found[power] = (solution.a0, solution.time_constant)
        rows.append((f"{power:g}", "", "none") if solution is None else row(solution))
    show("t1 = 5.300 and t2 = 9.900 ms at 9 V, dampings as published", headings, rows)
    others = []
    for power in (40.0, 20.0, 12.0, 9.0):
        for dampings in DAMPINGS:
            solution = solve(power, found[power], dampings)
            values = ("none", "") if solution is None else (f"{solution.a0:.2f}", f"{1e3 * solution.time_constant:.2f}")
            others.append((f"{power:g}", f"{dampings[0]:g}", f"{dampings[1]:g}", *values))
    show("with other dampings", ("P, W", "c1, N·s/m", "c2, N·s/m", "a0, N", "time constant, ms"), others)


if __name__ == "__main__":
    main()
