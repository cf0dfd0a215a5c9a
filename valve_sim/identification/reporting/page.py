"""A document as one page without network: its plots are drawn by a script that it carries along."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from jinja2 import Environment, PackageLoader

from valve_sim.files.json_text import finite_or_none
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.reporting.document import Array, Document, OnScale, Plots, Spark, Table

STEPS: Final = 1e-5
"""Of their range, to which numbers of a plot are rounded."""
LONGEST_VALUE: Final = 40
"""Characters of a cell that may stand at the right."""
WIDTH, HEIGHT = 120.0, 28.0
"""Of a small picture, px."""


def write_page(document: Document, path: Path | str) -> None:
    """Write a document as HTML, whole or not at all.

    Raises:
        ValveError: it cannot be written.
    """
    environment = Environment(
        loader=PackageLoader("valve_sim.identification.reporting"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    data: list[Any] = []

    def place(plots: Plots) -> list[tuple[int, Any]]:
        """The plots of a block with their numbers in the page's data."""
        made, first = list(plots.make()), len(data)
        data.extend(_plot_json(plot) for plot in made)
        return [(first + number, plot) for number, plot in enumerate(made)]

    environment.filters |= {
        "kind": lambda block: type(block).__name__,
        "points": points,
        "percent": _percent,
        "columns_of_words": _columns_of_words,
    }
    environment.globals |= {"place": place}
    write_whole(Path(path), environment.get_template("page.html.j2").render(document=document, data=data))


def _plot_json(plot: Any) -> dict[str, Any]:
    return {
        "x": rounded(plot.x),
        "name": plot.x_label,
        "panels": [
            {
                "label": panel.label,
                "zero": panel.has_zero,
                "curves": [{"name": own.name, "y": rounded(own.y), "dots": own.has_dots} for own in panel.curves],
                **({} if panel.low is None else {"low": rounded(panel.low), "high": rounded(panel.high)}),
            }
            for panel in plot.panels
        ],
    }


def rounded(values: Array) -> list[float | None]:
    """Values to a small part of their range, to keep a page small; None for what is not finite."""
    finite = values[np.isfinite(values)]
    size = float(np.ptp(finite) or np.max(np.abs(finite))) if len(finite) else 0.0
    digits = 0 if size == 0.0 else -math.floor(math.log10(STEPS * size))
    return [finite_or_none(value) for value in np.round(values, digits).tolist()]


def points(spark: Spark) -> str:
    """The points of an SVG polyline; empty where there is nothing to show."""
    at, shown = spark.at, spark.shown
    if len(at) < 2 or not np.all(np.isfinite(shown)) or not (np.ptp(shown) > 0.0 and at[-1] > at[0]):
        return ""
    across, down = WIDTH * (at - at[0]) / (at[-1] - at[0]), HEIGHT * (np.max(shown) - shown) / np.ptp(shown)
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across.tolist(), down.tolist(), strict=True))


def _percent(value: float, place: OnScale) -> str:
    """A place on a scale, in percent of its width."""
    return f"{50.0 + 50.0 * min(max(value / place.reach, -1.0), 1.0):.2f}%"


def _columns_of_words(table: Table) -> set[int]:
    """Columns after the first that have sentences, not values."""
    told = ((at, cell) for row in table.rows for at, cell in enumerate(row.cells) if isinstance(cell, str))
    return {at for at, cell in told if at and len(cell) > LONGEST_VALUE}
