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
from unittest import mock

import pytest

import nodes.ros  # noqa: F401
from valve_sim.nodes import __main__ as programs

from .ros_process import NodeProcess, own_lines

pytestmark = pytest.mark.ros

NO_BAG = Path(__file__)
"""A file that is no recording."""
OWN, PLUNGER = (
    Path(__file__).parents[2] / "docs" / "examples" / "own_plants" / name
    for name in ("single_plunger.yaml", "plunger.yaml")
)


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
    ("program", "arguments", "environment", "says"),
    [
        ("valve_node", ["-p", "publish_rat:=100.0"], {}, "did you mean publish_rate"),
        ("command_profile", [], {"ROS_LOG_DIR": "/dev/null/logs"}, "set ROS_LOG_DIR to a folder that can be written"),
    ],
)
def test_a_process_ends_with_code_2_and_one_line(
    in_own_domain: None, tmp_path: Path, program: str, arguments: list[str], environment: dict[str, str], says: str
) -> None:
    process = NodeProcess(tmp_path, ["--ros-args", *arguments], program, **environment)
    assert process.exit_code() == 2, process.output
    (line,) = own_lines(process.output)
    assert line.startswith(f"{program}: ")
    assert says in line


BAD_FILES = {
    "publish_rat: 100": "publish_rat: found 100 under an unknown name; .*did you mean publish_rate",
    "valve: {pilot_mass: 0}": "valve.pilot_mass: found 0, expected a number above 0",
    "valve: {pilot_mass: heavy}": "valve.pilot_mass: found 'heavy', expected a number",
    "valve: {attraction_polynomial: [0, 1.5, 2]}": "valve.attraction_polynomial: found 3 terms",
    "valve: {attraction_polynomial: [3, 1.5, 2, 1.0]}": (
        r"valve.attraction_polynomial: found .* expected values of one type"
    ),
}


@pytest.mark.parametrize("content", BAD_FILES)
def test_a_bad_file_of_a_valve(here: None, capfd: pytest.CaptureFixture[str], tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(f"/**:\n  ros__parameters:\n    {content}\n")
    said = refusal(capfd, "valve_node", "--params-file", str(path))
    assert re.match(f"valve_node: {path}: {BAD_FILES[content]}", said)


@pytest.mark.parametrize(
    ("program", "arguments", "says"),
    [
        ("valve_node", "-p valve.pilot_mas:=1.0", "valve_node: command line: valve.pilot_mas: .*mean valve.pilot_mass"),
        ("valve_node", "--params-file none.yaml", "valve_node: none.yaml: cannot be read"),
        ("valve_node", "-p frame_id:=[]", "gives a name without a value"),
        ("valve_node", "-p tolerances:=x", "tolerances: found .x. under an unknown name"),
        ("valve_node", "-p plant:=nowhere.yaml", "valve_node: nowhere.yaml: cannot be read"),
        (
            "valve_node",
            f"-p plant:={PLUNGER}",
            r"plunger.yaml: inputs.voltage: is missing; .* voltage at its coil, in V",
        ),
        (
            "valve_node",
            f"-p plant:={OWN} -p effects.stiction.force:=0.1",
            "stiction.force: is of the valve, which plant:=",
        ),
        ("valve_node", f"-p plant:={OWN} -p parameters.strok:=0.1", "did you mean parameters.stroke"),
        ("monitor_node", f"-p plant:={OWN}", "command line: plant: found .* a monitor watches valves, take it out"),
        ("valve_node", "--nonsense", "valve_node: ROS 2 refused to start: .*--nonsense"),
        ("identification_node", "", "bag: not given"),
        ("monitor_node", "-p commissioning_strokes:=20.5", "a whole number"),
        ("command_profile", "", "profile: not given"),
        ("identification_node", "-p bag:=nowhere.mcap", "nowhere.mcap"),
        ("identification_node", f"-p bag:={NO_BAG}", NO_BAG.name),
        ("identification_node", "-p bag:=a.mcap -p params:=nowhere.yaml", "nowhere.yaml"),
        ("identification_node", "-p bag:=a.mcap -p apply_to:=no/{such", "expected a ROS name"),
        ("monitor_node", "-p state:=/dev/null", "damaged"),
        ("monitor_node", "-p valve_node:=no/{such", "expected a ROS name"),
        ("monitor_node", "-p noise_mu:=1.0", "did you mean noise_um"),
        ("monitor_node", "-p tolerances.effects.stiction.force:=0.1", "not declared on"),
        ("monitor_node", "-p valve.pilot_gap:=5e-3", "pilot_gap"),
    ],
)
def test_what_a_node_cannot_use(
    here: None, capfd: pytest.CaptureFixture[str], tmp_path: Path, program: str, arguments: str, says: str
) -> None:
    output = ["-p", f"output:={tmp_path}"] if program == "identification_node" else []
    assert re.search(says, refusal(capfd, program, *arguments.split(), *output))
