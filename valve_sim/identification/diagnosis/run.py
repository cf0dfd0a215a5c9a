"""Close the loop: trace the residual to the missing effect, add it, report the error before and after.

Base fit, test of its residual, refit of the whole catalogue inside the simulator, forward selection with swaps and
backward elimination, competing models, force maps for what has no name: all on training strokes alone. Effects, timing
errors and force maps are compared on one scale, the score S of `result`, and timing errors of single commands pay the
Occam factor of their prior instead of being tried last. Then held-out strokes are opened, and may refute the choice.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.conclusion import Conclusion, Named
from valve_sim.identification.diagnosis.outcome import Candidate, Diagnosis, Grounds, State, Verdict
from valve_sim.identification.estimation.budget import Budget, OutOfTimeError
from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.estimation.problem import Mask, Problem
from valve_sim.identification.estimation.result import Fit, rmse
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.check import check_plant, name_of, named_interrupts
from valve_sim.identification.plants.hold_out import held_out_strokes
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.plants.stroke_choice import choose_strokes
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.current_check import current_noise_inflation
from valve_sim.identification.selection.held_out import HeldOut
from valve_sim.identification.selection.hypotheses import Progress, Search
from valve_sim.identification.selection.starts import start_near_off
from valve_sim.identification.selection.stepwise import Exploration
from valve_sim.identification.selection.table import Hypothesis
from valve_sim.model import SimulationError, Valve
from valve_sim.traces import Trace
from valve_sim.traces.checking import check_traces

__all__ = ["Begun", "Candidate", "Diagnosis", "Grounds", "State", "Verdict", "begin", "diagnose", "diagnose_plant"]

CURRENT_CHECKED_BY: Final = 0.2
"""The share of the time within which the current is tested: can the effects of the coil explain it?"""
BEGUN_BY: Final = 0.8
"""The share of the time within which the declared model must be fitted: without it there is no diagnosis."""
EXPLORED_BY: Final = 0.65
"""The share of the time after which no further hypothesis is tried; the rest is for the conclusion."""

LEAST_PREDICTIONS: Final = 30
"""No diagnosis does with fewer; that of one effect takes some hundred to a thousand."""
SAMPLES_EACH: Final = 10
"""Samples for each parameter, below which a model with all effects would explain noise, too."""


def diagnose(
    traces: Sequence[Trace],
    holdout: Sequence[Trace],
    valve: Valve,
    progress: Progress | None = None,
    budget: Budget | None = None,
    *,
    is_full: bool = False,
) -> Diagnosis:
    """Trace the residual of a declared valve to the effect it lacks.

    Args:
        traces: training data; of very many samples some strokes are chosen.
        holdout: other recordings of the same valve, or none: strokes are held out inside.
        valve: the declared valve.
        progress: told what is being tried, and the fraction done.
        budget: how long it may take, e.g. `Budget(60.0, time.monotonic)`; default as long as it takes.
        is_full: whether effects are tried where the declared valve leaves nothing to be found, too.

    Raises:
        OutOfTimeError: the budget is used up before the declared valve could be fitted.
        SimulationError: the declared valve cannot be simulated.
        TraceError: a recording has columns that cannot be used, say with NaN in them.
    """
    check_traces(traces)
    if holdout:
        check_traces(holdout)
    fitted, choice = choose_strokes(traces)
    others = ValvePlant(choose_strokes(holdout)[0], valve) if holdout else None
    found = diagnose_plant(ValvePlant(fitted, valve), others, progress, budget, is_full=is_full)
    return replace(found, choice=choice)


def diagnose_plant(
    plant: Plant,
    holdout: Plant | None,
    progress: Progress | None = None,
    budget: Budget | None = None,
    *,
    is_full: bool = False,
) -> Diagnosis:
    """Trace the residual of any plant to the effect it lacks.

    Args:
        plant: the machine and its training data. holdout: the same machine with other data, or None: strokes are held
            out inside.
        progress, budget, is_full: as of `diagnose`.

    Raises:
        OutOfTimeError: the budget is used up before the declared machine could be fitted.
        PlantError: a plant does not keep to what a `Plant` promises.
        SimulationError: the declared machine cannot be simulated.
    """
    return begin(plant, holdout, progress, budget).end(is_full=is_full)


class Begun(NamedTuple):
    """A diagnosis of which the declared model has been fitted, and nothing else tried yet.

    Attributes:
        declared: that fit. exploration: the search. held_out: what judges it. budget: of the whole.
    """

    declared: Fit
    exploration: Exploration
    held_out: HeldOut
    budget: Budget

    def end(self, *, is_full: bool = False) -> Diagnosis:
        """Search for what is missing, and conclude."""
        with named_interrupts(self.exploration.plant):
            with self.budget.until(EXPLORED_BY):
                self.exploration.explore(is_full=is_full)
            return Conclusion(self.exploration, self.held_out).conclude()

    def name(self) -> Named:
        """The same without what a report has beside the verdict: errors and intervals of all that was tried."""
        with self.budget.until(EXPLORED_BY):
            self.exploration.explore()
        return Conclusion(self.exploration, self.held_out).name()


def begin(
    plant: Plant,
    holdout: Plant | None = None,
    progress: Progress | None = None,
    budget: Budget | None = None,
    *,
    least: Mapping[str, float] | None = None,
) -> Begun:
    """The first part of `diagnose_plant`: the declared model, refitted.

    Args:
        plant, holdout, progress, budget: as there.
        least: standard deviations by kind of channel, which count where the data show less noise.

    Raises:
        OutOfTimeError: the budget is used up before. SimulationError: the declared model cannot be simulated.
        PlantError: a plant does not keep to what a `Plant` promises.
    """
    budget = budget or Budget.unlimited()
    with budget.until(BEGUN_BY), named_interrupts(plant):
        for one in (plant,) if holdout is None else (plant, holdout):
            _check(one, budget)
        return _begun(plant, holdout, progress, budget, least or {})


def _check(plant: Plant, budget: Budget) -> None:
    """A plant that keeps to its protocol and is fast enough for the budget.

    Raises:
        OutOfTimeError: it is not. PlantError: it does not.
    """
    looks: list[float] = []

    def look() -> None:
        looks.append(budget.spent)
        each = looks[-1] - looks[0]
        if LEAST_PREDICTIONS * each > budget.seconds:
            raise OutOfTimeError(
                f"{name_of(plant)}.predict took {each:.2g} s, and a search takes some thousand predictions: the budget "
                f"is {budget.seconds:g} s; give it more time"
            )

    check_plant(plant, look)


def _with_least(problem: Problem, least: Mapping[str, float]) -> Problem:
    """The same with white noise of at least these standard deviations."""
    known = problem.noises.items()
    quiet = {kind: noise for kind, noise in known if noise.samples and noise.sigma < least.get(kind, 0.0)}
    return problem.with_noises(
        {kind: Noise(least[kind], least[kind], (), noise.step, 1.0, noise.samples) for kind, noise in quiet.items()}
    )


def _begun(
    plant: Plant, holdout: Plant | None, progress: Progress | None, budget: Budget, least: Mapping[str, float]
) -> Begun:
    train_mask, holdout_mask = _split(plant) if holdout is None else (None, None)
    problem = _with_least(Problem(plant, train_mask, budget=budget), least)
    never_still = [kind for kind, noise in problem.noises.items() if noise.samples == 0]
    if never_still:
        problem = problem.with_noise_left_by(_largest_fit(problem).values)
    # Weighted by its sensor's noise alone, a current of another form would bias the fit of the motion.
    actuation = {channel.kind for channel in plant.channels if channel.role == "actuation"}
    with budget.until(CURRENT_CHECKED_BY):
        inflation = current_noise_inflation(problem)
    held_out = None
    if holdout is not None:
        held_out = Problem(holdout, budget=budget).with_noises({kind: problem.noises[kind] for kind in never_still})
        held_out = _with_least(held_out, least)
    elif holdout_mask is not None:
        held_out = problem.restricted(holdout_mask)
    for kind in sorted(actuation):
        problem = problem.with_inflated_noise(kind, inflation)
        held_out = None if held_out is None else held_out.with_inflated_noise(kind, inflation)
    search = Search(problem.condensed(), progress)
    try:
        search.fit(Hypothesis(()))
    except OutOfTimeError:
        # From one start it may be fitted all the same.
        if Hypothesis(()) not in search.log:
            raise
    return Begun(search.log[Hypothesis(())], Exploration(search), HeldOut(plant, held_out), budget)


def _largest_fit(problem: Problem) -> Fit:
    """The declared model with all effects on: no effect of the catalogue explains its residual.

    The residual of the declared model alone contains the effects that it lacks, and as noise would hide them: beside
    friction a constant force would never be found. (Mallows' Cp takes its variance from the full model, too.)
    """
    plant = problem.plant
    base = fit(problem, plant.base, {}, nuisances=plant.nuisances)
    effects = [effect for effect in plant.effects.values() if not effect.is_declared_value]
    free = (*plant.base, *itertools.chain(*(effect.free_names() for effect in effects)))
    if problem.samples < SAMPLES_EACH * len(free):
        return base
    start = dict(base.values)
    for effect in effects:
        start.update(start_near_off(effect))
    try:
        largest = fit(problem, free, start, nuisances=plant.nuisances)
    except SimulationError:
        return base
    return min(base, largest, key=rmse)


def _split(plant: Plant) -> tuple[Mask | None, Mask | None]:
    """Masks for training and held-out strokes, or None twice when there are too few strokes to hold any out."""
    held = held_out_strokes(plant)
    if not held:
        return None, None

    def is_held(index: int, groups: NDArray[np.integer]) -> NDArray[np.bool_]:
        recording = plant.channels[index].recording
        return np.isin(groups, [group for number, group in held if number == recording])

    return (lambda index, groups: ~is_held(index, groups)), is_held
