"""The state of a recording: its errors, what each costs, and what to do about it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from valve_sim.identification.diagnosis.recording_state import RecordingState
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.fit.recorded_errors import RecordedError
from valve_sim.identification.plants.effect_titles import capitalised, title_of
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.reporting.document import (
    Block,
    Chapter,
    Document,
    Items,
    On,
    Spark,
    Table,
    TableRow,
    Words,
)
from valve_sim.identification.reporting.finding_sentences import remarks
from valve_sim.identification.reporting.units import measured, percent, quantity
from valve_sim.identification.reporting.values import plain_name

UNITS: Final[Mapping[str, tuple[float, str]]] = {
    "m": (1e6, "um"),
    "s": (1e6, "us"),
    "Ω": (1.0, "ohm"),
    "A": (1e3, "ma"),
}
"""SI unit to factor and name of the unit in which JSON has errors."""
RATES: Final = ("clock_rate",)
"""Errors without a unit that are reported in ppm; all others are in per cent."""
SMALL_TALK: Final = ("clock_offset", "clock_rate", "scale")
"""Errors that are estimated and cost next to nothing: no advice is printed for them."""
UNTOLD: Final = (
    "An unmodelled effect acts. Part of it may appear here as errors of the recording, so do not rely on these sizes."
)
"""A warning about the sizes, if an unmodelled effect acts."""
MAY_BE_IT: Final = "This may be the unmodelled effect: look for something that warms, settles or wears."
"""What changes over the strokes, if an unmodelled effect acts."""
LEGEND: Final = (
    "Errors of sensors, clocks and supply are no effects of the valve. They are estimated together with every "
    "hypothesis. The probability is that the error is present; the size of an improbable error is an upper limit."
)


def recording_document(state: RecordingState) -> Document:
    """What `info --state` says: each error with its size and what to do, and what can be named in the recording."""
    (source,) = state.identification.sources
    noise, unit = state.identification.fit.problem.noise.sigma, state.identification.primary_channel.unit
    findings = remarks(state.identification.findings)
    why = Words(
        "The declared model lacks something that cannot be told from errors of the recording; valve-sim diagnose looks "
        "for it."
    )
    errors = errors_table(state.errors, noise, unit) if state.errors else why
    limits: list[Block] = [_limits_table(state)] if state.limits else []
    return Document(
        "State of a recording",
        [
            Chapter(
                f"State of {source}, beside the refitted declared valve",
                [errors, *limits, Items(findings)],
                {
                    "recording": [_entry_json(entry) for entry in state.errors],
                    "detection_limits": state.limits,
                    "detection_limits_without_errors": state.without_errors,
                    "findings": findings,
                },
            )
        ],
    )


def recording_sections(
    errors: Mapping[str, Sequence[RecordedError]], noise: float, unit: str, *, is_unknown: bool = False
) -> Iterator[Chapter]:
    """What a report says of each of its recordings; a terminal shows the errors that are there.

    Args:
        errors: by source. noise: standard deviation of the sensor's noise. unit: of both, SI, of the response.
        is_unknown: whether an unmodelled effect acts, which errors would imitate.
    """
    words: list[Block] = [Words(UNTOLD, style="doubt")] if is_unknown else []
    words.append(Words(LEGEND, style="soft", on="page"))
    for source, entries in errors.items():
        table = errors_table(entries, noise, unit, is_brief=True, on="page" if is_unknown else "both")
        changes = [change for entry in entries for change in entry.changes] if is_unknown else []
        if changes:
            words.append(Words(f"{capitalised('; '.join(changes))}. {MAY_BE_IT}"))
        yield Chapter(f"State of the recording {source}", [*words, table] if entries else [])
        words = []
    told = {source: [_entry_json(entry) for entry in entries] for source, entries in errors.items()}
    yield Chapter(fields={"recording": told})


def errors_table(
    entries: Sequence[RecordedError], noise: float, unit: str, *, is_brief: bool = False, on: On = "both"
) -> Table:
    """A row for each error of a recording, and below what to do, once for each kind of error."""
    rows = []
    for name, group in itertools.groupby(entries, key=lambda entry: entry.error):
        alike = list(group)
        last = next((entry for entry in reversed(alike) if entry.is_likely), None)
        for entry in alike:
            share = f"{abs(entry.size) / noise:.2g}" if entry.unit == unit and noise > 0.0 else "–"
            advice = f"{capitalised(entry.what_to_do)}." if entry is last and name not in SMALL_TALK else ""
            title = f"{entry.title} ({entry.detail})" if entry.detail else entry.title
            picture = Spark(entry.at, entry.shown, entry.over)
            cells = (title, size_words(entry), share, percent(entry.probability), picture)
            rows.append(TableRow(cells, name, note=advice, is_marked=entry.is_likely))
    return Table(("error", "size", "size / noise", "probability", "course"), rows, is_brief=is_brief, on=on)


def _unit(entry: RecordedError) -> tuple[float, str]:
    """Factor and name of the unit in which JSON has an error."""
    if entry.unit == "–":
        return (1e6, "ppm") if entry.error in RATES else (1e2, "%")
    return UNITS.get(entry.unit, (1.0, entry.unit))


def size_words(entry: RecordedError) -> str:
    """The size with its standard error and unit."""
    factor, unit = _unit(entry) if entry.unit == "–" else (1.0, entry.unit)
    if entry.size == entry.stderr == 0.0:
        return "0"
    size, stderr = factor * entry.size, factor * entry.stderr
    return measured(Interval(size, stderr, size, size), unit)


def _entry_json(entry: RecordedError) -> dict[str, Any]:
    factor, unit = _unit(entry)
    detail = {"detail": entry.detail} if entry.detail else {}
    return {
        "error": entry.error,
        "size": factor * entry.size,
        "stderr": factor * entry.stderr,
        "ci95": [factor * entry.low, factor * entry.high],
        "unit": unit,
        "probability": entry.probability,
        "what_to_do": entry.what_to_do,
        **detail,
    }


def limits_table(plant: Plant, *columns: Mapping[str, Mapping[str, float]], head: Sequence[str]) -> Table:
    """The size from which each effect would be named, by parameter that switches it; a column for each of `columns`."""
    rows = []
    for name in columns[0]:
        switches = [switch for switch in plant.effects[name].parameters if switch.name in columns[0][name]]
        for switch in switches:
            sizes = [limits[name].get(switch.name, math.nan) for limits in columns]
            if any(map(math.isfinite, sizes)):
                title = title_of(name) + (f": {plain_name(switch.name)}" if len(switches) > 1 else "")
                told = (quantity(size, switch.unit) if math.isfinite(size) else "–" for size in sizes)
                rows.append(TableRow((title, *told)))
    return Table(head, rows)


def _limits_table(state: RecordingState) -> Table:
    head = ("named in half of such recordings", "from a size of", "without these errors from")
    return limits_table(state.identification.fit.problem.plant, state.limits, state.without_errors, head=head)
