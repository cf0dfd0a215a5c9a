"""Texts and numbers that other programs send, read within bounds. Needs no ROS.

Whoever may publish on a topic may send anything there. What is out of bounds is one line and never another exception.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final, NoReturn

from valve_sim.files.entries import short
from valve_sim.model.errors import ValveError
from valve_sim.nodes.realtime import LAST_STAMP, NANOSECONDS

MOST_CHARACTERS: Final = 100_000
"""Of a text: fifty times as much as the longest report of a stroke."""
DEEPEST: Final = 10
"""Mappings and lists in each other."""
LARGEST_INTEGER: Final = 2**53
"""Beyond it not every integer is a double."""
LAST_SECOND: Final = float(LAST_STAMP // NANOSECONDS)
"""s since 1970."""


class UnusableMessageError(ValveError):
    """A message that does not hold what is wanted; the text says why."""


def read_report(text: str, schema: str) -> dict[str, Any]:
    """A report in JSON: all its numbers are finite, no text is too long, and nothing is nested too deep.

    Raises:
        UnusableMessageError: it is no such report of this schema.
    """
    if len(text) > MOST_CHARACTERS:
        raise UnusableMessageError(f"found {len(text)} characters, expected {MOST_CHARACTERS} at most")
    try:
        found = json.loads(text, parse_constant=_refuse)
        _check(found, DEEPEST)
    except (ValueError, RecursionError) as error:
        raise UnusableMessageError(f"found {text[:60]!r}, expected JSON: {str(error)[:100]}") from error
    if not isinstance(found, dict) or found.get("schema") != schema:
        told = short(found.get("schema")) if isinstance(found, dict) else text[:60]
        raise UnusableMessageError(f"found {told}, expected a report of schema {schema}: use one version")
    return found


def number_of(
    found: Mapping[str, object], name: str, lower: float = -math.inf, upper: float = math.inf
) -> float | None:
    """The number under a name, which may be its text; None where there is none or where it is null.

    Raises:
        UnusableMessageError: it is no finite number within the bounds.
    """
    value = found.get(name)
    if value is None:
        return None
    try:
        number = float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else math.nan
    except (ValueError, OverflowError):
        number = math.nan
    if not (math.isfinite(number) and lower <= number <= upper):
        bounds = "" if lower == -math.inf else f" from {lower:g} to {upper:g}"
        raise UnusableMessageError(f"{name}: found {short(value)}, expected a finite number{bounds}")
    return number


def required_number(found: Mapping[str, object], name: str, lower: float, upper: float) -> float:
    """As `number_of`, of a number that must be there."""
    number = number_of(found, name, lower, upper)
    if number is None:
        raise UnusableMessageError(f"{name}: is missing, expected a number from {lower:g} to {upper:g}")
    return number


def moment_of(found: Mapping[str, object], name: str = "time") -> float:
    """The time under a name, s since 1970; as `required_number`."""
    return required_number(found, name, 0.0, LAST_SECOND)


def count_of(found: Mapping[str, object], name: str) -> int:
    """The whole number, from 0 on, under a name; as `required_number`."""
    number = required_number(found, name, 0.0, LARGEST_INTEGER)
    if number != int(number):
        raise UnusableMessageError(f"{name}: found {number:g}, expected a whole number")
    return int(number)


def text_of(found: Mapping[str, object], name: str, most: int = 1000) -> str:
    """The text under a name; empty where there is none.

    Raises:
        UnusableMessageError: it is no text, or longer than `most` characters.
    """
    value = found.get(name)
    if value is None:
        return ""
    if not isinstance(value, str) or len(value) > most:
        raise UnusableMessageError(f"{name}: found {short(value)}, expected a text of {most} characters at most")
    return value


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number")


def _check(found: object, depth: int) -> None:
    if isinstance(found, dict | list):
        if depth == 0:
            raise ValueError(f"nested deeper than {DEEPEST}")
        for item in found.values() if isinstance(found, dict) else found:
            _check(item, depth - 1)
    elif isinstance(found, float) and not math.isfinite(found):
        raise ValueError("a number that is not finite")
    elif isinstance(found, int) and abs(found) > LARGEST_INTEGER:
        raise ValueError("an integer that is too large")
