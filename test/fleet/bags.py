"""Bags of small fleets, recorded from the independent plant, and what the command line makes of them."""

from __future__ import annotations

from pathlib import Path

from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, record, train_bags, write_bag

DAY_NS = 86_400_000_000_000
FINE = Recorder(quantisation=0.1e-6)


def make_bag(folder: Path, day: float = 0.0, valve: str = "/valve", seed: int = 1, **friction: float) -> Path:
    """A new bag of two strokes; `force` adds Coulomb friction, N."""
    plant = DeclaredPlant({"coulomb_friction": friction} if friction else {}, dict(CAMPAIGN_VALVE))
    made = record(plant, train_bags(4)[seed % 4], FINE, seed)
    return write_bag(made, folder, valve, BAG_START_NS + round(day * DAY_NS))
