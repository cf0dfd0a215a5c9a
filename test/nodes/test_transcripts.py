"""docs/reference/ros2_commands.md has what `ros2` says to a running valve_node, word for word.

    WRITE_TRANSCRIPTS=1 python -m pytest test/nodes/test_transcripts.py

writes it anew, which needs ros2cli; no wheel has it, and where there is none that test is skipped and says so. Another
one asks the running node what these commands ask it, and compares the page with the answers: it needs no ros2cli.
"""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

from nodes.ros import UInt8

from .ros_process import ENDS_WITHIN, Probe, running

pytestmark = [pytest.mark.ros, pytest.mark.any_distribution, pytest.mark.usefixtures("ros")]


PAGE: Final = Path(__file__).parents[2] / "docs" / "reference" / "ros2_commands.md"
ROS2: Final = (sys.executable, "-c", "import sys; from ros2cli.cli import main; sys.exit(main())")
SPIN: Final = ("--spin-time", "5")
"""s that a command looks for others; the daemon that would know them outlives a test."""
COMMANDS: Final = (
    ("What a node has", ("node info /valve",)),
    (
        "A parameter: what it means, its value, and setting it",
        (
            "param describe /valve command_timeout",
            "param get /valve command_timeout",
            "param set /valve command_timeout 0.5",
            "param set /valve valve.pilot_mass -0.1",
            "param set /valve tolerances.stroke 2.0e-6",
            "param get /valve tolerances.stroke",
        ),
    ),
    (
        "A topic: its type and QoS, and what it says",
        ("topic info --verbose /valve/phase", "topic echo --once /valve/phase"),
    ),
)
HEADINGS: Final = {"Subscribers": "subscriber", "Publishers": "publisher", "Service Servers": "service"}
"""Headings of `node info`, and the words of rclpy for what is below."""
CHANGING: Final = re.compile(r"^(GID: ).*$", re.MULTILINE)


def said(command: str) -> str:
    """What `ros2` answers; what is another in each run is left out."""
    words = command.split()
    group, verb, *rest = words
    spins = () if (group, verb) == ("topic", "echo") else SPIN
    ran = subprocess.run(
        [*ROS2, group, verb, "--no-daemon", *spins, *rest],
        capture_output=True, text=True, timeout=ENDS_WITHIN, env=dict(os.environ), check=False,
    )  # fmt: skip
    assert "Traceback" not in ran.stderr, ran.stderr
    lines = [line.rstrip() for line in (ran.stdout + ran.stderr).splitlines()]
    return CHANGING.sub(r"\1…", "\n".join(lines)).strip("\n")


def page(transcripts: Sequence[tuple[str, Sequence[tuple[str, str]]]]) -> str:
    parts = [
        "# What ros2 says",
        "To a valve_node with nothing but its defaults, on Jazzy. A test asks and compares, and writes this page.",
    ]
    for title, answers in transcripts:
        blocks = [f"$ ros2 {command}\n{answer}" for command, answer in answers]
        parts += [f"## {title}", "```console\n" + "\n".join(blocks) + "\n```"]
    return "\n\n".join(parts) + "\n"


def test_the_page_has_what_ros2_says(tmp_path: Path) -> None:
    for package in ("ros2cli", "ros2node", "ros2param", "ros2topic"):
        pytest.importorskip(package, reason=f"there is no {package} here, so nothing says what ros2 would")
    probe = Probe()
    try:
        with running(tmp_path, ["--ros-args", "-p", "publish_rate:=100.0"]) as node:
            assert probe.until(lambda: "ready" in node.output)
            made = page([(title, [(command, said(command)) for command in group]) for title, group in COMMANDS])
    finally:
        probe.close()
    if os.environ.get("WRITE_TRANSCRIPTS"):
        PAGE.write_text(made, encoding="utf-8")
    assert made == PAGE.read_text(encoding="utf-8")


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
