"""Real recordings before and after their sensors' errors are part of the model: `python -m benchmarks.real_recordings`.

The servo axis of `benchmarks.emps` and the magnet of `benchmarks.maglev` are diagnosed twice: with recordings that do
not err, and with sensors and a machine that do, as data sheets and warming let expect. What is printed is the table of
docs/results/measured.md: verdicts, errors fitted and held out of the refitted declared model and of the nearest names,
and the state of the recordings beside these names; then that of each of several recordings by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from benchmarks import emps
from benchmarks.maglev.plant import MagnetPlant
from benchmarks.maglev.records import DEFAULT, read_jumps, records_in
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.recorded_errors import RecordedError, recorded_errors
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.estimation.state_of_recording import with_learned_errors
from valve_sim.identification.plants.axis import AxisPlant
from valve_sim.identification.plants.effect_titles import titles_of
from valve_sim.identification.plants.protocol import Plant, Sensor, primary_channels
from valve_sim.identification.reporting.recording_state import size_words, title_words
from valve_sim.model import ValveError

FORCE_SENSOR: Final = Sensor(320.0, low=-160.0, shares={"hum": 0.0}, is_true_at_rest=False)
"""N: the drive's force is what its amplifier was told, times a gain. Filters leave nothing of the mains. While the axis
cruises its force is steady, but friction acts, which the declared model lacks."""
FRICTION_VARIES: Final = 0.05
"""From one out-and-back to the next, as lubrication does."""
CURRENT_SENSOR: Final = Sensor(3.0, shares={"zero": 1e-3}, is_true_at_rest=False)
"""A, of the rig: its zero has been taken off by readings with 6 mA of noise. The current rises while the ball rests."""
CURRENT_VARIES: Final = 0.02
"""From jump to jump, as of a coil that is 5 K warmer."""


class Compared(NamedTuple):
    """A recording's diagnoses.

    Attributes:
        name: of the machine. before: as if nothing erred. after: with the errors of its recordings.
        names: that are nearest after. errors: of the recordings, beside these.
    """

    name: str
    before: Diagnosis
    after: Diagnosis
    names: tuple[str, ...]
    errors: tuple[RecordedError, ...]


def compared(name: str, bare: Plant, erring: Plant) -> Compared:
    """A machine diagnosed without and with the errors of its recordings."""
    before, after = diagnose_plant(bare, None), diagnose_plant(erring, None)
    names = after.verdict.effects
    return Compared(name, before, after, names, beside(after, names))


def beside(diagnosis: Diagnosis, names: Sequence[str]) -> tuple[RecordedError, ...]:
    """The errors of all strokes of a diagnosed plant's recordings, learned beside some names."""
    plant = diagnosis.plant
    free = [*plant.base, *(own for name in names for own in plant.effects[name].free_names())]
    candidate = next((one for one in diagnosis.candidates if set(one.effects) == set(names)), None)
    start = {} if candidate is None else {name: own.value for name, own in candidate.intervals.items()}

    def fitted(problem: Problem, begun: Fit | None) -> Fit:
        return fit(problem, free, start if begun is None else begun.values, nuisances=problem.nuisances)

    return recorded_errors(with_learned_errors(Problem(plant), fitted)[1])


def table(machines: Sequence[Compared]) -> list[str]:
    """The lines of the one table in Markdown: two columns for each machine."""
    pairs = [(own.before, own.after) for own in machines]
    heads = [f"{own.name}, {when}" for own in machines for when in ("before", "after")]
    diagnoses = [diagnosis for pair in pairs for diagnosis in pair]
    lines = [_row("", heads), "|---" * (1 + len(heads)) + "|"]
    lines += [
        _row(
            "verdict; nearest names", [f"`{own.verdict.kind}`; {titles_of(own.verdict.effects)}" for own in diagnoses]
        ),
        _row("probability of something unnamed", [f"{own.verdict.unnamed:.3f}" for own in diagnoses]),
        _row("declared model, fitted / held out", [_errors(own, ()) for own in diagnoses]),
        _row("nearest names, fitted / held out", [_errors(own, own.verdict.effects) for own in diagnoses]),
        _row(
            "share of the squared error that they explain", [f"{100.0 * own.verdict.share:.1f} %" for own in diagnoses]
        ),
    ]
    kinds = [_by_title(own.errors) for own in machines]
    for title in dict.fromkeys(title for own in kinds for title in own):
        cells = [cell for own in kinds for cell in ("", _together(own.get(title, [])))]
        lines.append(_row(title, cells))
    return lines


def each(found: Compared) -> list[str]:
    """The lines of a table of the errors of each recording of a machine."""
    kinds = _by_title(found.errors)
    lines = [_row(f"{found.name}: jump", list(kinds)), "|---" * (1 + len(kinds)) + "|"]
    for number in sorted({entry.recording for entry in found.errors}):
        own = [[entry for entry in entries if entry.recording == number] for entries in kinds.values()]
        lines.append(_row(f"{number + 1}", [_together(entries) for entries in own]))
    return lines


def _by_title(errors: Sequence[RecordedError]) -> dict[str, list[RecordedError]]:
    kinds: dict[str, list[RecordedError]] = {}
    for entry in errors:
        kinds.setdefault(title_words(entry), []).append(entry)
    return kinds


def _together(entries: Sequence[RecordedError]) -> str:
    """The size with its standard error, and the probability; of several the least, the largest, how many are likely."""
    if len(entries) < 2:
        return "; ".join(f"{size_words(own)} ({own.probability:.2f})" for own in entries)
    ordered = sorted(entries, key=lambda own: own.size)
    likely = sum(own.is_likely for own in entries)
    return f"{size_words(ordered[0])} to {size_words(ordered[-1])}; likely in {likely} of {len(entries)}"


def _errors(diagnosis: Diagnosis, names: Sequence[str]) -> str:
    """Fitted and held out, of the refitted declared model or of names, in a readable unit."""
    factor, unit = diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]].readable
    of_names = [(set(one.effects), one.train_rmse, one.holdout_rmse) for one in diagnosis.candidates]
    before = set[str](), diagnosis.before.train_rmse, diagnosis.before.holdout_rmse
    fitted, held_out = next(errors for own, *errors in (before, *of_names) if own == set(names))
    return f"{factor * fitted:.2f} / {factor * held_out:.2f} {unit}"


def _row(title: str, cells: Sequence[str]) -> str:
    return f"| {title} | " + " | ".join(cells) + " |"


def plants() -> Mapping[str, tuple[Plant, Plant]]:
    """Of each machine that was recorded by others, the plant without and with errors of its recordings.

    Raises:
        ValveError: the data are not there.
    """
    record, jumps = emps.read_emps(emps.DEFAULT), read_jumps(records_in(DEFAULT, "force"))
    return {
        "servo axis (EMPS)": (
            AxisPlant(record),
            AxisPlant(record, sensor=FORCE_SENSOR, variation=FRICTION_VARIES),
        ),
        "magnet": (MagnetPlant(jumps), MagnetPlant(jumps, CURRENT_SENSOR, CURRENT_VARIES)),
    }


def main() -> int:
    """Print the tables; 2 where the data are missing."""
    try:
        found = [compared(name, bare, erring) for name, (bare, erring) in plants().items()]
    except ValveError as error:
        print(error, file=sys.stderr)
        return 2
    print("\n".join([*table(found), "", *each(found[-1])]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
