"""Fits and hypotheses of valves with gas, by the outlet's pressure of an independent plant that lacks nothing."""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest

from benchmarks.gas_recordings import drawn
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.score_test import score_gains
from valve_sim.identification.selection.stepwise import Exploration
from valve_sim.identification.selection.table import DECISIVE, Hypothesis

VOLUME = "gas.outlet_volume"


@functools.cache
def searched(seed: int, share: float = 1.0) -> Search:
    """A search of which the declared model is fitted, declared with this share of the outlet's volume."""
    case = drawn(seed, "")
    assert case.declared.gas is not None
    volume = share * case.declared.gas.outlet_volume
    declared = replace(case.declared, gas=case.declared.gas._replace(outlet_volume=volume))
    search = Search(Problem(ValvePlant(case.training, declared)))
    search.fit(Hypothesis(()))
    return search


@pytest.mark.parametrize("seed", [11, 17])
def test_a_fit_begun_far_away_does_not_end_at_a_plunger_that_creeps_open(seed: int) -> None:
    """Both ended with main dampings of some 4,000 N·s/m, where 3.9 and 4.0 are true, and declared values far off."""
    found = searched(seed).log[Hypothesis(())]
    assert found.converged
    assert found.chi2 < found.problem.samples
    assert found.values["main_damping"] < 30.0
    assert max(abs(found.deviations)) < 3.0


@pytest.mark.parametrize(("share", "is_wrong"), [(1.0, False), (0.8, True)])
def test_a_wrong_number_of_gas_is_charged_and_judged_as_every_other_declared_value_is(
    share: float, *, is_wrong: bool
) -> None:
    """Its logarithm once was compared with its value: it cost nothing, and was taken to be off wherever it was."""
    search, released = searched(11, share), Hypothesis((VOLUME,))
    base, with_it = search.log[Hypothesis(())], search.fit(released)
    gain = base.score - with_it.score
    assert gain == pytest.approx(score_gains(base)[VOLUME], abs=1.0)
    assert (gain > DECISIVE) is is_wrong
    assert Exploration(search).is_claimable(released) is is_wrong
