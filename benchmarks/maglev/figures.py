"""The picture: a jump, measured and modelled, what is left of it, and the pull where balls lift."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.maglev.plant import MagnetPlant
from benchmarks.maglev.report import FROM, TO, Findings, around_jump
from valve_sim.identification.reporting.figures import MAIN, PILOT, QUIET, SECOND, save_figure


def plot(path: Path, found: Findings) -> None:
    """Draw the middle one of the records, before and after correction, and the check of the force.

    Raises:
        ValveError: the picture cannot be written.
    """
    figure = Figure(figsize=(10.0, 6.0), layout="constrained")
    panels = figure.subplots(2, 2, height_ratios=(3, 2), width_ratios=(3, 2))
    above, below, pulls = panels[0, 0], panels[1, 0], panels[0, 1]
    panels[1, 1].set_axis_off()
    records = found.others or found.records
    record = records[len(records) // 2]
    plant = MagnetPlant([record])
    (channel,) = plant.channels
    judged = around_jump(record, channel.times)
    begins = channel.times[0] if record.jump is None else record.times[record.jump]
    times = 1e3 * (channel.times - begins)[judged]
    above.plot(times, channel.data[judged], "o", color=QUIET, markersize=3.5, label="measured")
    for rung, colour, label in zip(
        (found.rungs[0], found.rungs[-1]), (MAIN, PILOT), ("constant inductance", "corrected"), strict=True
    ):
        (shown,) = plant.predict(rung.values)
        above.plot(times, shown[judged], color=colour, linewidth=1.6, label=label)
        below.plot(times, 1e3 * (channel.data - shown)[judged], color=colour, linewidth=1.2)
    above.set_ylabel("current, A")
    above.legend(loc="lower right", frameon=False)
    below.axhline(0.0, color=QUIET, linewidth=0.8)
    below.set_ylabel("measured − model, mA")
    below.set_xlabel("after the jump, ms" if record.jump is not None else "time, ms")
    for (name, pull), colour in zip(found.pulls.items(), (PILOT, SECOND), strict=True):
        pulls.plot([1e3 * lift.distance for lift in found.lifts], pull.shares, "o", color=colour, label=name)
    pulls.axhline(1.0, color=QUIET, linewidth=0.8)
    pulls.set_ylim(bottom=0.0)
    pulls.set_xlabel("distance where the ball lifts, mm")
    pulls.set_ylabel("pull over weight")
    pulls.legend(loc="lower right", frameon=False)
    for axes in (above, below, pulls):
        axes.spines[["top", "right"]].set_visible(False)
    median = next(iter(found.pulls.values())).median
    figure.suptitle(f"{record.source}: {1e3 * FROM:+.0f} to {1e3 * TO:+.0f} ms; pull over weight {median:.2f} (median)")
    save_figure(figure, path)
