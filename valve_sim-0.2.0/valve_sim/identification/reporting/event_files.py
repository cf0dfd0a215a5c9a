"""The files that a diagnosis of an event table writes: report.json, valve.yaml and the pictures."""

from __future__ import annotations

import re
from pathlib import Path

from valve_sim.files.json_text import json_text
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.events import (
    COVARIANCE_DIGITS,
    ROUNDED,
    EventDiagnosis,
    declared_counterparts,
)
from valve_sim.identification.reporting.event_figures import plot_event_diagnosis
from valve_sim.identification.reporting.event_report import event_json
from valve_sim.model import ParameterError
from valve_sim.model.tolerances import COVARIANCE_NAME


def write_event_report(result: EventDiagnosis, folder: Path) -> tuple[Path, ...]:
    """Write report.json, valve.yaml and the pictures.

    Returns:
        what was written.

    Raises:
        ValveError: a file cannot be written.
    """
    report, valve = folder / "report.json", folder / "valve.yaml"
    write_whole(report, json_text(event_json(result)))
    write_valve(valve, result)
    return report, valve, *plot_event_diagnosis(folder, result)


def write_valve(path: Path, result: EventDiagnosis) -> None:
    """Write the declared valve's file anew, with the shipped values in place: comments and all else as they were.

    Raises:
        ParameterError: the file cannot be written, or the declared file has not one line for a value.
    """
    text = result.table.valve_file.read_text(encoding="utf-8")
    body = text[text.index("/**:") :]
    values = result.valve.declared()
    folded = declared_counterparts()
    for name in result.shipped.values:
        key, scalar = folded[name]
        value = f"{values[scalar]:.{ROUNDED}g}"
        body = _replaced(body, key, value, result.table.source, str(result.table.valve_file))
    if not result.valve.tolerances.is_exact:
        body = _with_tolerances(body, result)
    write_whole(path, _header(result) + body)


def _with_tolerances(body: str, result: EventDiagnosis) -> str:
    """The tolerances of the values in place, below `tolerances:` on a line of its own."""
    source = str(result.table.valve_file)
    match = re.search(r"^ *tolerances:", body, re.MULTILINE)
    if match is None:
        raise ParameterError(f"{source}: tolerances: found no line of its own, expected 'tolerances:'")
    before, below = body[: match.start()], body[match.start() :]
    tolerances, folded = result.valve.tolerances, declared_counterparts()
    for name in result.shipped.values:
        scalar = folded[name][1]
        if scalar != "a0":
            below = _replaced(below, scalar, f"{tolerances.declared[scalar]:g}", result.table.source, source)
        elif tolerances.attraction_covariance is not None:
            variance = f"{tolerances.attraction_covariance[0][0]:.{COVARIANCE_DIGITS}g}"
            below = _replaced(below, COVARIANCE_NAME, variance, result.table.source, source)
    return before + below


def _replaced(body: str, key: str, value: str, table: str, source: str) -> str:
    """A parameter file with the first number of one line replaced, and a comment that says from which table it is."""
    match = re.search(rf"^( *{key}: \[?)([^,\s\]]+)([^\n#]*?) *(?:(# \S+)[^\n]*)?$", body, re.MULTILINE)
    if match is None:
        raise ParameterError(f"{source}: valve.{key}: found no line of its own, expected '{key}: value'")
    before, old, rest, unit = match.groups()
    words = f"calibrated to {Path(table).name}; {Path(source).name} has {old}"
    mark = "# a0" if rest else f"{unit or '#'}     "
    return f"{body[: match.start()]}{before}{value}{rest}  {mark} {words}{body[match.end() :]}"


def _header(result: EventDiagnosis) -> str:
    """How the file was made, as comments."""
    table = result.table
    times = ", ".join(
        f"{event.name} = {1e3 * time:.4f} ms (measured {1e3 * event.time:g})"
        for event, time in zip(table.events, result.shipped.times, strict=True)
    )
    shipped = ", ".join(f"{name} = {value:.{ROUNDED}g}" for name, value in result.shipped.values.items())
    return "".join(
        f"# {line}".rstrip() + "\n"
        for line in (
            f"The default valve: {table.valve_file.name}, with two values calibrated to the event times in",
            f"{Path(table.source).name} and all others kept. Written by",
            f"    valve-sim diagnose --events config/{Path(table.source).name} --output DIR",
            "as DIR/valve.yaml; running it again gives this file. Do not edit it by hand.",
            "",
            'Source of every published number: Choi, Ahn and Kim, "Modeling the Dynamic Behavior of a Pilot-Operated',
            'Solenoid Valve for an Ultra-High Pressure Vessel", Appl. Sci. 2021, 11, 2329, converted to SI.',
            "",
            "As printed, that valve never opens: its attraction polynomial is 0 at x = 0. Calibrated, in SI units:",
            f"    {shipped}",
            f"(added to a0 and to the coil's lag), which gives, at {table.voltage:g} V from rest,",
            f"    {times}.",
            "Two event times leave no freedom to check the damping: it is the paper's, and not confirmed.",
            "docs/theory/paper.md says what else would fit.",
        )
    )
