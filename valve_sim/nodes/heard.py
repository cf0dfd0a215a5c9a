"""Texts and numbers that other programs send, read within bounds. Needs no ROS.

Whoever may publish on a topic may send anything there. What is out of bounds is one line and never another exception.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from valve_sim.files.entries import short
from valve_sim.model.errors import ValveError
from valve_sim.nodes.realtime import LAST_STAMP, NANOSECONDS

LARGEST_INTEGER: Final = 2**53
"""Beyond it not every integer is a double."""
LAST_SECOND: Final = float(LAST_STAMP // NANOSECONDS)
"""s since 1970."""


class UnusableMessageError(ValveError):
    """A message that does not hold what is wanted; the text says why."""


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
