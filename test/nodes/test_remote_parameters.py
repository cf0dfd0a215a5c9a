"""Handing parameters on to another node: what is said of it, and a reply that is lost on the way."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

import nodes.ros  # noqa: F401
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.model import ParameterError
from valve_sim.nodes import identification
from valve_sim.nodes.identification import changes_between


def test_changes_have_units_and_digits_that_show_the_interval() -> None:
    old = {
        "valve.pilot_damping": 1.0,
        "valve.stroke": 1.23e-3,
        "valve.attraction_polynomial": [0.0, 17096.0],
        "effects.coulomb_friction.force": 0.0,
        "effects.sensor_bandwidth.cutoff_frequency": math.inf,
    }
    new = {
        **old,
        "valve.pilot_damping": 1.2999987,
        "valve.attraction_polynomial": [3.0, 17096.0],
        "effects.coulomb_friction.force": 0.3,
        "effects.sensor_bandwidth.cutoff_frequency": 2000.0,
    }
    intervals = {
        "pilot_damping": Interval(1.2999987, 1e-6, 1.2999967, 1.3000007),
        "coulomb_friction.force": Interval(0.3, math.nan, 0.0, math.inf),
    }
    assert [change.text() for change in changes_between(old, new, intervals)] == [
        "valve.pilot_damping: 1 → 1.2999987 N·s/m, 95 % interval 1.2999967 to 1.3000007",
        "valve.attraction_polynomial: [0, 17096] → [3, 17096]",
        "effects.coulomb_friction.force: 0 → 0.3 N, 95 % interval 0 to infinity",
        "effects.sensor_bandwidth.cutoff_frequency: infinity → 2000 Hz",
    ]


def test_a_tolerance_that_changes_has_a_line_without_the_interval_of_its_value() -> None:
    old = {"tolerances.stroke": 4e-6, "tolerances.spring_rate": 12.8, "tolerances.effects.stiction.force": 0.0}
    new = {"tolerances.stroke": 2e-6, "tolerances.spring_rate": 12.8, "tolerances.effects.stiction.force": 0.01}
    assert [change.text() for change in changes_between(old, new, {"stroke": Interval(0.0, 1.0, -2.0, 2.0)})] == [
        "tolerances.stroke: 4e-06 → 2e-06 m",
        "tolerances.effects.stiction.force: 0 → 0.01 N",
    ]


class Forgetful:
    """A client of a node's parameters; the replies to its first questions are lost."""

    def __init__(self, lost: float, *, is_there: bool = True, reason: str = "") -> None:
        self.lost, self.is_there, self.asked = lost, is_there, 0
        self._reply = SimpleNamespace(result=SimpleNamespace(successful=not reason, reason=reason))

    def wait_for_services(self, timeout_sec: float) -> bool:
        return self.is_there

    def set_parameters_atomically(self, parameters: Any, callback: Callable[[Any], None]) -> None:
        self.asked += 1
        if self.asked > self.lost:
            callback(SimpleNamespace(result=lambda: self._reply))


@pytest.mark.parametrize(
    ("client", "asked", "says"),
    [
        (Forgetful(0), 1, ""),
        (Forgetful(2), 3, ""),
        (Forgetful(math.inf), 4, "/valve: did not answer within 0.02 s"),
        (Forgetful(0, is_there=False), 0, "/valve: no such node was found within 10 s"),
        (Forgetful(0, reason="too heavy"), 1, "/valve refuses them: too heavy"),
    ],
)
def test_a_question_whose_reply_is_lost_is_asked_again(
    client: Forgetful, asked: int, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(identification, "AsyncParameterClient", lambda node, name: client)
    monkeypatch.setattr(identification, "ANSWER_SECONDS", 0.02)
    remote: Any = identification.RemoteParameters(None, "/valve")  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match=f"^{says}$") if says else contextlib.nullcontext():
        remote.set({"valve.stroke": 1.2e-3})
    assert client.asked == asked
