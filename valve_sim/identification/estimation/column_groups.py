"""Nuisance parameters that act on disjoint samples share one simulation for their columns of the Jacobian.

An error of a command's stamp changes its own stroke and no other, so that one simulation with an error in each stroke
gives the difference quotients of all of them (Curtis, Powell and Reid, J. Inst. Maths Applics 13, 1974, p. 117).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.estimation.noise import stretches

LAST: Final = 3
"""Samples at the end of each stretch in which the effect of its nuisance must have died away."""
LEFT: Final = 1e-3
"""Share of the largest difference in a stretch that counts as zero."""


def group_columns(reach: Sequence[NDArray[np.bool_]]) -> list[list[int]]:
    """Indices of nuisances in groups: those in one group have no sample in common.

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
    return groups


def columns_decouple(differences: NDArray[np.float64], reach: Sequence[NDArray[np.bool_]]) -> bool:
    """Whether each nuisance's effect has died away at the end of each stretch of samples that it acts on.

    Where it has not, as in strokes that follow each other without rest, it reaches samples that another one acts on.

    Args:
        differences: (n,) change of the residuals when all of them are perturbed.
        reach: for each nuisance, (n,) which samples it acts on.
    """
    for mask in reach:
        for start, stop in stretches(mask):
            if stop < len(differences):
                sizes = np.abs(differences[start:stop])
                if np.max(sizes[-LAST:]) > LEFT * np.max(sizes):
                    return False
    return True
