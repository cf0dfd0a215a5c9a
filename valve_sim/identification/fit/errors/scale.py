"""Scale: the sensor's gain is off by what its data sheet allows."""

from __future__ import annotations

from typing import Final

from valve_sim.identification.fit.errors.error import RecordingError, Seen
from valve_sim.identification.plants.protocol import Array


def columns(seen: Seen) -> Array:
    """(n, 1) what is shown, as a share of the range."""
    return seen.shown[:, None] / seen.span


def amount(coefficients: Array, _: Array) -> float:
    """The error at the end of the range."""
    return float(coefficients[0])


SCALE: Final = RecordingError(
    "scale", "gain of the sensor",
    "calibrate the sensor against a gauge block", columns=columns, amount=amount,
    share=0.002, is_known=True, is_relative=True,
)  # fmt: skip
"""Prior: N(0, 0.2 %), the usual line of a data sheet."""
