"""Supply: the source of the coil's voltage has a resistance, so that current and time constant fall together."""

from __future__ import annotations

from typing import Final

from valve_sim.identification.estimation.errors.error import RecordingError

SUPPLY: Final = RecordingError(
    "supply", "resistance of the source",
    "use a stiffer supply and thicker cables, or record the voltage at the coil",
    stays=True, amount=lambda coefficients: float(coefficients[0]),
)  # fmt: skip
