"""What the campaign draws: cases that a family and a seed determine, with declared files that the package reads."""

import numpy as np
import pytest
from plants.common import FloatArray
from plants.recording import Recorder
from plants.tolerances import SHEET_VALVE

from benchmarks.campaign.cases import draw_case
from benchmarks.campaign.limits import DETECTABLE, Knowledge, detection_limit, yardstick
from benchmarks.campaign.running import true_effects

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


def test_an_effect_that_takes_up_an_unknown_deviation_is_not_judged() -> None:
    assert set(draw_case("reluctance", 16).truth) == {"stroke_offset"}
    assert true_effects(draw_case("reluctance", 16)) == {}
    within = draw_case("single_within", 17)
    assert true_effects(within)["stroke_offset.offset"] == pytest.approx(
        within.truth["stroke_offset"]["offset"] + within.true_scalars["stroke"] - within.declared.parameters.stroke
    )
