"""What a unit says of itself, and the file in it that holds the valve."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Final

from valve_sim import __version__

PARAMETER_FILE: Final = "valve.yaml"
"""Among the resources of a unit: the whole valve."""
DESCRIPTION: Final = "Pilot-operated solenoid valve of a hydrogen vessel, with events located exactly inside a step."
NEEDED: Final = (
    f"Needs Linux on x86-64 and a Python with the package valve_sim {__version__} in the tool that loads it; "
    "without that the unit does not load."
)


def token(file: Path) -> uuid.UUID:
    """The identity of a unit: of the package's version and of the valve's parameter file."""
    return uuid.uuid5(uuid.NAMESPACE_URL, f"valve_sim/{__version__}/{file.read_text(encoding='utf-8')}")
