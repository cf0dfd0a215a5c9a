"""Ten years of three valves in the archive: its size, and how long it takes to ask for a day, a month and all.

    python -m benchmarks.archive_years --folder /tmp/years

A month of one valve is written as archive_node does it, each minute of virtual time what has come in it, with a stroke
each 36 s whose figures have the scatter of a sensor. Nothing is flushed to the disk (`--durable` does that). The month
is then repeated for all months and valves with its times shifted: a month of a valve is a folder of its own, so it
costs the same.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from benchmarks.common import parser
from valve_sim.records.archive import Archive
from valve_sim.records.story import tell

VALVES = ("/tank_1/valve", "/tank_2/valve", "/tank_3/valve")
START = datetime(2026, 1, 1, tzinfo=timezone.utc)
FIGURES = {
    "opening_delay": (3.1e-3, 2e-6), "t1": (5.3e-3, 2e-6), "t1_stderr": (2e-6, 1e-7), "t2": (9.9e-3, 3e-6),
    "t2_stderr": (3e-6, 1e-7), "closing_time": (8.1e-3, 3e-6), "closing_time_stderr": (3e-6, 1e-7),
    "pilot_damping": (1.0, 5e-3), "pilot_damping_stderr": (5e-3, 1e-4), "main_damping": (4.0, 1e-2),
    "main_damping_stderr": (1e-2, 1e-4), "residual": (1e-6, 1e-8), "score": (2.0, 1.0), "volts": (9.0, 1e-2),
}  # fmt: skip
"""Value and scatter of each figure of a stroke, SI."""
EFFECTS = ("coulomb_friction", "stiction", "drag", "coil_resistance")


def stroke(number: int, random: np.random.Generator) -> dict[str, object]:
    """The row of a stroke."""
    scatter = random.standard_normal(len(FIGURES))
    values = {name: mean + spread * by for (name, (mean, spread)), by in zip(FIGURES.items(), scatter, strict=True)}
    return {"number": number, "threshold": 9.2, "cause": EFFECTS[number % 4], "state": "watching", **values}


def write_month(folder: Path, every: float) -> int:
    """A month of the first valve, as archive_node writes it; how many strokes."""
    archive, random, number = Archive(folder), np.random.default_rng(1), 0
    end, due, due_stroke = timedelta(days=31).total_seconds(), 60.0, 0.0
    while due_stroke < end:
        while due_stroke < min(due, end):
            archive.add("strokes", VALVES[0], START + timedelta(seconds=due_stroke), stroke(number, random), due_stroke)
            number, due_stroke = number + 1, due_stroke + every
        archive.flush()
        due += 60.0
    row = {"level": 1, "alarm_class": "health", "message": "the strokes since number 7 are not those of the valve"}
    archive.add("alarms", VALVES[0], START + timedelta(days=3), row, 0.0)
    archive.flush()
    return number


def repeat(folder: Path, years: int) -> None:
    """The month again for every month of all years and every valve, at the times of each."""
    months = [(START.year + index // 12, 1 + index % 12) for index in range(12 * years)]
    sources = list(folder.glob("*/valve=*/month=*/*.parquet"))
    tables = [(path, pq.read_table(path, partitioning=None)) for path in sources]
    for valve in VALVES:
        for year, month in months:
            shift = datetime(year, month, 1, tzinfo=timezone.utc) - START
            for path, table in tables:
                kind = path.parts[-4]
                target = folder / kind / f"valve={valve.replace('/', '%2F')}" / f"month={year}-{month:02d}" / path.name
                if target.exists():
                    continue
                target.parent.mkdir(parents=True, exist_ok=True)
                pq.write_table(_shifted(table, shift), target, compression="zstd", compression_level=9)


def _shifted(table: Any, shift: timedelta) -> Any:
    times = pc.add(table.column("time"), pa.scalar(shift, pa.duration("us")))
    return table.set_column(0, table.schema.field("time"), times)


@contextlib.contextmanager
def timed(words: str) -> Iterator[None]:
    """Print how long what is done inside took."""
    wall, cpu = time.monotonic(), time.process_time()
    yield
    print(f"{words}: {time.monotonic() - wall:.2f} s, {time.process_time() - cpu:.2f} s of a core")


def main() -> None:
    """Write, repeat, ask."""
    known = parser("archive_years", __doc__)
    known.add_argument("--folder", type=Path, default=None)
    known.add_argument("--years", type=int, default=10)
    known.add_argument("--every", type=float, default=36.0, help="s between strokes")
    known.add_argument("--durable", action="store_true", help="flush to the disk, as the node does")
    given = known.parse_args()
    with tempfile.TemporaryDirectory() as made:
        folder = given.folder or Path(made)
        flush = contextlib.nullcontext() if given.durable else mock.patch.object(os, "fsync", lambda number: None)
        with flush, timed("a month of a valve, written each minute"):
            strokes = write_month(folder, given.every)
        size = Archive(folder).size()
        print(f"{strokes} strokes, {size / 1e6:.2f} MB, {size / strokes:.1f} bytes each")
        with timed("repeated"):
            repeat(folder, given.years)
        archive = Archive(folder, years=given.years + 1.0)
        files = len(list(folder.rglob("*.parquet")))
        print(f"{given.years} years of {len(VALVES)} valves: {archive.size() / 1e9:.3f} GB in {files} files")
        last = START.replace(year=START.year + given.years - 1, month=6)
        with timed("a day of strokes"):
            count = len(archive.read("strokes", VALVES[1], last, last + timedelta(days=1)))
        print(f"  {count} strokes")
        with timed("alarms of all years"):
            count = len(archive.read("alarms", VALVES[1]))
        print(f"  {count} alarms")
        with timed("history of a month, with its medians"):
            tell(archive, VALVES[1], last, last + timedelta(days=30))
        with timed("number of strokes of all years"):
            count = archive.count("strokes", VALVES[1])
        print(f"  {count} strokes")
        with timed("prune, with nothing to take out"):
            archive.prune()


if __name__ == "__main__":
    main()
