"""What Fast DDS is asked to do otherwise: our file for its version, unless the user has profiles of their own."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from valve_sim.nodes.starting import FAST_DDS_2, FAST_DDS_3, OWN_FILES, installed_rclpy, offer_profile

JAZZY, KILTED, ROLLING = "7.1.5", "9.1.2", "10.0.3"


@pytest.mark.parametrize(
    ("rclpy", "variable", "name"),
    [
        (JAZZY, "FASTRTPS_DEFAULT_PROFILES_FILE", "nackSupressionDuration"),
        (KILTED, "FASTDDS_DEFAULT_PROFILES_FILE", "nack_supression_duration"),
        (ROLLING, "FASTDDS_DEFAULT_PROFILES_FILE", "nack_supression_duration"),
    ],
)
def test_each_version_of_fast_dds_finds_its_file_and_no_other(
    rclpy: str, variable: str, name: str, tmp_path: Path
) -> None:
    environment = {"HOME": "/root"}
    offer_profile(environment, tmp_path, rclpy)
    assert set(environment) == {"HOME", variable}
    participant, writer = ET.parse(environment[variable]).getroot()
    assert [part.attrib["is_default_profile"] for part in (participant, writer)] == ["true"] * 2
    (times,) = writer
    (duration,) = times
    assert duration.tag.rpartition("}")[2] == name
    assert seconds_of(duration) < 5e-3, "a reader asks again 5 ms after a heartbeat"
    (announcements,) = (part for part in participant.iter() if part.tag.endswith("initialAnnouncements"))
    count, period = (part for part in announcements if isinstance(part.tag, str))
    assert int(count.text or "") * seconds_of(period) == 3.0, "until those begin that come every 3 s"


def seconds_of(duration: ET.Element) -> float:
    seconds, nanoseconds = (int(number.text or "") for number in duration)
    return seconds + 1e-9 * nanoseconds


@pytest.mark.parametrize("rclpy", [JAZZY, KILTED])
@pytest.mark.parametrize("variable", [FAST_DDS_2.variable, FAST_DDS_3.variable])
def test_the_profiles_of_the_user_stay_alone(variable: str, rclpy: str, tmp_path: Path) -> None:
    environment = {variable: "/home/me/mine.xml"}
    offer_profile(environment, tmp_path, rclpy)
    assert environment == {variable: "/home/me/mine.xml"}


@pytest.mark.parametrize("name", OWN_FILES)
def test_so_does_a_file_where_the_process_starts(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("<profiles/>")
    environment: dict[str, str] = {}
    offer_profile(environment, tmp_path, JAZZY)
    assert environment == {}


def test_a_ros_that_does_not_say_its_version_is_left_alone(tmp_path: Path) -> None:
    environment: dict[str, str] = {}
    offer_profile(environment, tmp_path, None)
    assert environment == {}


def test_the_installed_ros_says_its_version() -> None:
    pytest.importorskip("rclpy")
    found = installed_rclpy()
    assert found is not None and int(found.partition(".")[0]) >= 7
