"""What a terminal and JUnit are told of a table."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from valve_sim.identification.reporting.document import Chapter, Document, OnScale, Spark, Table, TableRow, Words

OUT = OnScale(3.0, 2.0, 4.0, 5.0, 1.0, True, "out")
RISES = Spark(np.arange(24.0), np.arange(24.0), "strokes")
SWINGS = Spark(np.arange(480.0), np.tile([0.0, 1.0], 240), "strokes")
ROWS = [
    TableRow(["friction", "0.1 N", OUT, RISES], name="coulomb_friction", note="as large as a tenth"),
    TableRow(["stroke", "1 mm", OUT, SWINGS], name="stroke_offset", is_marked=True),
]


def table(**form: bool) -> Table:
    return Table(["what", "size", "scale", "over strokes"], ROWS, suite="checks", **form)


def text(**form: bool) -> list[str]:
    own = table(**form)
    chapters = [Chapter("Found", [own, Words("on the page alone", on="page")]), Chapter("Drawn", [own], on="page")]
    return Document("a test", chapters).to_text().splitlines()


def test_a_terminal_shows_cells_below_each_other_and_marked_rows_where_it_is_brief() -> None:
    title, head, first, note, second = text()
    assert title == "Found"
    assert head.split() == ["what", "size", "over", "strokes"], "a scale is drawn on the page alone"
    assert first.split()[:-1] == ["friction", "0.1", "N"]
    assert sorted(set(first.split()[-1])) == [*"▁▂▃▄▅▆▇█"]
    assert note.strip() == "as large as a tenth"
    assert second.split() == ["stroke", "1", "mm"], "what swings from stroke to stroke is no rise"
    assert first.index("0.1") == second.index("1 mm") == head.index("size")
    for form, begins in (("is_by_name", ["coulomb_friction", "as", "stroke_offset"]), ("is_brief", ["stroke"])):
        assert [line.split()[0] for line in text(**{form: True})[1:]] == ["what", *begins]


def test_a_marked_row_of_a_suite_is_a_failure() -> None:
    root = ElementTree.fromstring(Document("a test", [Chapter("", [table()])]).to_junit())
    assert root.attrib["failures"] == "1"
    assert [case.attrib["name"] for case in root.iter("testcase") if case.find("failure") is not None] == ["stroke"]
