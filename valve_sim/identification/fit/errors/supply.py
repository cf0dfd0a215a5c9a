"""Supply: the source of the coil's voltage has a resistance, so that current and time constant fall together."""

from __future__ import annotations

from typing import Final

from valve_sim.identification.fit.errors.error import RecordingError
from valve_sim.identification.plants.protocol import Array


def resistance(coefficients: Array, _: Array) -> float:
    """Ω, never negative, of (1,) coefficients."""
    return max(0.0, float(coefficients[0]))


SUPPLY: Final = RecordingError(
    "supply", "resistance of the source",
    "use a stiffer supply and thicker cables, or record the voltage at the coil",
    stays=True, amount=resistance,
)  # fmt: skip
