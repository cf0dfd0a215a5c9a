"""The files that a diagnosis leaves behind: report.json, report.html, report.png.

Of a valve also corrected.yaml, and record_next.yaml where there is something to tell apart.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Final

from valve_sim.files.json_text import json_text
from valve_sim.files.parameter_files import save_valve
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.diagnosis_json import to_json
from valve_sim.identification.reporting.html import plot_diagnosis, write_report
from valve_sim.identification.reporting.recording_profile import write_record_next

FILES: Final = ("report.json", "report.html", "report.png", "corrected.yaml")
"""Of a valve, in the order in which they are written; record_next.yaml follows where there is something to tell."""


def write_diagnosis(diagnosis: Diagnosis, directory: Path | str, provenance: str) -> tuple[Path, ...]:
    """Write what a diagnosis found, each file whole or not at all.

    Args:
        diagnosis: of any plant; only a valve has a corrected.yaml and a record_next.yaml.
        directory: made where it is missing.
        provenance: how the diagnosis was made; goes into report.html and corrected.yaml.

    Returns:
        the files, report.json first.

    Raises:
        ValveError: a file cannot be written.
    """
    folder = Path(directory)
    data, page, picture, corrected = (folder / name for name in FILES)
    write_whole(data, json_text(to_json(diagnosis)))
    write_report(diagnosis, page, provenance)
    plot_diagnosis(diagnosis, picture)
    if not isinstance(diagnosis.plant, ValvePlant):
        return data, page, picture
    save_valve(corrected, diagnosis.valve, provenance)
    profile = write_record_next(folder, diagnosis, provenance)
    return (data, page, picture, corrected) if profile is None else (data, page, picture, corrected, profile)


def load_drawing() -> None:
    """Load what draws the pictures, half of what they cost: before a budget begins that must hold them."""
    importlib.import_module("valve_sim.identification.reporting.figures")
    importlib.import_module("matplotlib.backends.backend_agg")
