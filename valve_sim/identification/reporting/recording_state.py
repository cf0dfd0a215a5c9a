"""The state of a recording: its errors as people and as report.json have them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from valve_sim.identification.diagnosis.recording_state import RecordingState
from valve_sim.identification.fit.recorded_errors import RecordedError
from valve_sim.identification.plants.effect_titles import title_of
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.reporting.findings import remarks
from valve_sim.identification.reporting.units import quantity, three_digits
from valve_sim.identification.reporting.wording import percent

UNITS: Final[Mapping[str, tuple[float, str, str]]] = {
    "m": (1e6, "µm", "um"),
    "s": (1e6, "µs", "us"),
    "Ω": (1.0, "Ω", "ohm"),
    "A": (1e3, "mA", "ma"),
}
"""SI unit to factor, name for people and name in JSON of the unit in which errors are reported."""
RATES: Final = ("clock_rate",)
"""Errors without a unit that are reported in ppm; all others are in per cent."""
WIDTH, HEIGHT = 120.0, 28.0
"""Of a picture, in pixels."""
HEIGHTS: Final = "▁▂▃▄▅▆▇█"
CHARACTERS: Final = 24
"""Of a picture on a terminal."""
SHOWN: Final = 0.5
"""Of the range, what their means are to reach."""
SMALL_TALK: Final = ("clock_offset", "clock_rate", "scale")
"""Errors that are estimated and cost next to nothing: no advice is printed for them."""
UNTOLD: Final = "State of the recording: not reported, because something unnamed acts, which its errors would imitate."
"""The line in place of the state of the recording, where something unnamed acts."""


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
    """Title of an error of a recording, with its further figures."""
    return f"{entry.title} ({entry.detail})" if entry.detail else entry.title


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
            "noise": _in_noise(entry, noise, unit),
            "probability": f"{entry.probability:.2f}",
            "is_likely": entry.is_likely,
            "picture": picture(entry.at, entry.shown),
            "over": entry.over,
            "what_to_do": entry.what_to_do if entry.is_likely else "",
        }
        for source, entries in errors.items()
        for entry in entries
    ]


def _in_noise(entry: RecordedError, noise: float, unit: str) -> str:
    """The size in standard deviations of the noise; – where the two are of other units."""
    return f"{abs(entry.size) / noise:.2g}" if entry.unit == unit and noise > 0.0 else "–"


def recording_lines(errors: Mapping[str, Sequence[RecordedError]]) -> list[str]:
    """Lines for a terminal: errors that are there, and what to do about them."""
    found = []
    for source, entries in errors.items():
        there = [entry for entry in entries if entry.is_likely]
        if there:
            found.append(f"State of the recording {source}:")
            found += [f"  {title_words(entry)}: {size_words(entry)}" for entry in there]
            advice = dict.fromkeys(entry.what_to_do for entry in there if entry.error not in SMALL_TALK)
            found += [f"  To do better: {words}." for words in advice]
    return found


def state_lines(state: RecordingState) -> list[str]:
    """Lines for a terminal: each error with its size and what to do, and what can be named in the recording."""
    found = state.identification
    (source,) = found.sources
    noise, unit = found.fit.problem.noise.sigma, found.primary_channel.unit
    if not state.errors:
        why = "its errors cannot be told from what the declared model lacks; valve-sim diagnose looks for that"
        return [f"State of {source}: {why}.", *remarks(found.findings)]
    lines = [f"State of {source}, beside the refitted declared valve:"]
    lines.append(f"  {'error':<52}{'size':<20}{'in noise':<10}{'probability':<13}picture")
    for name, entries in itertools.groupby(state.errors, key=lambda entry: entry.error):
        of_it = list(entries)
        for entry in of_it:
            share, probability = _in_noise(entry, noise, unit), percent(entry.probability)
            row = f"  {title_words(entry):<52}{size_words(entry):<20}{share:<10}{probability:<13}"
            lines.append(f"{row}{sparkline(entry.shown)}".rstrip())
        if any(entry.is_likely for entry in of_it) and name not in SMALL_TALK:
            lines.append(f"    {of_it[0].what_to_do}.")
    lines += _limit_lines(state)
    return [*lines, *remarks(found.findings)]


def _limit_lines(state: RecordingState) -> Iterator[str]:
    if not state.limits:
        return
    effects = state.identification.fit.problem.plant.effects
    yield f"  {'would be named in half of such recordings':<60}{'from':<20}without these errors from"
    for name, limits in state.limits.items():
        switches = [switch for switch in effects[name].parameters if switch.name in limits]
        for switch in switches:
            title = title_of(name) + (f": {switch.name.replace('_', ' ')}" if len(switches) > 1 else "")
            now, then = limits[switch.name], state.without_errors[name][switch.name]
            shown = (quantity(limit, switch.unit) if math.isfinite(limit) else "–" for limit in (now, then))
            yield f"    {title:<58}{next(shown):<20}{next(shown)}"


def state_json(state: RecordingState) -> dict[str, Any]:
    """What `info --json` holds of the state of a recording."""
    (source,) = state.identification.sources
    return {
        "recording": recording_json({source: state.errors})[source],
        "detection_limits": {name: dict(limits) for name, limits in state.limits.items()},
        "detection_limits_without_errors": {name: dict(limits) for name, limits in state.without_errors.items()},
        "findings": remarks(state.identification.findings),
    }


def sparkline(shown: Array) -> str:
    """A line of characters whose heights follow what an error adds; empty where so few cannot show it."""
    if len(shown) < 2 or not np.all(np.isfinite(shown)):
        return ""
    few = np.array([np.mean(part) for part in np.array_split(shown, min(CHARACTERS, len(shown)))])
    low, size = float(np.min(few)), float(np.ptp(few))
    # Of what swings faster the means are nothing.
    if size <= SHOWN * float(np.ptp(shown)):
        return ""
    return "".join(HEIGHTS[int(height)] for height in (few - low) / size * (len(HEIGHTS) - 1))


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
