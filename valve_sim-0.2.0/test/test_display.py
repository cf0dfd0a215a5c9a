"""What RViz shows of a valve: the plungers' faces are as far apart as the model says, in every phase of a stroke.

RViz and robot_state_publisher are not among the wheels: the description is read as XML, and its joints are moved here.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from nodes.launch_plan import LaunchConfiguration, read_launch_file

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Drive, simulate
from valve_sim.nodes import topics

ROOT = Path(__file__).parents[1]
URDF = ElementTree.parse(ROOT / "config" / "valve.urdf").getroot()
NAMES = ("pilot_plunger", "main_plunger")
EXACT = 1e-12
"""m."""


def joint(name: str) -> ElementTree.Element:
    (found,) = (joint for joint in URDF.findall("joint") if joint.attrib["name"] == name)
    return found


def numbers(element: ElementTree.Element, key: str) -> list[float]:
    return [float(word) for word in element.attrib[key].split()]


def faces(link: str, name: str) -> tuple[float, float]:
    """Lower and upper end of a named cylinder of a link along z, in the link's frame, m."""
    (found,) = (entry for entry in URDF.findall("link") if entry.attrib["name"] == link)
    (shape,) = (visual for visual in found.findall("visual") if visual.attrib.get("name") == name)
    origin, cylinder = shape.find("origin"), shape.find("geometry/cylinder")
    assert origin is not None and cylinder is not None
    middle, half = numbers(origin, "xyz")[2], 0.5 * float(cylinder.attrib["length"])
    return middle - half, middle + half


def height(name: str, position: float) -> float:
    """Of the frame of a joint's child in the body's, m, for a position of the joint."""
    origin, axis = joint(name).find("origin"), joint(name).find("axis")
    assert origin is not None and axis is not None
    assert numbers(origin, "xyz")[:2] == [0.0, 0.0] and numbers(axis, "xyz") == [0.0, 0.0, 1.0]
    return numbers(origin, "xyz")[2] + position


def gaps(pilot: float, main: float) -> tuple[float, float, float]:
    """Seat to main plunger, collar of the pilot plunger to lip of the main plunger, pilot plunger to core, m."""
    up, lifted = height("pilot_plunger", pilot), height("main_plunger", main)
    seated = lifted + faces("main_plunger_body", "shell")[0]
    between = lifted + faces("main_plunger_body", "lip")[0] - up - faces("pilot_plunger_body", "collar")[1]
    return seated, between, faces("body", "core")[0] - up - faces("pilot_plunger_body", "stem")[1]


def test_the_description_is_one_tree_of_the_joints_that_are_published() -> None:
    links = [link.attrib["name"] for link in URDF.findall("link")]
    children = [joint.find("child").attrib["link"] for joint in URDF.findall("joint")]  # type: ignore[union-attr]
    assert set(links) - set(children) == {"body"} and len(children) == len(set(children)) == len(links) - 1
    assert {joint.find("parent").attrib["link"] for joint in URDF.findall("joint")} == {"body"}  # type: ignore[union-attr]
    assert {joint.attrib["name"] for joint in URDF.findall("joint")} == set(NAMES)
    assert {joint.attrib["type"] for joint in URDF.findall("joint")} == {"prismatic"}
    colours = {material.attrib["name"] for material in URDF.findall("material")}
    assert {used.attrib["name"] for used in URDF.iter("material")} == colours


def test_the_limits_are_the_strokes_of_the_declared_valve() -> None:
    parameters = default_valve().parameters
    for name, stroke in (
        ("pilot_plunger", parameters.stroke),
        ("main_plunger", parameters.stroke - parameters.pilot_gap),
    ):
        limit = joint(name).find("limit")
        assert limit is not None and float(limit.attrib["lower"]) == 0.0
        assert float(limit.attrib["upper"]) == pytest.approx(stroke, abs=EXACT)


def test_faces_touch_where_the_model_has_contact_and_never_overlap() -> None:
    times = np.linspace(0.0, 60e-3, 6001)
    response = simulate(default_valve(), Drive.of([1e-3, 30e-3], [9.0, 0.0]), times)
    shown = np.array([
        gaps(pilot, main)
        for pilot, main in zip(response.pilot_position.tolist(), response.main_position.tolist(), strict=True)
    ])  # fmt: skip
    assert np.min(shown) > -EXACT
    assert np.min(shown[:, 2]) < EXACT, "it opens"
    assert gaps(0.0, 0.0) == pytest.approx((0.0, 0.26e-3, 1.23e-3), abs=EXACT)
    assert gaps(1.23e-3, 0.97e-3) == pytest.approx((0.97e-3, 0.0, 0.0), abs=EXACT)
    moving = response.main_position > 1e-6
    closing = times > 30e-3
    assert np.max(shown[moving & ~closing, 1]) < 1e-6, "while it opens, the pilot plunger lifts the main plunger"


def test_the_launch_file_shows_the_joints_of_the_valve_that_is_named() -> None:
    plan = read_launch_file(ROOT / "launch" / "display.launch.py")
    publisher, rviz = plan.started({})
    assert plan.started({"rviz": "false"}) == [publisher]
    assert (publisher.package, rviz.package) == ("robot_state_publisher", "rviz2")
    (given, _) = publisher.parameters
    assert isinstance(given, dict)
    assert ElementTree.fromstring(given["robot_description"].encode()).attrib["name"] == "valve"
    assert publisher.remappings == [("joint_states", [LaunchConfiguration("valve"), "/joint_states"])]
    assert "~/joint_states" in {topic.name for topic in topics.VALVE}
    flag, path = rviz.arguments
    assert flag == "-d"
    layout = yaml.safe_load(Path(path).read_text(encoding="utf-8"))["Visualization Manager"]
    assert layout["Global Options"]["Fixed Frame"] in {link.attrib["name"] for link in URDF.findall("link")}
    assert {display["Class"] for display in layout["Displays"]} >= {"rviz_default_plugins/RobotModel"}
