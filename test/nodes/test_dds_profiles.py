"""The profiles for Fast DDS that ship: one for either version, which names the same thing in another way."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest

from valve_sim.files.resources import config_path


@pytest.mark.parametrize(
    ("file", "name"), [("fast_dds_2.xml", "nackSupressionDuration"), ("fast_dds_3.xml", "nack_supression_duration")]
)
def test_a_message_can_be_asked_for_again_before_a_reader_does(file: str, name: str) -> None:
    (writer,) = ET.parse(config_path(file)).getroot()
    assert writer.attrib["is_default_profile"] == "true"
    (times,) = writer
    (duration,) = times
    assert duration.tag.rpartition("}")[2] == name
    seconds, nanoseconds = (int(number.text or "") for number in duration)
    assert 1e9 * seconds + nanoseconds < 5e6, "a reader asks 5 ms after a heartbeat"
