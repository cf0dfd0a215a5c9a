"""Handing parameters on to another node: what is said of it, and a reply that is lost on the way."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

import nodes.ros  # noqa: F401
from valve_sim.model import ParameterError
from valve_sim.nodes import identification


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


def test_a_change_is_told_with_as_many_digits_as_show_it() -> None:
    before = {"valve.pilot_mass": 0.109, "valve.attraction_polynomial": [1.0, 2.0], "valve.stroke": 1e-3}
    after = {"valve.pilot_mass": 0.109000012, "valve.attraction_polynomial": [1.0, 2.5], "valve.stroke": 1e-3}
    assert identification.change_lines(before, after, {}) == (
        "valve.pilot_mass: 0.109 → 0.109000012 kg", "valve.attraction_polynomial: [1, 2] → [1, 2.5]",
    )  # fmt: skip
