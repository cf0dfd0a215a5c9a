"""The diagnosis of an event table, as JSON and as text for the terminal."""

from __future__ import annotations

import math
from typing import Any

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.diagnosis.events import (
    Candidate,
    EventDiagnosis,
    FurtherMeasurement,
    Quantity,
)
from valve_sim.identification.plants.event_table import EventPlant
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.identification.reporting.units import listed_values, signed


def event_json(result: EventDiagnosis) -> dict[str, Any]:
    """The content of report.json."""
    report = {
        "schema": "valve_sim/event_diagnosis/1",
        "source": result.table.source,
        "events": [vars(event) for event in result.table.events],
        "verdict": {"kind": "insufficient", "summary": _summary(result)},
        "before": _candidate_json(result, result.declared),
        "after": {**_candidate_json(result, result.shipped), "standard_errors": dict(result.standard_errors)},
        "candidates": [_candidate_json(result, entry) for entry in (*result.singles, *result.pairs)],
        "largest_attraction_n": {"predicted": result.largest_attraction, "measured": result.table.largest_attraction},
        "intervals": {
            name: {
                "by_events": result.region.interval(name, capped=False),
                "and_plausible_pull": result.region.interval(name, capped=True),
            }
            for name in DAMPINGS
        },
        "record_next": [_measurement_json(entry) for entry in result.measurements],
    }
    return plain_mapping(report)


def _candidate_json(result: EventDiagnosis, entry: Candidate) -> dict[str, Any]:
    return {
        "effects": list(entry.effects),
        "parameters": dict(entry.values),
        "times_ms": [1e3 * time for time in entry.times],
        "errors_ms": [1e3 * error for error in result.errors(entry)],
        "closes": entry.closes,
    }


def _measurement_json(entry: FurtherMeasurement) -> dict[str, Any]:
    return {
        "name": measurement_words(entry),
        "lowest": entry.lowest,
        "highest": entry.highest,
        "uncertainty": entry.uncertainty,
        "unit": entry.unit,
        "power": entry.power,
    }


def measurement_words(entry: FurtherMeasurement) -> str:
    """What is to be measured, and where."""
    match entry.quantity:
        case Quantity.STATIC_ATTRACTION:
            words = "static attraction at the largest gap"
        case Quantity.CURRENT_TIME_CONSTANT:
            words = "time constant of the coil current"
        case Quantity.ARRIVAL:
            words = f"{entry.event} at {entry.volts:.3g} V"
        case Quantity.CLOSING_TIME:
            words = f"closing time after release from {entry.volts:g} V"
        case Quantity.DISPLACEMENT:
            words = f"displacement at {entry.volts:g} V, {1e3 * entry.time:.1f} ms"
    return words


def _summary(result: EventDiagnosis) -> str:
    """The verdict in one sentence."""
    singles, pairs = (sum(entry.closes for entry in found) for found in (result.singles, result.pairs))
    opens = "never opens" if math.isnan(result.declared.times[-1]) else "opens"
    return (
        f"The declared valve {opens}; {singles or 'no'} single effects and {pairs or 'no'} pairs close the table, "
        "so few numbers can name none of them."
    )


def event_text(result: EventDiagnosis) -> str:
    """The report for the terminal."""
    names = [event.name for event in result.table.events]
    head = "".join(f"{name + ' error, ms':>16}" for name in names)
    lines = [f"{'added to the declared valve':<38}{head}   values"]
    closing = [entry for entry in result.pairs if entry.closes]
    best_of_rest = [entry for entry in result.pairs if not entry.closes][:3]
    for entry in (result.declared, *result.singles, *closing, *best_of_rest):
        errors = "".join(
            f"{'never':>16}" if math.isnan(e) else f"{signed(1e3 * e, 3):>16}" for e in result.errors(entry)
        )
        values = listed_values(EventPlant(result.table), entry.values)
        lines.append(f"{' + '.join(entry.effects) or '(nothing)':<38}{errors}   {values}")
    lines += ["", _summary(result)]
    for name in DAMPINGS:
        free, capped = (_interval_words(result.region.interval(name, capped=flag)) for flag in (False, True))
        lines.append(
            f"{name}, N·s/m: the events allow {free}; with a pull at rest below the largest measured, {capped}"
        )
    shipped = listed_values(EventPlant(result.table), result.shipped.values, 5)
    errors = ", ".join(
        f"{name} off by {signed(1e6 * error, 2)} µs"
        for name, error in zip(names, result.errors(result.shipped), strict=True)
    )
    lines.append(f"written: {shipped} ({errors})")
    if result.table.largest_attraction is not None:
        lines.append(
            f"largest attraction while opening: {result.largest_attraction:.1f} N, measured "
            f"{result.table.largest_attraction:.1f} N: not fitted"
        )
    lines.append(
        "what would decide, the most decisive first (what the region predicts, and how well it can be measured):"
    )
    lines += [
        f"    {measurement_words(entry):<46}{entry.lowest:>9.3g} to {entry.highest:.3g} {entry.unit} ± "
        f"{entry.uncertainty:g} ({entry.power:.0f} standard errors)"
        for entry in result.measurements
    ]
    return "\n".join(lines)


def _interval_words(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:.3g} and above, to the end of the search" if math.isinf(high) else f"{low:.3g} to {high:.3g}"
