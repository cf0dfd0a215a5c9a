"""`python -m benchmarks.cross_validation`: leaving strokes out, linearised against refits without each stroke.

Recordings of the campaign's plants, fitted with the declared model, with the missing effect and with others that are
not missing. By how much the criterion rises where each stroke is predicted from the others, once from the Jacobian of
the one fit (theory, eq. (44)) and once from a refit for each stroke; and the processor time of both.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from valve_sim.identification.selection.cross_validation import cross_validate, folds_of, own_nuisances
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.table import Hypothesis

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.running import as_trace
from valve_sim.identification.estimation.gram import sum_squares
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.residual_tests import adequacy

CASES: Final = ("single:0", "single:17", "pair:1", "mismatched:0", "mismatched:11")
OTHERS: Final = ("coulomb_friction", "stiction", "pressure_force", "coil_lag", "squeeze_film", "stop_bounce")
CLOSE: Final = 0.1
"""Share of the larger rise by which the two may differ where the fit explains most."""
EXPLAINS: Final = 1.5
"""χ² per sample up to which a fit explains most."""


class Row(NamedTuple):
    """One fit. rises: linearised and exact, over the variance inflation. seconds: of a processor, likewise."""

    case: str
    words: str
    chi2_per_sample: float
    is_white: bool
    rises: tuple[float, float]
    seconds: tuple[float, float]

    @property
    def is_close(self) -> bool:
        """Whether the two agree, to a tenth or to one unit of χ²."""
        linear, exact = self.rises
        return abs(linear - exact) <= max(1.0, CLOSE * max(linear, exact))


def _restricted(problem: Problem, parts: Sequence[NDArray[np.bool_]]) -> Problem:
    """The same where of the samples that take part only these do."""
    return problem.restricted(lambda index, groups: (problem.weight(index) > 0.0) & parts[index])


def exact_rise(result: Fit) -> float:
    """By how much the criterion rises, from a refit without each stroke in turn."""
    problem, rise = result.problem, 0.0
    sizes = np.cumsum([len(channel.data) for channel in problem.plant.channels])[:-1]
    for fold in folds_of(problem):
        others, alone = (_restricted(problem, np.split(chosen, sizes)) for chosen in (~fold, fold))
        found = fit(others, result.free, result.values, nuisances=result.nuisances)
        own = [result.nuisances[index] for index in own_nuisances(result, fold)]
        names = {nuisance.name for nuisance in own}
        machine = {name: value for name, value in found.values.items() if name not in names}
        predicted = fit(alone, (), {}, nuisances=own, fixed=machine)
        before = sum((result.values[nuisance.name] / nuisance.sigma) ** 2 for nuisance in own)
        rise += predicted.chi2 - before - sum_squares(result.residuals[fold])
    return rise


def examine(name: str) -> list[Row]:
    """The fits of one recording."""
    family, seed = name.split(":")
    case = draw_case(family, int(seed))
    problem = Problem(ValvePlant([as_trace(case.recordings()[0], name)], case.declared))
    search, rows = Search(problem), []
    names = list(dict.fromkeys([*sorted(case.truth)[:1], *OTHERS]))
    for hypothesis in (Hypothesis(()), Hypothesis((), timing=True), *(Hypothesis((effect,)) for effect in names)):
        result = search.fit(hypothesis)
        begun = time.process_time()
        linear = cross_validate(result)
        between = time.process_time()
        exact = exact_rise(result)
        inflation = problem.variance_inflation
        rows.append(
            Row(
                name, str(hypothesis), result.chi2 / inflation / problem.effective_samples, adequacy(result).is_white,
                (math.nan if linear is None else linear.rise / inflation, exact / inflation),
                (between - begun, time.process_time() - between),
            )
        )  # fmt: skip
    return rows


def main() -> int:
    """Print the table; 1 where they disagree for a fit that explains most."""
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    print(f"{'recording':<15}{'model':<62}{'χ²/n':>9}{'white':>7}{'linear':>11}{'exact':>11}{'ms':>8}{'ms':>8}")
    rows: list[Row] = []
    for name in CASES:
        for row in examine(name):
            rows.append(row)
            ms = [f"{1e3 * seconds:8.0f}" for seconds in row.seconds]
            white = "yes" if row.is_white else "no"
            print(
                f"{row.case:<15}{row.words:<62}{row.chi2_per_sample:9.3f}{white:>7}"
                f"{row.rises[0]:11.1f}{row.rises[1]:11.1f}{ms[0]}{ms[1]}",
                flush=True,
            )
    near = [row for row in rows if row.chi2_per_sample <= EXPLAINS]
    far = [row for row in rows if row.chi2_per_sample > EXPLAINS]
    for words, some in ((f"χ²/n ≤ {EXPLAINS}", near), (f"χ²/n > {EXPLAINS}", far)):
        ratios = [row.rises[0] / row.rises[1] for row in some]
        print(
            f"{words}: {sum(row.is_close for row in some)} of {len(some)} agree to a tenth; "
            f"linear over exact {min(ratios):.2f} to {max(ratios):.2f}, median {np.median(ratios):.2f}"
        )
    spent: Array = np.sum([row.seconds for row in rows], axis=0)
    print(f"processor time: exact over linear {spent[1] / spent[0]:.0f}")
    return 0 if 2 * sum(row.is_close for row in near) > len(near) else 1


if __name__ == "__main__":
    sys.exit(main())
