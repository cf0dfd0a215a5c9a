"""The state of a recording: its errors, what each costs, and what to do about it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from valve_sim.identification.diagnosis.recording_state import RecordingState
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
from valve_sim.identification.reporting.units import percent, quantity, three_digits

UNITS: Final[Mapping[str, tuple[float, str, str]]] = {
    "m": (1e6, "µm", "um"),
    "s": (1e6, "µs", "us"),
    "Ω": (1.0, "Ω", "ohm"),
    "A": (1e3, "mA", "ma"),
}
"""SI unit to factor, name for people and name in JSON of the unit in which errors are reported."""
RATES: Final = ("clock_rate",)
"""Errors without a unit that are reported in ppm; all others are in per cent."""
SMALL_TALK: Final = ("clock_offset", "clock_rate", "scale")
"""Errors that are estimated and cost next to nothing: no advice is printed for them."""
UNTOLD: Final = (
    "Something without a name acts. Part of it may be counted here as errors of the recording, so these sizes cannot "
    "be relied on."
)
"""A warning about the sizes, if something unnamed acts."""
MAY_BE_IT: Final = "This may be what has no name: look for something that warms, settles or wears."
"""What changes over the strokes, if something unnamed acts."""
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
        is_unknown: whether something unnamed acts, which errors would imitate.
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
    return Table(("error", "size", "in noise", "probability", "picture"), rows, is_brief=is_brief, on=on)


def _unit(entry: RecordedError) -> tuple[float, str, str]:
    if entry.unit == "–":
        return (1e6, "ppm", "ppm") if entry.error in RATES else (1e2, "%", "%")
    return UNITS.get(entry.unit, (1.0, entry.unit, entry.unit))


def size_words(entry: RecordedError) -> str:
    """The size with its standard error and unit."""
    factor, unit, _ = _unit(entry)
    return f"{three_digits(factor * entry.size)} ± {factor * entry.stderr:.2g} {unit}"


def _entry_json(entry: RecordedError) -> dict[str, Any]:
    factor, _, unit = _unit(entry)
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
                title = title_of(name) + (f": {switch.name.replace('_', ' ')}" if len(switches) > 1 else "")
                told = (quantity(size, switch.unit) if math.isfinite(size) else "–" for size in sizes)
                rows.append(TableRow((title, *told)))
    return Table(head, rows)


def _limits_table(state: RecordingState) -> Table:
    head = ("would be named in half of such recordings", "from", "without these errors from")
    return limits_table(state.identification.fit.problem.plant, state.limits, state.without_errors, head=head)
