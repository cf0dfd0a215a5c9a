"""Plants from files: starts, windows, errors of columns, values that vary, and thresholds among the data."""

import math
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from valve_sim.files.plant_files import plant_from
from valve_sim.identification.diagnosis.identify import identify_plant
from valve_sim.identification.diagnosis.run import diagnose_plant
from valve_sim.identification.plants.own import OwnPlant, quiet_samples
from valve_sim.identification.plants.protocol import Direction
from valve_sim.identification.validation.own_plant import validate_plant
from valve_sim.recordings.columns import Column, Columns

TANK = """
plant: equations
states: {h: {unit: m, start: free}}
inputs: {q: {unit: L/s, between: held}}
parameters:
  outlet: {value: 0.02, unit: m^2/s, free: true, range: [0, 1]}
  area: {value: 0.5, unit: m^2, tolerance: 0.01}
derivatives: {h: (q - outlet*h)/area}
outputs: {level: {value: h, unit: m, noise: 0.002}}
effects:
  overflow:
    add: {h: '-k*max(0, h - top)/area'}
    parameters: {k: {unit: m^2/s, neutral: 0, scale: 0.1, range: [0, 5]}, top: {unit: m, range: [0, 100]}}
  inflow: {add: {h: o/area}, parameters: {o: {unit: L/s, neutral: 0, scale: 1}}}
"""


def plant(*recordings: Columns, **changes: Any) -> OwnPlant:
    content = {**yaml.safe_load(TANK), **changes}
    return OwnPlant(plant_from(content, "tank.yaml"), recordings)


def recorded(
    seed: int, *, k: float = 0.0, top: float = 1.0, gain: float = 1.0, outlet: float = 0.025, start: float = 0.3
) -> Columns:
    """A tank whose inflow changes every 20 s, by another integrator."""
    random, times = np.random.default_rng(seed), np.arange(0.0, 400.0, 0.5)
    levels = random.uniform(5.0, 45.0, 20)

    def rate(q: float, h: float) -> float:
        return float((q - outlet * h - k * max(0.0, h - top)) / 0.502)

    shown, at = np.zeros(len(times)), start
    for part in range(20):
        inside = times[40 * part : 40 * part + 40]
        wanted = [*inside, 20.0 * (part + 1)]
        done = solve_ivp(
            lambda t, y, q=1e-3 * levels[part]: [rate(q, y[0])], (wanted[0], wanted[-1]), [at], t_eval=wanted,
            rtol=1e-9, atol=1e-10, max_step=1.0,
        )  # fmt: skip
        shown[40 * part : 40 * part + 40] = done.y[0, :-1]
        at = float(done.y[0, -1])
    used = np.ones(len(times), dtype=bool)
    inflow = levels[np.minimum(19, (times / 20.0).astype(int))] * gain
    return Columns(
        f"tank_{seed}.csv",
        {
            "q": Column("q", "q", times, inflow, None, used),
            "level": Column("level", "level", times, shown + random.normal(0.0, 0.002, len(times)), None, used),
        },
    )


def test_free_starts_and_tolerated_values_are_estimated() -> None:
    found = identify_plant(plant(recorded(1, start=0.3), recorded(2, start=0.8)))
    own = found.intervals["outlet"]
    assert abs(own.value - 0.025) < 4.0 * own.stderr
    assert own.stderr < 1e-3
    assert found.fit.values["start[0,0].h"] == pytest.approx(0.3, abs=0.01)
    assert found.fit.values["start[1,0].h"] == pytest.approx(0.8, abs=0.01)
    assert found.fit.values["area"] == pytest.approx(0.502, abs=0.005)


def test_the_gain_of_a_column_is_estimated_for_each_recording() -> None:
    erring = recorded(2, gain=1.04)
    known = Columns(erring.source, {**erring.columns, "q": Column(**{**erring["q"].__dict__, "gain": 0.05})})
    found = identify_plant(plant(recorded(1), known))
    assert found.fit.values["gain[1].q"] == pytest.approx(1.0 / 1.04 - 1.0, abs=0.006)
    assert abs(found.intervals["outlet"].value - 0.025) < 4.0 * found.intervals["outlet"].stderr


def test_a_value_that_varies_differs_from_recording_to_recording() -> None:
    changes = yaml.safe_load(TANK)["parameters"]
    changes["outlet"]["varies"] = 0.003
    found = identify_plant(plant(recorded(1, outlet=0.024), recorded(2, outlet=0.028), parameters=changes))
    one, two = (found.fit.values[f"outlet[{k}]"] for k in (0, 1))
    assert two - one == pytest.approx(0.004, abs=3e-4)


def test_derivatives_are_those_of_differences_in_every_direction() -> None:
    own = plant(recorded(1, k=0.1), recorded(2, k=0.1), window=100.0)
    values = {one.name: one.mean for one in own.nuisances} | {"outlet": 0.02, "overflow.k": 0.05, "overflow.top": 0.9}
    for name in ("outlet", "area", "overflow.k", "overflow.top", "start[1,2].h"):
        column = own.sensitivities(values, [Direction({name: 1.0}, 1e-3)]).columns
        step = 1e-6 * max(1e-2, abs(values[name]))
        up, down = (own.predict({**values, name: values[name] + sign * step}) for sign in (1.0, -1.0))
        for slope, high, low in zip(column, up, down, strict=True):
            quotient = (high - low) / (2.0 * step)
            assert np.max(np.abs(slope[:, 0] - quotient)) < 1e-4 * max(1e-3, float(np.max(np.abs(quotient))))


def test_a_threshold_among_the_data_is_found_from_a_range_far_beyond_them() -> None:
    """Its range ends at 100 m; the level never rises above 1.5 m, and without a start among the data its slope is 0."""
    own = plant(recorded(4, k=0.08, top=0.9))
    places = own.effects["overflow"].places["overflow.top"]
    level = own.channels[0].data
    assert all(level.min() < place < level.max() for place in places)
    assert len(places) >= 3
    found = diagnose_plant(own, None)
    assert found.verdict.kind == "effects"
    assert found.verdict.effects == ("overflow",)
    assert found.after.intervals["overflow.top"].value == pytest.approx(0.9, abs=0.02)
    assert found.after.intervals["overflow.k"].value == pytest.approx(0.08, rel=0.1)


def test_what_two_names_are_worth_sums_to_one() -> None:
    erring = recorded(5, k=0.08, top=0.9)
    # 3 L/s more flow in than the column says.
    less = Column(**{**erring["q"].__dict__, "readings": erring["q"].readings - 3.0})
    found = diagnose_plant(plant(Columns(erring.source, {**erring.columns, "q": less})), None).verdict
    assert set(found.effects) == {"overflow", "inflow"}
    assert sum(one.improvement for one in found.worth.values()) == pytest.approx(1.0)
    assert all(0.0 < one.improvement < 1.0 for one in found.worth.values())
    # A name that cannot win by itself is not fitted by itself.
    fitted = [one.remaining for one in found.worth.values() if not math.isnan(one.remaining)]
    assert fitted
    assert all(0.0 < remaining <= 1.0 for remaining in fitted)


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_the_scales_of_a_template_are_those_of_its_recordings(size: float) -> None:
    times = np.arange(0.0, 4.0, 1e-2)
    used = np.ones(len(times), dtype=bool)
    columns = {
        "force": Column("force", "F", times, size * np.sin(times), None, used),
        "position": Column("position", "x", times, 0.1 * np.sin(5.0 * times), None, used),
    }
    axis = OwnPlant(plant_from({"plant": "axis"}, "axis.yaml"), [Columns("log", columns)])
    assert axis.parameter("coulomb_friction.level").prior_scale == pytest.approx(0.2 * size, rel=1e-3)
    assert axis.parameter("stiffness.rate").prior_scale == pytest.approx(2.0 * size, rel=1e-2)
    # The fastest is 0.1·5 m/s.
    assert axis.parameter("quadratic_drag.coefficient").prior_scale == pytest.approx(0.8 * size, rel=1e-2)


def test_what_a_start_takes_up_of_a_wrong_value_is_not_allowed_for() -> None:
    """An integrator that may drift: beside a start that is estimated, a drift leaves its deviation from the middle."""
    times = np.arange(0.0, 10.005, 1e-2)
    used = np.ones(len(times), dtype=bool)
    columns = {"x": Column("x", "x", times, 1.0 + 0.01 * times, None, used)}
    content = yaml.safe_load("""
        plant: equations
        states: {x: {unit: m, start: free}}
        parameters: {drift: {value: 0, unit: m/s, tolerance: 0.01}}
        derivatives: {x: drift}
        outputs: {x: {value: x, unit: m, noise: 0.001}}
    """)
    (found,) = validate_plant(OwnPlant(plant_from(content, "p"), [Columns("log", columns)])).replays
    assert len(found.strokes) == 8
    assert found.passed  # it drifts by one tolerance
    for number, part in enumerate(found.strokes):
        inside = np.minimum((8.0 * times / times[-1]).astype(int), 7) == number
        left = 0.01 * (times[inside] - 5.0)
        assert part.errors.tolerance == pytest.approx(3.0 * np.sqrt(1e-6 + np.mean(np.square(left))), rel=0.01)


def test_jagged_motion_is_no_rest() -> None:
    """A signal jumps about one level for most of a recording, as a torque behind a low-pass does, and then rests."""
    random, times = np.random.default_rng(5), np.arange(0.0, 20.0, 1e-2)
    moves = times < 14.0
    data = np.where(moves, 10.0, 1.0) * random.normal(0.0, 0.01, len(times))
    quiet = quiet_samples(times, data, [])
    assert not quiet[moves][:-50].any()
    assert np.mean(quiet[~moves]) > 0.8
    # What only rests shows noise nearly everywhere.
    assert np.mean(quiet_samples(times, random.normal(0.0, 0.01, len(times)), [])) > 0.8
