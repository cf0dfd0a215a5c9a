"""Disks that are full and bags that cannot be read now: one clear line, and the next run does what is left."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import fsspec
import pyarrow.parquet as pq
import pytest

from valve_sim.fleet import bag_files, results, work
from valve_sim.fleet.results import PARTS
from valve_sim.fleet.run import examine_fleet
from valve_sim.fleet.sources import Bag
from valve_sim.fleet.units import EXAMINED, Row
from valve_sim.model.errors import ValveError

from .bags import counted

pytestmark = pytest.mark.long

BAGS = ("day_1.mcap", "day_2.mcap", "day_3.mcap")


@pytest.fixture
def bags(tmp_path: Path) -> Path:
    """Three files that are called bags."""
    (tmp_path / "bags").mkdir()
    for name in BAGS:
        (tmp_path / "bags" / name).write_text(name)
    return tmp_path / "bags"


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the bags that are examined, which finds nothing; a first look reads their bytes and no more."""
    monkeypatch.setattr("valve_sim.traces.list_valves", lambda place: ("/valve",))
    return counted(monkeypatch, seconds=3.0)


def rows(output: Path) -> dict[str, Row]:
    table = pq.read_table(output / "fleet.parquet", columns=["source", "state", "error"])
    return {Path(row["source"]).name: row for row in table.to_pylist()}


def full(*ignored: Any, **options: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_disk_that_gets_full_ends_the_run_in_one_line_and_the_next_does_the_rest(
    bags: Path, tmp_path: Path, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write, output = pq.write_table, tmp_path / "out"

    def gets_full(table: Any, path: Path, **options: Any) -> None:
        if "-00003" in path.name:
            path.write_bytes(b"what was written until then")
            full()
        write(table, path, **options)

    monkeypatch.setattr(results.pq, "write_table", gets_full)
    with pytest.raises(ValveError, match="No space left on device") as refused:
        examine_fleet([str(bags)], output)
    assert str(refused.value).startswith(f"{output / PARTS}")
    assert "\n" not in str(refused.value)
    assert asked == list(BAGS)
    assert not list(tmp_path.rglob("*.partial"))
    monkeypatch.setattr(results.pq, "write_table", write)
    examine_fleet([str(bags)], output)
    assert asked == [*BAGS, BAGS[2]]
    assert {name: row["state"] for name, row in rows(output).items()} == dict.fromkeys(BAGS, EXAMINED)


def test_a_bag_that_may_not_be_read_has_a_row_that_says_so_and_is_tried_again(
    bags: Path, tmp_path: Path, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """To root every file is open, so that the refusal is that of a stand-in."""
    read = bag_files.content_hash

    def locked(bag: Bag, place: Path) -> str:
        if place.name == BAGS[1]:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(place))
        return read(bag, place)

    monkeypatch.setattr(work, "content_hash", locked)
    examine_fleet([str(bags)], tmp_path / "out")
    found = rows(tmp_path / "out")
    assert {name: row["state"] for name, row in found.items()} == {
        BAGS[0]: "examined", BAGS[1]: "lost", BAGS[2]: "examined",
    }  # fmt: skip
    words = found[BAGS[1]]["error"]
    assert words.startswith(f"{bags / BAGS[1]}: ")
    assert "Permission denied" in words
    assert "\n" not in words
    monkeypatch.setattr(work, "content_hash", read)
    examine_fleet([str(bags)], tmp_path / "out")
    assert asked == [BAGS[0], BAGS[2], BAGS[1]]
    assert {row["state"] for row in rows(tmp_path / "out").values()} == {EXAMINED}


def test_a_workers_full_disk_is_no_fault_of_the_bag(
    bags: Path, tmp_path: Path, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = fsspec.filesystem("memory")
    memory.put(str(bags / BAGS[0]), "/full-disk/one.mcap")
    try:
        monkeypatch.setattr(bag_files.shutil, "copyfileobj", full)
        examine_fleet(["memory://full-disk"], tmp_path / "out")
    finally:
        memory.rm("/full-disk", recursive=True)
    (row,) = rows(tmp_path / "out").values()
    assert row["state"] == "lost"
    assert row["error"] == "memory:///full-disk/one.mcap: OSError: [Errno 28] No space left on device"
    assert asked == []
