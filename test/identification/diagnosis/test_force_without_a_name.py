"""A bump of force without a name: found, drawn, written, stepped; the same curve everywhere."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from plants.recording import Recorder, holdout_profile, train_profile

from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.plants.protocol import EffectChoice
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.diagnosis_json import to_json

from .test_run import DECLARED, measured

pytestmark = pytest.mark.long

BUMP = {"amplitude": -1.2, "centre": 0.55e-3, "width": 0.1e-3}


class Unnamed(ValvePlant):
    """A valve of which no effect has a name: trying all that have one takes a minute."""

    @property
    def effects(self) -> Mapping[str, EffectChoice]:
        return {}


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    train, held_out = (
        measured({"force_bump": BUMP}, profile, Recorder(), seed)
        for profile, seed in ((train_profile(), 3), (holdout_profile(), 4))
    )
    return diagnose_plant(Unnamed([train], DECLARED), Unnamed([held_out], DECLARED))


def test_it_is_unknown(found: Diagnosis) -> None:
    assert (found.verdict.kind, found.verdict.effects) == ("unknown", ())
    assert found.verdict.probability > 0.99
    assert found.before.holdout_rmse > 2e-6
    # What has no name is shown, and not put into the model.
    assert found.after.fit is found.before.fit


def test_the_curve_is_the_bump(found: Diagnosis) -> None:
    assert found.unexplained is not None
    assert found.unexplained.variable == "x"
    at, force = np.array(found.unexplained.at), np.array(found.unexplained.force)
    truth = BUMP["amplitude"] * np.exp(-(((at - BUMP["centre"]) / BUMP["width"]) ** 2))
    assert np.sqrt(np.mean((force - truth) ** 2)) < 0.1 * abs(BUMP["amplitude"])
    assert at[np.argmin(force)] == pytest.approx(BUMP["centre"], abs=0.05e-3)


def test_the_report_describes_one_curve(found: Diagnosis) -> None:
    report = to_json(found)
    unexplained = report["unexplained"]
    assert found.unexplained is not None
    assert unexplained["variable"] == found.unexplained.variable == "x"
    assert unexplained["force"] == pytest.approx(found.unexplained.force)
    assert len(unexplained["force_stderr"]) == len(unexplained["at"]) == len(unexplained["force"])
    assert all(math.isfinite(value) and value >= 0.0 for value in unexplained["force_stderr"])
