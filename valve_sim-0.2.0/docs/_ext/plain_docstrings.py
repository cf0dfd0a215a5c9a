"""Docstrings are plain text with names in `backticks`, as people read them in an editor; Sphinx reads markup.

So what would be markup, and was not meant as such, is taken as it stands: |v|, *parameters, a trailing underscore, and
lines that are set apart by their indentation, such as an example or a formula.
"""

from __future__ import annotations

import re
from importlib.util import find_spec
from typing import Any

from sphinx.application import Sphinx

CODE = re.compile(r"(``.+?``|`[^`]+`)")
MARKUP = re.compile(r"[*|]|(?<=\w)_(?!\w)")
OPTION = re.compile(r"(?<![\w-])(--[a-z][a-z-]*)")
BULLET = re.compile(r"[*-] |\d+\. ")
ONE_VALUE = ("attribute", "data", "property")
ALIAS = re.compile(r"TypeAliasForwardRef\('(\w+)'\)")
SHORT = {
    "ndarray[tuple[Any, ...], dtype[float64]]": "Array",
    "ndarray[tuple[Any, ...], dtype[int64]]": "NDArray[int64]",
    "ndarray[tuple[Any, ...], dtype[uint8]]": "NDArray[uint8]",
    "ndarray[tuple[Any, ...], dtype[bool]]": "NDArray[bool]",
    "~collections.abc.": "",
}
LONG = re.compile("|".join(map(re.escape, SHORT)))
SECTION = re.compile(r"(Args|Attributes|Raises|Returns|Yields|Note|Example)s?:$")


def escaped(line: str) -> str:
    """A line in which *, | and a trailing _ mean themselves, but for those within backticks and for a bullet."""
    bullet = BULLET.match(line.lstrip())
    kept = len(line) - len(line.lstrip()) + (bullet.end() if bullet else 0)
    parts = CODE.split(line[kept:])
    parts[::2] = [OPTION.sub(r"``\1``", MARKUP.sub(lambda found: "\\" + found[0], part)) for part in parts[::2]]
    return line[:kept] + "".join(parts)


def as_meant(lines: list[str]) -> list[str]:
    """A docstring as reStructuredText that says what its plain text shows."""
    written: list[str] = []
    in_section = in_list = in_literal = False
    for line in lines:
        is_indented = line.startswith("  ")
        if line and not is_indented:
            in_section, in_list = bool(SECTION.match(line)), bool(BULLET.match(line))
        if is_indented and not in_section and not in_list:
            if not in_literal:
                written += ["", "::", ""]
            in_literal = True
            written.append(line)
            continue
        if line and in_literal:
            in_literal = False
            written.append("")
        written.append(escaped(line))
    return written


def without_markup(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Rewrite a docstring in place."""
    lines[:] = as_meant(lines)
    if what in ONE_VALUE:
        app.env.temp_data[name] = list(lines)


def without_type(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Undo what napoleon makes of a value's docstring: it takes the words before a colon for a type."""
    if what in ONE_VALUE:
        lines[:] = app.env.temp_data.pop(name, lines)


def shorter(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, arguments: str | None, returns: str | None
) -> Any:
    """A signature with the types as the source names them."""
    return tuple(
        text and LONG.sub(lambda found: SHORT[found[0]], ALIAS.sub(r"\1", text)) for text in (arguments, returns)
    )


def skip_fields(app: Sphinx, what: str, name: str, thing: Any, skip: bool, options: Any) -> bool | None:
    """Leave out the fields of named tuples: their class says what they are, and they "alias field number 3"."""
    return True if type(thing).__name__ == "_tuplegetter" else None


def examples_as_code(app: Sphinx, context: Any, lines: list[str]) -> None:
    """Of a command's help, set the lines that click leaves alone as code, and take the others as plain text."""
    written: list[str] = []
    for line in lines:
        is_code = line.startswith("|")
        if is_code and not (written and written[-1].startswith("   ")):
            written += ["", "::", ""]
        written.append(f"   {line[2:]}" if is_code else escaped(line))
    lines[:] = written


def setup(app: Sphinx) -> dict[str, bool]:
    """Come before napoleon, which writes markup of its own, and after it."""
    app.connect("autodoc-process-docstring", without_markup, priority=400)
    app.connect("autodoc-process-docstring", without_type, priority=600)
    app.connect("autodoc-process-signature", shorter)
    app.connect("autodoc-skip-member", skip_fields)
    if find_spec("sphinx_click"):
        app.setup_extension("sphinx_click")
        app.connect("sphinx-click-process-description", examples_as_code)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
