"""What Fast DDS is asked to do otherwise, where the user asks for nothing of their own."""

from __future__ import annotations

from collections.abc import MutableMapping
from pathlib import Path
from typing import Final

from valve_sim.files.resources import config_path

PROFILES: Final = {
    "FASTRTPS_DEFAULT_PROFILES_FILE": "fast_dds_2.xml",
    "FASTDDS_DEFAULT_PROFILES_FILE": "fast_dds_3.xml",
}
"""The variable that a major version of Fast DDS reads, and our file for it."""
OWN_FILES: Final = ("DEFAULT_FASTRTPS_PROFILES.xml", "DEFAULT_FASTDDS_PROFILES.xml")
"""What it reads from the folder in which a process starts."""


def offer_profiles(environment: MutableMapping[str, str], folder: Path) -> None:
    """Have Fast DDS acknowledge as `PROFILES` say; to be called before ROS starts.

    After each message Fast DDS wakes a thread of its own, only to note that a reader may now ask for that message
    again: 2 to 5 % of a core at 1 kHz. A reader does not ask sooner than 5 ms after the writer's heartbeat, so our
    profiles have it noted every 4 ms. Other middleware does not read these variables.

    Args:
        environment: of this process; changed, unless it has one of the variables.
        folder: in which the process starts; a file of profiles there counts too.
    """
    if any(variable in environment for variable in PROFILES) or any((folder / name).exists() for name in OWN_FILES):
        return
    environment.update({variable: str(config_path(name)) for variable, name in PROFILES.items()})
