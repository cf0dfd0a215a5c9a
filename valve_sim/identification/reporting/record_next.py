"""The recommended recording as a profile of commands, which `simulate --profile` and `command_profile` take."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.model import Drive

MAX_VOLTAGE: Final = 30.0
"""V: `command_profile` refuses more by default."""
RECORD_NEXT_FILE: Final = "record_next.yaml"
ON, REST = 30e-3, 65e-3
"""s: how long the voltage of a full stroke holds, and the rest after each stroke, at whose end nothing moves."""
LEAD: Final = 0.1
"""s of rest before the first command: the sensor's noise is read from it."""


def profile_to_record(recommendation: Recommendation | None, voltages: Sequence[float]) -> Drive:
    """The commands of the recommended recording: the best pulse, repeated, then full strokes at other voltages.

    Args:
        recommendation: the pulse that separates the candidates best; None where none does.
        voltages: of the full strokes, V.
    """
    pulses = [recommendation.experiment.commands] * recommendation.repeats if recommendation is not None else []
    strokes = [((0.0, volts), (ON, 0.0)) for volts in voltages]
    rows, start = [], LEAD
    for commands in [*pulses, *strokes]:
        rows += [(start + time, volts) for time, volts in commands]
        start = rows[-1][0] + REST
    times, volts = zip(*rows, strict=True)
    return Drive.of(times, volts)


def duration_of(drive: Drive) -> float:
    """How long to record it, s."""
    return float(drive.times[-1]) + REST


def typed_option(options: str, name: str) -> str:
    """One of the options of a diagnosis with its value and a space before it; empty where it was not given."""
    words = shlex.split(options)
    return f" {name} {shlex.quote(words[words.index(name) + 1])}" if name in words else ""


def typed_commands(drive: Drive, path: Path, options: str, output: str) -> tuple[str, str]:
    """Commands that simulate a profile, into `output`, and that drive a valve by it.

    Args:
        drive: the profile, in the file `path`. options: of the diagnosis; the valve is simulated with its --params.
    """
    file, highest = shlex.quote(str(path)), float(max(abs(drive.volts)))
    most = f" -p max_voltage:={math.ceil(highest):.1f}" if highest > MAX_VOLTAGE else ""
    params = typed_option(options, "--params")
    return (
        f"valve-sim simulate --profile {file} --duration {duration_of(drive):.2f}{params} --output {output}",
        f"ros2 run valve_sim command_profile --ros-args -p profile:={file} -p valve:=/valve{most}",
    )


def profile_of(diagnosis: Diagnosis) -> Drive | None:
    """The recording that a diagnosis advises; None of a machine that voltages do not drive."""
    voltages = diagnosis.plant.stroke_voltages(diagnosis.after.fit.values)
    return profile_to_record(diagnosis.recommendation, voltages) if voltages else None


def write_record_next(folder: Path, diagnosis: Diagnosis, provenance: str, options: str = "") -> Path | None:
    """Write record_next.yaml where a diagnosis advises a recording; its path, None where there is none.

    Args:
        folder: of the diagnosis' files. diagnosis: of any machine. provenance: how it was made.
        options: of the commands in its header: the diagnosed valve, as "--params my_valve.yaml --map map.yaml".

    Raises:
        ValveError: it cannot be written.
    """
    path = folder / RECORD_NEXT_FILE
    drive = profile_of(diagnosis) if diagnosis.verdict.is_open else None
    if drive is None:
        # One from an earlier run into this folder would advise what this diagnosis does not.
        path.unlink(missing_ok=True)
        return None
    write_profile(path, drive, diagnosis.recommendation, provenance, options)
    return path


def write_profile(
    path: Path, drive: Drive, recommendation: Recommendation | None, provenance: str, options: str = ""
) -> None:
    """Write a profile, whole or not at all; the commands in its header work where this process was started.

    Arguments are those of `write_record_next`; `recommendation` is the pulse of the profile, and what it separates.

    Raises:
        ValveError: it cannot be written.
    """
    simulate, command = typed_commands(drive, path, options, "next.mcap")
    notes = [
        *provenance.splitlines(),
        "",
        *_gain_words(recommendation),
        "",
        "Rows are [time in s, volts]; each voltage holds until the next row. Highest: "
        f"{max(abs(drive.volts)):g} V; remove rows that your coil or its driver cannot stand.",
        f"Simulate: {simulate}",
        f"Command:  {command}",
        "Then diagnose the new recording together with the old one: valve-sim diagnose OLD NEW"
        f"{f' {options}' if options else ''} --output results",
    ]
    rows = [
        f"- [{time:.6g}, {volts:g}]" for time, volts in zip(drive.times.tolist(), drive.volts.tolist(), strict=True)
    ]
    write_whole(path, "\n".join([*(f"# {note}".rstrip() for note in notes), *rows]) + "\n")


def _gain_words(recommendation: Recommendation | None) -> list[str]:
    if recommendation is None:
        return ["Full strokes at eight voltages. No single pulse is known to separate the candidates."]
    pulses = f"{recommendation.repeats} pulses of {recommendation.experiment.words}"
    lines = [f"{pulses}, then full strokes at eight voltages. The pulses separate:"]
    for (one, other), deviations in recommendation.together:
        lines.append(f"  {one} and {other} by {deviations:.0f} standard deviations")
    return lines
