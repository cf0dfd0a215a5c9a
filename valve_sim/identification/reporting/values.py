"""Estimated values with their intervals, and declared values beside their estimates: rows of tables, and JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from valve_sim.files.json_text import plain
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.fit.declared_values import BEYOND, DeclaredValue, out_of_tolerance
from valve_sim.identification.fit.intervals import Interval, Unbounded
from valve_sim.identification.plants.effect_titles import capitalised, named_value
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.identification.reporting.document import Block, Chapter, OnScale, Table, TableRow, Words
from valve_sim.identification.reporting.units import disagree, limits, measured, quantity, readable, signed

NORMAL_95: Final = 1.96
"""Half width of a 95 % interval, in standard errors."""
LEAST_REACH, MOST_REACH = 4.0, 15.0
"""Least and most range of the scale of the page, in tolerances."""
_LEAST_TOLD: Final = 0.05
"""Tolerances: less is 0.0 as it is printed."""
TAKEN_AS_EXACT: Final = "Declared values are taken as exact: the parameter file gives no tolerances."
UNBOUNDED: Final = {
    Unbounded.FLAT_PROFILE: "the profile is flat: these data do not determine it",
    Unbounded.MAY_BE_INFINITE: "it may be too long to be seen in these data",
}
_DISAGREEING: Final = (
    "± is one standard error, from the curvature of χ² at the best value; the 95 % interval follows from χ² itself, "
    "all else refitted, or ends at a bound. The two disagree here: use the interval"
)


def remark_on(interval: Interval) -> str:
    """Why an interval is wide, one-sided, or not what its standard error says; empty where it is as usual."""
    if interval.unbounded is not None:
        return UNBOUNDED[interval.unbounded]
    return _DISAGREEING if disagree(interval) else ""


def interval_json(interval: Interval) -> dict[str, Any]:
    """Value, standard error and 95 % interval; null where one is infinite."""
    remark = remark_on(interval)
    ends = {"value": interval.value, "stderr": interval.stderr, "ci95": [interval.low, interval.high]}
    return {key: plain(value) for key, value in ends.items()} | ({"remark": remark} if remark else {})


def intervals_json(intervals: Mapping[str, Interval]) -> dict[str, dict[str, Any]]:
    """Intervals by name, each as `interval_json` has it."""
    return {name: interval_json(interval) for name, interval in intervals.items()}


# --- values of a diagnosis ------------------------------------------------------------------------------------------


def is_stand_in(diagnosis: Diagnosis, name: str) -> bool:
    """Whether a value is of an effect that is not named, but only acts like what is there: it has no error."""
    effects = {grade.effect for grade in diagnosis.grades if grade.word != "named"}
    return name.partition(".")[0] in {*effects, *(effect.removeprefix("valve.") for effect in effects)}


def value_rows(diagnosis: Diagnosis) -> list[TableRow]:
    """Each value of the refitted declared model and of the corrected one, if any, and its 95 % interval."""
    before, after = diagnosis.before.intervals, diagnosis.after.intervals
    rows = []
    for name in dict.fromkeys([*before, *after]):
        if name.startswith("force_map."):
            continue  # a force map is drawn
        words, unit = named_value(diagnosis.plant, name)
        is_bare, interval = is_stand_in(diagnosis, name), after.get(name, before.get(name))
        assert interval is not None
        corrected = measured(after[name], unit) if name in after else "–"
        if is_bare and name in after:
            corrected = f"about {quantity(after[name].value, unit, 2)}"
        refitted = measured(before[name], unit) if name in before else "–"
        pair = [refitted, corrected] if diagnosis.verdict.is_corrected else [refitted]
        remark = "" if is_bare or not (remark := remark_on(interval)) else f"{capitalised(remark)}."
        rows.append(TableRow([words, *pair, "" if is_bare else limits(interval, unit)], name, remark))
    return rows


# --- declared values ------------------------------------------------------------------------------------------------


def declared_section(values: Sequence[DeclaredValue], *, says_exact: bool = True, is_whole: bool = False) -> Chapter:
    """What the data say of declared values, or that all are exact; on a terminal the table only where it `is_whole`."""
    reach = max((abs(row.deviation) + NORMAL_95 * row.spread for row in values), default=0.0)
    scale = min(max(math.ceil(reach), LEAST_REACH), MOST_REACH)
    table = Table(
        ("declared value", "declared ± tolerance", "estimate ± standard error", f"−{scale:g} to +{scale:g}", "off by"),
        [_declared_row(row, scale) for row in values],
        is_by_name=True,
        on="both" if is_whole else "page",
    )
    legend = (
        "Each value that has a tolerance (one standard deviation) was estimated from data and tolerance together. The "
        "dot is the estimate less the declared value, in tolerances, and the bar its 95 % interval; the band is "
        f"± {BEYOND:g}."
    )
    blocks: list[Block] = []
    if says_exact or values:
        blocks.append(Words(f"{summary_words(values)}.", style="doubt" if any(row.is_out for row in values) else ""))
    if values:
        blocks += [Words(legend, style="soft", on="page"), table]
    return Chapter(
        "Declared values",
        blocks,
        {
            "declared": {
                row.name: {
                    key: plain(getattr(row, key)) for key in ("value", "tolerance", "estimate", "stderr", "deviation")
                }
                for row in values
            },
            "out_of_tolerance": out_of_tolerance(values),
        },
    )


def _declared_row(row: DeclaredValue, reach: float) -> TableRow:
    low, high = (row.deviation + sign * NORMAL_95 * row.spread for sign in (-1.0, 1.0))
    off = signed(row.deviation, 1)
    place = OnScale(row.deviation, low, high, reach, BEYOND, row.is_out, f"{off} tolerances")
    declared, estimate = ((row.value, row.tolerance), (row.estimate, row.stderr))
    told = (measured(Interval(*pair, pair[0], pair[0]), row.unit) for pair in (declared, estimate))
    return TableRow((plain_name(row.name), *told, place, off), row.name, is_marked=row.is_out)


def amount_words(row: DeclaredValue) -> str:
    """461.2 ± 2.4 N/m, not 428: 4.2 tolerances; or 1264 ± 666 N/m, which agrees with the declared 2000."""
    scale, _ = readable(row.unit, row.estimate or row.stderr)
    value = f"{scale * row.value:.6g}".replace("-", "−")
    estimate = measured(Interval(row.estimate, row.stderr, row.estimate, row.estimate), row.unit)
    if not row.is_apart:
        return f"{estimate}, which agrees with the declared {value} within its own error"
    return f"{estimate}, not {value}: {abs(row.deviation):.1f} tolerances"


def plain_name(name: str) -> str:
    """The name of a declared value without underscores and dots."""
    axis, bracket, rest = name.partition("[")
    if bracket:
        return f"{axis}, direction {int(rest.rstrip(']')) + 1} of its covariance"
    effect, dot, parameter = name.removeprefix(GROUP).partition(".")
    return (f"{parameter} of {effect}" if dot else effect).replace("_", " ")


def summary_words(values: Sequence[DeclaredValue]) -> str:
    """Which values are out of tolerance, or which is the furthest; without the full stop."""
    if not values:
        return TAKEN_AS_EXACT.rstrip(".")
    out = [row for row in values if row.is_out] or [row for row in values if abs(row.deviation) > BEYOND][:1]
    if out:
        return capitalised("; ".join(f"the {plain_name(row.name)} is {amount_words(row)}" for row in out))
    furthest = max(values, key=lambda row: abs(row.deviation))
    if abs(furthest.deviation) < _LEAST_TOLD:
        return f"All {len(values)} are as declared, within a tenth of a tolerance"
    return (
        f"All {len(values)} are within {BEYOND:g} tolerances of what is declared; the furthest is the "
        f"{plain_name(furthest.name)}, off by {signed(furthest.deviation, 1)}"
    )
