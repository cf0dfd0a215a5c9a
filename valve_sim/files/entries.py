"""Checks of what a YAML file holds: each error is one line with file, key, what was found and what is expected."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from valve_sim.model.core.own.units import Unit, UnitError, parse_unit
from valve_sim.model.errors import ValveError

LONGEST_MESSAGE: Final = 480
"""Characters: keys and values of a file may be long, and of several lines."""
MOST_LISTED: Final = 20
"""Names that an error lists."""


class Entries:
    """The entries of one file.

    Args:
        where: the file, for errors.
        error: the type of what its checks raise.
    """

    def __init__(self, where: str, error: type[ValveError]) -> None:
        self.where, self._error = where, error

    def fail(self, key: str, words: str) -> ValveError:
        """An error of a key, or with an empty one of the whole file, to be raised."""
        text = " ".join((f"{self.where}: {key}: {words}" if key else f"{self.where}: {words}").split())
        return self._error(text if len(text) <= LONGEST_MESSAGE else f"{text[: LONGEST_MESSAGE - 3]}...")

    def mapping(self, key: str, found: object, expected: str) -> Mapping[Any, Any]:
        """Keys and values; `expected` says of which."""
        if not isinstance(found, Mapping):
            raise self.fail(key, f"found {short(found)}, expected {expected}")
        return found

    def filled(self, key: str, found: object, expected: str) -> Mapping[Any, Any]:
        """Keys and values, at least one; `expected` shows what."""
        if not isinstance(found, Mapping) or not found:
            raise self.fail(key, f"found {short(found)}, expected {expected}")
        return found

    def check_keys(self, key: str, found: Mapping[Any, Any], known: Sequence[str], hint: str = "") -> None:
        """Refuse keys that are not known; `hint` ends the error."""
        for name in found:
            own = f"{key}.{str(name)[:80]}" if key else str(name)[:80]
            if isinstance(name, bool):
                raise self.fail(own, f"found {name} for a key: YAML reads on, off, yes and no so; write it in quotes")
            if name not in known:
                raise self.fail(own, f"unknown key; {alternatives(name, known)}{hint}")

    def number(self, key: str, found: object) -> float:
        """A finite number."""
        if isinstance(found, bool):
            raise self.fail(key, f"found {found}, expected a number (YAML reads on, off, yes and no as true or false)")
        if isinstance(found, str):
            mend = ": take the quotes away" if is_number(found) else ""
            raise self.fail(key, f"found the text {short(found)}, expected a number{mend}")
        if not isinstance(found, int | float):
            raise self.fail(key, f"found {short(found)}, expected a finite number")
        if not math.isfinite(found):
            raise self.fail(key, f"found {found}, expected a finite number")
        return float(found)

    def choice(self, key: str, found: object, known: Sequence[object]) -> Any:
        """One of a few values."""
        if isinstance(found, bool) or found not in known:
            raise self.fail(
                key, f"found {short(found)}, expected {' or '.join(str(own) for own in known if own != '')}"
            )
        return found

    def text(self, key: str, found: object) -> str:
        """A text; YAML may have read it as a whole number."""
        text = str(found) if isinstance(found, int) and not isinstance(found, bool) else found
        if not isinstance(text, str):
            mend = " (YAML reads on, off, yes and no so: write it in quotes)" if isinstance(found, bool) else ""
            raise self.fail(key, f"found {short(found)}, expected a text{mend}")
        return text.strip()

    def unit(self, key: str, found: object) -> Unit:
        """A unit; 1, which YAML reads as a number, is that of a plain number."""
        text = "1" if found == 1 and not isinstance(found, bool) else found
        if not isinstance(text, str):
            raise self.fail(key, f"found {short(found)}, expected a text such as N*s/m; 1 for a plain number")
        try:
            return parse_unit(text)
        except UnitError as error:
            raise self.fail(key, str(error)) from error


def is_number(text: str) -> bool:
    """Whether a text is that of a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def alternatives(name: object, known: Iterable[str]) -> str:
    """What ends an error of a name that is not known: the most alike, and all that are."""
    listed = list(known)
    if not listed:
        return "there is none"
    alike = difflib.get_close_matches(str(name), listed, n=1, cutoff=0.6)
    mend = f"did you mean {alike[0]}? " if alike else ""
    return f"{mend}expected one of {', '.join(listed[:MOST_LISTED])}{', ...' if len(listed) > MOST_LISTED else ''}"


def short(value: object) -> str:
    """What was found, as an error shows it: on one line, and not too long."""
    text = "nothing" if value is None else " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
