"""Nuisance parameters that act on disjoint samples share one simulation for their columns of the Jacobian.

An error of a command's stamp changes its own stroke and no other, so that one simulation with an error in each stroke
gives the difference quotients of all of them (Curtis, Powell and Reid, J. Inst. Maths Applics 13, 1974, p. 117).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.noise import stretches
from valve_sim.identification.plants.protocol import Array, Nuisance

LAST: Final = 3
"""Samples at the end of each stretch in which the effect of its nuisance must have died away."""
LEFT: Final = 1e-3
"""Share of the largest difference in a stretch that counts as zero."""
ROUNDING: Final = 1e-9
"""Share of the largest difference in all stretches that counts as zero: nothing but rounding reaches one that is held
out, and it would not die away."""


class ColumnGroup:
    """Nuisances of which no two act on the same sample.

    Args:
        members: their indices. reach: for each of them, (n,) which samples it acts on.

    Attributes:
        members: as given.
    """

    def __init__(self, members: Sequence[int], reach: Sequence[NDArray[np.bool_]]) -> None:
        self.members = list(members)
        self._stretches = [stretch for mask in reach for stretch in stretches(mask)]
        self._rows = np.concatenate([np.flatnonzero(mask) for mask in reach])
        self._columns = np.repeat(self.members, [np.count_nonzero(mask) for mask in reach])

    def part(self, differences: Array, columns: Array, places: NDArray[np.intp]) -> bool:
        """Part the change of residuals when all are perturbed: what each acts on is its column's.

        Args:
            differences: (n,) that change. columns: (n, m) of a Jacobian, 0 where these are to be filled in.
            places: of all nuisances among its columns.

        Returns:
            whether they could be parted; else nothing is filled in.
        """
        if not self._decouples(differences):
            return False
        columns[self._rows, places[self._columns]] = differences[self._rows]
        return True

    def _decouples(self, differences: Array) -> bool:
        """Whether each one's effect has died away at the end of each stretch of samples that it acts on.

        Where it has not, as in strokes that follow each other without rest, it reaches samples that another one acts
        on. Arguments: see `part`.
        """
        rounding = ROUNDING * float(np.max(np.abs(differences), initial=0.0))
        for start, stop in self._stretches:
            if stop < len(differences):
                sizes = np.abs(differences[start:stop])
                if np.max(sizes[-LAST:]) > max(LEFT * np.max(sizes), rounding):
                    return False
        return True


def reach_of(nuisance: Nuisance, times: Sequence[Array]) -> NDArray[np.bool_]:
    """(n,) which rows of the Jacobian a nuisance acts on; times: s, of the rows of each channel."""
    low, high = nuisance.during
    acts_on = nuisance.channels or range(len(times))
    if (low, high) == (-math.inf, math.inf) and set(acts_on) == set(range(len(times))):
        return np.broadcast_to(True, sum(map(len, times)))
    return np.concatenate([(low <= own) & (own < high) & (index in acts_on) for index, own in enumerate(times)])


def group_columns(reach: Sequence[NDArray[np.bool_]]) -> list[ColumnGroup]:
    """Nuisances in groups: those in one group have no sample in common.

    Args:
        reach: for each nuisance, (n,) which samples it acts on.
    """
    groups: list[list[int]] = []
    for index, mask in enumerate(reach):
        free = (members for members in groups if not any(np.any(mask & reach[member]) for member in members))
        group = next(free, None)
        if group is None:
            groups.append([index])
        else:
            group.append(index)
    return [ColumnGroup(members, [reach[member] for member in members]) for members in groups]
