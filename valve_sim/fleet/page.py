"""The page of a fleet: one file without network, in the look of a diagnosis' report."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np

from valve_sim import __version__
from valve_sim.fleet.columns import BEFORE
from valve_sim.fleet.trends import FALSE_ALARMS, FEWEST, Drift, Series, drifts, effects_of, series_of
from valve_sim.fleet.units import EXAMINED, Row
from valve_sim.identification.plants.effect_titles import named
from valve_sim.identification.reporting import document as doc
from valve_sim.identification.reporting.page import write_page as write_document
from valve_sim.identification.reporting.units import quantity, readable

FOLLOWED: Final = tuple(
    f"{name}{BEFORE}" for name in ("opening_delay", "t1", "t2", "closing_time", "pilot_damping", "main_damping")
)
"""Quantities that are drawn of every valve; beside these, what drifts and what effects were named."""
MOST_DRAWN: Final = 400
"""Points of one plot: of more bags as many are drawn, evenly."""
MOST_LISTED: Final = 5000
"""Bags of one list; the table has all."""
FIRST_LISTED: Final = 8
"""Of them, those that are shown at once; the others unfold."""
_VERDICTS: Final = {
    "none": "nothing missing", "effects": "effects found", "partly": "corrected in part",
    "unknown": "an unmodelled effect", "insufficient": "cannot be told",
}  # fmt: skip


MADE: Final = (
    ("Numbers", "They are in fleet.parquet, beside this page."),
    (
        "Each bag",
        "The declared valve is refitted within its tolerances, and its residual is tested. If more than noise is left, "
        "a search looks for the missing effect.",
    ),
    (
        "Trends",
        "They are those of the declared valve, refitted to each bag. Times are simulated at its reference voltage from "
        "rest, so that bags of different strokes compare. Sizes of named effects are shown, but not tested.",
    ),
    (
        "Drift",
        "A robust test of the slope over the order of the bags in each of {} series of values, of valves with {} bags "
        "or more; corrected for all of them together (Holm): if nothing drifts, the probability of naming any valve "
        "is at most {:g} %. Lines are Theil and Sen's.",
    ),
)
"""How the page was made."""


def write_page(rows: Sequence[Row], path: Path) -> list[str]:
    """Write the page of these rows, whole or not at all.

    Returns:
        the valves that drift, in words, the surest first.

    Raises:
        ValveError: it cannot be written.
    """
    document, drifting = fleet_document(rows)
    write_document(document, path)
    return drifting


def fleet_document(rows: Sequence[Row]) -> tuple[doc.Document, list[str]]:
    """The page of a fleet, and the valves that drift, in words."""
    series, effects = series_of(rows), effects_of(rows)
    drifting: dict[str, list[Drift]] = defaultdict(list)
    for drift in drifts(series):
        drifting[drift.valve].append(drift)
    by_valve: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row["state"] == EXAMINED:
            by_valve[row["valve"]].append(row)
    names = sorted(by_valve, key=lambda name: _order(name, by_valve[name], drifting.get(name, [])))
    valves = [_valve(name, by_valve[name], (series[name], effects[name]), drifting.get(name, [])) for name in names]
    refused = sorted((row for row in rows if row["state"] != EXAMINED), key=lambda row: str(row["source"]))
    hint = "A row unfolds: trends with their 95 % intervals, and the report of each bag in which something is wrong."
    shown = [
        doc.TableRow((row["source"], row["state"], row["error"]), row["valve"] or "") for row in refused[:MOST_LISTED]
    ]
    more = max(0, len(refused) - MOST_LISTED)
    also = [doc.Words(f"And {more} more, which fleet.parquet lists.", style="soft")] if more else []
    bags = doc.Table(("bag", "state", "why"), shown)
    made = [("Made by", f"valve_sim {__version__}")]
    made += [(term, words.format(sum(map(len, series.values())), FEWEST, 100.0 * FALSE_ALARMS)) for term, words in MADE]
    sections = [
        doc.Chapter("", [doc.Words(_counts(rows), style="soft")]),
        doc.Chapter("Valves, what is wrong first", [doc.Words(hint, style="soft"), *valves]),
        doc.Chapter("Bags without a result, and why", [bags, *also] if refused else []),
        doc.Chapter("How this was made", [doc.Table(("", ""), [doc.TableRow(row) for row in made])]),
    ]
    headline = _headline(len(drifting), len(valves), len(refused))
    told = [f"{name}: {_drift_words(drifting[name][0])}" for name in names if drifting.get(name)]
    return doc.Document("Fleet", sections, headline, "", "fleet", _many(len(valves), "valve"), not drifting), told


def _headline(drifting: int, valves: int, refused: int) -> str:
    first = f"{drifting} of {_many(valves, 'valve')} {'drifts' if drifting == 1 else 'drift'}"
    return first + (f"; {_many(refused, 'bag')} without a result" if refused else "")


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _counts(rows: Iterable[Row]) -> str:
    verdicts = Counter(_VERDICTS.get(row["verdict"], row["verdict"]) for row in rows if row["state"] == EXAMINED)
    parts = [f"{words} in {count}" for words, count in verdicts.most_common()]
    examined = sum(verdicts.values())
    return f"{_many(examined, 'examination')} of a valve in a bag: {', '.join(parts)}." if parts else ""


# --- a valve --------------------------------------------------------------------------------------------------------


def _order(name: str, rows: Sequence[Row], drifting: Sequence[Drift]) -> tuple[Any, ...]:
    """What drifts most surely first, then what is wrong, then by name."""
    wrong = [row for row in rows if _is_wrong(row)]
    newest = max(rows, key=_time)
    digits = [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]
    p_value = min((drift.p_value for drift in drifting), default=1.0)
    return p_value, not _is_wrong(newest), -len(wrong) / len(rows), digits


def _time(row: Row) -> tuple[Any, ...]:
    return row["start_time"], row["source"]


def _valve(
    name: str, rows: Sequence[Row], series: tuple[Sequence[Series], Sequence[Series]], drifting: Sequence[Drift]
) -> doc.Fold:
    """A valve's row; `series`: what is followed, and the effects that were named."""
    ordered = sorted(rows, key=_time, reverse=True)
    wrong = [row for row in ordered if _is_wrong(row)]
    drift_of = {drift.series.quantity.name: drift for drift in drifting}
    followed = [one for one in series[0] if one.quantity.name in drift_of or one.quantity.name in FOLLOWED]
    drawn = sorted([*followed, *series[1]], key=lambda one: _place(one, drift_of))
    told = [_drift_words(drift) for drift in drifting]
    bags = doc.Table(
        ("bag", "result"),
        [
            # A name in a URL's path: whatever it holds, it leads nowhere else.
            doc.TableRow(
                (_date(row["start_time"]), f"{_state([row])}: {row['summary']}"),
                row["source"],
                link=quote(row["report"] or ""),
            )
            for row in wrong[:MOST_LISTED]
        ],
        FIRST_LISTED,
    )
    blocks: list[doc.Block] = [doc.Items(told)] if len(told) > 1 else []
    blocks.append(doc.Plots(lambda: [_plot(one, drift_of.get(one.quantity.name)) for one in drawn], is_small=True))
    last = "Last bag: " if drifting or _is_wrong(ordered[0]) else ""
    trend = doc.Spark(drawn[0].days, drawn[0].values, "time") if drawn else doc.Spark(np.empty(0), np.empty(0), "time")
    return doc.Fold(
        name,
        f"Drifts: {told[0]}." if told else "",
        f"{last}{_state(ordered)}. {_many(len(rows), 'bag')}",
        trend,
        [*blocks, bags] if wrong else blocks,
    )


def _place(series: Series, drifting: Mapping[str, Drift]) -> tuple[float, int]:
    """What drifts most surely first, then in the usual order; without any drift, t2 leads."""
    name = series.quantity.name
    usual = (f"t2{BEFORE}", *FOLLOWED)
    p_value = drifting[name].p_value if name in drifting else 1.0
    return p_value, usual.index(name) if name in usual else len(usual)


def _is_wrong(row: Row) -> bool:
    return row["verdict"] != "none" or bool(row["out_of_tolerance"])


def _state(newest_first: Sequence[Row]) -> str:
    row = newest_first[0]
    if row["effects"]:
        words = named(row["effects"])
    elif row["out_of_tolerance"]:
        words = f"{', '.join(row['out_of_tolerance']).replace('_', ' ')} out of tolerance"
    else:
        words = _VERDICTS.get(row["verdict"], str(row["verdict"]))
    return f"{words[:1].upper()}{words[1:]}"


def _drift_words(drift: Drift) -> str:
    measure, change = drift.series.quantity, drift.change
    before = float(np.median(drift.series.values[: max(1, len(drift.series.values) // 10)]))
    p_value = f"{drift.adjusted:.1g}" if drift.adjusted >= 1e-6 else "< 0.000001"
    sign = "+" if change > 0.0 else ""
    return (
        f"{_title(measure.name)} {sign}{quantity(change, measure.unit)} in {np.ptp(drift.series.days):.3g} days, from "
        f"{quantity(before, measure.unit)} (p {p_value} over the fleet)"
    )


def _title(column: str) -> str:
    return column.removesuffix(BEFORE).replace("_", " ")


def _date(nanoseconds: int) -> str:
    return datetime.fromtimestamp(nanoseconds / 1e9, timezone.utc).strftime("%Y-%m-%d %H:%M")


def _plot(series: Series, drift: Drift | None) -> doc.Plot:
    """Values over the days after the first, their 95 % interval, and the line of a drift, in a readable unit."""
    chosen = np.unique(np.linspace(0, len(series.values) - 1, MOST_DRAWN).astype(np.intp))
    days, values, errors = series.days[chosen] - series.days[0], series.values[chosen], series.errors[chosen]
    scale, unit = readable(series.quantity.unit, float(np.median(np.abs(values))))
    curves = [doc.Line("after", scale * values, has_dots=True)]
    if drift is not None:
        curves.append(doc.Line("before", scale * (np.median(values - drift.slope * days) + drift.slope * days)))
    name, half = _title(series.quantity.name), 1.96 * errors
    label = f"{name}, {unit}" if unit else name
    panel = doc.Panel(label, curves, scale * (values - half), scale * (values + half))
    return doc.Plot(name, "", days, f"days after {_date(int(series.days[0] * 86400e9))}", [panel])
