"""Plants of which samples can be left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Plant


@runtime_checkable
class Thinnable(Plant, Protocol):
    """A plant that can show some of its samples and take less time for it: an optional member."""

    @property
    def can_be_thinned(self) -> bool:
        """Whether what it shows of a sample is the same whichever others it shows."""

    def thinned(self, kept: Sequence[NDArray[np.intp]]) -> Plant:
        """This plant with some samples of each channel, of which the first is one."""
