"""What the campaign draws: cases that a family and a seed determine, with declared files that the package reads."""

import json
from dataclasses import replace

import numpy as np
import pytest
from plants.common import FloatArray
from plants.laboratory import IMPERFECTIONS, LABORATORIES, true_sizes
from plants.recording import Recorder
from plants.tolerances import SHEET_VALVE

from benchmarks.campaign.actuators import KINDS, ROUND, SUBSTEPS, march, missing
from benchmarks.campaign.cases import AT_LIMITS, EXACT_VALUES, RECORDED, SIZES, draw_case, planned
from benchmarks.campaign.effects import CATALOGUED
from benchmarks.campaign.limits import DETECTABLE, Knowledge, detection_limit, yardstick
from benchmarks.campaign.running import Answer, Outcome, is_unnamed, true_effects, true_names
from benchmarks.campaign.tables import DEMANDS, family_table, interval_table, standing, upper_limit

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


@pytest.mark.parametrize("seed", range(8))
def test_a_wrong_value_is_off_by_four_to_ten_tolerances_and_no_effect(seed: int) -> None:
    case = draw_case("wrong_value", seed)
    [name] = case.truth
    assert 4.0 <= abs(case.deviations[name.removeprefix("valve.")]) <= 10.0
    assert case.effects == {}
    [(own, value)] = case.truth[name].items()
    # Another mass deviates, too, and moves the sum of both.
    assert own == "moving_mass" or case.true_scalars[own] == pytest.approx(value)


def test_bags_of_a_folder_have_clocks_of_their_own_or_share_one() -> None:
    own, shared = draw_case("folder", 0), draw_case("folder", 1)
    assert len(own.recordings()) == len(set(own.clock_offsets)) == 5
    assert len(set(shared.clock_offsets)) == 1


def test_the_reluctance_plant_is_declared_by_its_static_table() -> None:
    case = draw_case("reluctance", 0)
    # No cubic is a reluctance: it misses by up to 0.22 N.
    force = POWERS @ np.array(case.declared.parameters.attraction_polynomial)
    np.testing.assert_allclose(force, 2.592e-5 / (2.4e-3 - np.linspace(0.0, 1.2e-3, 7)) ** 2, atol=0.3)
    covariance = np.array(case.declared.tolerances.attraction_covariance)
    assert 0.005 < np.sqrt(POWERS[3] @ covariance @ POWERS[3]) < 0.1


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


@pytest.mark.long
def test_an_effect_that_takes_up_an_unknown_deviation_is_not_judged() -> None:
    assert set(draw_case("reluctance", 16).truth) == {"stroke_offset"}
    assert true_effects(draw_case("reluctance", 16)) == {}
    within = draw_case("single_within", 17)
    assert true_effects(within)["stroke_offset.offset"] == pytest.approx(
        within.truth["stroke_offset"]["offset"] + within.true_scalars["stroke"] - within.declared.parameters.stroke
    )


@pytest.mark.parametrize("seed", range(len(EXACT_VALUES) + len(CATALOGUED)))
def test_an_exact_file_is_wrong_in_one_value_or_one_effect(seed: int) -> None:
    case = draw_case("exact_wrong", seed)
    [(name, amount)] = case.amplitudes.items()
    declared = case.declared
    assert declared.tolerances.is_exact
    if name in CATALOGUED:
        assert amount > 0.0
        assert declared.effects[name] != case.effects[name]
        return
    own = name.removeprefix("valve.")
    assert 0.05 <= abs(amount) <= 0.2
    np.testing.assert_allclose(
        getattr(declared.parameters, own), (1.0 + amount) * np.asarray(case.true_values[own], float)
    )


@pytest.mark.long
@pytest.mark.parametrize("turn", [0, 4])
def test_effects_at_limits_take_the_same_number_of_limits_for_a_round(turn: int) -> None:
    case = draw_case("at_limits", len(CATALOGUED) * turn + 3)
    assert case.amplitudes == {"constant_force": pytest.approx(AT_LIMITS[turn])}


@pytest.mark.long
def test_an_effect_beside_an_unnamed_one_is_all_that_is_to_be_named() -> None:
    case = draw_case("unnamed_beside", 0)
    assert len(case.truth) == 2
    assert true_names(case) == {"coulomb_friction"}
    assert is_unnamed(case)


def test_every_imperfection_of_every_size_takes_its_turn_with_either_noise() -> None:
    cases = [draw_case("imperfect", seed) for seed in range(2 * RECORDED["imperfect"].per_round)]
    wanted = {(f"{name}:{size}", noise) for name in IMPERFECTIONS for size in SIZES for noise in ("white", "quiet")}
    assert {(case.laboratory, case.noise) for case in cases} == wanted
    assert not any(case.truth for case in cases)
    for noise in ("white", "quiet"):
        assert {case.with_current for case in cases[:42] if case.noise == noise} == {False, True}
    assert [name for name, _ in planned(range(1), tuple(RECORDED), is_slice=False)].count("laboratory") == 5


def test_an_imperfect_recording_is_of_the_valve_that_the_file_declares_within_tolerances() -> None:
    case = draw_case("imperfect", 3)
    assert case.laboratory == "ringing:small"
    assert case == draw_case("imperfect", 3)
    assert not case.declared.tolerances.is_exact
    train, holdout = case.recordings()
    assert train.command_times[0] - train.true_command_times[0] == pytest.approx(case.clock_offsets[0])
    assert train.truth.pilot_position.max() == pytest.approx(case.true_scalars["stroke"])
    assert holdout.times[-1] < 0.5 * train.times[-1] + 0.1
    laboratory = case.laboratory_of(1)
    assert laboratory.position_noise == (0.2e-6 if case.noise == "quiet" else 1e-6)
    assert {name for name, size in true_sizes(laboratory).items() if size} == {"ringing"}


@pytest.mark.parametrize("seed", range(len(LABORATORIES)))
def test_a_laboratory_records_both_bags_with_draws_of_its_own(seed: int) -> None:
    case = draw_case("laboratory", seed)
    assert case.laboratory == list(LABORATORIES)[seed]
    assert case.truth == {}
    first, second = case.laboratory_of(0), case.laboratory_of(1)
    assert replace(first, clock_offset=second.clock_offset) == second != first
    assert first.position_noise == LABORATORIES[case.laboratory].position_noise
    noises = [one.pilot_position - one.truth.pilot_position for one in case.recordings()]
    assert not np.array_equal(noises[0][:100], noises[1][:100])


@pytest.mark.parametrize("seed", [3, 34])
def test_an_effect_stands_out_beside_an_imperfection(seed: int) -> None:
    case = draw_case("beside", seed)
    [(name, limits)] = case.amplitudes.items()
    assert name == list(CATALOGUED)[seed % len(CATALOGUED)]
    assert 9.9 <= limits <= 40.0
    assert case.laboratory.partition(":")[2] in ("middle", "large")


def test_an_effect_meets_another_imperfection_in_every_round() -> None:
    own_laboratory = RECORDED["beside"].laboratory
    assert own_laboratory is not None
    met = {own_laboratory(3 + len(CATALOGUED) * turn) for turn in range(2 * len(IMPERFECTIONS))}
    assert len(met) == 2 * len(IMPERFECTIONS)


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


def outcome_of(family: str, kind: str, effects: tuple[str, ...], probability: float, alike: str = "") -> Outcome:
    """A made-up answer to the first case of a family."""
    others = {effects[0]: (alike,)} if alike else {}
    answer = Answer(kind, effects, others, probability, 2.0, 2.0, 1.0, None, 1.0, 0.1, 1.0, 5.0, 1.0)
    return Outcome(draw_case(family, 0), (answer,), 1.0, {"pilot_damping": True, "main_damping": True})


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


def test_every_kind_of_actuator_lacks_each_of_its_effects_and_one_in_five_nothing() -> None:
    kinds, found = list(KINDS), [missing(seed) for seed in range(2 * ROUND)]
    assert found.count("") == 2 * ROUND // 5
    for place, (name, kind) in enumerate(KINDS.items()):
        assert {*found[place :: len(kinds)]} == {*kind.sizes, ""}, name


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
