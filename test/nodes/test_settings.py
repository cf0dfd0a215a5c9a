"""The settings of every node but valve_node, without ROS: what may be given, and what is refused in one line."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from valve_sim.files.parameter_files import load_valve
from valve_sim.files.parameter_sections import Section, read_sections
from valve_sim.model import ParameterError
from valve_sim.nodes.parameters import OF_ANY_NODE, NodeSettings, of_others
from valve_sim.nodes.profile_playing import ProfileSettings
from valve_sim.nodes.settings import IdentificationSettings, MonitorNodeSettings
from valve_sim.nodes.starting import read_files
from valve_sim.nodes.valve_parameters import ValveSettings
from valve_sim.station.tables import ArchiveSettings, OpcUaSettings, PlcSettings

from .dumps import TOLERATED, dump

TWO = ["a", "b"]
ALL: tuple[type[NodeSettings], ...] = (
    ValveSettings, MonitorNodeSettings, IdentificationSettings, ProfileSettings, ArchiveSettings, OpcUaSettings,
    PlcSettings,
)  # fmt: skip
COMMON = """
/**:
  ros__parameters:
    valve: {stroke: 1.2e-3}
    parameters: {mass: 0.1}
    publish_rate: 500.0
    commissioning_strokes: 30
    measured: coil
    bag: a.mcap
    params: valve.yaml
    profile: b.yaml
    valves: [valve]
    megabytes: 100.0
    history_days: 10.0
    plc_host: plc
"""


def test_the_settings_of_any_node_are_those_of_all() -> None:
    assert frozenset().union(*(settings.rows() for settings in ALL)) == OF_ANY_NODE


@pytest.mark.parametrize("settings", ALL, ids=lambda settings: settings.program)
def test_one_file_for_many_nodes_is_of_use_to_each(settings: type[NodeSettings], tmp_path: Path) -> None:
    def values(*sections: Section) -> dict[str, Any]:
        told = [("a.yaml", section) for section in sections]
        given = {name: value for section in sections for name, value in section.values.items()}
        others = of_others(given, told, "/me", settings)
        return settings.values({name: value for name, value in given.items() if name not in others}, {})

    path = tmp_path / "common.yaml"
    path.write_text(COMMON)
    (common,) = read_sections(path)
    known = settings.table().keys() & common.values.keys()
    assert known
    found = values(common)
    assert {name: _listed(found[name]) for name in known} == {name: common.values[name] for name in known}
    for node, wrong in (("/**", "publish_rat"), ("/me", "publish_rat"), ("/me", "folder_of_another")):
        with pytest.raises(ParameterError, match=f"{wrong}: found 1 under an unknown name"):
            values(common, Section(node, {wrong: 1}))
    for name in OF_ANY_NODE - settings.table().keys() - {"plant"}:
        with pytest.raises(ParameterError, match=f"{name}: found 1 under an unknown name"):
            values(common, Section("/me", {name: 1}))


def _listed(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def test_what_must_not_be_passed_over_is_refused_in_any_section() -> None:
    for settings, given in ((IdentificationSettings, {"valve.stroke": 1e-3}), (MonitorNodeSettings, {"plant": "a"})):
        assert not of_others(given, [("a.yaml", Section("/**", given))], "/me", settings)
    assert of_others({"valve.stroke": 1}, [("a.yaml", Section("/*", {"valve.stroke": 1}))], "/me", PlcSettings)


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
    values = MonitorNodeSettings.values({"valve_node": "/tank_1/valve", **section.values}, {})
    assert values["valve_node"] == "/tank_1/valve"
    assert load_valve(dump(values, tmp_path / "dump.yaml", "/monitor")) == load_valve(path)


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
        (IdentificationSettings, {"bag": "a", "loop": "yes"}, "true or false"),
        (IdentificationSettings, {"bag": "a", "mode": "guess"}, "identify or diagnose"),
        (IdentificationSettings, {"bag": "a", "free": "pilot_dampin"}, "did you mean pilot_damping"),
        (IdentificationSettings, {"bag": "a", "free": [1, 2]}, "list of names"),
        (IdentificationSettings, {"bag": "a", "rat": 1.0}, "did you mean rate"),
        (IdentificationSettings, {"bag": "a", "valve.pilot_mass": 0.1}, "parameter params instead"),
        (ProfileSettings, {}, "profile: not given"),
        (ProfileSettings, {"profile": "x", "max_voltage": math.nan}, "expected a number at least 0 V"),
        (PlcSettings, {"volt": 1.0}, "command line: volt: found 1.0 under an unknown na"),
        (PlcSettings, {"valves": "tank_1/valve"}, "valves: found 'tank_1/valve', expected a list of names"),
        (ArchiveSettings, {"years": 0.0}, "command line: years: found 0.0, expected a number from 0.01 to 100 years"),
        (OpcUaSettings, {"valves": TWO}, "monitors: found 1, expected 2, one for each of valves"),
        (OpcUaSettings, {"port": 70000}, "command line: port: found 70000, expected a number from 1 to 65535"),
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
