"""Numbers out of live messages by a map; without ROS, messages are whatever has their fields."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from valve_sim.files.recording_map import MapError
from valve_sim.nodes.live_map import live_inputs

TEXT = """
command: {topic: /plc/volts, unit: mV}
position: {topic: /plc/joints, joint: lift_2, unit: mm, sign: -1, offset: 2.0}
current: {topic: /daq, type: lab_msgs/msg/Daq, field: "channels[1].level", clock: bag}
"""


@pytest.fixture(autouse=True)
def packages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Message packages as far as they are asked for."""
    for package, name in (("std_msgs", "Float64"), ("sensor_msgs", "JointState"), ("lab_msgs", "Daq")):
        for module in (package, f"{package}.msg"):
            monkeypatch.setitem(sys.modules, module, ModuleType(module))
        setattr(sys.modules[f"{package}.msg"], name, type(name, (), {}))


def written(text: str, folder: Path) -> str:
    (folder / "lab.yaml").write_text(text)
    return str(folder / "lab.yaml")


def header(seconds: int, nanoseconds: int) -> Any:
    return SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds))


def test_numbers_come_out_in_si(tmp_path: Path) -> None:
    inputs = live_inputs(written(TEXT, tmp_path), "/valve")
    assert [entry.message_class.__name__ for entry in inputs.values()] == ["Float64", "JointState", "Daq"]
    assert inputs["command"].value(SimpleNamespace(data=9000.0)) == pytest.approx(9.0)
    joints = SimpleNamespace(header=header(12, 34), name=["lift_1", "lift_2"], position=[5.0, 0.8])
    assert inputs["position"].value(joints) == pytest.approx(1.2e-3)
    assert inputs["position"].stamp(joints) == 12_000_000_034
    daq = SimpleNamespace(header=header(1, 0), channels=[SimpleNamespace(level=7.0), SimpleNamespace(level=0.9)])
    assert inputs["current"].value(daq) == 0.9
    assert inputs["current"].stamp(daq) == 0, "clock: bag"


@pytest.mark.parametrize(
    "joints",
    [
        SimpleNamespace(name=["lift_1"], position=[1.0]),
        SimpleNamespace(name=["lift_1", "lift_2"], position=[1.0]),
        SimpleNamespace(name=[], position=[]),
    ],
)
def test_a_message_without_it_has_no_number(joints: Any, tmp_path: Path) -> None:
    assert math.isnan(live_inputs(written(TEXT, tmp_path), "/valve")["position"].value(joints))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            TEXT.replace("lab_msgs/msg/Daq", "lab_msgs/msg/Other"),
            "current.type: found lab_msgs/msg/Other",
        ),
        (TEXT.replace("lab_msgs/msg/Daq", "no_such_msgs/msg/Daq"), "which is not installed here"),
        (TEXT.replace(', field: "channels[1].level"', ""), "holds several numbers; choose one with field:"),
        (TEXT.replace("command:", "voltage:"), "a live node needs the commands as they are sent"),
        ("time: t\ncommand: U\nposition: x\n", "names a column; a live node hears topics"),
    ],
)
def test_what_cannot_be_heard_is_refused(text: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(MapError, match=expected) as caught:
        live_inputs(written(text, tmp_path), "/valve")
    assert "\n" not in str(caught.value)
