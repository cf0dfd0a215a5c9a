"""What two printed arrivals determine of the paper's valve: `python docs/examples/paper_events.py [PNG]`.

The paper prints when the pilot plunger picks the main plunger up (t1) and when all parts reach the core (t2), at 9 V.
Two numbers can be met by solving for two values, and no residual is left that could be tested.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.optimize import brentq, root

import valve_sim as vs
from valve_sim.model import published_times

ARRIVALS: Final = np.array([5.3e-3, 9.9e-3])
"""s: t1 and t2 as printed, to 0.1 ms."""
STDERR: Final = 0.05e-3
"""s, assumed: half of the last digit printed."""
DAMPINGS: Final = ((0.0, 0.0), (1.0, 4.0), (10.0, 1.0), (1.0, 20.0), (100.0, 20.0))
"""N·s/m: pairs of c1 and c2; the second pair is the published one."""
END: Final = 0.04
"""s: no arrival is looked for later than this."""

published = vs.load_valve(Path(__file__).parents[2] / "config" / "published.yaml")
step = vs.Drive.of([0.0], [9.0])


def arrivals(**values: float) -> NDArray[np.float64]:
    """t1 and t2, s, of the published valve with other values; NaN where a plunger does not arrive."""
    return np.array(published_times(vs.simulate(published.with_values(**values), step, [END])))


def meeting_t1(**values: float) -> float:
    """The pull at rest, N, with which t1 is as printed."""
    late = lambda a0: float(np.nan_to_num(arrivals(a0=a0, **values)[0], nan=END) - ARRIVALS[0])  # noqa: E731
    return float(brentq(late, 0.1, 20.0, xtol=1e-9))


def meeting_both(pilot_damping: float, main_damping: float) -> tuple[float, float]:
    """The pull at rest, N, and the coil's time constant, s, with which both arrivals are as printed."""

    def misfit(scaled: NDArray[np.float64]) -> NDArray[np.float64]:
        found = arrivals(
            a0=scaled[0], coil_time_constant=1e-3 * scaled[1], pilot_damping=pilot_damping, main_damping=main_damping
        )
        return 1e3 * (np.nan_to_num(found, nan=END) - ARRIVALS)

    found = root(misfit, [3.0, 1.0], tol=1e-10)
    if not found.success:
        raise ValueError(f"no pull and lag meet both arrivals at dampings of {pilot_damping} and {main_damping}")
    return float(found.x[0]), 1e-3 * float(found.x[1])


def standard_errors(a0: float, lag: float) -> NDArray[np.float64]:
    """Of the pull at rest, N, and of the coil's time constant, s, by those of the printed arrivals."""
    at, change = {"a0": a0, "coil_time_constant": lag}, []
    for name, value in at.items():
        above, below = (arrivals(**{**at, name: value * factor}) for factor in (1.001, 0.999))
        change.append((above - below) / (0.002 * value))
    return np.asarray(STDERR * np.linalg.norm(np.linalg.inv(np.transpose(change)), axis=1))


def drawn(valves: dict[str, dict[str, float]]) -> Figure:
    """Displacement over time, and the printed arrivals."""
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    axes = figure.subplots()
    times = np.linspace(0.0, 0.013, 1301)
    for words, values in valves.items():
        run = vs.simulate(published.with_values(**values), step, times)
        axes.plot(1e3 * times, 1e6 * run.pilot_position, label=words)
    lifts = [1e6 * published.parameters.pilot_gap, 1e6 * published.parameters.stroke]
    axes.errorbar(1e3 * ARRIVALS, lifts, xerr=1e3 * STDERR, fmt="ko", capsize=3, label="published: 5.3 and 9.9 ms")
    axes.set(xlabel="time after the voltage, ms", ylabel="displacement, µm", title="Opening at 9 V")
    axes.legend(frameon=False, loc="upper left")
    return figure


def main(picture: str = "") -> dict[str, tuple[float, ...]]:
    """Print the table of docs/theory/paper.md; its rows: a0 (N), coil lag (s), c1, c2 (N·s/m), t1, t2 (s)."""
    c1, c2 = published.parameters.pilot_damping, published.parameters.main_damping
    a0 = meeting_t1()
    rows = {"as printed": (0.0, 0.0, c1, c2), "a0": (a0, 0.0, c1, c2), "a0, c2 = 0": (a0, 0.0, c1, 0.0)}
    rows |= {f"a0 and lag, c1 = {own[0]:g}, c2 = {own[1]:g}": (*meeting_both(*own), *own) for own in DAMPINGS}
    names = ("a0", "coil_time_constant", "pilot_damping", "main_damping")
    found = {words: (*row, *arrivals(**dict(zip(names, row, strict=True)))) for words, row in rows.items()}
    print(f"{'added to the published model':<34}{'a0, N':>8}{'lag, ms':>9}{'t1, ms':>9}{'t2, ms':>9}")
    for words, (pull, lag, _, _, t1, t2) in found.items():
        late = "".join("    never" if np.isnan(time) else f"{1e3 * time:9.3f}" for time in (t1, t2))
        print(f"{words:<34}{pull:8.4f}{1e3 * lag:9.4f}{late}")
    pull, lag = meeting_both(c1, c2)
    error, error_of_lag = standard_errors(pull, lag)
    print(f"config/valve.yaml: a0 {pull:.4f} ± {error:.2g} N, coil lag {1e3 * lag:.4f} ± {1e3 * error_of_lag:.2g} ms")
    if picture:
        both = {"a0": pull, "coil_time_constant": lag}
        drawn({"as printed": {}, "a0": {"a0": a0}, "a0 and coil lag": both}).savefig(picture, dpi=110)
    return found


if __name__ == "__main__":
    main(*sys.argv[1:2])
