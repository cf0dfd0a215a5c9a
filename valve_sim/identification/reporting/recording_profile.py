"""The recommended recording as a profile of commands, which `simulate --profile` and `command_profile` take."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Final

from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.plants.valve import HIGHEST_LEVEL, LOWEST_LEVEL, ValvePlant, volts_at
from valve_sim.model import Drive, Valve

MAX_VOLTAGE: Final = 30.0
"""V: `command_profile` refuses more by default."""
RECORD_NEXT_FILE: Final = "record_next.yaml"
STROKE_LEVELS: Final = (
    LOWEST_LEVEL,
    8.5 / 9.0,
    9.5 / 9.0,
    10.5 / 9.0,
    11.5 / 9.0,
    12.5 / 9.0,
    13.5 / 9.0,
    HIGHEST_LEVEL,
)
"""Voltages of the full strokes after the pulses, of the reference voltage: friction, drag and pull grow differently."""
ON, REST = 30e-3, 65e-3
"""s: how long the voltage of a full stroke holds, and the rest after each stroke, at whose end nothing moves."""
LEAD: Final = 0.1
"""s of rest before the first command: the sensor's noise is read from it."""


def profile_to_record(recommendation: Recommendation | None, valve: Valve, driven: float = math.inf) -> Drive:
    """The commands of the recommended recording: the best pulse, repeated, then full strokes at other voltages.

    Args:
        recommendation: the pulse that separates the candidates best; None where none does.
        valve: what is recorded; its reference voltage scales the full strokes.
        driven: the highest voltage that was recorded so far, V; see `volts_at`.
    """
    pulses = [recommendation.experiment.commands] * recommendation.repeats if recommendation is not None else []
    strokes = [((0.0, volts), (ON, 0.0)) for volts in volts_at(valve, STROKE_LEVELS, driven)]
    rows, start = [], LEAD
    for commands in [*pulses, *strokes]:
        rows += [(start + time, volts) for time, volts in commands]
        start = rows[-1][0] + REST
    times, volts = zip(*rows, strict=True)
    return Drive.of(times, volts)


def duration_of(drive: Drive) -> float:
    """How long to record it, s."""
    return float(drive.times[-1]) + REST


def highest_of(drive: Drive) -> float:
    """Its highest voltage, V."""
    return float(max(abs(drive.volts)))


def most_volts(drive: Drive) -> str:
    """The option with which `command_profile` takes a profile whose voltages it refuses by default."""
    return f" -p max_voltage:={math.ceil(highest_of(drive)):.1f}" if highest_of(drive) > MAX_VOLTAGE else ""


def option_of(options: str, name: str) -> str:
    """One of the options of a diagnosis with its value and a space before it; empty where it was not given."""
    words = shlex.split(options)
    return f" {name} {shlex.quote(words[words.index(name) + 1])}" if name in words else ""


def params_of(options: str) -> str:
    """Of the options of a diagnosis, the one that `simulate` takes, too."""
    return option_of(options, "--params")


def write_record_next(folder: Path, diagnosis: Diagnosis, provenance: str, options: str = "") -> Path | None:
    """Write record_next.yaml where a diagnosis advises a recording; its path, None where there is none.

    Args:
        folder: of the diagnosis' files. diagnosis: of a valve. provenance: how it was made.
        options: of the commands in its header: the diagnosed valve, as "--params my_valve.yaml --map map.yaml".

    Raises:
        ValveError: it cannot be written.
    """
    path = folder / RECORD_NEXT_FILE
    if not diagnosis.verdict.is_open:
        # One from an earlier run into this folder would advise what this diagnosis does not.
        path.unlink(missing_ok=True)
        return None
    driven = diagnosis.plant.driven if isinstance(diagnosis.plant, ValvePlant) else math.inf
    write_profile(path, diagnosis.recommendation, diagnosis.valve, provenance, options, driven)
    return path


def write_profile(
    path: Path,
    recommendation: Recommendation | None,
    valve: Valve,
    provenance: str,
    options: str = "",
    driven: float = math.inf,
) -> None:
    """Write record_next.yaml, whole or not at all.

    The commands in its header can be typed where this process was started.

    Args:
        path: of the file.
        recommendation: the pulse that separates the candidates best; None where none does.
        valve: what is recorded.
        provenance: how the diagnosis was made.
        options, driven: as of `write_record_next` and `profile_to_record`.

    Raises:
        ValveError: it cannot be written.
    """
    drive, file = profile_to_record(recommendation, valve, driven), shlex.quote(str(path))
    notes = [
        *provenance.splitlines(),
        "",
        *_gain_words(recommendation),
        "",
        "Rows are [time in s, volts]; each voltage holds until the next row. Highest: "
        f"{highest_of(drive):g} V; remove rows that your coil or its driver cannot stand.",
        f"Simulate: valve-sim simulate --profile {file} --duration {duration_of(drive):.2f}{params_of(options)} "
        "--output next.mcap",
        f"Command:  ros2 run valve_sim command_profile --ros-args -p profile:={file} "
        f"-p valve:=/valve{most_volts(drive)}",
        f"Then diagnose the new recording together with the old one: valve-sim diagnose OLD NEW"
        f"{f' {options}' if options else ''} --output results",
    ]
    rows = [
        f"- [{time:.6g}, {volts:g}]" for time, volts in zip(drive.times.tolist(), drive.volts.tolist(), strict=True)
    ]
    write_whole(path, "\n".join([*(f"# {note}".rstrip() for note in notes), *rows]) + "\n")


def _gain_words(recommendation: Recommendation | None) -> list[str]:
    if recommendation is None:
        return ["Full strokes at eight voltages. No single pulse is known to tell the candidates apart."]
    pulses = f"{recommendation.repeats} pulses of {recommendation.experiment.words}"
    lines = [f"{pulses}, then full strokes at eight voltages. The pulses separate:"]
    for (one, other), deviations in recommendation.together:
        lines.append(f"  {one} and {other} by {deviations:.0f} standard deviations")
    return lines
