"""Words without credentials: what goes into a row, a log or a page is made harmless here, and nowhere else."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Final

HIDDEN: Final = "***"
"""Text that replaces a credential."""

_USER: Final = re.compile(r"(?<=://)[^/@\s]+@")
_QUERY: Final = re.compile(r"(?<=\w)\?\S*[=&]\S*")
_KEY_ID: Final = re.compile(r"\b(AKIA|ASIA)[A-Z0-9]{12,}\b")
_SECRET_NAMES: Final = ("KEY", "SECRET", "TOKEN", "PASSWORD", "CREDENTIAL", "CONNECTION_STRING")
_SHORTEST: Final = 8
"""Shorter values of the environment are words, such as "true", and hide nothing."""


def without_credentials(text: str, environment: Mapping[str, str] | None = None) -> str:
    """A text without users and passwords in URLs, signed queries, key identifiers, and secrets of the environment.

    `None` is the environment of this process; as a default it would be printed, values and all, where signatures are.
    """
    for name, value in (os.environ if environment is None else environment).items():
        if len(value) >= _SHORTEST and any(part in name.upper() for part in _SECRET_NAMES):
            text = text.replace(value, HIDDEN)
    text = _USER.sub(f"{HIDDEN}@", text)
    return _KEY_ID.sub(HIDDEN, _QUERY.sub(f"?{HIDDEN}", text))


def one_line(error: BaseException) -> str:
    """What went wrong, in one line without credentials."""
    words = " ".join(str(error).split()) or type(error).__name__
    return without_credentials(words)[:_LONGEST]


_LONGEST: Final = 600
"""Characters of a message that are kept."""
