"""What has no name, as a random process beside a model: blocks of samples, and the process on them.

No model is exact. A discrepancy of unknown form is added to what each channel shows while the machine moves: a Gaussian
process in time within each stroke, of standard deviation τ in units of the channel's noise,

    Cov(δ_c(t), δ_c'(t')) = τ² (1/2 + 1/2 [c = c']) exp(−|t − t'| / ℓ)

(Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001, p. 425; what its prior has to do with: Brynjarsdóttir and O'Hagan,
Inverse Problems 30, 2014, 114007). It is seen in sums over blocks of samples, with U the orthonormal indicator of the
blocks, so that the covariance of the whitened residuals is V = 1 + τ² U K Uᵀ. In the eigenvectors Q of each stroke's K,
with eigenvalues λ, V⁻¹ = 1 − U Q diag(τ²λ/(1 + τ²λ)) Qᵀ Uᵀ: products beside the process are the data's products less
those of a few rotated sums (theory, section 6).
"""

from __future__ import annotations

import itertools
import math
import weakref
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.model import Sums
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.rows import RowPlaces
from valve_sim.identification.fit.white_columns import WhiteColumns
from valve_sim.identification.plants.protocol import Array

BLOCK: Final = 8
"""Samples in a block: 0.4 ms at 20 kHz."""
MOST_BLOCKS: Final = 250
"""Largest number of blocks in a stroke: in longer strokes each block has more samples."""
SHARED: Final = 0.5
"""Share of the covariance that is common to all channels."""
LENGTHS: Final = (0.03, 0.1, 0.4)
"""ℓ, of the time for which the machine moves one way in a stroke: 0.3, 1 and 4 ms of an opening's 10 ms."""
TAUS: Final = 0.1 * 2.0 ** np.arange(10)
"""τ: 0.1 to 51.2 standard deviations of a sample's noise."""
LOG_PRIOR_OF_TAU: Final = np.log(2.0 / math.pi / (1.0 + TAUS**2) * TAUS * math.log(2.0))
"""A half-Cauchy density of scale 1 on the grid, whose logarithm is even."""


class Cell(NamedTuple):
    """A place on the grid: τ in standard deviations of the noise, and the index of ℓ."""

    tau: float
    length: int


SMALLEST: Final = Cell(float(TAUS[0]), 0)


class Process:
    """The process on the rows in motion of a problem.

    Attributes:
        blocks: how many there are. stroke: (blocks,) the number of the stroke of each.
        eigenvalues: (lengths, blocks) of K, stroke by stroke.
    """

    def __init__(self, problem: Problem) -> None:
        places = problem.rows.places
        moving = np.flatnonzero(places.moves & (places.steady > 0.0))
        order = moving[np.lexsort((places.time[moving], places.channel[moving], places.stroke[moving]))]
        stroke, channel = places.stroke[order], places.channel[order]
        counts = np.bincount(stroke) if len(order) else np.zeros(0, dtype=np.intp)
        edges = [0, *(np.flatnonzero(np.diff(stroke) | np.diff(channel)) + 1).tolist(), len(order)]
        starts: list[int] = []
        for first, last in itertools.pairwise(edges):
            if last > first:
                size = max(BLOCK, math.ceil(int(counts[stroke[first]]) / MOST_BLOCKS))
                starts.extend(range(first, last, size))
        self._order, self._starts = order, np.array(starts, dtype=np.intp)
        self._counts = np.diff(np.append(self._starts, len(order)))
        self.blocks, self.stroke = len(starts), stroke[self._starts]
        self._strokes = [np.flatnonzero(self.stroke == number) for number in np.unique(self.stroke)]
        self.eigenvalues = np.zeros((len(LENGTHS), self.blocks))
        self._axes: list[list[Array]] = [[] for _ in LENGTHS]
        self._fixed = weakref.WeakKeyDictionary[WhiteColumns, list[Array]]()
        self._take_apart(problem, places, channel)

    def _take_apart(self, problem: Problem, places: RowPlaces, channel: NDArray[np.intp]) -> None:
        """Eigenvalues and eigenvectors of each stroke's K, for each ℓ."""
        if not self.blocks:
            return
        times = np.add.reduceat(places.time[self._order], self._starts) / self._counts
        gains = np.add.reduceat(places.steady[self._order], self._starts) / np.sqrt(self._counts)
        of_channel = channel[self._starts]
        lengths = _lengths(problem)
        for own in self._strokes:
            apart = np.abs(times[own, None] - times[own])
            alike = np.where(of_channel[own, None] == of_channel[own], 1.0, SHARED) * np.outer(gains[own], gains[own])
            for number, length in enumerate(lengths):
                values, axes = np.linalg.eigh(alike * np.exp(-apart / length))
                self.eigenvalues[number, own] = np.maximum(values, 0.0)
                self._axes[number].append(axes)

    def rotated(self, sums: Sums, length: int) -> Array:
        """(blocks, k + q + 1) Qᵀ Uᵀ [J | −B | e] of a linearisation, for one ℓ."""
        moved = self._along(self._summed(sums.moved), length)
        if sums.fixed not in self._fixed:
            summed = self._summed(sums.fixed.dense())
            self._fixed[sums.fixed] = [self._along(summed, number) for number in range(len(LENGTHS))]
        return np.hstack([moved[:, :-1], self._fixed[sums.fixed][length], moved[:, -1:]])

    def _summed(self, rows: Array) -> Array:
        """(blocks, m) Uᵀ of (r, m) rows."""
        if not self.blocks:
            return np.empty((0, rows.shape[1]))
        return np.asarray(np.add.reduceat(rows[self._order], self._starts, axis=0) / np.sqrt(self._counts)[:, None])

    def _along(self, summed: Array, length: int) -> Array:
        """(blocks, m) Qᵀ of such sums."""
        found = np.empty_like(summed)
        for own, axes in zip(self._strokes, self._axes[length], strict=True):
            found[own] = axes.T @ summed[own]
        return found

    def shrinkage(self, cell: Cell) -> Array:
        """(blocks,) what V⁻¹ takes away along each eigenvector."""
        spread = cell.tau**2 * self.eigenvalues[cell.length]
        return np.asarray(spread / (1.0 + spread))

    def log_determinants(self, cell: Cell) -> Array:
        """(blocks,) ln of each block's share of |V|."""
        return np.asarray(np.log1p(cell.tau**2 * self.eigenvalues[cell.length]))


def _lengths(problem: Problem) -> tuple[float, ...]:
    """ℓ, s: shares of the time for which a machine moves one way in a stroke, by how its samples tell."""
    places = problem.rows.places
    steps = [float(np.median(np.diff(own.times))) for own in problem.plant.channels if len(own.times) > 1]
    strokes = np.unique(places.stroke[places.moves])
    # Each stroke by its own first channel: another recording has other channels.
    channels = [places.channel[places.moves & (places.stroke == stroke)] for stroke in strokes]
    moving = [np.count_nonzero(own == own[0]) for own in channels]
    # A stroke is there and back.
    return tuple(share * 0.5 * float(np.median(moving)) * steps[0] for share in LENGTHS)
