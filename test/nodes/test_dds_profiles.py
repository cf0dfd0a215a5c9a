"""What Fast DDS is asked to do otherwise: our files for either version, unless the user has profiles of their own."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from valve_sim.nodes.dds_profiles import PROFILES, offer_profiles


def test_each_version_of_fast_dds_finds_a_file_of_its_own(tmp_path: Path) -> None:
    environment = {"HOME": "/root"}
    offer_profiles(environment, tmp_path)
    names = {"FASTRTPS_DEFAULT_PROFILES_FILE": "nackSupressionDuration"}
    names["FASTDDS_DEFAULT_PROFILES_FILE"] = "nack_supression_duration"
    assert set(environment) == {"HOME", *names}
    for variable, name in names.items():
        (writer,) = ET.parse(environment[variable]).getroot()
        assert writer.attrib["is_default_profile"] == "true"
        (times,) = writer
        (duration,) = times
        assert duration.tag.rpartition("}")[2] == name
        seconds, nanoseconds = (int(number.text or "") for number in duration)
        assert 1e9 * seconds + nanoseconds < 5e6, "a reader asks again 5 ms after a heartbeat"


@pytest.mark.parametrize("variable", PROFILES)
def test_the_profiles_of_the_user_stay_alone(variable: str, tmp_path: Path) -> None:
    environment = {variable: "/home/me/mine.xml"}
    offer_profiles(environment, tmp_path)
    assert environment == {variable: "/home/me/mine.xml"}


def test_so_does_a_file_where_the_process_starts(tmp_path: Path) -> None:
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text("<profiles/>")
    environment: dict[str, str] = {}
    offer_profiles(environment, tmp_path)
    assert environment == {}
