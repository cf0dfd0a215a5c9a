"""How long a search may take: seconds of a clock that the caller gives, read before every simulation of a fit.

A fit is a chain of simulations, so that work which is out of time ends within one of them. Work is done in parts, each
with a share of the whole: what a search leaves undone must not keep its conclusion from being drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from valve_sim.model.errors import ValveError

Clock = Callable[[], float]

WRITING: Final = 1.0
"""s of a processor for the report and its pictures, measured: 0.6."""
WRITING_AT_LEAST: Final = (5.0, 0.4)
"""s, or this share of the budget where that is less: a machine may get busy after its speed was seen."""
WRITING_AT_MOST: Final = 0.7
"""Largest share of the budget that is kept for writing."""


class OutOfTimeError(ValveError):
    """The time for this part of the work is used up."""


def kept_for_writing(seconds: float, slowness: float) -> float:
    """The part of a budget to keep for the report and its pictures, s.

    Args:
        seconds: the budget.
        slowness: s that pass on this machine for each that it gives a processor to this process; 1 where nothing else
            runs.
    """
    least, share = WRITING_AT_LEAST
    return min(max(WRITING * slowness, min(least, share * seconds)), WRITING_AT_MOST * seconds)


class Budget:
    """Time that work may take, from now on.

    Args:
        seconds: for all of it; math.inf for as long as it takes.
        clock: tells seconds that never go back, such as time.monotonic.

    Raises:
        ValveError: the time is not above 0.
    """

    def __init__(self, seconds: float, clock: Clock) -> None:
        if not seconds > 0.0:
            raise ValveError(f"budget: found {seconds:g} s, expected a time above 0")
        self.seconds = seconds
        self._clock = clock
        self._begun = clock()
        self._limit = seconds

    @classmethod
    def unlimited(cls) -> Budget:
        """One that is never used up."""
        return cls(math.inf, lambda: 0.0)

    @property
    def spent(self) -> float:
        """Seconds since the beginning."""
        return self._clock() - self._begun

    def check(self) -> None:
        """Go on only while there is time.

        Raises:
            OutOfTimeError: the time of the part that is being done is used up.
        """
        if self.spent > self._limit:
            raise OutOfTimeError(f"the budget of {self.seconds:g} s is used up; give it more time")

    @contextmanager
    def until(self, share: float) -> Iterator[None]:
        """Within this block, time is used up when this share of the whole is; threads of the block included."""
        before, self._limit = self._limit, min(self._limit, share * self.seconds)
        try:
            yield
        finally:
            self._limit = before
