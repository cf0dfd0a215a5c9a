"""Are the refitted dampings unbiased, and their 95 % intervals honest? `python -m benchmarks.coverage --seeds 200`.

Every seed makes a valve with dampings of its own and a noisy recording of it (eight strokes at 7.5 to 14 V, 20 kHz), by
the independent plant of test/plants: no line of its code is the package's. `identify` then starts from the shipped
valve. Wanted: the mean error within 3 standard errors of the mean, and 92 to 98 % of the intervals holding the truth.
Fewer seeds widen that range to what chance allows. Declared values within their tolerances are the campaign's families
`none_within` and `single_within`. Needs no ROS.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, record, train_profile
from scipy import stats

from benchmarks.campaign.declared import as_trace
from benchmarks.common import parser, say, show
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.model import Valve

RECORDERS = {
    "1 µm white, 0.1 µm steps": Recorder(quantisation=0.1e-6),
    "1 µm AR(1) ρ 0.7, 0.1 µm steps": Recorder(quantisation=0.1e-6, colour=0.7),
    "1 µm white, 5 µm steps": Recorder(quantisation=5e-6),
}
RANGES = {"pilot_damping": (0.5, 2.0), "main_damping": (2.0, 8.0)}
"""N·s/m: half to twice the published value, drawn evenly in the logarithm."""
WANTED_COVERAGE = (0.92, 0.98)
ENOUGH_SEEDS = 200
"""From so many on the wanted range is applied as it is."""
MOST_BIAS = 3.0
"""Standard errors of the mean."""


class Row(NamedTuple):
    """One parameter over all seeds, in one kind of noise.

    Attributes:
        bias: mean error in standard errors of the mean.
        spread: standard deviation of the errors, N·s/m. claimed: mean of the claimed standard errors, N·s/m.
        coverage: share of 95 % intervals that hold the truth. accepted: the range that `coverage` must be in.
    """

    noise: str
    parameter: str
    bias: float
    spread: float
    claimed: float
    coverage: float
    accepted: tuple[float, float]

    @property
    def is_good(self) -> bool:
        """Unbiased and covered."""
        return abs(self.bias) <= MOST_BIAS and self.accepted[0] <= self.coverage <= self.accepted[1]


def true_dampings(seed: int) -> dict[str, float]:
    """The dampings of this seed's valve, N·s/m."""
    random = np.random.default_rng([seed, 1])
    return {name: math.exp(random.uniform(math.log(low), math.log(high))) for name, (low, high) in RANGES.items()}


def refitted(seed: int, recorder: Recorder, valve: Valve) -> list[tuple[float, float, bool]]:
    """Of each damping of a recorded valve: error and standard error, N·s/m, and whether its interval is right."""
    truth = true_dampings(seed)
    recording = record(DeclaredPlant(parameters={**CAMPAIGN_VALVE, **truth}), train_profile(), recorder, seed)
    found = identify([as_trace(recording, f"seed {seed}")], valve).intervals
    pairs = [(found[name], true) for name, true in truth.items()]
    return [(own.value - true, own.stderr, own.low <= true <= own.high) for own, true in pairs]


def accepted_coverage(seeds: int) -> tuple[float, float]:
    """The wanted range; with few seeds, where it is wider, what 99.9 % of their draws give at a true 95 %."""
    if seeds >= ENOUGH_SEEDS:
        return WANTED_COVERAGE
    low, high = stats.binom.interval(0.999, seeds, 0.95)
    return min(WANTED_COVERAGE[0], float(low) / seeds), max(WANTED_COVERAGE[1], float(high) / seeds)


def measure(seeds: int) -> list[Row]:
    """All rows: every kind of noise with the seeds 0 to `seeds` − 1."""
    valve, accepted, rows = default_valve().exact(), accepted_coverage(seeds), []
    for noise, recorder in RECORDERS.items():
        found = np.array([refitted(seed, recorder, valve) for seed in range(seeds)])
        for name, (errors, claimed, covered) in zip(RANGES, found.transpose(1, 2, 0), strict=True):
            spread = float(np.std(errors, ddof=1))
            bias = float(np.mean(errors)) / (spread / math.sqrt(seeds))
            rows.append(Row(noise, name, bias, spread, float(claimed.mean()), float(covered.mean()), accepted))
    return rows


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; 1 if it is short of what is wanted."""
    options = parser("coverage", __doc__)
    options.add_argument("--seeds", type=int, default=200, help="valves for each kind of noise (default: 200)")
    seeds = options.parse_args(arguments).seeds
    if seeds < 2:
        options.error(f"--seeds {seeds}: expected at least 2")
    started = time.perf_counter()
    rows = measure(seeds)
    cells = [
        (row.noise, row.parameter, f"{row.bias:.2f}", f"{row.spread:.5f}", f"{row.claimed:.5f}", f"{row.coverage:.3f}",
         "good" if row.is_good else "SHORT")
        for row in rows
    ]  # fmt: skip
    show("errors, N·s/m", ("noise", "parameter", "bias/SEM", "spread", "claimed", "coverage", ""), cells)
    low, high = accepted_coverage(seeds)
    wanted = f"bias within ±{MOST_BIAS:g} SEM, coverage {low:.3f} to {high:.3f}"
    words = f"{wanted}; {seeds} seeds each, {time.perf_counter() - started:.0f} s"
    return 0 if say(all(row.is_good for row in rows), words) else 1


if __name__ == "__main__":
    raise SystemExit(main())
