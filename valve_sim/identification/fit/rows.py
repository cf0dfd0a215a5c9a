"""What a fit compares: rows of whitened, weighted residuals, of each sample or of blocks of samples.

What is read while a machine is still is summed up in blocks, of which one sample is simulated. Where a model says the
same for all n samples of a block, and their weights are w, whitened readings aₜ enter the criterion by their weighted
mean alone:

    Σ w² (a − m)² = W (ā − m)² + Σ w² (a − ā)²,    W = Σ w²,  ā = Σ w² a / W

so that a row of weight √W stands for n, and the last sum, which no model changes, is added to the criterion. A model
that moves while the machine is still is seen at one sample of each block; blocks are shorter where a still stretch
begins, in which what settles may still be seen.

Of a long recording rows are not held at all: its pieces are added up one after the other.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.fit.column_groups import ColumnGroup, group_columns, reach_of
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.noise import Noise, WhiteRows, readings_near, stretches
from valve_sim.identification.plants.protocol import (
    Array,
    Channel,
    Direction,
    Nuisance,
    Piece,
    Plant,
    finite_prediction,
    strokes_of_plant,
)
from valve_sim.model import SimulationError

FIRST_BLOCKS: Final = (3, 3, 3, 5, 5, 7, 9, 11, 13)
"""Samples in the blocks with which a still stretch begins; odd, so that one sample is in the middle."""
LONGEST_BLOCK: Final = 15
"""Samples in all others: 0.75 ms at 20 kHz."""
STILL: Final = 6.0
"""Standard deviations within which readings stay that are of a machine at rest."""
SETTLES: Final = 20
"""Samples at the beginning of those that may be of one that still moves."""
SCATTER: Final = 0.02
"""Of χ², that creeping may add to the scatter in all blocks of a stretch."""
LARGER: Final = 3.0
"""By how much the scatter of a block may be larger beside what the declared machine shows, by chance."""


class _Layout(NamedTuple):
    """The rows of one channel.

    Attributes:
        kept: (m,) which samples are simulated, ascending; None: all of them.
        readings: (m,) what is measured there, which is taken from what is simulated before it is whitened.
        at: (r,) index among these of the sample of each row. lags: (r,) how many before it a row takes to be whitened;
            −1 for a block, in which all are the same.
        scale: (r,) factor of that. target: (r,) what is measured of a row, whitened and weighted, beyond `readings`.
        counts: (r,) samples that a row stands for. times: (r,) s.
        moves: (r,) whether it is one sample that is not known to be still. groups: (r,) the stroke that it belongs to.
        steady: (r,) what an offset by one standard deviation of the noise makes of it.
        constant: what all blocks add to the criterion, whatever is simulated.
        starts: (r',) where rows begin, those that do not take part among them; None: each sample is a row.
        squares: (n,) of the samples' weights.
    """

    kept: NDArray[np.intp] | None
    readings: Array
    at: NDArray[np.intp]
    lags: NDArray[np.intp]
    scale: Array
    target: Array
    counts: Array
    times: Array
    moves: NDArray[np.bool_]
    groups: NDArray[np.integer]
    steady: Array
    constant: float
    starts: NDArray[np.intp] | None
    squares: Array

    def whitened(self, columns: Array, noise: Noise) -> Array:
        """(r, q) whitened, weighted columns of (n, q) of all samples.

        Of a block that is the weighted mean, as of its readings: what rings and hums within it is not one sample's.
        """
        own = np.empty(columns.shape)
        if self.starts is None:
            noise.whiten_into(own, columns, np.sqrt(self.squares))
            return own
        noise.whiten_into(own, columns, self.squares)
        total = np.add.reduceat(self.squares, self.starts)
        used = total > 0.0
        return np.asarray(np.add.reduceat(own, self.starts, axis=0)[used] / np.sqrt(total[used])[:, None])


class RowPlaces(NamedTuple):
    """What is known of the rows of a fit, beside what is measured there.

    Attributes:
        channel: (r,) index of its channel. time: (r,) s. stroke: (r,) number of its stroke, from 0 on.
        moves: (r,) whether it is one sample, taken while the machine is not known to be still.
        steady: (r,) what an offset of the channel by one standard deviation of its noise makes of the row.
    """

    channel: NDArray[np.intp]
    time: Array
    stroke: NDArray[np.intp]
    moves: NDArray[np.bool_]
    steady: Array


class PieceSums(NamedTuple):
    """Sums over n whitened, weighted residuals e and their derivatives J along k directions.

    Attributes:
        squares: eᵀ e. gradient: (k,) Jᵀ e. information: (k, k) Jᵀ J.
    """

    squares: float
    gradient: Array
    information: Array


class Rows:
    """Rows of whitened, weighted residuals: each sample of a plant is one.

    Args:
        plant: the machine and its data.
        weights: (n,) of the samples of each channel. noises: of each channel. budget: of the fits.
    """

    def __init__(self, plant: Plant, weights: Sequence[Array], noises: Sequence[Noise], budget: Budget) -> None:
        self.plant = plant
        self._weights, self._noises, self._budget = list(weights), list(noises), budget
        self._strokes = max(1, len(strokes_of_plant(plant)))
        self._groups: dict[tuple[Nuisance, ...], list[ColumnGroup]] = {}

    @functools.cached_property
    def _layouts(self) -> list[_Layout]:
        channels = zip(self.plant.channels, self._weights, self._noises, strict=True)
        return [_each_sample(*channel) for channel in channels]

    @property
    def _simulated(self) -> Plant:
        """The plant with the samples that are simulated."""
        return self.plant

    @property
    def constant(self) -> float:
        """What is to be added to the sum of the squares of the residuals."""
        return 0.0

    @functools.cached_property
    def counts(self) -> Array:
        """(r,) samples that each row stands for."""
        return np.concatenate([layout.counts for layout in self._layouts])

    @functools.cached_property
    def places(self) -> RowPlaces:
        """Time and stroke of each row, whether it is in motion, and its weight."""
        layouts = self._layouts
        channel = np.concatenate([np.full(len(own.times), index) for index, own in enumerate(layouts)])
        recordings = np.array([own.recording for own in self.plant.channels])
        keys = np.column_stack([recordings[channel], np.concatenate([own.groups for own in layouts])])
        _, stroke = np.unique(keys, axis=0, return_inverse=True)
        times, moves, steady = (
            np.concatenate([getattr(own, name) for own in layouts]) for name in ("times", "moves", "steady")
        )
        return RowPlaces(channel, times, stroke.reshape(-1), moves, steady)

    def reach(self, nuisance: Nuisance) -> NDArray[np.bool_]:
        """(r,) which rows a nuisance acts on."""
        return reach_of(nuisance, [layout.times for layout in self._layouts])

    def groups(self, nuisances: tuple[Nuisance, ...]) -> list[ColumnGroup]:
        """Nuisances in groups, of which no two act on the same row."""
        if nuisances not in self._groups:
            self._groups[nuisances] = group_columns([self.reach(nuisance) for nuisance in nuisances])
        return self._groups[nuisances]

    def residuals(self, values: Mapping[str, float]) -> Array:
        """(r,) whitened, weighted residuals of all channels in a row (measured − predicted).

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        self._budget.count(self._strokes)
        return self._white(finite_prediction(self._simulated, values))[:, 0]

    def linearised(
        self, values: Mapping[str, float], directions: Sequence[Direction]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """(r, k + 1) derivatives of the residuals and residuals; (k,) where the plant knows the former, else 0.

        Args:
            values, directions: see the plant's `sensitivities`.

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        self._budget.count(self._strokes, len(directions))
        known = np.zeros(0, dtype=bool)
        if directions:
            columns, known, shown = self._simulated.sensitivities(values, directions)
            if known.any():
                return self._white(shown, columns), known
        left = self.residuals(values)
        return np.column_stack([np.zeros((len(left), len(directions))), left]), known

    def _white(self, shown: Sequence[Array], columns: Sequence[Array] | None = None) -> Array:
        """(r, k + 1) derivatives of the residuals and residuals, whitened and weighted.

        Args:
            shown: (m,) in each channel, at the samples that are simulated. columns: (m, k) derivatives of these.
        """
        found = np.empty((len(self._target), 1 + (0 if columns is None else columns[0].shape[1])))
        start = 0
        for index, (layout, noise, rows) in enumerate(zip(self._layouts, self._noises, self._white_rows, strict=True)):
            own = found[start : start + len(layout.at)]
            if columns is not None:
                noise.whiten_rows(own[:, :-1], columns[index], rows)
            noise.whiten_rows(own[:, -1:], (shown[index] - layout.readings)[:, None], rows)
            own *= -layout.scale[:, None]
            start += len(own)
        found[:, -1] += self._target
        return found

    @functools.cached_property
    def _target(self) -> Array:
        return np.concatenate([layout.target for layout in self._layouts])

    @functools.cached_property
    def _white_rows(self) -> list[WhiteRows]:
        return [own.white_rows(layout.at, layout.lags) for layout, own in zip(self._layouts, self._noises, strict=True)]

    def whitened_columns(self, columns: Mapping[int, Array]) -> dict[int, tuple[slice, Array]]:
        """The slice of rows of some channels, and (r, q) whitened, weighted columns of (n, q) of all their samples."""
        found, start = {}, 0
        for index, (layout, noise) in enumerate(zip(self._layouts, self._noises, strict=True)):
            own = slice(start, start + len(layout.at))
            if index in columns:
                found[index] = own, layout.whitened(columns[index], noise)
            start = own.stop
        return found

    def sums(self, values: Mapping[str, float], directions: Sequence[Direction]) -> PieceSums | None:
        """Sums over the residuals and their derivatives, of which only a piece is held; None where they are not known.

        Args:
            values, directions: see the plant's `sensitivities`; without directions no derivative is asked for.

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        self._budget.count(self._strokes, len(directions))
        pieces = self.plant.pieces(values, directions)
        if pieces is None:
            return None
        total = np.zeros((1 + len(directions),) * 2)
        before = [np.empty((0, 1 + len(directions))) for _ in self._noises]
        for piece in pieces:
            noise, weight = self._noises[piece.channel], self._weights[piece.channel]
            known = before[piece.channel]
            rows = _rows_of(piece, self.plant.channels[piece.channel], known)
            first, order = len(known), len(noise.coefficients)
            before[piece.channel] = rows[max(0, len(rows) - order) :].copy()
            white = np.empty_like(rows)
            noise.whiten_into(white, rows, weight[piece.start - first : piece.start + len(rows) - first])
            total += gram(white[first:], white[first:])
        return PieceSums(float(total[0, 0]), total[0, 1:], total[1:, 1:])


def _rows_of(piece: Piece, channel: Channel, before: Array) -> Array:
    """(n, 1 + k) measured less shown, and derivatives of that, after the rows that colour the noise of the first."""
    rows = np.empty((len(before) + len(piece.shown), before.shape[1]))
    rows[: len(before)] = before
    own = rows[len(before) :]
    np.subtract(channel.data[piece.samples], piece.shown, out=own[:, 0])
    np.negative(piece.columns, out=own[:, 1:])
    return rows


class CondensedRows(Rows):
    """Rows of which some stand for many samples; arguments: see `Rows`, the plant one that can be thinned."""

    def __init__(self, plant: Plant, weights: Sequence[Array], noises: Sequence[Noise], budget: Budget) -> None:
        super().__init__(plant, weights, noises, budget)
        edges = np.unique(
            [end for own in (*plant.nuisances, *plant.timing_errors, *plant.varying) for end in own.during]
        )
        channels = zip(plant.channels, _reference(plant), weights, noises, strict=True)
        self._condensed = [_in_blocks(*channel, edges[np.isfinite(edges)]) for channel in channels]
        self._thinned = plant.thinned([np.arange(0) if own.kept is None else own.kept for own in self._condensed])

    @property
    def _layouts(self) -> list[_Layout]:
        return self._condensed

    @property
    def _simulated(self) -> Plant:
        return self._thinned

    @property
    def constant(self) -> float:
        """What the scatter in blocks adds to the sum of the squares of the residuals."""
        return math.fsum(layout.constant for layout in self._layouts)


def _reference(plant: Plant) -> list[Array]:
    """What the declared machine would show in each channel; nothing where it cannot be simulated."""
    try:
        return plant.predict({})
    except SimulationError:
        return [np.zeros_like(channel.data) for channel in plant.channels]


def _each_sample(channel: Channel, weight: Array, noise: Noise) -> _Layout:
    """The rows of a channel of which each sample is one; weight: (n,) of them."""
    count = len(channel.data)
    at = np.arange(count)
    steady = noise.sigma * (1.0 - math.fsum(noise.coefficients)) / noise.innovation
    return _Layout(
        None, channel.data, at, np.minimum(at, len(noise.coefficients)), weight / noise.innovation, np.zeros(count),
        np.ones(count), channel.times, ~channel.quiet & (weight > 0.0), channel.group, weight * steady, 0.0, None,
        np.square(weight),
    )  # fmt: skip


def _in_blocks(channel: Channel, reference: Array, weight: Array, noise: Noise, edges: Array) -> _Layout:
    """The rows of a channel of which blocks of samples are some.

    Args:
        reference: (n,) what is taken from the readings before they are summed up, so that what settles alike in both
            is no scatter; but where it makes the scatter larger.
        weight: (n,) of its samples. noise: of it. edges: times, s, that no block may contain.
    """
    order = len(noise.coefficients)
    starts, stops = _blocks(channel, noise, edges)
    squares = np.square(np.broadcast_to(weight, len(channel.data)))
    total, every = np.add.reduceat(squares, starts), starts
    takes_part = total > 0.0
    counts = np.add.reduceat((squares > 0.0).astype(np.float64), starts)[takes_part]
    readings = (channel.data, channel.data - reference)
    by_itself, beside = (_summed(noise.whiten(seen), squares, starts) for seen in readings)
    is_beside = (stops - starts > 1) & (beside[1] < by_itself[1] + LARGER)
    mean, constant = np.where(is_beside, beside, by_itself)
    starts, stops, is_beside = starts[takes_part], stops[takes_part], is_beside[takes_part]
    total, mean = total[takes_part], mean[takes_part]
    middle, is_block = (starts + stops) // 2, stops - starts > 1
    lags = np.where(is_block, -1, np.minimum(middle, order))
    before = [middle[lags >= lag] - lag for lag in range(1, order + 1)]
    # The first sample says when a run begins.
    kept = np.unique(np.concatenate([[0], middle, *before]).astype(np.intp))
    gain = np.where(is_block, 1.0 - math.fsum(noise.coefficients), 1.0) / noise.innovation
    mean[is_beside] += gain[is_beside] * reference[middle[is_beside]]
    root = np.sqrt(total)
    steady = noise.sigma * (1.0 - math.fsum(noise.coefficients)) / noise.innovation
    return _Layout(
        kept, np.zeros(len(kept)), np.searchsorted(kept, middle), lags, root * gain, root * mean,
        counts, channel.times[middle], ~is_block & ~channel.quiet[middle],
        channel.group[middle], root * steady, math.fsum(constant), every, squares,
    )  # fmt: skip


def _summed(whitened: Array, squares: Array, starts: NDArray[np.intp]) -> tuple[Array, Array]:
    """(r,) weighted means of rows that begin so, and the scatter about them; no scatter of one sample.

    Args:
        whitened: (n,) readings. squares: (n,) of their weights.
    """
    total = np.add.reduceat(squares, starts)
    mean = np.add.reduceat(squares * whitened, starts) / np.where(total > 0.0, total, 1.0)
    about = np.repeat(mean, np.diff(np.append(starts, len(whitened))))
    return mean, np.add.reduceat(squares * np.square(whitened - about), starts)


def _blocks(channel: Channel, noise: Noise, edges: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """(r,) where rows start and stop: samples by themselves, and blocks in which the machine is still."""
    count, order = len(channel.data), len(noise.coefficients)
    cuts = np.searchsorted(channel.times, edges).tolist()
    starts = np.ones(count, dtype=bool)
    for first, last, longest in _still(channel, max(noise.sigma, noise.step)):
        for low, high in itertools.pairwise([first, *(cut for cut in cuts if first < cut < last), last]):
            # Whitening reaches back by so many samples, which need not be still.
            begin, sizes = low + order, itertools.chain(FIRST_BLOCKS, itertools.repeat(LONGEST_BLOCK))
            while begin + (size := min(next(sizes), longest)) <= high:
                starts[begin + 1 : begin + size] = False
                begin += size
    found = np.flatnonzero(starts)
    return found, np.append(found[1:], count)


def _still(channel: Channel, sigma: float) -> list[tuple[int, int, int]]:
    """(start, stop, most samples of a block) of stretches in which readings stay near those known to be still.

    What is quiet begins late, so that it may tell what noise is; here the model only has to say nearly the same. A
    plunger may creep in it, and blocks are so short that this adds nothing to their scatter, or one sample.
    """
    found: list[tuple[int, int, int]] = []
    for first, last in stretches(channel.quiet):
        quiet = channel.data[first:last]
        before = channel.data[found[-1][1] if found else 0 : first][::-1]
        near = readings_near(before, float(np.mean(quiet[:LONGEST_BLOCK])), STILL * sigma)
        centred = np.arange(len(quiet)) - 0.5 * (len(quiet) - 1)
        slope = abs(float(centred @ quiet)) / max(float(centred @ centred), 1.0) / sigma
        fits = min(LONGEST_BLOCK, int(math.sqrt(12.0 * SCATTER / len(quiet)) / max(slope, 1e-12)))
        # The first of them may be of what still moves.
        found.append((first - max(0, near - SETTLES), last, max(1, fits - (fits + 1) % 2)))
    return found
