"""Declared values beside their estimates: as JSON, as lines for the terminal and as words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

from valve_sim.files.json_text import plain
from valve_sim.identification.fit.declared_values import BEYOND, DeclaredValue, out_of_tolerance
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.plants.effect_titles import capitalised
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.identification.reporting.units import measured, readable, signed

NORMAL_95: Final = 1.96
"""Half width of a 95 % interval, in standard errors."""
LEAST_REACH, MOST_REACH = 4, 15
"""Least and most range of the scale on the page, in tolerances."""
_LEAST_TOLD: Final = 0.05
"""Tolerances: less is 0.0 as it is printed."""
TAKEN_AS_EXACT: Final = "declared values are taken as exact: the parameter file gives no tolerances."


def declared_json(values: Sequence[DeclaredValue]) -> dict[str, Any]:
    """`declared` and `out_of_tolerance` of report.json and identify.json."""
    return {
        "declared": {
            found.name: {
                "value": found.value,
                "tolerance": found.tolerance,
                "estimate": plain(found.estimate),
                "stderr": plain(found.stderr),
                "deviation": plain(found.deviation),
            }
            for found in values
        },
        "out_of_tolerance": out_of_tolerance(values),
    }


def declared_lines(values: Sequence[DeclaredValue]) -> list[str]:
    """A table for the terminal, and a sentence for each value that is out of its tolerance; or that all are exact."""
    if not values:
        return [TAKEN_AS_EXACT]
    lines = [
        f"{'declared value':<28}{'declared ± tolerance':<30}{'estimate ± standard error':<30}off by, in tolerances"
    ]
    lines += [
        f"{found.name:<28}{as_declared(found):<30}{as_estimated(found):<30}{signed(found.deviation, 1)}"
        for found in values
    ]
    return [*lines, *(f"{out_words(found)}." for found in values if found.is_out)]


def as_declared(found: DeclaredValue) -> str:
    """428 ± 13 N/m."""
    return measured(_interval(found.value, found.tolerance), found.unit)


def as_estimated(found: DeclaredValue) -> str:
    """461.2 ± 2.4 N/m."""
    return measured(_interval(found.estimate, found.stderr), found.unit)


def out_words(found: DeclaredValue) -> str:
    """The spring rate is 461.2 ± 2.4 N/m, not 428: 4.2 tolerances."""
    return f"the {plain_name(found.name)} is {amount_words(found)}"


def amount_words(found: DeclaredValue) -> str:
    """461.2 ± 2.4 N/m, not 428: 4.2 tolerances; or 1264 ± 666 N/m, which does not differ from the declared 2000."""
    scale, _ = readable(found.unit, found.estimate or found.stderr)
    value = f"{scale * found.value:.6g}".replace("-", "−")
    if not found.is_apart:
        return f"{as_estimated(found)}, which does not differ from the declared {value} by more than its own error"
    return f"{as_estimated(found)}, not {value}: {abs(found.deviation):.1f} tolerances"


def plain_name(name: str) -> str:
    """The name of a declared value without underscores and dots."""
    axis, bracket, rest = name.partition("[")
    if bracket:
        return f"{axis}, direction {int(rest.rstrip(']')) + 1} of its covariance"
    effect, dot, parameter = name.removeprefix(GROUP).partition(".")
    return (f"{parameter} of {effect}" if dot else effect).replace("_", " ")


def summary_words(values: Sequence[DeclaredValue]) -> str:
    """Which are out of tolerance, or which is the furthest; without the full stop."""
    if not values:
        return TAKEN_AS_EXACT.rstrip(".")
    out = [out_words(found) for found in values if found.is_out]
    if out:
        return "; ".join(out)
    furthest = max(values, key=lambda found: abs(found.deviation))
    loose = [found for found in values if abs(found.deviation) > BEYOND and not found.is_apart]
    if loose:
        return f"the {plain_name(loose[0].name)} is {amount_words(loose[0])}"
    if abs(furthest.deviation) < _LEAST_TOLD:
        return f"all {len(values)} are where they are declared, within a tenth of a tolerance"
    return (
        f"all {len(values)} are within {BEYOND:g} tolerances of what is declared; the furthest is the "
        f"{plain_name(furthest.name)}, off by {signed(furthest.deviation, 1)}"
    )


def declared_section(values: Sequence[DeclaredValue]) -> dict[str, Any]:
    """The section of the page: words, and rows with places on a scale of tolerances, in percent of its width."""
    furthest = max((abs(found.deviation) + _half_width(found) for found in values), default=0.0)
    reach = float(min(max(math.ceil(furthest), LEAST_REACH), MOST_REACH))

    def at(deviation: float) -> float:
        return round(50.0 + 50.0 * min(max(deviation / reach, -1.0), 1.0), 2)

    step = max(1, round(reach / 3.0))
    marks = range(-step * int(reach // step), int(reach) + 1, step)
    return {
        "words": capitalised(summary_words(values)),
        "is_doubtful": any(found.is_out for found in values),
        "beyond": f"{BEYOND:g}",
        "low": at(-BEYOND),
        "width": round(at(BEYOND) - at(-BEYOND), 2),
        "ticks": [{"at": at(mark), "words": f"{mark:+d}".replace("-", "−") if mark else "0"} for mark in marks],
        "rows": [_row(found, at) for found in values],
    }


def _row(found: DeclaredValue, at: Callable[[float], float]) -> dict[str, Any]:
    low, high = (at(found.deviation + sign * _half_width(found)) for sign in (-1.0, 1.0))
    return {
        "name": found.name,
        "words": plain_name(found.name),
        "declared": as_declared(found),
        "estimate": as_estimated(found),
        "deviation": signed(found.deviation, 1),
        "is_out": found.is_out,
        "at": at(found.deviation),
        "left": low,
        "width": round(high - low, 2),
    }


def _half_width(found: DeclaredValue) -> float:
    """Half the width of the 95 % interval, in tolerances."""
    return NORMAL_95 * found.spread


def _interval(value: float, error: float) -> Interval:
    return Interval(value, error, value, value)
