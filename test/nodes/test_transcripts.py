"""docs/reference/ros2_commands.md has what `ros2` says to a running valve_node, word for word.

    WRITE_TRANSCRIPTS=1 python -m pytest test/nodes/test_transcripts.py

writes it anew. Needs ros2cli, which no wheel has: it is skipped, saying so, where there is none.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import pytest

from .ros_process import ENDS_WITHIN, Probe, running

pytestmark = [pytest.mark.ros, pytest.mark.any_distribution]
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")
for package in ("ros2cli", "ros2node", "ros2param", "ros2topic"):
    pytest.importorskip(package, reason=f"there is no {package} here, so nothing says what ros2 would")

import rclpy  # noqa: E402

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
            "param get /valve tolerances",
        ),
    ),
    (
        "A topic: its type and QoS, and what it says",
        ("topic info --verbose /valve/phase", "topic echo --once /valve/phase"),
    ),
)
CHANGING: Final = re.compile(r"^(GID: ).*$", re.MULTILINE)


@pytest.fixture(scope="module", autouse=True)
def ros(in_own_domain: None) -> Iterator[None]:
    rclpy.init()
    yield
    rclpy.try_shutdown()


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
