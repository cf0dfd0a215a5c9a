"""A result as a document: sections of sentences, tables, plots and fields, each built once.

`to_text`, `to_json` and `to_junit` tell it; `page` and `figures` draw it. Each block says where it is told: `on`.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from valve_sim.files.json_text import plain_mapping

Array = NDArray[np.float64]
On = Literal["both", "page", "terminal"]
WIDTH: Final = 118
"""Characters of a line on a terminal, where notes are broken."""
HEIGHTS: Final = "▁▂▃▄▅▆▇█"
CHARACTERS: Final = 24
"""Of a small picture on a terminal."""
TOLD: Final = 0.5
"""Least range of the means of a small picture, of its range: what swings faster does not show on a terminal."""
MANY: Final = 1_000_000


@dataclass(frozen=True)
class Words:
    """Sentences after a bold `lead`; `style` is the page's: "", "soft" or "doubt"."""

    text: str
    lead: str = ""
    style: str = ""
    on: On = "both"


@dataclass(frozen=True)
class Items:
    """A list of sentences, which unfolds on the page where it has a title, `fold`."""

    lines: Sequence[str]
    fold: str = ""
    on: On = "both"


@dataclass(frozen=True)
class Typed:
    """Lines to type."""

    lines: Sequence[str]
    on: On = "page"


@dataclass(frozen=True)
class Entry:
    """Blocks under a title of their own; `name` is that of code."""

    title: str
    name: str
    blocks: Sequence[Block]
    on: On = "both"


@dataclass(frozen=True)
class Fold:
    """A row of the page that unfolds: who, what is in doubt, what else is said, a trend, and blocks."""

    who: str
    doubt: str
    words: str
    trend: Spark
    blocks: Sequence[Block]
    on: On = "page"


@dataclass(frozen=True)
class Spark:
    """A small picture in a cell: `shown` over `at`, (n,) each; `over` says what `at` is."""

    at: Array
    shown: Array
    over: str


@dataclass(frozen=True)
class OnScale:
    """A place with its interval on a scale from −reach to reach, and the half width of what is usual there."""

    at: float
    low: float
    high: float
    reach: float
    limit: float
    is_out: bool
    words: str


Cell = str | Spark | OnScale


@dataclass(frozen=True)
class TableRow:
    """A row of a table, with a note below; a marked one stands out, or is a test that failed.

    `name` is that of code, and the first cell leads to `link` on the page.
    """

    cells: Sequence[Cell]
    name: str = ""
    note: str = ""
    is_marked: bool = False
    link: str = ""


@dataclass(frozen=True)
class Table:
    """Rows below a head.

    Attributes:
        shown: rows that the page shows at once. is_sorted_on_click: whether a click on the head sorts the page's rows.
        is_by_name: whether a terminal shows names of code in place of the first cells.
        is_brief: whether a terminal shows marked rows only. suite: of tests, of which each row is a case; else empty.
    """

    head: Sequence[str]
    rows: Sequence[TableRow]
    shown: int = MANY
    is_sorted_on_click: bool = False
    is_by_name: bool = False
    is_brief: bool = False
    suite: str = ""
    on: On = "both"


@dataclass(frozen=True)
class Line:
    """Values over those of a plot, (n,), NaN where nothing is known; the name is that of a colour, too."""

    name: str
    y: Array
    has_dots: bool = False


@dataclass(frozen=True)
class Panel:
    """Curves on one axis, beside a band from `low` to `high`, (n,) each."""

    label: str
    curves: Sequence[Line]
    low: Array | None = None
    high: Array | None = None
    has_zero: bool = False


@dataclass(frozen=True)
class Plot:
    """Panels below each other over `x`, (n,)."""

    title: str
    caption: str
    x: Array
    x_label: str
    panels: Sequence[Panel]


@dataclass(frozen=True)
class Plots:
    """Plots beside each other, made where they are drawn.

    Attributes:
        shown: how many the page shows at once; the others unfold. legend: curves that the page can hide, each with what
            it is. is_small: whether they are half as wide.
    """

    make: Callable[[], Sequence[Plot]]
    shown: int = MANY
    legend: Sequence[tuple[str, str]] = ()
    is_small: bool = False
    on: On = "page"


Block = Words | Items | Typed | Entry | Fold | Table | Plots


@dataclass(frozen=True)
class Chapter:
    """Blocks under a title, and fields of JSON; a field that is a function is called for JSON only."""

    title: str = ""
    blocks: Sequence[Block] = ()
    fields: Mapping[str, Any] = field(default_factory=dict)
    on: On = "both"


@dataclass(frozen=True)
class Document:
    """A result.

    Attributes:
        name: of what it is: "Diagnosis". headline: what it says, in a sentence or two. kind: of the headline, in code.
        status: how sure it is, in a few words. chance: beside it. is_sure: whether that is enough to act on it.
    """

    name: str
    sections: Sequence[Chapter]
    headline: str = ""
    kind: str = ""
    status: str = ""
    chance: str = ""
    is_sure: bool = False

    def to_json(self) -> dict[str, Any]:
        """The fields of all sections, numbers that are not finite as null."""
        fields = {key: value for section in self.sections for key, value in section.fields.items()}
        return plain_mapping({key: value() if callable(value) else value for key, value in fields.items()})

    def to_text(self) -> str:
        """For a terminal."""
        lines = [f"{self.kind}: {self.headline}"] if self.headline else []
        if self.status:
            lines.append(f"{self.status}{f' ({self.chance})' if self.chance else ''}.")
        for section in self.sections:
            lines += _section_lines(section)
        return "\n".join(lines)

    def to_junit(self) -> str:
        """JUnit XML: a suite for each section that has checks, a test case for each of their rows."""
        root = ElementTree.Element("testsuites", name=self.name)
        for section in self.sections:
            for table in section.blocks:
                if isinstance(table, Table) and table.suite:
                    _add_suite(root, table)
        for key in ("tests", "failures", "errors"):
            root.set(key, str(sum(int(suite.get(key, "0")) for suite in root)))
        ElementTree.indent(root)
        text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
        return text.decode() + "\n"


def _add_suite(root: ElementTree.Element, table: Table) -> None:
    counts = {"failures": str(sum(row.is_marked for row in table.rows)), "errors": "0", "skipped": "0"}
    suite = ElementTree.SubElement(root, "testsuite", {"name": table.suite, "tests": str(len(table.rows)), **counts})
    for row in table.rows:
        told = zip(table.head[1:], row.cells[1:], strict=True)
        words = ", ".join(f"{head} {cell}" for head, cell in told if head)
        case = ElementTree.SubElement(suite, "testcase", classname=table.suite, name=str(row.cells[0]))
        if row.is_marked:
            ElementTree.SubElement(case, "failure", message=words, type="outside tolerance")
        else:
            ElementTree.SubElement(case, "system-out").text = words


# --- on a terminal --------------------------------------------------------------------------------------------------


def _section_lines(section: Chapter) -> Iterator[str]:
    if section.on == "page":
        return
    lines = list(_lines(section.blocks))
    if section.title and lines:
        yield section.title
    yield from (f"  {line}" if section.title else line for line in lines)


def _lines(blocks: Sequence[Block]) -> Iterator[str]:
    for block in blocks:
        if block.on == "page":
            continue
        match block:
            case Words(text, lead):
                yield f"{lead}: {text}" if lead else text
            case Items(lines):
                yield from lines
            case Entry(title, name, inside):
                yield f"{title} ({name})"
                yield from (f"  {line}" for line in _lines(inside))
            case Table():
                yield from _table_lines(block)


def _table_lines(table: Table) -> Iterator[str]:
    rows = [row for row in table.rows if row.is_marked or not table.is_brief]
    if not rows:
        return
    told = [index for index, cell in enumerate(rows[0].cells) if index and not isinstance(cell, OnScale)]
    firsts = [row.name if table.is_by_name and row.name else _cell_words(row.cells[0]) for row in rows]
    cells = [[first, *(_cell_words(row.cells[at]) for at in told)] for first, row in zip(firsts, rows, strict=True)]
    every = [[table.head[0], *(table.head[at] for at in told)], *cells]
    widths = [max(map(len, column)) + 2 for column in zip(*every, strict=True)]
    for row, words in zip([None, *rows], every, strict=True):
        if row is not None or any(words):
            yield "".join(word.ljust(width) for word, width in zip(words, widths, strict=True)).rstrip()
        if row is not None and row.note:
            yield from textwrap.wrap(row.note, WIDTH, initial_indent="  ", subsequent_indent="  ")


def _cell_words(cell: Cell) -> str:
    return sparkline(cell.shown) if isinstance(cell, Spark) else str(cell)


def sparkline(shown: Array) -> str:
    """A line of characters whose heights follow the values; empty where so few cannot show them."""
    if len(shown) < 2 or not np.all(np.isfinite(shown)):
        return ""
    few = np.array([np.mean(part) for part in np.array_split(shown, min(CHARACTERS, len(shown)))])
    low, size = float(np.min(few)), float(np.ptp(few))
    if size <= TOLD * float(np.ptp(shown)):
        return ""
    return "".join(HEIGHTS[int(height)] for height in (few - low) / size * (len(HEIGHTS) - 1))
