"""A diagnosis of another machine: a force-driven axis, made up here and measured by others (EMPS)."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks import emps
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.plants.axis import AxisPlant, AxisRecord
from valve_sim.identification.plants.protocol import Sensor
from valve_sim.model import ValveError

RATE = 1000.0
MASS, VISCOUS = 50.0, 100.0


def made_up_record(friction, load, seed=0):
    """Five out-and-back moves of an axis under position control, integrated here by small steps of its own.

    Args:
        friction: v → dry friction in N, a size. load: N, constant.
        seed: of the noise on the force.
    """
    random = np.random.default_rng(seed)
    interval, substeps = 1.0 / RATE, 10
    times = np.arange(0.0, 20.0, interval)
    wanted = 0.1 * (1.0 - np.cos(0.5 * math.pi * times))
    position, force = np.empty(len(times)), np.empty(len(times))
    x, v, before = 0.0, 0.0, 0.0
    for i, target in enumerate(wanted):
        position[i] = x
        force[i] = 4e4 * (target - x) + 3e3 * ((target - before) / interval - v)
        before = target
        for _ in range(substeps):
            step = interval / substeps
            pushed = v + step * (force[i] + load - VISCOUS * v) / MASS
            held = step * friction(pushed) / MASS
            v = math.copysign(max(abs(pushed) - held, 0.0), pushed)
            x += step * v
    return AxisRecord("made up", times, position, force + random.normal(0.0, 0.5, len(times)))


def test_a_constant_load_and_friction_are_found_and_measured():
    plant = AxisPlant(made_up_record(lambda v: 8.0, 3.0))
    diagnosis = diagnose_plant(plant, None)
    assert set(diagnosis.verdict.effects) in ({"coulomb_friction", "constant_force"}, {"asymmetric_friction"})
    found = emps.rung(plant, ("coulomb_friction", "constant_force"))
    assert found.values["mass"] == pytest.approx(MASS, rel=0.02)
    assert found.values["coulomb_friction.force"] == pytest.approx(8.0, rel=0.05)
    assert found.values["constant_force.force"] == pytest.approx(3.0, rel=0.05)


def test_no_effect_is_claimed_where_there_is_none():
    diagnosis = diagnose_plant(AxisPlant(made_up_record(lambda v: 0.0, 0.0)), None)
    assert diagnosis.verdict.effects == ()


def test_an_axis_simulated_with_its_own_parameters_follows_the_record():
    plant = AxisPlant(made_up_record(lambda v: 8.0, 3.0))
    true = {"mass": MASS, "viscous_friction": VISCOUS, "coulomb_friction.force": 8.0, "constant_force.force": 3.0}
    without = {"mass": MASS, "viscous_friction": VISCOUS}
    assert plant.window_rmse(true) < 0.1 * plant.window_rmse(without)
    assert plant.residual_share(true) < 0.1 * plant.residual_share(without)


@pytest.fixture(scope="module")
def measured():
    if not emps.DEFAULT.is_file():
        pytest.skip("../shared/data/emps/DATA_EMPS.mat is missing: EMPS is not in the repository")
    return AxisPlant(emps.read_emps(emps.DEFAULT))


@pytest.fixture(scope="module")
def diagnosis(measured):
    return diagnose_plant(measured, None)


def test_emps_lacks_friction_by_direction_and_nothing_that_an_axis_cannot_have(diagnosis):
    # The flexible axis leaves more than noise beside it, which has no name here, so that it leads and is not claimed.
    named = diagnosis.verdict.effects
    assert (diagnosis.verdict.kind, named) == ("unknown", ("asymmetric_friction",))
    errors = {candidate.effects: candidate.holdout_rmse for candidate in diagnosis.candidates}
    assert errors[named] < 1.01 * errors[("asymmetric_friction",)]
    assert {name for candidate in diagnosis.candidates for name in candidate.effects} <= {
        "coulomb_friction",
        "stiction",
        "asymmetric_friction",
        "constant_force",
        "quadratic_drag",
    }
    best = min(diagnosis.candidates, key=lambda candidate: candidate.delta_bic)
    assert best.holdout_rmse < 0.2 * diagnosis.before.holdout_rmse


def test_emps_gains_in_the_published_order_and_by_the_published_amounts(measured, diagnosis):
    rungs = emps.ladder(measured, diagnosis)
    assert [rung.effects for rung in rungs] == [
        (),
        ("coulomb_friction",),
        ("coulomb_friction", "constant_force"),
        ("asymmetric_friction",),
    ]
    assert rungs[2].residual <= 4.1
    assert rungs[3].residual <= 3.15
    assert rungs[0].windows == pytest.approx(6.2e-3, rel=0.05)
    assert rungs[3].windows <= 0.6e-3


def test_emps_has_the_published_parameters(measured):
    values = emps.rung(measured, ("coulomb_friction", "constant_force")).values
    for name, published in emps.PUBLISHED.items():
        assert values[name] == pytest.approx(published, rel=0.05 if name == "constant_force.force" else 0.01)


def test_what_stays_of_emps_is_reported_with_its_place(measured, diagnosis):
    # Of the declared model friction is left, a damping that is largest where the axis is slowest.
    assert diagnosis.unexplained is not None
    assert diagnosis.unexplained.variable == "v"
    values = emps.rung(measured, ("asymmetric_friction",)).values
    assert "accelerates or turns" in emps.remainder_line(measured, values)


def test_a_missing_file_is_one_line_that_says_how_to_get_it(capsys, tmp_path):
    assert emps.main([str(tmp_path / "DATA_EMPS.mat")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "nonlinearbenchmark.org" in said


@pytest.mark.parametrize("content", [b"", b"no MAT file at all", bytes(200)])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    path = tmp_path / "DATA_EMPS.mat"
    path.write_bytes(content)
    with pytest.raises(ValveError, match=f"^{path}: is no MAT file"):
        emps.read_emps(path)


def test_a_file_without_the_force_is_refused(tmp_path: Path):
    path = tmp_path / "DATA_EMPS.mat"
    savemat(path, {"t": np.zeros(3), "qm": np.zeros(3)})
    with pytest.raises(ValveError, match="holds no variable vir"):
        emps.read_emps(path)


@pytest.mark.long
@pytest.mark.parametrize(("friction", "lacks"), [(0.0, set()), (8.0, {"coulomb_friction", "stiction"})])
def test_a_force_that_drifts_is_no_unnamed_effect_where_the_plant_says_that_it_may(friction, lacks):
    record = made_up_record(lambda v: friction, 0.0, seed=1)
    steps = np.random.default_rng(6).standard_normal(len(record.times))
    record = replace(record, force=record.force + 0.5 * np.cumsum(steps) / math.sqrt(4.0 * RATE))
    assert diagnose_plant(AxisPlant(record), None).verdict.kind == "unknown"
    sensor = Sensor(100.0, low=-50.0, shares={"hum": 0.0}, is_true_at_rest=False)
    found = diagnose_plant(AxisPlant(record, sensor=sensor, variation=0.05), None)
    assert found.verdict.kind == ("effects" if lacks else "none")
    assert set(found.verdict.effects) <= lacks
    (errors,) = found.recording.values()
    drift = next(own for own in errors if own.error == "drift")
    assert drift.probability > 0.99
    assert drift.low < 0.5 < drift.high


def test_friction_that_varies_is_that_of_its_own_out_and_back():
    plant = AxisPlant(made_up_record(lambda v: 8.0, 3.0), variation=0.05)
    values = {"viscous_friction": 100.0, "coulomb_friction.force": 8.0, "constant_force.force": 3.0}
    stronger = {**values, "viscous_friction": 110.0, "coulomb_friction.force": 8.8}
    (channel,), third = plant.channels, plant.varying[2]
    (as_usual,), (varied,) = plant.predict(values), plant.predict({**values, third.name: 0.1})
    (with_more,) = plant.predict(stronger)
    within = (channel.times > third.during[0] + 0.2) & (channel.times < third.during[1] - 0.2)
    without = (channel.times < third.during[0] - 0.2) | (channel.times > third.during[1] + 0.2)
    # The filter of the decimation rings on from the edges of the out-and-back.
    np.testing.assert_allclose(varied[within], with_more[within], atol=2e-3)
    np.testing.assert_allclose(varied[without], as_usual[without], atol=2e-3)
    assert np.max(np.abs(varied - as_usual)[within]) > 1.0
