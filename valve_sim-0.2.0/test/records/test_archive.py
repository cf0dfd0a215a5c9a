"""The archive: what was written is read, in order, whatever is killed when; and it stays within its bounds."""

from __future__ import annotations

import fcntl
import random
import subprocess
import sys
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest

from valve_sim.model import ValveError

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install '.[parquet]'")

from valve_sim.records.archive import Archive

START = datetime(2026, 11, 29, 12, 0, tzinfo=timezone.utc)
VALVE = "/tank_1/valve"


def filled(folder: Path, writes: int, rows: int = 2, step: timedelta = timedelta(minutes=1)) -> Archive:
    archive, number = Archive(folder), 0
    for write in range(writes):
        for _ in range(rows):
            time = START + write * step + timedelta(seconds=number % rows)
            archive.add("strokes", VALVE, time, {"number": number, "t1": 5.3e-3, "cause": "none"}, 60.0 * write)
            number += 1
        archive.flush()
    return archive


def test_what_was_added_is_read_in_order(tmp_path: Path) -> None:
    archive = filled(tmp_path, 100)
    rows = archive.read("strokes", VALVE)
    assert [row["number"] for row in rows] == list(range(200))
    assert rows[0]["time"] == START and rows[0]["t1"] == pytest.approx(5.3e-3) and rows[0]["t2"] is None
    some = archive.read("strokes", VALVE, START + timedelta(minutes=10), START + timedelta(minutes=12))
    assert [row["number"] for row in some] == [20, 21, 22, 23]
    assert archive.read("findings", VALVE) == [] and archive.valves() == [VALVE]
    assert len(list(tmp_path.rglob("*.parquet"))) == 3 + 4, "three mergers of 32, and four that wait"


def test_rows_are_parted_by_valve_and_month_whatever_order_they_come_in(tmp_path: Path) -> None:
    archive, times = Archive(tmp_path), [START + timedelta(hours=7 * k) for k in range(40)]
    random.Random(1).shuffle(times)
    for time in times:
        archive.add("alarms", VALVE, time, {"level": 1, "message": "changed"}, 0.0)
        archive.add("alarms", "/tank 2=é/valve", time, {"level": 2}, 0.0)
    archive.flush()
    assert {path.name for path in tmp_path.glob("alarms/*/*")} == {"month=2026-11", "month=2026-12"}
    assert [row["time"] for row in archive.read("alarms", VALVE)] == sorted(times)
    assert archive.valves() == ["/tank 2=é/valve", VALVE]


def test_rows_wait_a_minute_at_most(tmp_path: Path) -> None:
    archive = Archive(tmp_path)
    archive.add("findings", VALVE, START, {"effect": "coulomb_friction", "value": 0.3}, 100.0)
    archive.tick(159.0)
    assert archive.read("findings", VALVE) == []
    archive.tick(160.0)
    assert [row["effect"] for row in archive.read("findings", VALVE)] == ["coulomb_friction"]
    with pytest.raises(ValueError, match="strokes have no column t3"):
        archive.add("strokes", VALVE, START, {"t3": 1.0}, 0.0)


def test_a_merger_that_was_cut_off_neither_doubles_nor_loses_rows(tmp_path: Path) -> None:
    archive = filled(tmp_path, 31)
    small = {path: path.read_bytes() for path in tmp_path.rglob("*.parquet")}
    filled_up = filled(tmp_path / "other", 32)
    (merged,) = (tmp_path / "other").rglob("*.parquet")
    (next(iter(small)).parent / merged.name).write_bytes(merged.read_bytes())  # and the small ones are still there
    assert [row["number"] for row in archive.read("strokes", VALVE)] == list(range(64))
    assert len(filled_up.read("strokes", VALVE)) == 64
    archive.add("strokes", VALVE, START + timedelta(minutes=33), {"number": 64}, 0.0)
    archive.flush()
    assert [row["number"] for row in archive.read("strokes", VALVE)] == list(range(65))
    assert len(list(tmp_path.glob("strokes/*/*/*.parquet"))) == 2


def test_kills_lose_nothing_that_was_written(tmp_path: Path) -> None:
    program = """
import sys; from pathlib import Path; from datetime import timedelta
sys.path.insert(0, sys.argv[2])
from records.test_archive import START, VALVE, Archive
archive, number = Archive(Path(sys.argv[1])), int(sys.argv[3])
while True:
    archive.add("strokes", VALVE, START + timedelta(seconds=number), {"number": number}, 0.0)
    archive.flush()
    print(number, flush=True)
    number += 1
"""
    number = 0
    for lines in (3, 40, 1, 31, 32, 33, 5):
        arguments = [str(tmp_path), str(Path(__file__).parents[1]), str(number)]
        with subprocess.Popen(
            [sys.executable, "-c", program, *arguments], stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout is not None
            for _ in range(lines):
                process.stdout.readline()
            process.kill()
        found = [row["number"] for row in Archive(tmp_path).read("strokes", VALVE)]
        assert found == list(range(len(found))) and len(found) >= number + lines
        number = len(found)


def test_two_writers_at_once_lose_nothing(tmp_path: Path) -> None:
    program = """
import sys; from pathlib import Path; from datetime import timedelta
sys.path.insert(0, sys.argv[2])
from records.test_archive import START, VALVE, Archive, ValveError
archive, first = Archive(Path(sys.argv[1])), int(sys.argv[3])
for number in range(first, first + 100):
    archive.add("strokes", VALVE, START + timedelta(seconds=number), {"number": number}, 0.0)
    try:
        archive.flush()
    except ValveError:  # the other one had the lock for long: what waits is written with the next
        pass
while archive._waiting:
    try:
        archive.flush()
    except ValveError:
        pass
"""
    arguments = [sys.executable, "-c", program, str(tmp_path), str(Path(__file__).parents[1])]
    processes = [subprocess.Popen([*arguments, str(first)]) for first in (0, 100)]
    assert [process.wait(600) for process in processes] == [0, 0]
    assert [row["number"] for row in Archive(tmp_path).read("strokes", VALVE)] == list(range(200))


def test_who_holds_the_lock_for_long_is_said_and_rows_wait(tmp_path: Path) -> None:
    archive = filled(tmp_path, 1)
    archive.add("strokes", VALVE, START + timedelta(minutes=5), {"number": 2}, 0.0)
    with (tmp_path / ".lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(ValveError, match="another program has been writing"):
            archive.flush()
    archive.flush()
    assert [row["number"] for row in archive.read("strokes", VALVE)] == [0, 1, 2]


def test_a_disk_that_is_full_loses_nothing_once_there_is_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = filled(tmp_path, 1)
    archive.add("strokes", VALVE, START + timedelta(minutes=5), {"number": 2}, 0.0)
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", lambda number: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(ValveError, match="No space left on device"):
            archive.flush()
    assert len(archive.read("strokes", VALVE)) == 2
    archive.flush()
    assert [row["number"] for row in archive.read("strokes", VALVE)] == [0, 1, 2]


def test_it_stays_within_its_years_and_bytes(tmp_path: Path) -> None:
    filled(tmp_path, 36, step=timedelta(days=31))
    months = sorted({path.name for path in tmp_path.glob("strokes/*/*")})
    archive = Archive(tmp_path, years=1.0)
    gone = archive.prune()
    assert [f"month={month}" for month in gone] == months[: len(gone)] and 20 < len(gone) < 26
    size = archive.size()
    bounded = Archive(tmp_path, most_bytes=size // 2)
    assert bounded.prune() and bounded.size() <= size // 2
    assert Archive(tmp_path, most_bytes=0).prune() and len(list(tmp_path.glob("strokes/*/*"))) == 1


@pytest.mark.parametrize(
    "wrong", [datetime(1970, 1, 1, tzinfo=timezone.utc), datetime(2106, 1, 1, tzinfo=timezone.utc)]
)
def test_a_wrong_clock_costs_no_month_but_what_it_made(tmp_path: Path, wrong: datetime) -> None:
    archive = filled(tmp_path, 6, step=timedelta(days=31))
    archive.add("strokes", VALVE, wrong, {"number": -1}, 0.0)
    archive.flush()
    assert Archive(tmp_path, years=0.5).prune() == []
    rows = archive.read("strokes", VALVE)
    assert {row["number"] for row in rows} == set(range(-1, 12))
    assert [row["number"] for row in archive.read("strokes", VALVE, START, START + timedelta(days=1))] == [0, 1]


def test_rows_are_counted_from_a_time_on(tmp_path: Path) -> None:
    archive = filled(tmp_path, 70, step=timedelta(days=1))
    assert archive.count("strokes", VALVE) == 140 and archive.count("alarms", VALVE) == 0
    for days in (0, 1, 31, 40, 69, 90):
        since = START + timedelta(days=days)
        assert archive.count("strokes", VALVE, since) == len(archive.read("strokes", VALVE, since)), days


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    archive = filled(tmp_path, 1)
    (path,) = tmp_path.rglob("*.parquet")
    path.write_bytes(b"damaged")
    with pytest.raises(ValveError, match=f"{path.name}: cannot be read"):
        archive.read("strokes", VALVE)
