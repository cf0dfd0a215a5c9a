"""The page of a fleet: one file without network, in the look of a diagnosis' report."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader

from valve_sim import __version__
from valve_sim.files.whole_files import write_whole
from valve_sim.fleet.columns import BEFORE
from valve_sim.fleet.trends import FALSE_ALARMS, FEWEST, Drift, Series, drifts, effects_of, series_of
from valve_sim.fleet.units import EXAMINED, Row
from valve_sim.identification.plants.effect_titles import named
from valve_sim.identification.reporting.units import quantity, readable

FOLLOWED: Final = tuple(
    f"{name}{BEFORE}" for name in ("opening_delay", "t1", "t2", "closing_time", "pilot_damping", "main_damping")
)
"""Quantities that are drawn of every valve; beside these, what drifts and what effects were named."""
DIGITS: Final = 5
"""Significant digits of what is drawn."""
MOST_DRAWN: Final = 400
"""Points of one plot: of more bags as many are drawn, evenly."""
MOST_LISTED: Final = 5000
"""Bags of one list; the table has all."""
FIRST_LISTED: Final = 8
"""Of them, those that are shown at once; the others unfold."""
_VERDICTS: Final = {
    "none": "nothing missing", "effects": "effects found", "partly": "corrected in part",
    "unknown": "something without a name", "insufficient": "cannot be told",
}  # fmt: skip


def write_page(rows: Sequence[Row], path: Path) -> list[str]:
    """Write the page of these rows, whole or not at all.

    Returns:
        the valves that drift, in words, the surest first.

    Raises:
        ValveError: it cannot be written.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader("valve_sim.fleet"), PackageLoader("valve_sim.identification.reporting")]),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    shown = content(rows)
    write_whole(path, environment.get_template("fleet.html.j2").render(shown))
    return [f"{valve['name']}: {valve['drifts'][0]}" for valve in shown["valves"] if valve["drifts"]]


def content(rows: Sequence[Row]) -> dict[str, Any]:
    """The template's variables."""
    series, effects = series_of(rows), effects_of(rows)
    found: dict[str, list[Drift]] = defaultdict(list)
    for drift in drifts(series):
        found[drift.valve].append(drift)
    by_valve: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row["state"] == EXAMINED:
            by_valve[row["valve"]].append(row)
    valves = [_valve(name, by_valve[name], (series[name], effects[name]), found.get(name, [])) for name in by_valve]
    valves.sort(key=lambda valve: valve["order"])
    refused = [row for row in rows if row["state"] != EXAMINED]
    return {
        "headline": _headline(len(found), len(by_valve), len(refused)),
        "is_sure": not found,
        "counts": _counts(rows),
        "valves": valves,
        "refused": [_refused(row) for row in sorted(refused, key=lambda row: row["source"])[:MOST_LISTED]],
        "more_refused": max(0, len(refused) - MOST_LISTED),
        "false_alarms": f"{100.0 * FALSE_ALARMS:g} %",
        "tested": sum(len(own) for own in series.values()),
        "fewest": FEWEST,
        "shown": FIRST_LISTED,
        "version": __version__,
        "data": [valve.pop("drawn") for valve in valves],
    }


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


def _valve(
    name: str, rows: Sequence[Row], series: tuple[Sequence[Series], Sequence[Series]], found: Sequence[Drift]
) -> dict[str, Any]:
    """A valve's part of the template's variables; `series`: what is followed, and the effects that were named."""
    ordered = sorted(rows, key=lambda row: (row["start_time"], row["source"]), reverse=True)
    wrong = [row for row in ordered if _is_wrong(row)]
    drifting = {drift.series.quantity.name: drift for drift in found}
    followed = [one for one in series[0] if one.quantity.name in drifting or one.quantity.name in FOLLOWED]
    shown = sorted([*followed, *series[1]], key=lambda one: _place(one, drifting))
    return {
        "name": name,
        "bags": len(rows),
        "drifts": [_drift_words(drift) for drift in found],
        "state": _state(ordered),
        "is_wrong": bool(found) or _is_wrong(ordered[0]),
        "findings": [_finding(row) for row in wrong[:MOST_LISTED]],
        "order": (
            min((drift.p_value for drift in found), default=1.0),
            not _is_wrong(ordered[0]),
            -len(wrong) / len(rows),
            [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)],
        ),
        "drawn": [_drawn(one, drifting.get(one.quantity.name)) for one in shown],
    }  # fmt: skip


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
    own, change = drift.series.quantity, drift.change
    before = float(np.median(drift.series.values[: max(1, len(drift.series.values) // 10)]))
    p_value = f"{drift.adjusted:.1g}" if drift.adjusted >= 1e-6 else "< 0.000001"
    sign = "+" if change > 0.0 else ""
    return (
        f"{_title(own.name)} {sign}{quantity(change, own.unit)} in {np.ptp(drift.series.days):.3g} days, from "
        f"{quantity(before, own.unit)} (p {p_value} over the fleet)"
    )


def _title(column: str) -> str:
    return column.removesuffix(BEFORE).replace("_", " ")


def _finding(row: Row) -> dict[str, str]:
    return {
        "time": _date(row["start_time"]),
        "state": _state([row]),
        "summary": row["summary"],
        "source": row["source"],
        # A name in a URL's path: whatever it holds, it leads nowhere else.
        "report": quote(row["report"] or ""),
    }


def _refused(row: Row) -> dict[str, str]:
    return {"source": row["source"], "valve": row["valve"], "state": row["state"], "error": row["error"]}


def _date(nanoseconds: int) -> str:
    return datetime.fromtimestamp(nanoseconds / 1e9, timezone.utc).strftime("%Y-%m-%d %H:%M")


def _drawn(series: Series, drift: Drift | None) -> dict[str, Any]:
    """What the page's script draws: times in days after the first, values and half intervals in a readable unit."""
    chosen = np.unique(np.linspace(0, len(series.values) - 1, MOST_DRAWN).astype(np.intp))
    days, values, errors = series.days[chosen], series.values[chosen], series.errors[chosen]
    scale, unit = readable(series.quantity.unit, float(np.median(np.abs(values))))
    drawn = {
        "name": _title(series.quantity.name) + (f", {unit}" if unit else ""),
        "from": _date(int(series.days[0] * 86400e9)),
        "t": [_rounded(day - float(series.days[0])) for day in days.tolist()],
        "v": [_rounded(scale * value) for value in values.tolist()],
        "e": [_rounded(1.96 * scale * error) if math.isfinite(error) else None for error in errors.tolist()],
    }
    if drift is not None:
        middle = float(np.median(values - drift.slope * (days - days[0])))
        drawn["line"] = [_rounded(scale * middle), _rounded(scale * (middle + drift.change))]
    return drawn


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
