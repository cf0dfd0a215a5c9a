"""What is done with one bag and with one unit, in whichever process: answers in, answers out, never an exception."""

from __future__ import annotations

import dataclasses
import re
import tempfile
import time
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.fleet.bag_files import at_hand, content_hash
from valve_sim.fleet.secrets import one_line
from valve_sim.fleet.sources import Bag
from valve_sim.fleet.units import EXAMINED, FAILED, LOST, UNREADABLE, Row, Survey, Unit
from valve_sim.model.errors import ValveError

REPORTS: Final = "reports"
"""Folder of the reports, below that of the table."""


class Surveyed(NamedTuple):
    """A bag, what a first look at it found, and the processor's seconds for that."""

    bag: Bag
    survey: Survey
    seconds: float


class Examined(NamedTuple):
    """A row, the files of its report by name where something was found, and the processor's seconds."""

    row: Row
    report: dict[str, str]
    seconds: float


def survey_bags(bags: Sequence[Bag]) -> list[Surveyed]:
    """A first look at each bag: its content's hash and its valves."""
    found = []
    for bag in bags:
        begun = time.process_time()
        found.append(Surveyed(bag, _survey(bag), time.process_time() - begun))
    return found


def _survey(bag: Bag) -> Survey:
    from valve_sim.traces import list_valves

    content, place = "", None
    try:
        with at_hand(bag) as place:
            content = content_hash(bag, place)
            valves = list_valves(place)
            if not valves:
                words = "no valve in it: no topic ends with /coil_voltage or /measured/joint_states"
                return Survey(content, (), f"{bag.source}: {words}; record those two")
            return Survey(content, valves)
    except ValveError as error:
        return Survey(content, (), _words(bag, place, error))
    except Exception as error:  # a file system, or a reader that stumbles over what is damaged
        return Survey(content, (), f"{bag.source}: {_kind(error)}{_words(bag, place, error)}", is_lost=not content)


def examine_units(units: Sequence[Unit], output: Path) -> list[Examined]:
    """Examine each unit; those of one bag follow each other, so that it is fetched once.

    Args:
        output: the folder of the table, for the commands that reports print; nothing is written there.
    """
    found: list[Examined] = []
    for bag, of_bag in groupby(units, key=lambda unit: unit.bag):
        together = list(of_bag)
        try:
            with at_hand(bag) as place:
                found += [_examined(unit, place, output) for unit in together]
        except Exception as error:  # it cannot be fetched now
            words = f"{bag.source}: {_kind(error)}{_words(bag, None, error)}"
            rest = together[len([one for one in found if one.row["source"] == bag.source]) :]
            found += [Examined(unit.row(LOST, error=words), {}, 0.0) for unit in rest]
    return found


def _examined(unit: Unit, place: Path, output: Path) -> Examined:
    begun = time.process_time()
    report: dict[str, str] = {}
    try:
        row, report = _diagnosed(unit, place, output)
    except MemoryError as error:
        row = unit.row(LOST, error=f"{unit.bag.source}: {_kind(error)}the worker's memory does not suffice")
    except ValveError as error:
        row = unit.row(UNREADABLE if _is_of_reading(error) else FAILED, error=_words(unit.bag, place, error))
    except Exception as error:  # a fault of this program must not end a run of a day
        words = f"{unit.bag.source} ({unit.valve}): {_kind(error)}{_words(unit.bag, place, error)}"
        row = unit.row(FAILED, error=words)
    seconds = time.process_time() - begun
    return Examined({**row, "seconds": seconds}, report, seconds)


def _diagnosed(unit: Unit, place: Path, output: Path) -> tuple[Row, dict[str, str]]:
    from valve_sim.fleet.rows import refitted, row_values, row_without_search
    from valve_sim.identification.estimation.budget import Budget
    from valve_sim.identification.estimation.parallel import threads_limited_to
    from valve_sim.traces import read_trace, refuse_doubtful_units

    trace = read_trace(place, unit.valve)
    refuse_doubtful_units(trace, unit.declared.parameters)
    trace = dataclasses.replace(trace, source=f"{unit.bag.source} ({unit.valve})")
    budget = Budget.of_seconds(unit.options.budget)
    with threads_limited_to(1):
        begun, followed = refitted(trace, unit.declared, budget)
        if not unit.options.search:
            return unit.row(EXAMINED, **row_without_search(trace, followed)), {}
        diagnosis = begun.end(is_full=unit.options.full)
    values = row_values(trace, diagnosis, followed)
    report: dict[str, str] = {}
    if values["verdict"] != "none" or values["out_of_tolerance"]:
        from valve_sim.identification.reporting.files import write_diagnosis

        name = report_name(unit)
        with tempfile.TemporaryDirectory(prefix="valve-sim-fleet-") as folder:
            origin = f"Written by: valve-sim fleet\nFrom: {trace.source}"
            written = write_diagnosis(diagnosis, folder, origin, final=output / REPORTS / name)
            # What report.json says is in the row, or can be had again; thousands of them are gigabytes.
            report = {path.name: path.read_text("utf-8") for path in written if path.suffix != ".json"}
        values["report"] = f"{REPORTS}/{name}/report.html"
    return unit.row(EXAMINED, **values), report


def report_name(unit: Unit) -> str:
    """Folder of a unit's report: letters, digits and dashes alone, whatever a bag or valve is called."""
    parts = (unit.valve, unit.bag.source.rstrip("/").rpartition("/")[2], unit.key[:10])
    return "-".join(filter(None, (re.sub(r"[^A-Za-z0-9]+", "-", part).strip("-")[:40] for part in parts)))


def _is_of_reading(error: ValveError) -> bool:
    from valve_sim.traces import TraceError

    return isinstance(error, TraceError)


def _kind(error: BaseException) -> str:
    return f"{type(error).__name__}: "


def _words(bag: Bag, place: Path | None, error: BaseException) -> str:
    """The error's one line; a bag that was fetched is called as it is where it came from."""
    words = one_line(error)
    return words if place is None or bag.is_local else words.replace(str(place), bag.source)
