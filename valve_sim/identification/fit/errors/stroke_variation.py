"""Variation by stroke: dampings, seat load and preload differ from stroke to stroke, as lubrication and seats do."""

from __future__ import annotations

from typing import Final

from valve_sim.identification.fit.errors.error import RecordingError

STROKE_VARIATION: Final = RecordingError(
    "stroke_variation", "variation from stroke to stroke",
    "record more strokes, after some that warm the machine up and spread its grease", is_normal=True,
    stays=True,
)  # fmt: skip
