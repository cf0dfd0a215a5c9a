"""How the campaign judges: its yardsticks, what becomes of an answer, and its tables."""

import functools
import json
from dataclasses import replace

import numpy as np
import pytest
from plants.common import FloatArray
from plants.recording import Recorder
from plants.tolerances import SHEET_VALVE

from benchmarks.campaign.actuators import KINDS, SUBSTEPS, march
from benchmarks.campaign.cases import Case, draw_case
from benchmarks.campaign.limits import DETECTABLE, Knowledge, detection_limit, yardstick
from benchmarks.campaign.running import Answer, Outcome
from benchmarks.campaign.tables import DEMANDS, family_table, interval_table, standing, upper_limit

pytestmark = pytest.mark.long

POWERS: FloatArray = np.linspace(0.0, 1.2e-3, 7)[:, np.newaxis] ** np.arange(4)


def test_a_file_with_tolerances_tells_how_far_the_true_values_are() -> None:
    case = draw_case("none_within", 3)
    declared, tolerances = case.declared.parameters, case.declared.tolerances
    assert not tolerances.is_exact
    assert set(tolerances.declared) >= {"pilot_mass", "moving_mass", "spring_rate", "seat_load", "stroke"}
    for name in ("pilot_mass", "spring_rate", "stroke"):
        off = (case.true_scalars[name] - float(getattr(declared, name))) / tolerances.declared[name]
        assert off == pytest.approx(case.deviations[name])
    force = POWERS @ np.subtract(case.true_values["attraction_polynomial"], declared.attraction_polynomial)
    spread = np.sqrt(np.diag(POWERS @ np.array(tolerances.attraction_covariance) @ POWERS.T))
    assert 0.0 < np.abs(force / spread).max() < 4.0
    assert draw_case("none_within", 3) == case != draw_case("none_within", 4)


def test_a_limit_within_tolerances_is_what_they_cannot_imitate() -> None:
    recorder = Recorder()
    exact, within = (
        detection_limit("coulomb_friction", {}, recorder, knowledge)
        for knowledge in (Knowledge.SHEET, Knowledge.WITHIN)
    )
    assert 5.0 * exact < within < 50.0 * exact
    measure = yardstick(recorder, Knowledge.WITHIN)
    assert measure.distance({"coulomb_friction": {"force": within}}) == pytest.approx(DETECTABLE, rel=0.03)
    # What the data determine costs what its prior asks; a mass is imitated by forces.
    assert measure.distance_of_deviation("stroke") == pytest.approx(1.0, abs=0.02)
    assert measure.distance_of_deviation("main_mass") < 0.3
    assert SHEET_VALVE["seat_load"] == 0.3


def test_the_table_of_families_counts_all_sizes_of_an_imperfection_together() -> None:
    outcomes = [
        outcome_of("imperfect", "none", (), 0.9),
        replace(outcome_of("imperfect", "effects", ("stiction",), 0.95), is_covered=None),
        Outcome(draw_case("imperfect", 1), error="it failed"),
    ]
    drift, hum, whole = (row.split() for row in family_table(outcomes).splitlines()[1:4])
    # Cases, then unique, class, missed, wrong and failed, and how many were confidently wrong.
    assert drift[:9] == ["imperfect", "drift", "2", "1", "·", "·", "1", "·", "1"]
    assert hum[:9] == ["imperfect", "hum", "1", "·", "·", "·", "·", "1", "·"]
    assert whole[:2] == ["all", "3"]
    old = outcomes[0].to_json()
    del old["case"]["laboratory"]
    assert Outcome.from_json(old).case.laboratory == ""


@functools.cache
def first_case(family: str) -> Case:
    return draw_case(family, 0)


def outcome_of(family: str, kind: str, effects: tuple[str, ...], probability: float, alike: str = "") -> Outcome:
    """A made-up answer to the first case of a family."""
    others = {effects[0]: (alike,)} if alike else {}
    answer = Answer(kind, effects, others, probability, 2.0, 2.0, 1.0, None, 1.0, 0.1, 1.0, 5.0, 1.0)
    return Outcome(first_case(family), (answer,), 1.0, {"pilot_damping": True, "main_damping": True})


@pytest.mark.parametrize(
    ("family", "kind", "effects", "alike", "wanted"),
    [
        ("none", "none", (), "", "unique"),
        ("none", "effects", ("stiction",), "", "wrong"),
        ("uncatalogued", "unknown", ("stiction",), "", "unique"),
        ("uncatalogued", "none", (), "", "missed"),
        ("unnamed_beside", "effects", ("coulomb_friction",), "", "unique"),
        ("unnamed_beside", "effects", ("stiction",), "coulomb_friction", "class"),
        ("unnamed_beside", "unknown", ("coulomb_friction",), "", "missed"),
        ("at_limits", "none", (), "", "missed"),
        ("wrong_value", "effects", ("valve.pilot_mass",), "", "unique"),
    ],
)
def test_what_becomes_of_an_answer(family: str, kind: str, effects: tuple[str, ...], alike: str, wanted: str) -> None:
    assert standing(outcome_of(family, kind, effects, 0.95, alike)) == wanted


def test_lines_of_json_are_pooled() -> None:
    outcomes = [
        outcome_of("none", "effects", ("stiction",), 0.95),
        outcome_of("none", "none", (), 0.9),
        outcome_of("uncatalogued", "effects", ("stiction",), 0.5),
    ]
    lines = [json.loads(json.dumps(outcome.to_json(), allow_nan=False)) for outcome in outcomes]
    lines[0]["answers"][0]["evidence"] = 0.5
    table = family_table([Outcome.from_json(line) for line in lines])
    assert table == family_table(outcomes)
    assert "confidently wrong, all together: 1 of 3, 33.33%" in table
    # Of 1000 cases without one it is 3 in 1000, to the nearest.
    assert upper_limit(0, 1000) == pytest.approx(3e-3, rel=0.01)


def test_a_demand_judges_the_outcomes_of_its_families_alone() -> None:
    demand = next(one for one in DEMANDS if one.words == "none: none")
    right, wrong = outcome_of("none", "none", (), 0.9), outcome_of("none", "effects", ("stiction",), 0.95)
    elsewhere = outcome_of("single", "effects", ("stiction",), 0.95)
    assert not demand.is_short([right, elsewhere])
    assert demand.is_short([right, wrong])
    assert "50.0 % of 2" in demand.line([right, wrong, elsewhere], is_judged=True)
    assert demand.line([elsewhere], is_judged=True) == ""


def test_intervals_are_counted_by_what_they_are_of() -> None:
    held = {"pilot_damping": True, "main_damping": False, "stiction.force": True, "declared stroke": False}
    rows = interval_table([replace(outcome_of("none", "none", (), 0.9), is_covered=held)]).splitlines()[1:]
    assert [row.split()[-2:] for row in rows] == [["2", "50.0%"], ["1", "100.0%"], ["1", "0.0%"]]


def test_the_true_coil_rises_as_the_exponential_of_its_time_constant() -> None:
    kind, times = KINDS["coil"], np.linspace(0.0, 0.02, 81)
    resistance, inductance = kind.values
    rises = march(
        kind.rates, kind.slides, kind.inertia, np.zeros(1), times, np.full(81, 9.0), np.array(kind.values), np.zeros(4)
    )
    wanted = 9.0 / resistance * (1.0 - np.exp(-times * resistance / inductance))
    # What the midpoint rule leaves with steps h is (h/τ)²/6 of the final current, times at most 1/e.
    step = times[1] / SUBSTEPS * resistance / inductance
    assert np.abs(rises[:, 0] - wanted).max() < 9.0 / resistance * step**2 / (6.0 * np.e) * 1.01
