"""How the campaign judges: its yardsticks, what becomes of an answer, and its tables."""

import functools
import json

import numpy as np
import pytest
from plants.actuators import KINDS, SUBSTEPS, march

from benchmarks.campaign.cases import Case, draw_case
from benchmarks.campaign.running import Answer, Outcome
from benchmarks.campaign.tables import DEMANDS, family_table, standing, upper_limit

pytestmark = pytest.mark.long


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
