"""The additive pair satisfies the conditions of its order, each part alone and coupled: a wrong digit shows."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from valve_sim.model.core import gas_steps
from valve_sim.model.core.gas_steps import DIAGONAL
from valve_sim.model.core.layout import STAGES

TIMES, WEIGHTS, EMBEDDED = (np.array(table) for table in (gas_steps.TIMES, gas_steps.WEIGHTS, gas_steps.EMBEDDED))
EXPLICIT, IMPLICIT = (np.reshape(table, (STAGES, STAGES - 1)) for table in (gas_steps.EXPLICIT, gas_steps.IMPLICIT))
TABLEAUS = {
    "explicit": np.hstack([EXPLICIT, np.zeros((STAGES, 1))]),
    "implicit": np.hstack([IMPLICIT, np.zeros((STAGES, 1))]) + np.diag([0.0, *[DIAGONAL] * (STAGES - 1)]),
}
PAIRS = list(itertools.product(TABLEAUS.values(), repeat=2))


@pytest.mark.parametrize("name", TABLEAUS)
def test_stages_look_where_their_times_say(name: str) -> None:
    np.testing.assert_allclose(TABLEAUS[name].sum(axis=1), TIMES, atol=1e-14)


def test_the_weights_are_of_order_4_whichever_parts_meet() -> None:
    b, c = WEIGHTS, TIMES
    np.testing.assert_allclose([b @ c**k for k in range(4)], [1, 1 / 2, 1 / 3, 1 / 4], atol=1e-14)
    for inner, outer in PAIRS:
        found = [b @ inner @ c, (b * c) @ inner @ c, b @ inner @ c**2, b @ outer @ inner @ c]
        np.testing.assert_allclose(found, [1 / 6, 1 / 8, 1 / 12, 1 / 24], atol=1e-13)


def test_the_embedded_weights_are_of_order_3_and_no_more() -> None:
    np.testing.assert_allclose([EMBEDDED @ TIMES**k for k in range(3)], [1, 1 / 2, 1 / 3], atol=1e-14)
    for tableau in TABLEAUS.values():
        assert EMBEDDED @ tableau @ TIMES == pytest.approx(1 / 6, abs=1e-13)
    assert abs(EMBEDDED @ TIMES**3 - 1 / 4) > 1e-4


def test_the_implicit_part_forgets_what_is_infinitely_stiff() -> None:
    """R(∞) = 0, and the last stage is the end of the step."""
    implicit = TABLEAUS["implicit"]
    np.testing.assert_allclose(implicit[-1], WEIGHTS, atol=1e-15)
    passed_on = np.linalg.solve(implicit[1:, 1:], -implicit[1:, 0])
    assert abs(passed_on[-1]) < 1e-12
