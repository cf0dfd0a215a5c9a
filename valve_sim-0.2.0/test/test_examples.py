"""The examples of docs/ do what their pages say."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

from valve_sim.model import CATALOGUE

pytestmark = pytest.mark.long

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"


@pytest.fixture
def catalogue_as_shipped() -> Iterator[None]:
    shipped = set(CATALOGUE)
    yield
    for name in set(CATALOGUE) - shipped:
        CATALOGUE.unregister(name)


@pytest.mark.usefixtures("catalogue_as_shipped")
def test_an_effect_of_your_own_takes_part_in_the_diagnosis() -> None:
    found = runpy.run_path(str(EXAMPLES / "my_effect.py"))["run"]()
    assert found.verdict.kind == "effects"
    assert found.verdict.effects == ("eddy_drag",)
    assert found.after.intervals["eddy_drag.force"].value == pytest.approx(0.15, rel=0.05)
    assert found.after.train_rmse < 0.5 * found.before.train_rmse
