"""`python -m benchmarks.record_well_figure PNG`: what each mistake of a laboratory does to a recording.

Makes docs/images/record_well.png: one healthy valve, recorded with each mistake of docs/how_to/record_well.md in turn,
less the motion that the same valve has at the commands as they were stamped. What remains is what a fit has to explain.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.figure import Figure
from plants.laboratory import Laboratory, measure
from plants.recording import Profile

from benchmarks.campaign.cases import MISTAKES, draw_case

SHOWN: Final = (0.0, 0.08)
"""s: the first opening and closing, and the beginning of the second."""
RANGE: Final = 20.0
"""µm, either way; beyond it a curve leaves its panel."""
COLUMNS: Final = 3


def main(image: str) -> int:
    """Draw the figure."""
    rows = -(-len(MISTAKES) // COLUMNS)
    figure = Figure(figsize=(9.0, 1.7 * rows), layout="constrained")
    panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True).ravel()
    for panel, (seed, words) in zip(panels, enumerate(MISTAKES), strict=False):
        case = draw_case("mistake", seed)
        recording = case.recordings()[0]
        stamps = recording.command_times - case.clock_offsets[0]  # a common offset is in every recording
        stamped = Profile(stamps, recording.volts, float(recording.times[-1]) + 1e-3)
        rate = case.laboratory_of(0).sample_rate
        healthy = measure(case.true_values, {}, stamped, Laboratory(sample_rate=rate), seed).truth.pilot_position
        begin, end = np.searchsorted(recording.times, SHOWN)
        left = recording.pilot_position[begin:end] - healthy[begin:end]
        panel.plot(1e3 * recording.times[begin:end], 1e6 * left, linewidth=0.6, color="#0b6fa4")
        panel.set_title(words.replace("nothing", "no mistake"), fontsize=9)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].set(xlim=tuple(1e3 * end for end in SHOWN), ylim=(-RANGE, RANGE))
    for panel in panels[len(MISTAKES) :]:
        panel.set_visible(False)
    figure.supxlabel("time, ms", fontsize=9)
    figure.supylabel("recorded less expected position, µm", fontsize=9)
    figure.savefig(image, dpi=110)
    return 0


if __name__ == "__main__":
    sys.exit(main(str(Path(sys.argv[1]))))
