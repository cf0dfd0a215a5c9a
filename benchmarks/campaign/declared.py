"""What the package is told of a plant: its valve, and its recordings as traces."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from plants.recording import Recording
from plants.tolerances import Entries

from benchmarks.campaign.effects import Effects
from valve_sim.model import Drive, Valve
from valve_sim.recordings import Signal, Trace

EXACT_SENSOR: Final = {"sensor": {"gain": 0.0, "linearity": 0.0}}
"""Tolerances of a file that declares everything to be exact."""


def declared_valve(
    entries: Entries, tolerances: Mapping[str, float | list[float]] | None = None, effects: Effects | None = None
) -> Valve:
    """The package's valve of a plant's entries and of declared effects, with tolerances; or exact, its sensor too."""
    values = {name: list(value) if isinstance(value, tuple) else value for name, value in entries.items()}
    beside = {"tolerances": EXACT_SENSOR if tolerances is None else tolerances, "effects": effects}
    return Valve.from_mapping({"valve": values} | {key: own for key, own in beside.items() if own}, "the campaign")


def as_trace(recording: Recording, source: str) -> Trace:
    """A recording as `read_trace` would give it."""
    current = None if recording.coil_current is None else Signal(recording.times, recording.coil_current)
    drive = Drive(recording.command_times, recording.volts)
    return Trace(
        source, drive, recording.times, recording.pilot_position, recording.main_position, coil_current=current
    )
