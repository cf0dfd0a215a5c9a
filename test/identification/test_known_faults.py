"""Faults that a review found in diagnoses, by their numbers in it: none of them may come back.

Each is a property that any decision ought to have, shown on the smallest machine that broke it. The others of that
review are guarded where the property is at home: in fit and in diagnosis/test_budget.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from plants.recording import Recorder

from identification.fit.linear_plant import COLUMNS, SAMPLES, LinearPlant
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.plants.protocol import Array, EffectChoice
from valve_sim.model import Parameter, Valve
from valve_sim.recordings import Trace

from .diagnosis.test_run import DECLARED
from .recordings import Short, recorded

COARSE = Recorder(sample_rate=5e3)
SURE = 0.9
"""A claim of this probability is confident."""


def diagnosed(train: Trace, valve: Valve, few: Sequence[str]) -> Diagnosis:
    """The diagnosis of a valve with a short catalogue."""
    return diagnose_plant(Short([train], valve, few), None)


def named(found: Diagnosis) -> set[str]:
    """What is claimed, and what would do in its place."""
    verdict = found.verdict
    return {*verdict.effects, *itertools.chain.from_iterable(verdict.confusable_with.values())}


@pytest.mark.long
def test_a_plain_error_that_is_larger_by_chance_vetoes_nothing() -> None:
    """Fault 2."""
    delayed = recorded(COARSE, effects={"sensor_delay": {"delay": 6.3e-4}})
    found = diagnosed(delayed, DECLARED, ["sensor_delay"])
    assert (found.verdict.kind, found.verdict.effects) == ("effects", ("sensor_delay",))


@pytest.mark.xfail(
    strict=True,
    raises=AssertionError,
    reason="beside something unnamed no name is claimed: six of 75 controls would be named wrongly",
)
def test_what_explains_nearly_all_is_named_beside_a_remainder_that_held_out_data_show() -> None:
    """Fault 14."""
    still = np.arange(SAMPLES) < SAMPLES // 2
    columns = np.where(still[:, None], 0.0, COLUMNS)
    strong = EffectChoice("strong", (Parameter("size", "m", "of a column", -1e6, 1e6, 1.0, 0.0),))

    def shown(values: Mapping[str, float]) -> Array:
        return np.asarray(
            values.get("level", 0.0) * (columns - COLUMNS)[:, 0] + values.get("strong.size", 0.0) * columns[:, 1]
        )

    noise = np.random.default_rng(3).normal(0.0, 0.5, SAMPLES)
    noise = np.where(still, noise, 0.1 * (noise - columns @ np.linalg.lstsq(columns, noise, rcond=None)[0]))
    data = 2.0 * columns[:, 0] + 10.0 * columns[:, 1] + noise
    train, other = (
        LinearPlant(own, shown, effects=[strong], still=still) for own in (data, data + 0.9 * columns[:, 2])
    )
    found = diagnose_plant(train, other)
    assert found.before.holdout_rmse > 8.0 * found.after.holdout_rmse
    assert (found.verdict.kind, found.verdict.effects) == ("effects", ("strong",))


def test_a_wrong_declared_value_gets_no_confident_other_name() -> None:
    """Fault 23."""
    declared = DECLARED.with_values(spring_preload=2.7)
    found = diagnosed(recorded(COARSE), declared, ["pressure_force", "constant_force", "spring_hardening"])
    is_confident = found.verdict.kind in ("effects", "none") and found.verdict.probability >= SURE
    assert not is_confident or "valve.spring_preload" in named(found)
