"""`python -m benchmarks.posterior_figure REPORT.json PNG`: evidence and posterior of the sets that a diagnosis tried.

Makes docs/images/posterior.png of the report of `valve-sim diagnose bags/friction` and prints the table beside it in
docs/theory/selection.md.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt

SHOWN: Final = 8
"""Sets of the highest probability that are shown, and all single effects."""
LEAST: Final = 1e-5
"""Probability at which the axis ends."""


def main(report_path: str, image: str) -> int:
    """Print the table and draw the figure."""
    report = json.loads(Path(report_path).read_text(encoding="utf-8"))
    shown = [
        candidate
        for place, candidate in enumerate(report["candidates"])
        if place < SHOWN or len(candidate["effects"]) == 1
    ]
    for candidate in shown:
        gained = -0.5 * candidate["delta_bic"]
        print(f"| {' + '.join(candidate['effects'])} | {gained:.2f} | {candidate['probability']:.3g} |")
    print(f"unnamed {report['verdict']['unnamed']:.2g}, claim {report['verdict']['probability']:.4f}")
    draw(shown, report["verdict"], Path(image))
    return 0


def draw(shown: list[dict[str, Any]], verdict: dict[str, Any], image: Path) -> None:
    """Two panels with one row for each set: ln of the evidence gained, and the posterior probability."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), sharey=True, layout="constrained")
    names = [" + ".join(candidate["effects"]) for candidate in shown]
    class_names = {*verdict["effects"], *(other for own in verdict["confusable_with"].values() for other in own)}
    colours = ["tab:blue" if class_names & set(candidate["effects"]) else "tab:gray" for candidate in shown]
    left.barh(names, [-0.5 * candidate["delta_bic"] for candidate in shown], color=colours)
    left.set(xlabel="ln of the evidence gained")
    right.barh(names, [candidate["probability"] for candidate in shown], color=colours, left=LEAST / 10.0)
    right.set(xlabel="posterior probability", xscale="log", xlim=(LEAST, 1.5))
    left.invert_yaxis()
    figure.savefig(image, dpi=110)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
