"""What a family hands to a diagnosis where it has plants, sensors or judgements of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.estimation.budget import Budget
from valve_sim.model import Valve
from valve_sim.traces import Trace

Measured = Mapping[str, float]
"""Figures of one diagnosis by name, each in the unit that its name says; nan where there is none."""


class Bench(NamedTuple):
    """One valve on the bench.

    Attributes:
        words: what it is. declared: what its file says. training, held_out: its recordings; without the second, strokes
            are held out of the first.
        judge: figures of the diagnosis by the truth, which is known here. seconds: that stand for the work allowed.
    """

    words: str
    declared: Valve
    training: Sequence[Trace]
    held_out: Sequence[Trace]
    judge: Callable[[Diagnosis], Measured]
    seconds: float | None = None

    @property
    def budget(self) -> Budget | None:
        """The work that a diagnosis may do; None for as much as it takes."""
        return None if self.seconds is None else Budget.of_seconds(self.seconds)
