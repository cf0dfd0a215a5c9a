"""The errors of a recording beside a machine of known values: clocks, stamps, and what its sensors add."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.fit.columns import Columns, columns_of, known_name
from valve_sim.identification.fit.gaussian import Gaussian, Sizes
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.model import Sums
from valve_sim.identification.fit.priors import Elsewhere
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit, fit
from valve_sim.identification.fit.unknown import Group, Unknown, unknowns_of
from valve_sim.model import SimulationError

HELD: Final = 0.3
"""Of the scale of its prior: the size of an error before the data are asked."""
ROUNDS: Final = 3
"""Of fits and sizes."""
DRAWS: Final = 32
"""Errors of the stamps that are drawn to start a fit from."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which these are compared, so that one impact at another time does not decide."""
REDRAWN: Final = 3
"""Largest number of draws."""


def usual_sizes(groups: Mapping[str, Group]) -> dict[str, float]:
    """Sizes of errors before the data are asked."""
    return {name: own.scale * (1.0 if own.law == "known" else HELD) for name, own in groups.items()}


def free_of_prior(own: Unknown) -> Unknown:
    """An unknown whose prior is stated elsewhere: by other data of the same machine."""
    return replace(own, prior=Elsewhere(), group=None)


def columns_like(result: Fit, problem: Problem, machine: Mapping[str, float]) -> Columns:
    """The errors that other recordings of the same sensors may have: mounts ring in the modes that a fit has found.

    Raises:
        SimulationError: the machine cannot be simulated.
    """
    known = result.problem.columns
    return Columns() if problem.is_long else columns_of(problem.plant, machine, known.modes, known.changing)


def sizes_like(result: Fit, columns: Columns) -> dict[str, float]:
    """Sizes of the errors of other recordings: those that stay are as large as a fit has them."""
    stays = {known_name(own): result.gaussian.size(own) for own in result.problem.columns.groups.values() if own.stays}
    usual = usual_sizes(columns.groups)
    return {name: stays.get(known_name(own), usual[name]) for name, own in columns.groups.items()}


def sizes_at_rest(gaussian: Gaussian) -> dict[str, float]:
    """Sizes of drift and hum by the samples at rest alone, by name: in motion they would imitate what is missing."""
    rests = ~gaussian.model.problem.rows.places.moves
    groups = {name: own for name, (own, _) in gaussian.groups.items()}
    names = {name for name, own in groups.items() if own.at_rest}
    if not names or not len(gaussian.sums.moved) or not rests.any():
        return {}
    # Beside a hum its channel may drift: what is steady there may be the model's error.
    keys = {groups[name].key for name in names}
    beside = {name for name, own in groups.items() if own.error == "drift" and own.key in keys}
    rows, sums = gaussian.sums.rows[rests], gaussian.sums
    still = Sums(sums.moved, sums.fixed, gram(rows, rows), sums.constant)
    read = Gaussian(gaussian.model, gaussian.z, still, gaussian.sizes).with_best_sizes({*names, *beside}).sizes
    return {name: read[name] for name in names}


def fit_recording(
    problem: Problem, machine: Mapping[str, float], sizes: Sizes | None = None, *, learns: bool = False
) -> Fit:
    """What a machine of known values shows of a recording, once the errors of the recording are estimated.

    Drift and hum are as large as they are at rest. Errors of the commands' stamps are among them where the evidence is
    for it: most recorders stamp commands well, and a few stamp them when they happen to receive them. A plunger that
    turns beside a contact touches it or does not, by some microseconds of a stamp: where more than noise is left, the
    fit begins again from other stamps.

    Args:
        problem: the recording. machine: values of the machine by name; what is missing is as declared.
        sizes: of its errors, by name, those that stay with the machine as other recordings have them; None: usual ones.
        learns: whether these are where learning begins.

    Raises:
        SimulationError: the machine cannot be simulated.
    """
    plant = problem.plant
    unknowns, columns = unknowns_of(plant), problem.columns
    clocks = [own for own in unknowns.known if not own.of_machine]
    stamps, errors = unknowns.stamps, [*columns.varying, *columns.unknowns]
    groups = {**columns.groups, **{own.group.name: own.group for own in stamps if own.group}}
    usual = {**usual_sizes(groups), **(sizes or {})}
    names = {name for name, own in groups.items() if own.is_learned and (sizes is None or not own.stays)}

    def fitted(which: Sequence[Unknown], start: Mapping[str, float]) -> Fit:
        """With the sizes of errors that suit it: those beside wrong stamps would be far too large."""
        own = usual
        best = fit(problem, [*clocks, *which, *errors], start, held=machine, sizes=own)
        for _ in range(ROUNDS if learns and names else 0):
            read = sizes_at_rest(best.gaussian)
            suited = best.gaussian.resized(read).with_best_sizes(names - read.keys()).sizes
            if max(abs(math.log(suited[name] / own[name])) for name in names) < HELD:
                break
            own = dict(suited)
            best = fit(problem, [*clocks, *which, *errors], best.values, held=machine, sizes=own)
        return best

    best = fitted([], {})
    if not stamps:
        return best
    best = max(best, fitted(stamps, best.values), key=lambda found: found.log_evidence)
    for seed in range(REDRAWN):
        if not leaves_more_than_noise(best):
            break
        start = likely_stamps(problem, stamps, {**machine, **best.values}, seed)
        best = max(best, fitted(stamps, {**best.values, **start}), key=lambda found: found.log_evidence)
    return best


def likely_stamps(
    problem: Problem, stamps: Sequence[Unknown], values: Mapping[str, float], seed: int
) -> dict[str, float]:
    """Errors of the stamps, drawn from their priors: of several draws the best for what each of them acts on.

    Args:
        problem: the recording. stamps: their errors. values: of all else. seed: of the draws.
    """
    random = np.random.default_rng(seed)
    draws = [
        {own.name: own.scale * z for own, z in zip(stamps, random.standard_normal(len(stamps)).tolist(), strict=True)}
        for _ in range(DRAWS)
    ]
    costs, count = [], len(problem.every_row.counts)
    for draw in draws:
        try:
            residuals = problem.residuals({**values, **draw})
        except SimulationError:
            residuals = np.full(count, np.inf)
        costs.append(np.log1p(np.square(residuals / ROBUST)))
    found = {}
    for own in stamps:
        assert own.nuisance is not None
        reach = problem.every_row.reach(own.nuisance)
        found[own.name] = draws[int(np.argmin([cost[reach].sum() for cost in costs]))][own.name]
    return found


TOO_MUCH: Final = 5.0
"""Standard deviations of χ² beyond which the residual is larger than the noise."""


def leaves_more_than_noise(result: Fit) -> bool:
    """Whether χ² exceeds what noise gives it by 5 %, and by more than `TOO_MUCH` of its standard deviations.

    These include that the noise itself is known from a limited number of quiet samples only.
    """
    samples, quiet = result.problem.effective_samples, [noise.samples for noise in result.problem.noises.values()]
    left = result.chi2 / samples - 1.0
    return left > max(0.05, TOO_MUCH * float(np.sqrt(2.0 / samples + 2.0 / max(1, min(quiet)))))
