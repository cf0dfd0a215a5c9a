"""The archive: what was written is read, whatever is killed when, by other programs too; and it stays in bounds."""

from __future__ import annotations

import itertools
import random
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from valve_sim.model import ValveError
from valve_sim.records.archive import COLUMNS, Archive, Row

START = datetime(2026, 11, 29, 12, 0, tzinfo=timezone.utc)
VALVE = "/tank_1/valve"


def stroke(number: int, at: datetime, valve: str = VALVE) -> Row:
    return Row("strokes", valve, at, {"number": number, "t1": 5.3e-3, "cause": "none"})


def written(folder: Path, count: int, step: timedelta) -> Archive:
    archive = Archive(folder, is_written=True)
    archive.write(stroke(number, START + number * step) for number in range(count))
    return archive


def numbers(archive: Archive, since: datetime | None = None, until: datetime | None = None) -> list[int]:
    return [row["number"] for row in archive.read("strokes", VALVE, since, until)]


def test_what_was_written_is_read_in_order_of_time(tmp_path: Path) -> None:
    archive, order = Archive(tmp_path, is_written=True), list(range(100))
    random.Random(1).shuffle(order)
    for number in order:
        at = START + timedelta(hours=7 * number)
        archive.write([stroke(number, at), stroke(-1, at, "/tank 2=é/valve"), Row("alarms", VALVE, at, {"level": 1})])
    assert numbers(archive) == list(range(100)) and archive.valves() == ["/tank 2=é/valve", VALVE]
    for first, last in ((0, 10), (10, 12), (99, 200), (40, 40)):
        since, until = START + timedelta(hours=7 * first), START + timedelta(hours=7 * last)
        assert numbers(archive, since, until) == list(range(first, min(last, 100)))
        assert archive.count("strokes", VALVE, since) == 100 - first
    row = archive.read("strokes", VALVE)[0]
    assert (row["time"], row["t1"], row["t2"], row["cause"]) == (START, 5.3e-3, None, "none")
    assert len(archive.read("alarms", VALVE)) == 100 and archive.read("findings", VALVE) == []


def test_other_programs_read_it_while_it_is_written(tmp_path: Path) -> None:
    archive = written(tmp_path, 40, timedelta(days=1))
    base = sqlite3.connect(tmp_path / "archive.sqlite")
    question = "SELECT strftime('%Y-%m', time), count(*), avg(t1) FROM strokes WHERE valve=? GROUP BY 1 ORDER BY 1"
    months = base.execute(question, (VALVE,)).fetchall()
    assert [month[:2] for month in months] == [("2026-11", 2), ("2026-12", 31), ("2027-01", 7)]
    assert months[0][2] == pytest.approx(5.3e-3)
    archive.write([stroke(40, START + timedelta(days=40))])
    assert base.execute("SELECT count(*) FROM strokes").fetchone() == (41,)


def test_kills_lose_nothing_that_was_written(tmp_path: Path) -> None:
    program = """
import sys; from pathlib import Path; from datetime import datetime, timedelta, timezone
from valve_sim.records.archive import Archive, Row
archive, number = Archive(Path(sys.argv[1]), is_written=True), int(sys.argv[2])
start = datetime(2026, 11, 29, tzinfo=timezone.utc)
while True:
    archive.write([Row("strokes", "/tank_1/valve", start + timedelta(seconds=number), {"number": number})])
    print(number, flush=True)
    number += 1
"""
    count = 0
    for lines in (3, 40, 1, 200):
        arguments = [str(tmp_path), str(count)]
        with subprocess.Popen(
            [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            for _ in range(lines):
                process.stdout.readline()
            process.kill()
        found = numbers(Archive(tmp_path))
        assert found == list(range(len(found))) and len(found) >= count + lines
        count = len(found)


def test_rows_that_cannot_be_written_are_not_written_in_part(tmp_path: Path) -> None:
    archive, other = written(tmp_path, 1, timedelta()), sqlite3.connect(tmp_path / "archive.sqlite")
    other.execute("BEGIN IMMEDIATE")
    with pytest.raises(ValveError, match=r"archive\.sqlite: cannot be used \(database is locked\)"):
        archive.write([stroke(1, START)])
    other.rollback()
    other.execute("CREATE TRIGGER full BEFORE INSERT ON strokes WHEN NEW.number=3 BEGIN SELECT RAISE(ABORT, 'x'); END")
    with pytest.raises(ValveError):
        archive.write(stroke(number, START) for number in (2, 3))
    assert numbers(archive) == [0]


def test_it_stays_within_its_years_and_bytes(tmp_path: Path) -> None:
    archive = written(tmp_path, 36 * 200, timedelta(days=31) / 200)
    for wrong in (datetime(1970, 1, 1, tzinfo=timezone.utc), datetime(2106, 1, 1, tzinfo=timezone.utc)):
        archive.write([stroke(-1, wrong)])
    assert archive.prune(years=3.2, most_bytes=10**9) == [], "a clock that is wrong makes a month of its own"
    gone = archive.prune(years=1.0, most_bytes=10**9)
    assert gone[:2] == ["1970-01", "2026-11"] and len(gone) == 40 - 13
    size = archive.size()
    assert archive.prune(years=1.0, most_bytes=size // 2) and archive.size() <= size // 2
    archive.prune(years=1.0, most_bytes=0)
    assert numbers(archive) == [-1], "the last month stays"


def test_a_stroke_takes_the_bytes_that_the_page_says(tmp_path: Path) -> None:
    archive, values = Archive(tmp_path, is_written=True), random_values()
    archive.write(Row("strokes", VALVE, START + timedelta(seconds=36 * n), next(values)) for n in range(3000))
    page = Path(__file__).parents[2] / "docs" / "how_to" / "archive.md"
    (said,) = re.findall(r"A stroke takes (\d+) bytes", page.read_text(encoding="utf-8"))
    assert archive.size() / 3000 == pytest.approx(float(said), rel=0.05)


def random_values() -> Iterator[dict[str, object]]:
    """Strokes of which every figure is known."""
    source = random.Random(1)
    for number in itertools.count():
        known: dict[str, object] = {name: source.random() for name, of in COLUMNS["strokes"].items() if of == "REAL"}
        yield {**known, "number": number, "cause": "coulomb_friction", "state": "watching"}


def test_a_file_that_is_missing_or_damaged_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValveError, match=r"archive\.sqlite: there is no archive"):
        Archive(tmp_path)
    assert not list(tmp_path.iterdir())
    (tmp_path / "archive.sqlite").write_bytes(b"nonsense" * 1000)
    with pytest.raises(ValveError, match=r"archive\.sqlite: is damaged"):
        Archive(tmp_path, is_written=True)
