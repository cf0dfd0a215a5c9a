"""Fits by names, for tests: what is freed as names, what is known within a standard deviation as nuisances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from valve_sim.identification.fit import result
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.unknown import Unknown, freed, known, unknowns_of
from valve_sim.identification.plants.protocol import Nuisance


def unknowns(problem: Problem, free: Sequence[str], nuisances: Sequence[Nuisance] = ()) -> list[Unknown]:
    """Records of names, those of effects as their hypotheses have them."""
    effects = {own.name: own for one in unknowns_of(problem.plant).hypotheses.values() for own in one.frees}
    named = [effects[name] if name in effects else freed(problem.plant, name) for name in free]
    return [*named, *map(known, nuisances)]


def fit(
    problem: Problem, free: Sequence[str], start: Mapping[str, float], *, nuisances: Sequence[Nuisance] = ()
) -> Fit:
    return result.fit(problem, unknowns(problem, free, nuisances), start)
