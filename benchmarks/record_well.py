"""What each mistake of a laboratory costs: `python -m benchmarks.record_well`.

Records a healthy valve eight times at 7.5 to 14 V with one imperfection each, by the independent plant of test/plants,
diagnoses it, and prints how large a dry friction and a constant force would have to be to be named in half of such
recordings, beside what a clean recording would name. `--picture FILE` draws what each imperfection looks like.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
from plants.laboratory import Laboratory, measure
from plants.recording import Recording, holdout_profile, train_profile
from plants.tolerances import SHEET_VALVE, declared_tolerances

from benchmarks.campaign.cases import declared_valve
from benchmarks.campaign.running import as_trace
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose

MISTAKES: Final[dict[str, Laboratory]] = {
    "nothing": Laboratory(),
    "five times the noise": Laboratory(position_noise=5e-6),
    "2 kHz in place of 20 kHz": Laboratory(sample_rate=2e3),
    "steps of 5 µm": Laboratory(quantisation=5e-6),
    "a sensor that drifts by 15 µm a stroke": Laboratory(drift=15e-6),
    "3 µm of hum": Laboratory(hum=3e-6),
    "a mount that rings, 6 µm at 400 Hz": Laboratory(ringing=6e-6, ringing_frequency=400.0, ringing_damping=0.3),
    "a tilted sensor, bent by 3 µm": Laboratory(bend=3e-6),
    "a supply of 0.5 Ω": Laboratory(supply_resistance=0.5),
    "stamps that scatter by 300 µs": Laboratory(command_jitter=300e-6),
    "a dry valve, friction varies by 15 %": Laboratory(stroke_variation=0.15),
}
"""One mistake each, beside 1 µm of white noise at 20 kHz."""


def diagnosed(laboratory: Laboratory, seed: int) -> tuple[Diagnosis, Recording]:
    """The diagnosis of a healthy valve in a laboratory, and what was fitted."""
    recordings = [
        measure(SHEET_VALVE, {}, profile, laboratory, seed + number)
        for number, profile in enumerate((train_profile(), holdout_profile()))
    ]
    traces = [as_trace(recording, f"bag {number}") for number, recording in enumerate(recordings)]
    declared = declared_valve(SHEET_VALVE, declared_tolerances(SHEET_VALVE))
    return diagnose(traces[:1], traces[1:], declared), recordings[0]


def price(diagnosis: Diagnosis) -> str:
    """The limits of a dry friction and of a constant force, mN; or the verdict where something is claimed."""
    if diagnosis.verdict.kind != "none":
        return diagnosis.verdict.kind
    limits = diagnosis.detection_limits
    return " ".join(f"{1e3 * limits[name]['force']:>10.1f}" for name in ("coulomb_friction", "constant_force"))


def draw(recordings: dict[str, Recording], path: Path) -> None:
    """Half a stroke of each recording, less what the same valve shows in a clean one without noise."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 9.0), layout="constrained")
    clean = measure(SHEET_VALVE, {}, train_profile(), Laboratory(position_noise=0.0), 0)
    panels = figure.subplots(4, 3).ravel().tolist()
    for axes in panels[len(recordings) :]:
        axes.set_visible(False)
    for axes, (words, recording) in zip(panels, recordings.items(), strict=False):
        shown = np.interp(recording.times, clean.times, clean.pilot_position)
        own = (recording.times > 0.005) & (recording.times < 0.075)
        axes.plot(1e3 * recording.times[own], 1e6 * (recording.pilot_position - shown)[own], linewidth=0.6)
        axes.set_title(words, fontsize=9)
        axes.set_xlabel("time, ms", fontsize=8)
        axes.set_ylabel("recorded less true, µm", fontsize=8)
        axes.set_ylim(-20.0, 20.0)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=90)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seed", type=int, default=1, help="of the recordings (default: 1)")
    parser.add_argument("--picture", type=Path, metavar="FILE", help="draw what each mistake looks like")
    options = parser.parse_args(arguments)
    print(f"{'mistake':<44}{'friction':>10} {'force':>10}  mN that would be named")
    recordings = {}
    for words, laboratory in MISTAKES.items():
        diagnosis, recordings[words] = diagnosed(replace(laboratory), options.seed)
        print(f"{words:<44}{price(diagnosis)}", flush=True)
    if options.picture is not None:
        draw(recordings, options.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
