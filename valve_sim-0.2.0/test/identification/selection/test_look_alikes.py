"""Sets are compared with the same things known: each is fitted with every declared value that has a tolerance."""

from __future__ import annotations

from pathlib import Path

import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.run import begin
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.selection.search import Set
from valve_sim.traces import read_trace

BAGS = Path(__file__).parents[3] / "bags"


@pytest.mark.long
def test_no_set_takes_a_value_for_exact_that_another_one_estimates() -> None:
    session = begin(ValvePlant([read_trace(BAGS / "friction")], default_valve()))
    session.name()
    search = session._search
    plant = search.problem.plant
    tolerated = {own.name: own.same_as for own in plant.nuisances if own.is_of_machine}

    def expected(names: Set) -> set[str]:
        free = {one for name in names for one in plant.effects[name].free_names()}
        return {name for name, same in tolerated.items() if not {name, same} & free}

    assert len(search.tried) > 5
    for names, tried in search.tried.items():
        assert {own.name for own in tried.fit.nuisances if own.is_of_machine} == expected(names), names
