"""Derivatives of nuisances that act on samples of their own: the same from one run as from one run for each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from plants.recording import Profile, Recorder, train_profile

from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.estimation.column_groups import group_columns
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve import ValvePlant

STEP = 1e-6


def test_where_nothing_acts_rounding_does_not_keep_strokes_together() -> None:
    """A stroke that is held out shows the rounding of the one before."""
    masks = [np.isin(np.arange(12), np.arange(first, last)) for first, last in ((0, 6), (6, 9), (9, 12))]
    (group,), columns = group_columns(masks), np.zeros((12, 3))
    assert group.part(np.array([0.0, 5.0, 1.0, 0.0, 0.0, 0.0, 3e-17, 2e-17, 2e-17, 2.0, 1.0, 0.0]), columns)


class Counting(ValvePlant):
    """A plant without derivatives of its own that counts how often it is asked."""

    count = 0
    sensitivities = None  # type: ignore[assignment]

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """As of any valve's plant."""
        self.count += 1
        return super().predict(values)


def refitted(profile: Profile) -> tuple[Fit, int]:
    """A fit of the clock and the stamps from its own optimum, which takes one step at most, and its number of runs."""
    plant = Counting([recorded(Recorder(), profile)], default_valve().exact())
    problem, nuisances = Problem(plant), (plant.nuisances[0], *plant.timing_errors)
    assert len(nuisances) == 17
    found = fit(problem, (), {}, nuisances=nuisances)
    plant.count = 0
    again = fit(problem, (), found.values, nuisances=nuisances)
    assert again.values == found.values
    return again, plant.count


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
    found, _ = refitted(profile)
    expected = one_by_one(found)
    scale = np.abs(expected).max(axis=0)
    assert np.all(scale > 0.0)
    assert np.all(np.abs(found.jacobian - expected).max(axis=0) < 2e-3 * scale)


def test_a_run_for_each_command_is_spent_only_where_strokes_follow_without_rest() -> None:
    _, runs = refitted(train_profile())
    assert runs == 4, "one where it stands, one for the clock, one for beginnings and one for ends"
    _, runs = refitted(hurried())
    assert runs >= 1 + 17
