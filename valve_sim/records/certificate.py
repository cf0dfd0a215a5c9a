"""A calibration record as a page that is printed, signed and filed: one HTML file without network."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, PackageLoader

from valve_sim.files.whole_files import write_whole
from valve_sim.records.calibration import Change, Record


def certificate(record: Record, changes: tuple[Change, ...] = ()) -> str:
    """The page, in HTML, for A4 and Letter."""
    environment = Environment(
        loader=PackageLoader("valve_sim.records"), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["number"] = _number
    return environment.get_template("certificate.html.j2").render(record=record, changes=changes)


def write_certificate(path: Path, record: Record, changes: tuple[Change, ...] = ()) -> None:
    """Write the page, whole or not at all.

    Raises:
        ValveError: it cannot be written.
    """
    write_whole(path, certificate(record, changes), durable=True)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.5g}".replace("-", "−")
