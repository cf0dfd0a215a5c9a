"""The examples of docs/ do what their pages say."""

from __future__ import annotations

import math
import runpy
from collections.abc import Iterator
from pathlib import Path

import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import CATALOGUE

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"


@pytest.fixture
def catalogue_as_shipped() -> Iterator[None]:
    shipped = set(CATALOGUE)
    yield
    for name in set(CATALOGUE) - shipped:
        CATALOGUE.unregister(name)


@pytest.mark.long
@pytest.mark.usefixtures("catalogue_as_shipped")
def test_an_effect_of_your_own_takes_part_in_the_diagnosis() -> None:
    found = runpy.run_path(str(EXAMPLES / "my_effect.py"))["run"]()
    assert found.verdict.kind == "effects"
    assert found.verdict.effects == ("eddy_drag",)
    assert found.after.intervals["eddy_drag.force"].value == pytest.approx(0.15, rel=0.05)
    assert found.after.train_rmse < 0.5 * found.before.train_rmse


def test_two_printed_arrivals_fix_neither_damping_of_the_papers_valve() -> None:
    """As printed it never opens; a pull at rest meets t1 alone; with a coil lag, both are met at any dampings."""
    printed, pull, undamped, *both = runpy.run_path(str(EXAMPLES / "paper_events.py"))["main"]().values()
    assert all(math.isnan(time) for time in printed[4:])
    assert pull[4:] == pytest.approx((5.3e-3, 10.9e-3), abs=0.05e-3)
    assert undamped[5] > 10.5e-3
    assert len(both) == 5
    for row in both:
        assert row[4:] == pytest.approx((5.3e-3, 9.9e-3), abs=1e-9)
    shipped = default_valve()
    assert both[1][:2] == pytest.approx((shipped.declared()["a0"], shipped.declared()["coil_time_constant"]), rel=1e-4)
