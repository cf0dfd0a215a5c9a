"""How much of a force without a name is inside its band of two standard errors? `python -m benchmarks.curve_bands`.

Every seed is a bump of force at a place of the stroke, recorded by the independent plant of test/plants: the campaign's
`uncatalogued` bumps with their four kinds of noise. A curve over the position is fitted to each. At each sample in
motion it is asked whether the true force is within two standard errors of the curve. Wanted: 92 to 98 % on average
over the positions that were visited, of all recordings. Needs no ROS.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from benchmarks.campaign.cases import Case, draw_case
from benchmarks.campaign.effects import UNCATALOGUED
from benchmarks.campaign.running import as_trace
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Array, ForceMap
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.force_maps import describe, fit_maps
from valve_sim.identification.selection.search import Search

BUMP: Final = "force_bump"
WANTED: Final = (0.92, 0.98)
MOVES: Final = 0.02
"""Share of the fastest speed from which on the plunger counts as moving."""
NEAR: Final = 1.5
"""Widths of the bump about its centre that are also counted by themselves."""
STANDARD_ERRORS: Final = 2.0


class OverPosition(ValvePlant):
    """A valve of which only a curve over the position is tried."""

    @property
    def force_maps(self) -> Sequence[ForceMap]:
        """That one."""
        return [choice for choice in super().force_maps if choice.variable == "x"]


class Held(NamedTuple):
    """Shares of the samples at which the true force is inside the band: of all in motion, and near the bump."""

    everywhere: float
    near: float


def held_by_band(case: Case) -> Held:
    """Fit the curve to the first recording of a case and compare."""
    plant = OverPosition([as_trace(case.recordings()[0], case.name)], case.declared)
    base = Search(Problem(plant)).fit(())
    found = fit_maps(base, (), lambda what, fraction: None)[0]
    curve = describe(found.choice, found.fit, base)
    visited = _visited(found.fit)
    truth = case.truth[BUMP]
    places = (visited - truth["centre"]) / truth["width"]
    force, error = (np.interp(visited, curve.at, values) for values in (curve.force, curve.stderr))
    is_held = np.abs(force - truth["amplitude"] * np.exp(-(places**2))) < STANDARD_ERRORS * error
    return Held(float(np.mean(is_held)), float(np.mean(is_held[np.abs(places) < NEAR])))


def _visited(fit: Fit) -> Array:
    """Positions in motion between the stops, m."""
    position, times = fit.problem.plant.predict(fit.values)[0], fit.problem.plant.channels[0].times
    speed = np.abs(np.gradient(position, times))
    return np.asarray(position[speed > MOVES * speed.max()])


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each recording and the means; 1 if these are not what is wanted."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.curve_bands", description=__doc__)
    parser.add_argument("--seeds", type=int, default=30, help="recordings (default: 30)")
    seeds = parser.parse_args(arguments).seeds
    if seeds < 1:
        parser.error(f"--seeds {seeds}: expected at least 1")
    first = list(UNCATALOGUED).index(BUMP)
    found = []
    for seed in range(first, first + seeds * len(UNCATALOGUED), len(UNCATALOGUED)):
        case = draw_case("uncatalogued", seed)
        found.append(held_by_band(case))
        print(f"{case.name:<20}{case.noise:<12}{found[-1].everywhere:>8.1%}{found[-1].near:>8.1%} near", flush=True)
    everywhere, near = np.mean(found, axis=0)
    print(f"{seeds} recordings: {everywhere:.1%} inside the band, near the bump {near:.1%}; wanted 92 to 98 %")
    return 0 if WANTED[0] <= everywhere <= WANTED[1] else 1


if __name__ == "__main__":
    sys.exit(main())
