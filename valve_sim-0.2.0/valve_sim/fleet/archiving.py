"""What a fleet found in its bags, kept in the archive that monitors share: one row for each bag and valve, once."""

from __future__ import annotations

import time
from collections.abc import Iterable
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

from valve_sim.fleet.units import EXAMINED, Row
from valve_sim.records.archive import COLUMNS, Archive

_SECOND: Final = 1e9
"""ns."""


def archive_rows(folder: Path, rows: Iterable[Row]) -> int:
    """Keep the rows of examined bags that an archive has not yet, each at its bag's first stamp.

    Args:
        folder: of the archive. rows: of the fleet's table; what was not examined is passed over.

    Returns:
        how many are new in the archive.

    Raises:
        ValveError: the archive cannot be read or written; what is missing is written by the next run.
    """
    archive, known, count = Archive(folder), dict[str, set[str]](), 0
    for row in rows:
        if row["state"] != EXAMINED or row.get("start_time") is None:
            continue
        valve = row["valve"]
        if valve not in known:
            known[valve] = {kept["key"] for kept in archive.read("recordings", valve)}
        if row["key"] in known[valve]:
            continue
        values = {name: row.get(name) for name in COLUMNS["recordings"]}
        values["effects"] = ", ".join(row.get("effects") or ())
        start = datetime.fromtimestamp(row["start_time"] / _SECOND, timezone.utc)
        archive.add("recordings", valve, start, values, time.monotonic())
        count += 1
    archive.flush()
    return count
