"""What a node cannot use ends it with exit code 2 and one line that says why. Nothing is heard or sent.

Of each program one case is a process of its own; of the others the program's function is called here, which returns the
exit code.
"""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from .ros_process import NodeProcess, own_lines

pytestmark = pytest.mark.ros
pytest.importorskip("rclpy", reason="there is no ROS 2 here: rclpy cannot be imported")

from valve_sim.nodes import __main__ as programs  # noqa: E402

NO_BAG = Path(__file__)
"""A file that is no recording."""
Case = tuple[dict[str, object], str]


@pytest.fixture
def here(in_own_domain: None, tmp_path: Path) -> Iterator[None]:
    """What a program changes of its process, its signals and its environment, is put back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with mock.patch.dict(os.environ, {"ROS_LOG_DIR": str(tmp_path)}):
        yield
    for number, handler in before.items():
        signal.signal(number, handler)


def refusal(said: pytest.CaptureFixture[str], program: str, *arguments: str) -> str:
    """The one line that a program says, which ends with code 2."""
    said.readouterr()
    assert getattr(programs, program)([program, "--ros-args", *arguments]) == 2
    (line,) = own_lines(said.readouterr().err)
    return line


@pytest.mark.parametrize(
    ("program", "arguments", "says"),
    [
        ("valve_node", ["-p", "publish_rat:=100.0"], "did you mean publish_rate"),
        ("identification_node", [], "bag: not given"),
        ("monitor_node", ["-p", "commissioning_strokes:=20.5"], "a whole number"),
        ("command_profile", [], "profile: not given"),
    ],
)
def test_a_process_ends_with_code_2_and_one_line(
    in_own_domain: None, tmp_path: Path, program: str, arguments: list[str], says: str
) -> None:
    process = NodeProcess(tmp_path, ["--ros-args", *arguments], program)
    assert process.exit_code() == 2, process.output
    (line,) = own_lines(process.output)
    assert line.startswith(f"{program}: ")
    assert says in line


def given(parameters: dict[str, object]) -> list[str]:
    return [word for name, value in parameters.items() for word in ("-p", f"{name}:={value}")]


def first_everywhere(first: Case, *others: Case) -> list[Any]:
    """Cases of which one shows what hangs on ROS: how it gives parameters is tested with valve_node, for all nodes."""
    return [first, *(pytest.param(*case, marks=pytest.mark.any_distribution) for case in others)]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("publish_rat: 100", "publish_rat: found 100 under an unknown name; .*did you mean publish_rate"),
        ("valve: {pilot_mass: 0}", "valve.pilot_mass: found 0, expected a number above 0"),
        ("valve: {pilot_mass: heavy}", "valve.pilot_mass: found 'heavy', expected a number"),
        ("valve: {attraction_polynomial: [0, 1.5, 2]}", "valve.attraction_polynomial: found 3 terms"),
        (
            "valve: {attraction_polynomial: [3, 1.5, 2, 1.0]}",
            r"valve.attraction_polynomial: found .* expected values of one type",
        ),
    ],
)
def test_a_bad_file_of_a_valve(
    here: None, capfd: pytest.CaptureFixture[str], tmp_path: Path, content: str, says: str
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    {content}\n")
    assert re.match(f"valve_node: {path}: {says}", refusal(capfd, "valve_node", "--params-file", str(path)))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["-p", "valve.pilot_mas:=1.0"], "valve_node: command line: valve.pilot_mas: .*did you mean valve.pilot_mass"),
        (["--params-file", "none.yaml"], "valve_node: none.yaml: cannot be read"),
        (["-p", "frame_id:=[]"], "gives a name without a value"),
        (["--nonsense"], "valve_node: ROS 2 refused to start: .*--nonsense"),
    ],
)
def test_a_bad_command_line_of_a_valve(
    here: None, capfd: pytest.CaptureFixture[str], arguments: list[str], says: str
) -> None:
    assert re.search(says, refusal(capfd, "valve_node", *arguments))


@pytest.mark.parametrize(
    ("parameters", "says"),
    first_everywhere(
        ({}, "bag: not given"),
        ({"bag": "nowhere.mcap"}, "nowhere.mcap"),
        ({"bag": str(NO_BAG)}, NO_BAG.name),
        ({"bag": "a.mcap", "free": "[pilot_dampin]"}, "did you mean pilot_damping"),
        ({"bag": "a.mcap", "ratee": "1.0"}, "did you mean rate"),
        ({"bag": "a.mcap", "mode": "guess"}, "identify or diagnose"),
        ({"bag": "a.mcap", "params": "nowhere.yaml"}, "nowhere.yaml"),
        ({"bag": "a.mcap", "apply_to": "no/{such"}, "expected a ROS name"),
    ),
)
def test_what_identification_cannot_use(
    here: None, capfd: pytest.CaptureFixture[str], tmp_path: Path, parameters: dict[str, object], says: str
) -> None:
    assert says in refusal(capfd, "identification_node", *given({"output": tmp_path, **parameters}))


@pytest.mark.parametrize(
    ("parameters", "says"),
    first_everywhere(
        ({"commissioning_strokes": 20.5}, "a whole number"),
        ({"noise_mu": 1.0}, "did you mean noise_um"),
        ({"state": "/dev/null"}, "damaged"),
        ({"commissioning_strokes": 2}, "from 8 to 1000"),
        ({"valve_node": "no/{such"}, "expected a ROS name"),
        ({"tolerances.strok": 4e-6}, "did you mean tolerances.stroke"),
        ({"tolerances.effects.stiction.force": 0.1}, "not declared on"),
        ({"valve.pilot_gap": 5e-3}, "pilot_gap"),
        ({"effects.coulomb_fricton.force": 0.1}, "did you mean"),
    ),
)
def test_what_a_monitor_cannot_use(
    here: None, capfd: pytest.CaptureFixture[str], parameters: dict[str, object], says: str
) -> None:
    assert says in refusal(capfd, "monitor_node", *given(parameters))
