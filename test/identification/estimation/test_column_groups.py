"""Derivatives of nuisances that act on samples of their own: the same from one run as from one run for each."""

from __future__ import annotations

import numpy as np
import pytest
from plants.recording import Profile, Recorder, train_profile

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve import ValvePlant

STEP = 1e-6


class ByDifferences(ValvePlant):
    """A plant without derivatives of its own."""

    sensitivities = None  # type: ignore[assignment]


def refitted(profile: Profile) -> Fit:
    """A fit of the clock and the stamps from its own optimum, which takes one step at most."""
    plant = ByDifferences([recorded(Recorder(), profile)], default_valve().exact())
    problem, nuisances = Problem(plant), (plant.nuisances[0], *plant.timing_errors)
    assert len(nuisances) == 17
    found = fit(problem, (), {}, nuisances=nuisances)
    again = fit(problem, (), found.values, nuisances=nuisances)
    assert again.values == found.values
    return again


def one_by_one(found: Fit) -> Array:
    """The difference quotients of the nuisances, a run for each."""
    columns = []
    for nuisance in found.nuisances:
        there = found.problem.residuals({**found.values, nuisance.name: found.values[nuisance.name] + STEP})
        columns.append((there - found.residuals) / STEP)
    return np.column_stack(columns)


def hurried() -> Profile:
    """Pulses without rest between them: each begins while the plunger still moves from the one before."""
    starts = 0.01 + 0.009 * np.arange(8)
    times = np.sort(np.concatenate([starts, starts + 0.006]))
    return Profile(times, np.tile([12.0, 0.0], 8), 0.12)


@pytest.mark.parametrize("profile", [train_profile(), hurried()], ids=["with rest", "without rest"])
def test_derivatives_are_those_of_a_run_for_each_command(profile: Profile) -> None:
    found = refitted(profile)
    expected = one_by_one(found)
    scale = np.abs(expected).max(axis=0)
    assert np.all(scale > 0.0)
    assert np.all(np.abs(found.jacobian - expected).max(axis=0) < 2e-3 * scale)
