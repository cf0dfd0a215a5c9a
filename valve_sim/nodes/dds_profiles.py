"""What Fast DDS is asked to do otherwise, where the user asks for nothing of their own."""

from __future__ import annotations

from collections.abc import MutableMapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.files.resources import config_path


class Profile(NamedTuple):
    """A file of ours and the environment variable by which Fast DDS finds it."""

    variable: str
    file: str


FAST_DDS_2: Final = Profile("FASTRTPS_DEFAULT_PROFILES_FILE", "fast_dds_2.xml")
FAST_DDS_3: Final = Profile("FASTDDS_DEFAULT_PROFILES_FILE", "fast_dds_3.xml")
OWN_FILES: Final = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
"""File that Fast DDS reads from the folder in which a process starts."""
RCLPY_WITH_FAST_DDS_3: Final = 9
"""The major version of rclpy in Kilted, the first ROS 2 with Fast DDS 3; Jazzy has 7 and Fast DDS 2.14."""


def profile_of(rclpy: str) -> Profile:
    """Which of our profiles the Fast DDS of a ROS 2 understands.

    Fast DDS 3 reads the variable of version 2, too, and complains of what it finds there: a process is given one only.

    Args:
        rclpy: version of that ROS 2's rclpy, such as 7.1.5.
    """
    return FAST_DDS_3 if int(rclpy.partition(".")[0]) >= RCLPY_WITH_FAST_DDS_3 else FAST_DDS_2


def installed_rclpy() -> str | None:
    """Version of the rclpy on the path, or None if it does not say."""
    try:
        return version("rclpy")
    except PackageNotFoundError:
        return None


def offer_profile(environment: MutableMapping[str, str], folder: Path, rclpy: str | None) -> None:
    """Have Fast DDS note acknowledgements every 4 ms, and announce itself for 3 s; to be called before ROS starts.

    After each message Fast DDS wakes a thread of its own, only to note that a reader may now ask for that message
    again: 2 to 5 % of a core at 1 kHz. A reader does not ask sooner than 5 ms after the writer's heartbeat, so our
    profiles have it noted every 4 ms. And it announces itself five times to a process that begins, which may hear none
    of them while it starts, and then every 3 s: our profiles have it announce itself every 0.1 s until then, so that a
    process that begins is found within half a second, not after 3 s. Other middleware does not read these variables.

    Args:
        environment: of this process; changed, unless it names profiles of the user's own.
        folder: in which the process starts; a file of profiles there counts too.
        rclpy: see `installed_rclpy`; nothing is offered where it is not known.
    """
    named = any(profile.variable in environment for profile in (FAST_DDS_2, FAST_DDS_3))
    if rclpy is None or named or any((folder / name).exists() for name in OWN_FILES):
        return
    profile = profile_of(rclpy)
    environment[profile.variable] = str(config_path(profile.file))
