"""docs/reference/ros2_commands.md has what `ros2` says to a running valve_node: the node is asked the same."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

from nodes.ros import UInt8

from .ros_process import Probe, running

pytestmark = [pytest.mark.ros, pytest.mark.any_distribution, pytest.mark.usefixtures("ros")]


PAGE: Final = Path(__file__).parents[2] / "docs" / "reference" / "ros2_commands.md"
HEADINGS: Final = {"Subscribers": "subscriber", "Publishers": "publisher", "Service Servers": "service"}
"""Headings of `node info`, and the words of rclpy for what is below."""


def shown(command: str) -> list[str]:
    """The lines of the page after a command, without their indent."""
    lines = PAGE.read_text(encoding="utf-8").partition(f"$ ros2 {command}\n")[2].splitlines()
    return [line.strip() for line in itertools.takewhile(lambda line: not line.startswith(("$ ", "```")), lines)]


def below(heading: str, lines: Sequence[str]) -> dict[str, str]:
    """Names and types below a heading of `node info`."""
    rest = lines[lines.index(f"{heading}:") + 1 :]
    entries = itertools.takewhile(lambda line: line and not line.endswith(":"), rest)
    return dict(entry.split(": ") for entry in entries)


def test_what_the_page_says_is_what_the_node_answers(tmp_path: Path) -> None:
    from rcl_interfaces.srv import DescribeParameters

    probe = Probe()
    try:
        with running(tmp_path, ["--ros-args", "-p", "publish_rate:=100.0"]) as node:
            assert probe.until(lambda: "ready" in node.output)
            info, known = shown("node info /valve"), ("valve", "/")
            assert probe.until(lambda: known in probe.node.get_node_names_and_namespaces())
            for heading, kind in HEADINGS.items():
                ask = getattr(probe.node, f"get_{kind}_names_and_types_by_node")
                wanted = below(heading, info)
                probe.until(lambda ask=ask, wanted=wanted: len(ask(*known)) >= len(wanted))
                assert {name: types[0] for name, types in ask(*known)} == wanted
            request = DescribeParameters.Request(names=["command_timeout"])
            (found,) = probe.call("describe_parameters", DescribeParameters, request).descriptors
            (limits,) = found.floating_point_range
            assert shown("param describe /valve command_timeout") == [
                f"Parameter name: {found.name}",
                "Type: double",
                f"Description: {found.description}",
                "Constraints:",
                f"Min value: {limits.from_value}",
                f"Max value: {limits.to_value}",
                f"Additional constraints: {found.additional_constraints}",
            ]
            assert shown("param get /valve command_timeout") == [
                f"Double value is: {probe.parameters()['command_timeout']}"
            ]
            (done,) = probe.set_parameters(command_timeout=0.5)
            assert done.successful and shown("param set /valve command_timeout 0.5") == ["Set parameter successful"]
            (refused,) = probe.set_parameters(valve__pilot_mass=-0.1)
            assert shown("param set /valve valve.pilot_mass -0.1") == [f"Setting parameter failed: {refused.reason}"]
            (done,) = probe.set_parameters(tolerances__stroke=2.0e-6)
            assert done.successful and shown("param set /valve tolerances.stroke 2.0e-6") == [
                "Set parameter successful"
            ]
            assert shown("param get /valve tolerances.stroke") == ["Double value is: 2e-06"]
            (publisher,) = probe.node.get_publishers_info_by_topic("/valve/phase")
            told = shown("topic info --verbose /valve/phase")
            for words in (
                f"Topic type hash: {publisher.topic_type_hash}",
                f"Reliability: {publisher.qos_profile.reliability.name}",
                f"Durability: {publisher.qos_profile.durability.name}",
            ):
                assert words in told
            phases = probe.hear("phase", UInt8, latched=True)
            assert probe.until(lambda: phases)
            assert shown("topic echo --once /valve/phase") == [f"data: {phases[0].data}", "---"]
    finally:
        probe.close()
