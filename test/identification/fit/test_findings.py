"""What a fit says of itself, where the fit is made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from valve_sim.identification.fit.findings import Correlated, Finding, NotConverged, StampErrors, findings
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.fit.result import Fit

NAMES = ("a", "b", "c")


def made_up(correlation: list[list[float]], **changes: Any) -> Fit:
    """A fit of three parameters without any other finding, but for what is changed."""
    of_stamps = (("stamp[0]", "command_stamps"), ("stamp[1]", "command_stamps"), ("edge[0]", "input_edges"))
    stamps = tuple(SimpleNamespace(name=name, error=error) for name, error in of_stamps)
    clock = SimpleNamespace(name="clock_offset[0]")
    plant = SimpleNamespace(declared=lambda name: 1.0, nuisances=(clock,), timing_errors=stamps)
    noises = {"position": SimpleNamespace(samples=1000)}
    problem = SimpleNamespace(plant=plant, effective_samples=1000, noises=noises)
    content = {
        "problem": problem, "free": NAMES, "chi2": 1000.0, "nuisances": plant.nuisances, "values": {},
        "converged": True, "correlation": lambda: np.array(correlation), "on_bound": lambda name: None,
    }  # fmt: skip
    return cast("Fit", SimpleNamespace(**{**content, **changes}))


def found(correlation: list[list[float]], **changes: Any) -> tuple[Finding, ...]:
    return findings(made_up(correlation, **changes), dict.fromkeys(NAMES, Interval(1.0, 0.01, 0.98, 1.02)))


NONE = [[1.0, 0.5, 0.1], [0.5, 1.0, 0.0], [0.1, 0.0, 1.0]]


def test_a_fit_without_anything_to_say_has_no_findings() -> None:
    assert found(NONE) == ()


def test_each_pair_is_named_once_and_a_partner_of_a_pair_is_not_left_out() -> None:
    """b goes with a, and a goes more closely with c: both are said."""
    correlation = [[1.0, 0.995, -0.999], [0.995, 1.0, 0.5], [-0.999, 0.5, 1.0]]
    assert found(correlation) == (Correlated("a", "c", 0.999), Correlated("b", "a", 0.995))


def test_stamps_and_lack_of_convergence_are_findings() -> None:
    nuisances = tuple(SimpleNamespace(name=name) for name in ("clock_offset[0]", "stamp[0]", "stamp[1]", "edge[0]"))
    values = {"stamp[0]": 2e-6, "stamp[1]": -5e-6, "edge[0]": 9e-6}
    changes = {"nuisances": nuisances, "values": values, "converged": False}
    assert found(NONE, **changes) == (StampErrors(5e-6), NotConverged())
