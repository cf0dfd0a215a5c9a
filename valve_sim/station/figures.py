"""The one table of what an OPC UA client sees of a valve, and how it follows from what monitors and valves say.

Independent of OPC UA and ROS: reports are the keys and values of a monitor's topics, values are plain Python.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Final, Literal, NamedTuple

from valve_sim.nodes.heard import count_of, moment_of, number_of, text_of
from valve_sim.nodes.valve_parameters import unit_of

Kind = Literal["Double", "Int32", "Boolean", "String"]
Values = dict[str, object]
"""Values by path; None for what is not known."""


class Figure(NamedTuple):
    """One variable of a valve.

    Attributes:
        path: group and name, as they are browsed. kind: its type. unit: SI symbol, empty for none.
        description: one line. is_list: whether it is an array. is_kept: whether its history is kept.
    """

    path: str
    kind: Kind
    unit: str
    description: str
    is_list: bool = False
    is_kept: bool = True

    @property
    def group(self) -> str:
        """The object that it is a component of."""
        return self.path.partition(".")[0]

    @property
    def name(self) -> str:
        """Its name within the group."""
        return self.path.partition(".")[2]

    @property
    def column(self) -> str:
        """How monitors and the archive call it: Stroke.T1StandardError is t1_stderr."""
        return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", self.name).lower().replace("standard_error", "stderr")


FIGURES: Final = (
    Figure("Health.Level", "Int32", "", "state of the valve, by its monitor: 0 OK, 1 WARN, 2 ERROR, 3 STALE"),
    Figure("Health.Message", "String", "", "state of the valve in words"),
    Figure("Driver.Level", "Int32", "", "worst state that the valve's node reports: 0 OK, 1 WARN, 2 ERROR, 3 STALE"),
    Figure("Driver.Message", "String", "", "that state in words"),
    Figure("Live.Phase", "Int32", "", "0 closed, 1 pilot, 2 gap_hold, 3 main, 4 open"),
    Figure("Live.IsOpen", "Boolean", "", "whether the flow path is fully open"),
    Figure("Live.CoilCurrent", "Double", "A", "current of the coil", is_kept=False),
    Figure("Live.OutletPressure", "Double", "Pa", "pressure behind the valve, absolute", is_kept=False),
    Figure("Stroke.Number", "Int32", "", "number of the last stroke, from 0"),
    Figure("Stroke.State", "String", "", "state of the monitor at that stroke"),
    Figure("Stroke.OpeningDelay", "Double", "s", "from the command until the plunger moves"),
    Figure("Stroke.T1", "Double", "s", "pilot plunger reaches the main plunger, after the command"),
    Figure("Stroke.T1StandardError", "Double", "s", "standard error of T1"),
    Figure("Stroke.T2", "Double", "s", "all parts reach the core, after the command"),
    Figure("Stroke.T2StandardError", "Double", "s", "standard error of T2"),
    Figure("Stroke.ClosingTime", "Double", "s", "pilot plunger is back on its seat, after the command to close"),
    Figure("Stroke.ClosingTimeStandardError", "Double", "s", "standard error of ClosingTime"),
    Figure("Stroke.PilotDamping", "Double", "N·s/m", "damping in Phase 1, refitted to this stroke"),
    Figure("Stroke.PilotDampingStandardError", "Double", "N·s/m", "standard error of PilotDamping"),
    Figure("Stroke.MainDamping", "Double", "N·s/m", "damping in Phase 2, refitted to this stroke"),
    Figure("Stroke.MainDampingStandardError", "Double", "N·s/m", "standard error of MainDamping"),
    Figure("Stroke.Residual", "Double", "m", "measured less predicted position, root mean square"),
    Figure("Stroke.CurrentResidual", "Double", "A", "measured less predicted current, of a valve watched by it alone"),
    Figure("Stroke.Score", "Double", "", "largest cumulative sum of the scores"),
    Figure("Stroke.Threshold", "Double", "", "score at which an alarm is raised"),
    Figure("Stroke.Cause", "String", "", "effect in whose direction the score points"),
    Figure("Stroke.ScoreNames", "String", "", "effects with the largest scores of this stroke", is_list=True),
    Figure("Stroke.Scores", "Double", "", "these scores, standard normal while nothing has changed", is_list=True),
    Figure("Finding.Effect", "String", "", "what has changed: names of effects or of declared values"),
    Figure("Finding.Parameter", "String", "", "parameter whose value is given"),
    Figure("Finding.Value", "Double", "", "value of that parameter, in the unit of Unit"),
    Figure("Finding.StandardError", "Double", "", "standard error of Value"),
    Figure("Finding.Unit", "String", "", "SI unit of value and standard error"),
    Figure("Finding.Probability", "Double", "", "probability of this finding, 0 to 1"),
    Figure("Finding.Stroke", "Int32", "", "last stroke of those that gave the finding"),
    Figure("Finding.Summary", "String", "", "the finding in one sentence"),
)
"""All variables of a valve, in the order in which they are browsed."""

BY_PATH: Final = {figure.path: figure for figure in FIGURES}

_CODES: Final = {
    "s": ("SEC", "second"),
    "m": ("MTR", "metre"),
    "A": ("AMP", "ampere"),
    "V": ("VLT", "volt"),
    "Pa": ("PAL", "pascal"),
    "N·s/m": ("C57", "newton second per metre"),
}
"""Common codes of UNECE Recommendation 20 of the units above, and their names."""


def unit_id(unit: str) -> int:
    """The UnitId that OPC UA derives from a unit's common code; -1 for a unit without one."""
    found = _CODES.get(unit)
    return -1 if found is None else int.from_bytes(found[0].encode("ascii"), "big")


def unit_words(unit: str) -> str:
    """A unit's name in words, or its symbol."""
    found = _CODES.get(unit)
    return unit if found is None else found[1]


_LONGEST: Final = 2000
"""Characters of a text."""
_MOST_SCORES: Final = 3


class Report(NamedTuple):
    """A message about a valve: full name of its node, time in UTC, and values by path."""

    valve: str
    time: datetime
    values: Values


def utc(seconds: float) -> datetime:
    """A time in s since 1970 as OPC UA wants it."""
    return datetime.fromtimestamp(seconds, timezone.utc)


def shown(group: str, told: Mapping[str, object]) -> Values:
    """The figures of a group by path, of what was told by column.

    Raises:
        UnusableMessageError: a value is of another kind, not finite, or out of bounds.
    """
    return {figure.path: _checked(figure, told) for figure in FIGURES if figure.group == group}


def stroke_report(summary: str, found: Mapping[str, str]) -> Report:
    """What a monitor's ~/stroke_report says; of its scores the largest are shown.

    Raises:
        UnusableMessageError: it is no such report.
    """
    scores = {name.removeprefix("scores."): number_of(found, name) or 0.0 for name in found if name[:7] == "scores."}
    largest = sorted(scores, key=lambda name: -abs(scores[name]))[:_MOST_SCORES]
    told: dict[str, object] = {
        **found,
        "number": count_of(found, "stroke"),
        "residual": _scaled(number_of(found, "residual_rms_um"), 1e-6),
        "current_residual": _scaled(number_of(found, "residual_rms_ma"), 1e-3),
        "score": found.get("alarm.sum"),
        "threshold": found.get("alarm.threshold"),
        "cause": found.get("alarm.cause"),
        "score_names": list(largest),
        "scores": [scores[name] for name in largest],
    }
    for name in ("pilot_damping", "main_damping"):
        told[name], told[f"{name}_stderr"] = (found.get(f"damping.{name}.{key}") for key in ("value", "stderr"))
    return Report(text_of(found, "valve"), utc(moment_of(found)), shown("Stroke", told))


def finding_report(summary: str, found: Mapping[str, str]) -> Report:
    """What a monitor's ~/finding says; of several parameters the first is shown, and all are in the summary.

    Raises:
        UnusableMessageError: it is no such finding.
    """
    name = next((key for key in found if key.startswith("parameters.") and key.endswith(".value")), "")
    name = name.removeprefix("parameters.").removesuffix(".value")
    told: dict[str, object] = {
        "effect": found.get("effects") or found.get("kind"),
        "parameter": name,
        "value": found.get(f"parameters.{name}.value"),
        "stderr": found.get(f"parameters.{name}.stderr"),
        "unit": unit_of(name),
        "probability": found.get("probability"),
        "stroke": count_of(found, "stroke"),
        "summary": summary,
    }
    return Report(text_of(found, "valve"), utc(moment_of(found)), shown("Finding", told))


def worst(statuses: Sequence[tuple[int, str, str]]) -> tuple[int, str]:
    """The level and the words of the worst of some statuses: (level, task, message) each."""
    level, task, message = max(statuses, key=lambda status: status[0])
    return level, f"{task}: {message}"


def _checked(figure: Figure, told: Mapping[str, object]) -> object:
    if figure.is_list:
        entries = told.get(figure.column)
        items = [{figure.column: entry} for entry in entries] if isinstance(entries, list) else []
        found = [_checked(figure._replace(is_list=False), item) for item in items]
        return [math.nan if entry is None else entry for entry in found]
    if figure.kind == "String":
        return text_of(told, figure.column, _LONGEST).encode("utf-8", "replace").decode()  # no half of a character
    if figure.kind == "Int32":
        number = number_of(told, figure.column, -(2.0**31), 2.0**31 - 1.0)
        return None if number is None else int(number)
    return number_of(told, figure.column)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
