"""The state of a recording: its errors as people and as report.json have them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from valve_sim.identification.estimation.recorded_errors import RecordedError
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.reporting.units import three_digits

UNITS: Final[Mapping[str, tuple[float, str, str]]] = {
    "m": (1e6, "µm", "um"),
    "s": (1e6, "µs", "us"),
    "Ω": (1.0, "Ω", "ohm"),
    "A": (1e3, "mA", "ma"),
}
"""SI unit to factor, name for people and name in JSON of the unit in which errors are reported."""
RATES: Final = ("clock_rate",)
"""Errors without a unit that are reported in ppm; all others are in per cent."""
LIKELY: Final = 0.9
"""Probability from which an error is said to be there."""
WIDTH, HEIGHT = 120.0, 28.0
"""Of a picture, in pixels."""


def _unit(entry: RecordedError) -> tuple[float, str, str]:
    if entry.unit == "–":
        return (1e6, "ppm", "ppm") if entry.error in RATES else (1e2, "%", "%")
    return UNITS.get(entry.unit, (1.0, entry.unit, entry.unit))


def recording_json(errors: Mapping[str, Sequence[RecordedError]]) -> dict[str, list[dict[str, Any]]]:
    """What report.json holds of the recordings, by source."""
    return {source: [_entry_json(entry) for entry in entries] for source, entries in errors.items()}


def _entry_json(entry: RecordedError) -> dict[str, Any]:
    factor, _, unit = _unit(entry)
    found: dict[str, Any] = {
        "error": entry.error,
        "size": factor * entry.size,
        "stderr": factor * entry.stderr,
        "ci95": [factor * entry.low, factor * entry.high],
        "unit": unit,
        "probability": entry.probability,
        "what_to_do": entry.what_to_do,
    }
    return {**found, "detail": entry.detail} if entry.detail else found


def size_words(entry: RecordedError) -> str:
    """The size with its standard error and unit."""
    factor, unit, _ = _unit(entry)
    size, error = factor * entry.size, factor * entry.stderr
    return f"{three_digits(size)} ± {error:.2g} {unit}"


def title_words(entry: RecordedError) -> str:
    """What it is, with what else is known of it."""
    return f"{entry.title} ({entry.detail})" if entry.detail else entry.title


def is_likely(entry: RecordedError) -> bool:
    """Whether an error is said to be there."""
    return entry.probability >= LIKELY


def recording_rows(errors: Mapping[str, Sequence[RecordedError]], noise: float, unit: str) -> list[dict[str, Any]]:
    """Rows of the report's table, recording by recording.

    Args:
        errors: by source. noise: standard deviation of the sensor's noise. unit: that of both, of the response.
    """
    return [
        {
            "source": source,
            "title": title_words(entry),
            "name": entry.error,
            "size": size_words(entry),
            "noise": f"{entry.size / noise:.2g}" if entry.unit == unit and noise > 0.0 else "–",
            "probability": f"{entry.probability:.2f}",
            "is_likely": is_likely(entry),
            "picture": picture(entry.at, entry.shown),
            "over": entry.over,
            "what_to_do": entry.what_to_do if is_likely(entry) else "",
        }
        for source, entries in errors.items()
        for entry in entries
    ]


def recording_lines(errors: Mapping[str, Sequence[RecordedError]]) -> list[str]:
    """Lines for a terminal: errors that are there, and what to do about them."""
    found = []
    for source, entries in errors.items():
        there = [entry for entry in entries if is_likely(entry)]
        if there:
            found.append(f"State of the recording {source}:")
            found += [f"  {title_words(entry)}: {size_words(entry)}" for entry in there]
            advice = dict.fromkeys(entry.what_to_do for entry in there if entry.error not in SMALL_TALK)
            found += [f"  To do better: {words}." for words in advice]
    return found


SMALL_TALK: Final = ("clock_offset", "clock_rate", "scale")
"""Errors that are estimated and cost next to nothing: no advice is printed for them."""


def picture(at: Array, shown: Array) -> str:
    """The points of an SVG polyline; empty where there is nothing to show."""
    if len(at) < 2 or not np.all(np.isfinite(shown)):
        return ""
    low, high = float(np.min(shown)), float(np.max(shown))
    size, first, last = high - low, float(at[0]), float(at[-1])
    if not (size > 0.0 and last > first):
        return ""
    across = WIDTH * (at - first) / (last - first)
    down = HEIGHT * (high - shown) / size
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across.tolist(), down.tolist(), strict=True) if math.isfinite(y))
