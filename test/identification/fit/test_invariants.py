"""What holds of any posterior: on a sum of known columns exactly, on a valve nearly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from plants.recording import Recorder

from identification.diagnosis.test_run import DECLARED
from identification.fit.linear_plant import COLUMNS, LinearPlant, measured, problem_of
from identification.freed import fit
from identification.recordings import Short, recorded
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.fit.posterior import decide
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.search import Search
from valve_sim.identification.plants.protocol import Array, EffectChoice
from valve_sim.model import Parameter

# -- names and their order ---------------------------------------------------------------------------------------------

EFFECTS = {"alpha": 1, "beta": 2, "gamma": 3, "delta": 4}


def searched(names: Mapping[str, str], order: list[str]) -> Search:
    """The search of a plant whose effects have these names and this order; two of them act."""

    def shown(values: Mapping[str, float]) -> Array:
        sizes = [values.get(f"{names[name]}.size", 0.0) for name in EFFECTS]
        return np.asarray(COLUMNS[:, 1:5] @ np.array(sizes))

    data = measured() + 0.04 * COLUMNS[:, 1] + 0.3 * COLUMNS[:, 3]
    switch = Parameter("size", "m", "added", -1e6, 1e6, 0.2, 0.0)
    plant = LinearPlant(data, shown, effects=[EffectChoice(names[name], (switch,)) for name in order])
    found = Search(problem_of(plant))
    found.run()
    return found


def test_other_names_in_another_order_change_no_probability() -> None:
    same = {name: name for name in EFFECTS}
    new = dict(zip(EFFECTS, ("zeta", "eta", "epsilon", "aleph"), strict=True))
    first = searched(same, list(EFFECTS)).posterior()
    for names, order in (
        (same, [*reversed(EFFECTS)]),
        (new, list(EFFECTS)),
        (new, ["gamma", "alpha", "delta", "beta"]),
    ):
        second = searched(names, order).posterior()
        for name, probability in first.inclusion().items():
            assert second.inclusion()[names[name]] == pytest.approx(probability, abs=1e-4)
        assert second.unnamed == pytest.approx(first.unnamed, abs=1e-4)
        assert set(decide(second).names) == {names[name] for name in decide(first).names}
        assert decide(second).probability == pytest.approx(decide(first).probability, abs=1e-4)
    assert decide(first).names == ("alpha", "gamma")
    assert 0.5 < first.inclusion()["alpha"] < 0.9999


# -- a valve -----------------------------------------------------------------------------------------------------------


@pytest.mark.long
def test_a_declared_effect_of_no_size_changes_nothing() -> None:
    few = ["quadratic_drag", "drive_gain", "coulomb_friction"]
    trace = recorded(Recorder(sample_rate=5e3), effects={"quadratic_drag": {"coefficient": 1.0}})
    without = Short([trace], DECLARED, few)
    with_it = Short([trace], replace(DECLARED, effects={"coulomb_friction": {"force": 0.0}}), few)
    first, second = (fit(Problem(plant), plant.base, {}, nuisances=plant.nuisances) for plant in (without, with_it))
    assert second.chi2 == pytest.approx(first.chi2, rel=1e-9)
    assert second.log_evidence == pytest.approx(first.log_evidence, abs=1e-6)
    found, again = (diagnose_plant(plant, None).verdict for plant in (without, with_it))
    assert (again.kind, again.effects) == (found.kind, found.effects)
    # It is a declared thing that may be wrong in place of an effect that may act: that is all that moves.
    assert again.probability == pytest.approx(found.probability, abs=0.02)
