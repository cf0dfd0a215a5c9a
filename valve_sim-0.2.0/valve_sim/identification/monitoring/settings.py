"""Settings of a monitor."""

from __future__ import annotations

from typing import NamedTuple


class MonitorSettings(NamedTuple):
    """Settings of a monitor.

    Attributes:
        commissioning_strokes: number of first strokes, which are taken as the baseline.
        strokes_between_false_alarms: mean number, of a healthy valve.
        diagnosis_strokes: number of last strokes kept for fault isolation.
        stroke_timeout: s after which a stroke that has not ended is.
        settle: s of rest after which a stroke has ended.
        noise: standard deviation of the position sensor, m; 0 to estimate it.
        patience: s that a valve may be later than the model before it is said to be stuck; as long as the model took,
            if that is longer.
    """

    commissioning_strokes: int = 20
    strokes_between_false_alarms: float = 10_000.0
    diagnosis_strokes: int = 20
    stroke_timeout: float = 600.0
    settle: float = 0.05
    noise: float = 0.0
    patience: float = 0.1
