"""The files that an identification and a diagnosis leave behind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from valve_sim.files.json_text import json_text
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.identify import Identification
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.fit.declared_values import estimate_of
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.identification_document import identification_document
from valve_sim.identification.reporting.page import write_page
from valve_sim.identification.reporting.record_next import write_record_next

IDENTIFIED: Final = ("identify.json", "identified.yaml")
"""What `write_identification` writes."""
FILES: Final = ("report.json", "report.html", "corrected.yaml")
"""Of a valve, in the order in which they are written; record_next.yaml follows where there is something to tell."""


def write_identification(
    result: Identification, directory: Path | str, provenance: str, *, report: Mapping[str, Any] | None = None
) -> tuple[Path, ...]:
    """Write the report and the refitted machine, each file whole or not at all.

    Args:
        result: of any machine. directory: made where it is missing.
        provenance: where the values are from; the refitted values are added to it.
        report: its JSON, if that is known.

    Returns:
        the files.

    Raises:
        ValveError: a file cannot be written.
    """
    data, machine = (Path(directory) / name for name in IDENTIFIED)
    write_whole(data, json_text(report or identification_document(result).to_json()))
    values = [f"{name}: {interval.value:.6g} ± {interval.stderr:.2g}" for name, interval in result.intervals.items()]
    origin = f"{provenance}\nidentified: {', '.join(values)}"
    effects = tuple(dict.fromkeys(name.partition(".")[0] for name in result.intervals if "." in name))
    is_written = result.plant.save_corrected(machine, estimate_of(result.fit), effects, origin)
    return (data, machine) if is_written else (data,)


def write_diagnosis(
    diagnosis: Diagnosis,
    directory: Path | str,
    provenance: str,
    picture: Path | None = None,
    final: Path | None = None,
    *,
    report: Mapping[str, Any] | None = None,
    options: str = "",
) -> tuple[Path, ...]:
    """Write a diagnosis, each file whole or not at all.

    Args:
        diagnosis: of any plant; only a valve has a record_next.yaml.
        directory: made where it is missing.
        provenance: how the diagnosis was made; goes into report.html and corrected.yaml.
        picture: where to draw the page's plots, too; default nowhere.
        final: the folder that the files will be moved to, for the commands that the page prints; default `directory`.
        report: its JSON, if that is known; it may take many simulations.
        options: of commands that the files print: the machine and the map, as "--params my_valve.yaml --map map.yaml".

    Returns:
        the files, report.json first.

    Raises:
        ValveError: a file cannot be written.
    """
    folder = Path(directory)
    data, page, corrected = (folder / name for name in FILES)
    document = diagnosis_document(diagnosis, final or folder, options, provenance)
    write_whole(data, json_text(report or document.to_json()))
    write_page(document, page)
    written = [data, page]
    effects = diagnosis.verdict.effects if diagnosis.verdict.is_corrected else ()
    if diagnosis.plant.save_corrected(corrected, estimate_of(diagnosis.after.fit), effects, provenance):
        written.append(corrected)
    if (profile := write_record_next(folder, diagnosis, provenance, options)) is not None:
        written.append(profile)
    if picture is not None:
        from valve_sim.identification.reporting.figures import draw_diagnosis, save_figure

        save_figure(draw_diagnosis(diagnosis), picture)
        written.append(picture)
    return tuple(written)
