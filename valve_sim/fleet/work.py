"""What is done with one bag and with one valve of it, in any process.

A fault of the bag or of this program is an answer. What is raised is no fault of the bag (it cannot be fetched now, or
the memory does not suffice), and is tried again.
"""

from __future__ import annotations

import dataclasses
import re
import tempfile
import time
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.fleet.sources import Bag, SourceError, at_hand, content_hash, one_line
from valve_sim.fleet.units import EXAMINED, FAILED, UNREADABLE, Row, Survey, Unit
from valve_sim.model.errors import ValveError

REPORTS: Final = "reports"
"""Folder of the reports, below that of the table."""


class Examined(NamedTuple):
    """A row, and the files of its report by name where something was found."""

    row: Row
    report: dict[str, str]


def look(bag: Bag) -> Survey:
    """A first look at a bag: its content's hash and its valves.

    Raises:
        OSError: it cannot be fetched now.
    """
    from valve_sim.recordings import list_valves

    content, path = "", Path()
    try:
        with at_hand(bag) as path:
            content = content_hash(bag, path)
            valves = list_valves(path)
    except ValveError as error:
        return Survey(content, (), _words(bag, path, error))
    except Exception as error:
        if not content:
            raise
        return Survey(content, (), f"{bag.source}: {type(error).__name__}: {_words(bag, path, error)}")
    if not valves:
        words = "no valve in it: no topic ends with /coil_voltage or /measured/joint_states; record those two"
        return Survey(content, (), f"{bag.source}: {words}")
    return Survey(content, valves)


def examine(unit: Unit, output: Path) -> Examined:
    """Examine one valve of a bag.

    Args:
        output: the folder of the table, for the commands that reports print; nothing is written there.

    Raises:
        OSError: the bag cannot be fetched now.
        MemoryError: the memory does not suffice.
    """
    begun = time.process_time()
    with at_hand(unit.bag) as path:
        try:
            row, report = _diagnosed(unit, path, output)
        except (MemoryError, OSError):
            raise
        except Exception as error:
            row, report = _refused(unit, path, error), {}
    return Examined({**row, "seconds": time.process_time() - begun}, report)


def _refused(unit: Unit, path: Path, error: Exception) -> Row:
    from valve_sim.recordings import TraceError

    words = _words(unit.bag, path, error)
    if not isinstance(error, ValveError):  # a fault of this program must not end a run of a day
        words = f"{unit.bag.source} ({unit.valve}): {type(error).__name__}: {words}"
    return unit.row(UNREADABLE if isinstance(error, TraceError | SourceError) else FAILED, error=words)


def _diagnosed(unit: Unit, path: Path, output: Path) -> tuple[Row, dict[str, str]]:
    from valve_sim.fleet.rows import refitted, row_values, row_without_search
    from valve_sim.identification.fit.budget import Budget
    from valve_sim.identification.reporting.files import write_diagnosis
    from valve_sim.recordings import read_trace, refuse_doubtful_units

    trace = read_trace(path, unit.valve)
    refuse_doubtful_units(trace, unit.declared.parameters)
    trace = dataclasses.replace(trace, source=f"{unit.bag.source} ({unit.valve})")
    begun, followed = refitted(trace, unit.declared, Budget.of_seconds(unit.options.budget))
    if not unit.options.search:
        return unit.row(EXAMINED, **row_without_search(trace, followed)), {}
    diagnosis = begun.end(is_full=unit.options.full)
    values = row_values(trace, diagnosis, followed)
    if values["verdict"] == "none" and not values["out_of_tolerance"]:
        return unit.row(EXAMINED, **values), {}
    name = report_name(unit)
    with tempfile.TemporaryDirectory(prefix="valve-sim-fleet-") as folder:
        origin = f"Written by: valve-sim fleet\nFrom: {trace.source}"
        written = write_diagnosis(diagnosis, folder, origin, final=output / REPORTS / name)
        # What report.json says is in the row, or can be had again; thousands of them are gigabytes.
        report = {path.name: path.read_text("utf-8") for path in written if path.suffix != ".json"}
    return unit.row(EXAMINED, **values, report=f"{REPORTS}/{name}/report.html"), report


def report_name(unit: Unit) -> str:
    """Folder of a unit's report: letters, digits and dashes alone, whatever a bag or valve is called."""
    parts = (unit.valve, unit.bag.source.rstrip("/").rpartition("/")[2], unit.key[:10])
    return "-".join(filter(None, (re.sub(r"[^A-Za-z0-9]+", "-", part).strip("-")[:40] for part in parts)))


def _words(bag: Bag, path: Path, error: BaseException) -> str:
    """The error's one line; a bag that was fetched is called as it is where it came from."""
    words = one_line(error)
    return words if bag.is_local or path == Path() else words.replace(str(path), bag.source)
