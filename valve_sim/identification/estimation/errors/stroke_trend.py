"""Trend over strokes: a damping grows or falls over the recording, as grease warms up, spreads or wears."""

from __future__ import annotations

from typing import Final

from valve_sim.identification.estimation.errors.error import RecordingError
from valve_sim.identification.plants.protocol import Array


def change(coefficients: Array) -> float:
    """The change from the first stroke to the last, with its sign; (1,) coefficients."""
    return float(coefficients[0])


STROKE_TREND: Final = RecordingError(
    "stroke_trend", "trend over the strokes",
    "record after some strokes that warm the valve up, and look after what rubs if the trend stays", is_known=True,
    amount=change,
)  # fmt: skip
