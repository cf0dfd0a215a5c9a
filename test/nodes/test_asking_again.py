"""A reply that is lost on the way is asked for again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from valve_sim.nodes.valve_parameters import ValveSettings

from .ros_process import Probe, piped

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

import rclpy  # noqa: E402
from rcl_interfaces.srv import (  # noqa: E402
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.parameter import Parameter  # noqa: E402
from std_msgs.msg import String  # noqa: E402

BAG = Path(__file__).parents[2] / "bags" / "one_opening.mcap"


ENTRIES = ValveSettings.table()


@pytest.fixture(scope="module", autouse=True)
def ros(in_own_domain: None) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


class Forgetful:
    """The parameter services of a node; what it says to the first questions never leaves it."""

    def __init__(self, name: str, lost: int) -> None:
        self._node: Any = rclpy.create_node(name, start_parameter_services=False)
        self._lost = lost
        self._setting = self._serve(SetParametersAtomically, "set_parameters_atomically")
        self._getting = self._serve(GetParameters, "get_parameters")
        # An AsyncParameterClient waits for all six.
        for kind, service in (
            (GetParameterTypes, "get_parameter_types"),
            (SetParameters, "set_parameters"),
            (DescribeParameters, "describe_parameters"),
            (ListParameters, "list_parameters"),
        ):
            self._serve(kind, service)
        self.asked = 0

    def _serve(self, kind: Any, service: str) -> Any:
        # Never spun: requests are taken by hand.
        return self._node.create_service(kind, f"~/{service}", lambda _, reply: reply)

    def answer(self) -> None:
        """Take a question that waits, if any; answer it if enough of them were lost."""
        self._tell_values()
        with self._setting.handle:
            question = self._setting.handle.service_take_request(SetParametersAtomically.Request)
        if question is None or question == (None, None):
            return
        self.asked += 1
        if self.asked > self._lost:
            reply = SetParametersAtomically.Response()
            reply.result.successful = True
            self._setting.send_response(reply, question[1])

    def _tell_values(self) -> None:
        with self._getting.handle:
            question = self._getting.handle.service_take_request(GetParameters.Request)
        if question is None or question == (None, None):
            return
        values = [Parameter(name, value=ENTRIES[name].default).get_parameter_value() for name in question[0].names]
        self._getting.send_response(GetParameters.Response(values=values), question[1])

    def close(self) -> None:
        """Release the node."""
        self._node.destroy_node()


@pytest.mark.parametrize(("lost", "is_set"), [(1, True), pytest.param(100, False, marks=pytest.mark.long)])
def test_a_result_is_handed_on_past_lost_replies(lost: int, is_set: bool, tmp_path: Path) -> None:
    forgetful = Forgetful(f"forgetful_{lost}", lost)
    for _ in range(3):
        applied = handed_on(forgetful, f"/forgetful_{lost}", tmp_path)
        if "no such node was found" not in applied["reason"]:
            break
    assert applied["is_set"] is is_set
    assert ("did not answer" in applied["reason"]) is not is_set
    assert forgetful.asked >= min(lost + 1, 2)
    forgetful.close()


def handed_on(forgetful: Forgetful, name: str, folder: Path) -> Any:
    """What identification_node says of handing its result on."""
    probe = Probe("/identification")
    results = probe.hear("result", String, latched=True)

    def has_ended() -> bool:
        forgetful.answer()
        return bool(results)

    given: dict[str, object] = {"bag": BAG, "output": folder, "apply_to": name, "rate": 0, "linger": "true"}
    with piped(folder, ("-m", "valve_sim.nodes", "identification_node"), **given):
        assert probe.until(has_ended), "no result"
    probe.close()
    return json.loads(results[0].data)["applied"]
