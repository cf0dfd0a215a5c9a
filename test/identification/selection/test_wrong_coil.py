"""A coil time constant that is off its declared value, to either side: the truth is the independent plant's."""

from __future__ import annotations

import pytest
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, record, train_profile
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.stepwise import Exploration
from valve_sim.identification.selection.table import Hypothesis

from benchmarks.campaign.cases import declared_valve
from benchmarks.campaign.running import as_trace
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Valve

DECLARED = float(CAMPAIGN_VALVE["coil_time_constant"])  # type: ignore[arg-type]
SIGMA = 0.02 * DECLARED
LAG, WRONG = Hypothesis(("coil_lag",)), Hypothesis(("valve.coil_time_constant",))


def declared_within(**tolerances: float) -> Valve:
    return declared_valve(CAMPAIGN_VALVE, tolerances)


def explored(tolerances_off: float) -> Exploration:
    plant = DeclaredPlant(parameters={**CAMPAIGN_VALVE, "coil_time_constant": DECLARED + tolerances_off * SIGMA})
    trace = as_trace(record(plant, train_profile(), Recorder(), 5), "train")
    return Exploration(Search(Problem(ValvePlant([trace], declared_within(coil_time_constant=SIGMA)))))


@pytest.mark.parametrize(("tolerances_off", "right", "other"), [(8.0, LAG, WRONG), (-8.0, WRONG, LAG)])
def test_a_coil_that_is_later_has_the_name_of_the_effect_and_one_that_is_earlier_its_own(
    tolerances_off: float, right: Hypothesis, other: Hypothesis
) -> None:
    exploration = explored(tolerances_off)
    exploration.search.fit_each([right, other], (0.0, 1.0))
    assert exploration.is_adequate(right)
    assert exploration.best_claimable() == right
    assert not exploration.is_claimable(other)
    assert right in exploration.table()
    assert (WRONG in exploration.table()) == (right == WRONG)


@pytest.mark.parametrize("tolerances_off", [-2.6, 2.6])
def test_a_value_within_three_tolerances_starts_no_search(tolerances_off: float) -> None:
    exploration = explored(tolerances_off)
    exploration.explore()
    assert exploration.tried() == [Hypothesis(())]
    assert max(exploration.screened.values()) > 0.0


@pytest.mark.parametrize("tolerances_off", [-5.0, 5.0])
def test_one_that_is_clearly_beyond_starts_a_search(tolerances_off: float) -> None:
    exploration = explored(tolerances_off)
    exploration.search.fit(Hypothesis(()))
    exploration.explore()
    assert {LAG, WRONG} <= set(exploration.tried())


def test_freed_by_hand_the_coil_time_constant_has_its_natural_range() -> None:
    recording = record(DeclaredPlant(), train_profile(), Recorder(), 5)
    plant = ValvePlant([as_trace(recording, "train")], declared_within(coil_time_constant=SIGMA))
    assert plant.parameter("coil_time_constant").upper > 10.0 * DECLARED
