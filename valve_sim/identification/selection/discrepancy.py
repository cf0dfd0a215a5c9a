"""What no named effect explains, as a random process beside the model: evidence with it, and how large it is.

No model is exact. A discrepancy with unknown form is added to what each channel shows while the machine moves:
a Gaussian process in time within each stroke, of standard deviation τ in units of the channel's noise,

    Cov(δ_c(t), δ_c'(t')) = τ² (1/2 + 1/2 [c = c']) exp(−|t − t'| / ℓ)

(Kennedy and O'Hagan, J. R. Stat. Soc. B 63, 2001, p. 425; what its prior has to do with: Brynjarsdóttir and O'Hagan,
Inverse Problems 30, 2014, 114007). It is seen in sums over blocks of samples, e = J d + U δ + noise with U the
orthonormal indicator of the blocks, so that the covariance of the whitened residuals is V = 1 + τ² U K Uᵀ, and

    ln p(data | E, τ, ℓ) = −½ min over d of [(e + J d)ᵀ V⁻¹ (e + J d) + priors] − ½ ln |V| + ln volume

In the eigenvectors Q of each stroke's K, with eigenvalues λ, V⁻¹ = 1 − U Q diag(τ²λ/(1 + τ²λ)) Qᵀ Uᵀ: one Gram matrix
and one rotation of block sums serve all τ and ℓ, over which the evidence is summed with their priors (theory, section
6). The linearisation holds within 0.3 of ln p where τ ≤ 0.4; beyond, fits are repeated with V in the whitening.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.linearised import Linearised
from valve_sim.identification.estimation.rows import RowPlaces
from valve_sim.identification.plants.protocol import Array, Plant

BLOCK: Final = 8
"""Samples in a block: 0.4 ms at 20 kHz."""
MOST_BLOCKS: Final = 250
"""Largest number of blocks in a stroke: in longer strokes each block has more samples. Eigenvectors of so many take
20 ms."""
SIZES: Final = tuple(0.1 * 2.0**power for power in range(10))
"""τ: 0.1 to 51.2 standard deviations of a sample's noise."""
NEARLY: Final = 3.0
"""Difference in ln p by which a model with a discrepancy may be less probable than without, and be looked at twice."""
SHARED: Final = 0.5
"""Share of the covariance that is common to all channels."""
LENGTHS: Final = (0.03, 0.1, 0.4)
"""ℓ, of the time for which the machine moves in a stroke: 0.3, 1 and 4 ms of an opening's 10 ms."""

_LOG_PRIOR_OF_SIZE: Final = np.log([2.0 / math.pi / (1.0 + size**2) * size * math.log(2.0) for size in SIZES])
"""A half-Cauchy density of scale 1 on the grid, whose logarithm is even."""


class Cell(NamedTuple):
    """A place on the grid: τ in standard deviations of the noise, and the index of ℓ."""

    size: float
    length: int


class Spread(NamedTuple):
    """The evidence of a model with a discrepancy.

    Attributes:
        log_evidence: ln p(data | E, δ), on the scale of `Fit.log_evidence`. cell: the most probable τ and ℓ.
        size: τ, its posterior mean. errors: (g,) the sizes of the recordings' errors beside it.
    """

    log_evidence: float
    cell: Cell
    size: float
    errors: Array


class _Stroke(NamedTuple):
    """Blocks of one stroke: from `start` to `stop` among all blocks, and by ℓ eigenvalues and eigenvectors of K."""

    start: int
    stop: int
    spectra: tuple[tuple[Array, Array], ...]


class Discrepancy:
    """Blocks of the samples in motion of a problem's rows, and the process on them.

    Args:
        places: of the rows. lengths: ℓ, s.

    Attributes:
        blocks: how many there are.
    """

    def __init__(self, places: RowPlaces, lengths: Sequence[float]) -> None:
        moving = np.flatnonzero(places.moves & (places.steady > 0.0))
        order = np.lexsort((places.time[moving], places.channel[moving], places.stroke[moving]))
        self._order = moving[order]
        strokes, channels = places.stroke[self._order], places.channel[self._order]
        counts = np.bincount(strokes) if len(strokes) else np.zeros(0, dtype=np.intp)
        starts: list[int] = []
        edges = np.flatnonzero(np.diff(strokes) | np.diff(channels)) + 1
        for first, last in zip([0, *edges.tolist()], [*edges.tolist(), len(strokes)], strict=True):
            if last > first:
                size = max(BLOCK, math.ceil(int(counts[strokes[first]]) / MOST_BLOCKS))
                starts.extend(range(first, last, size))
        self._starts = np.array(starts, dtype=np.intp)
        self._sizes = np.diff(np.append(self._starts, len(strokes)))
        self.blocks = len(starts)
        self._lengths = tuple(lengths)
        self._strokes = self._laid_out(places, strokes, channels)

    def _laid_out(self, places: RowPlaces, strokes: NDArray[np.intp], channels: NDArray[np.intp]) -> list[_Stroke]:
        """The strokes, with the eigenvectors of their K for each ℓ."""
        if not self.blocks:
            return []
        roots = np.sqrt(self._sizes)
        times = np.add.reduceat(places.time[self._order], self._starts) / self._sizes
        gains = np.add.reduceat(places.steady[self._order], self._starts) / self._sizes * roots
        of_stroke, of_channel = strokes[self._starts], channels[self._starts]
        edges = np.flatnonzero(np.diff(of_stroke)) + 1
        found = []
        for start, stop in zip([0, *edges.tolist()], [*edges.tolist(), self.blocks], strict=True):
            own = slice(start, stop)
            apart = np.abs(times[own, None] - times[own])
            alike = np.where(of_channel[own, None] == of_channel[own], 1.0, SHARED) * np.outer(gains[own], gains[own])
            spectra = []
            for length in self._lengths:
                sizes, axes = np.linalg.eigh(alike * np.exp(-apart / length))
                spectra.append((np.maximum(sizes, 0.0), axes))
            found.append(_Stroke(start, stop, tuple(spectra)))
        return found

    def sums(self, rows: Array) -> Array:
        """Uᵀ of (r, k) columns: (blocks, k)."""
        if not self.blocks:
            return np.empty((0, rows.shape[1]))
        return np.add.reduceat(rows[self._order], self._starts, axis=0) / np.sqrt(self._sizes)[:, None]

    def _rotated(self, sums: Array, length: int) -> tuple[Array, Array]:
        """Qᵀ of (blocks, k) sums, and the (blocks,) eigenvalues."""
        rotated, sizes = np.empty_like(sums), np.empty(self.blocks)
        for stroke in self._strokes:
            own = slice(stroke.start, stroke.stop)
            sizes[own], axes = stroke.spectra[length]
            rotated[own] = axes.T @ sums[own]
        return rotated, sizes

    def whiten(self, rows: Array, cell: Cell) -> Array:
        """V^(−1/2) of (r, k) columns."""
        sums, found = self.sums(rows), rows.copy()
        rotated, sizes = self._rotated(sums, cell.length)
        rotated *= (1.0 / np.sqrt(1.0 + cell.size**2 * sizes) - 1.0)[:, None]
        change = np.empty_like(rotated)
        for stroke in self._strokes:
            own = slice(stroke.start, stroke.stop)
            change[own] = stroke.spectra[cell.length][1] @ rotated[own]
        spread = np.repeat(change / np.sqrt(self._sizes)[:, None], self._sizes, axis=0)
        found[self._order] += spread
        return found

    def spread(self, model: Linearised) -> Spread:
        """The evidence of a linearised model with a discrepancy, with the most probable errors of the recording beside.

        Beside a discrepancy they may be far from what they are without: either explains what the other does. So they
        are chosen again at the most probable cell, from those without a discrepancy and from none at all, where neither
        is much less probable than the model without.
        """
        if not len(model.sizes) or not self.blocks:
            return self._over_cells(model, model.sizes, 0.0)
        starts = (
            self._over_cells(model, model.best_sizes, model.log_integral),
            self._over_cells(model, model.no_sizes, 0.0),
        )
        if max(start.log_evidence for start in starts) < model.integrated - NEARLY:
            return starts[0]
        whole = model.with_columns()
        of_all, sums, found = gram(whole, whole), self.sums(whole), [starts[0]]
        for start in starts[:1] if starts[0].cell == starts[1].cell else starts:
            rotated, eigenvalues = self._rotated(sums, start.cell.length)
            shrunk = rotated * (1.0 - 1.0 / (1.0 + start.cell.size**2 * eigenvalues))[:, None]
            by_sizes = model.by_sizes(of_all - rotated.T @ shrunk)
            sizes = by_sizes.most_probable(start.errors)
            found.append(self._over_cells(model, sizes, by_sizes.log_integral(sizes)))
        return max(found, key=lambda one: one.log_evidence)

    def _over_cells(self, model: Linearised, errors: Array, log_integral: float) -> Spread:
        """The evidence with a discrepancy, for errors of the recording of these sizes, and the integral over others."""
        whole = model.rows(errors)
        of_rows, sums = gram(whole, whole), self.sums(whole)
        logs, evidence = np.empty((len(SIZES), len(self._lengths))), model.evidence_of(errors)
        for length in range(len(self._lengths)):
            rotated, sizes = self._rotated(sums, length)
            spreads = np.square(SIZES)[:, None] * sizes
            known = [rotated.T @ (rotated * (1.0 - 1.0 / (1.0 + own))[:, None]) for own in spreads]
            logs[:, length] = evidence(of_rows - np.array(known)) - 0.5 * np.log1p(spreads).sum(axis=1)
        posterior = logs + _LOG_PRIOR_OF_SIZE[:, None] - math.log(len(self._lengths))
        total = float(logsumexp(posterior))
        row, column = np.unravel_index(int(np.argmax(posterior)), posterior.shape)
        shares = np.exp(posterior - total).sum(axis=1)
        cell, size = Cell(SIZES[int(row)], int(column)), float(shares @ np.array(SIZES))
        return Spread(total + model.log_constant(errors) + log_integral, cell, size, errors)


def lengths_of(plant: Plant, places: RowPlaces) -> tuple[float, ...]:
    """ℓ, s: shares of the time for which a machine moves in a stroke, by how its samples tell."""
    steps = [float(np.median(np.diff(channel.times))) for channel in plant.channels if len(channel.times) > 1]
    strokes = np.unique(places.stroke[places.moves])
    if not len(strokes) or not steps:
        return tuple(share for share in LENGTHS)
    # Each stroke by its own first channel: another recording has other channels.
    channels = [places.channel[places.moves & (places.stroke == stroke)] for stroke in strokes]
    moving = [np.count_nonzero(own == own[0]) for own in channels]
    # A stroke is there and back.
    return tuple(share * 0.5 * float(np.median(moving)) * steps[0] for share in LENGTHS)
