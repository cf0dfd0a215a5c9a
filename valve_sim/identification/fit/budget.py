"""How much work a search may do: counted in simulated strokes, so that no verdict depends on how busy a machine is."""

from __future__ import annotations

import math
import threading
from typing import Final

from valve_sim.model.errors import ValveError

STROKES_A_SECOND: Final = 4000
"""Simulated strokes that `--budget` allows for each of its seconds, whatever the machine."""
DERIVATIVES: Final = 4
"""Derivatives that cost as much as the stroke itself: 16 take as long as five strokes."""


class OutOfWorkError(ValveError):
    """The work that was allowed is done."""


class Budget:
    """How much a diagnosis may simulate.

    Args:
        strokes: simulated strokes; math.inf for as many as it takes.

    Attributes:
        strokes: as given. spent: what has been counted.

    Raises:
        ValveError: the work is not above 0.
    """

    def __init__(self, strokes: float) -> None:
        if not strokes > 0.0:
            raise ValveError(f"budget: found {strokes:g} simulated strokes, expected a number above 0")
        self.strokes = strokes
        self.spent = 0.0
        self._lock = threading.Lock()

    @classmethod
    def of_seconds(cls, seconds: float) -> Budget:
        """The budget that `--budget SECONDS` stands for.

        Raises:
            ValveError: the time is not above 0.
        """
        if not seconds > 0.0:
            raise ValveError(f"budget: found {seconds:g} s, expected a time above 0")
        return cls(STROKES_A_SECOND * seconds)

    @classmethod
    def unlimited(cls) -> Budget:
        """A budget without a limit."""
        return cls(math.inf)

    def count(self, strokes: int, derivatives: int = 0) -> None:
        """Count a simulation of so many strokes with so many derivatives."""
        with self._lock:
            self.spent += strokes * (1.0 + derivatives / DERIVATIVES)

    @property
    def is_used_up(self) -> bool:
        """Whether the budget is used up, so that nothing more is begun."""
        return self.spent >= self.strokes
