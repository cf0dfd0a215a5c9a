"""The settings of every node but valve_node, without ROS: what may be given, and what is refused in one line."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.model import ParameterError
from valve_sim.nodes.parameters import NodeSettings
from valve_sim.nodes.profile_playing import ProfileSettings
from valve_sim.nodes.settings import IdentificationSettings, MonitorNodeSettings
from valve_sim.nodes.starting import read_files
from valve_sim.station.tables import ArchiveSettings, OpcUaSettings, PlcSettings

from .dumps import TOLERATED, dump

TWO = ["a", "b"]


@pytest.mark.parametrize("settings", [ArchiveSettings, OpcUaSettings, PlcSettings])
def test_the_defaults_may_be_given_and_are_those_without_any(settings: type[NodeSettings]) -> None:
    assert settings.read({}, {}) == settings() == settings.read(dumped(settings()), {})


def dumped(settings: NodeSettings) -> dict[str, object]:
    """As `ros2 param dump` writes it."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(settings).items()}


def test_identification_takes_integers_for_doubles_and_names_in_one_text() -> None:
    given: dict[str, Any] = {"bag": "a.mcap", "rate": 2, "free": "a0, main_damping,a0", "loop": True}
    expected = IdentificationSettings(bag="a.mcap", free=("a0", "main_damping"), rate=2.0, loop=True)
    assert IdentificationSettings.read(given, {}) == expected


def test_the_valve_of_a_monitor_is_dumped_as_a_file_of_the_same_valve(tmp_path: Path) -> None:
    path = tmp_path / "tolerances.yaml"
    path.write_text(TOLERATED)
    ((_, section),) = read_files(["", "--ros-args", "--params-file", str(path)])
    values = MonitorNodeSettings.values({"valve_node": "/tank_1/valve", "publish_rate": 10.0, **section.values}, {})
    assert values["valve_node"] == "/tank_1/valve"
    assert load_valve(dump(values, tmp_path / "dump.yaml", "/monitor")) == load_valve(path)


def test_a_dump_of_command_profile_is_a_file_for_it_again(tmp_path: Path) -> None:
    values = asdict(ProfileSettings.read({"profile": "a.csv", "valve": "/tank_1/valve"}, {}))
    path = dump(values, tmp_path / "dump.yaml", "/command_profile")
    ((_, section),) = read_files(["", "--ros-args", "--params-file", str(path)])
    assert asdict(ProfileSettings.read(section.values, {})) == values


def test_a_serial_number_that_is_not_given_is_not_known() -> None:
    two = OpcUaSettings.read({"valves": TWO, "monitors": ["c", "d"]}, {})
    assert two.serial_numbers == ("", "")
    assert OpcUaSettings.read(dumped(two), {}) == two
    known = OpcUaSettings.read({"valves": TWO, "monitors": ["c", "d"], "serial_numbers": ["", "SN-7"]}, {})
    assert known.serial_numbers == ("", "SN-7"), "that of one valve may be unknown"


@pytest.mark.parametrize(
    ("settings", "given", "says"),
    [
        (IdentificationSettings, {}, "bag: not given"),
        (IdentificationSettings, {"bag": 3}, "expected text"),
        (IdentificationSettings, {"bag": "a", "rate": -1.0}, "file.yaml: rate: found -1.0, expected a number at least"),
        (IdentificationSettings, {"bag": "a", "rate": True}, "expected a number"),
        (IdentificationSettings, {"bag": "a", "loop": "yes"}, "true or false"),
        (IdentificationSettings, {"bag": "a", "mode": "guess"}, "identify or diagnose"),
        (IdentificationSettings, {"bag": "a", "free": "pilot_dampin"}, "did you mean pilot_damping"),
        (IdentificationSettings, {"bag": "a", "free": [1, 2]}, "list of names"),
        (IdentificationSettings, {"bag": "a", "free": ","}, "at least one"),
        (IdentificationSettings, {"bag": "a", "rat": 1.0}, "did you mean rate"),
        (IdentificationSettings, {"bag": "a", "valve.pilot_mass": 0.1}, "parameter params instead"),
        (ProfileSettings, {}, "profile: not given"),
        (ProfileSettings, {"profile": "x", "max_voltage": math.nan}, "expected a number at least 0 V"),
        (ProfileSettings, {"profile": "x", "patience": True}, "expected a number in s"),
        (PlcSettings, {"volt": 1.0}, "command line: volt: found 1.0 under an unknown na"),
        (PlcSettings, {"valves": "tank_1/valve"}, "valves: found 'tank_1/valve', expected a list of names"),
        (ArchiveSettings, {"years": 0.0}, "command line: years: found 0.0, expected a number from 0.01 to 100 years"),
        (ArchiveSettings, {"folder": ""}, "folder: found '', expected a text"),
        (OpcUaSettings, {"valves": TWO}, "monitors: found 1, expected 2, one for each of valves"),
        (OpcUaSettings, {"port": 70000}, "command line: port: found 70000, expected a number from 1 to 65535"),
        (OpcUaSettings, {"port": "x"}, "command line: port: found 'x', expected a whole number"),
        (PlcSettings, {"valves": ["a", "a"]}, "valves: found a, a, expected each once"),
        (PlcSettings, {"address": ""}, "address: found '', expected a text"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(
    settings: type[NodeSettings], given: dict[str, object], says: str
) -> None:
    with pytest.raises(ParameterError) as refused:
        settings.read(given, {"rate": "file.yaml"})
    assert says in str(refused.value)
    assert "\n" not in str(refused.value)
