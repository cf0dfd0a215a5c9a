"""What a family hands over where it has plants, sensors or judgements of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from valve_sim.identification.diagnosis.run import Diagnosis

Measured = Mapping[str, float]
"""Figures of one diagnosis by name, each in the unit that its name says; nan where there is none."""


class Bench(NamedTuple):
    """One machine on the bench, recorded.

    Attributes:
        words: what it is. diagnose: its recordings by what its file says.
        judge: figures of the diagnosis by the truth, which is known here.
    """

    words: str
    diagnose: Callable[[], Diagnosis]
    judge: Callable[[Diagnosis], Measured]
