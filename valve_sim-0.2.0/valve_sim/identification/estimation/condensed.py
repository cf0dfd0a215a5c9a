"""Fewer rows of a fit: what is read while a machine is still is summed up in blocks, of which one sample is simulated.

Where a model says the same for all n samples of a block, and their weights are w, whitened readings aₜ enter the
criterion by their weighted mean alone:

    Σ w² (a − m)² = W (ā − m)² + Σ w² (a − ā)²,    W = Σ w²,  ā = Σ w² a / W

so that a row of weight √W stands for n, and the last sum, which no model changes, is added to the criterion. A model
that moves while the machine is still is seen at one sample of each block; blocks are shorter where a still stretch
begins, in which what settles may still be seen.
"""

from __future__ import annotations

import copy
import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.estimation.budget import Budget
from valve_sim.identification.estimation.column_groups import ColumnGroup, group_columns, reach_of
from valve_sim.identification.estimation.noise import Noise, readings_near, stretches
from valve_sim.identification.plants.protocol import (
    Array,
    Channel,
    Differentiable,
    Direction,
    Nuisance,
    Plant,
    Thinnable,
    strokes_of_plant,
    varying_of,
)
from valve_sim.model import SimulationError
from valve_sim.model.core.machine import made_once
from valve_sim.model.core.native import native
from valve_sim.model.core.polynomials import Block

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
        kept: (m,) which samples are simulated, ascending.
        at: (r,) index among these of the sample of each row. lags: (r,) how many before it a row takes to be whitened;
            −1 for a block, in which all are the same.
        scale: (r,) factor of what is simulated. target: (r,) whitened, weighted reading.
        counts: (r,) samples that a row stands for. times: (r,) s.
        moves: (r,) whether it is one sample that is not known to be still. groups: (r,) the stroke that it belongs to.
        steady: (r,) what an offset by one standard deviation of the noise makes of it.
        constant: what all blocks add to the criterion, whatever is simulated.
        starts: (r',) where rows begin, those that do not take part among them. squares: (n,) of the samples' weights.
    """

    kept: NDArray[np.intp]
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
    starts: NDArray[np.intp]
    squares: Array


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


def places_of(
    recordings: Sequence[int], parts: Sequence[tuple[Array, NDArray[np.integer], NDArray[np.bool_], Array]]
) -> RowPlaces:
    """The places of rows, channel by channel.

    Args:
        recordings: of each channel. parts: of each channel, (r,) times, groups, whether it moves, and `steady`.
    """
    times, groups, moves, steady = (np.concatenate(part) for part in zip(*parts, strict=True))
    channel = np.concatenate([np.full(len(part[0]), index) for index, part in enumerate(parts)])
    keys = np.column_stack([np.asarray(recordings)[channel], groups])
    _, stroke = np.unique(keys, axis=0, return_inverse=True)
    return RowPlaces(channel, times, stroke.reshape(-1), moves, steady)


class Condensed:
    """Rows of whitened, weighted residuals, of which some stand for many.

    Args:
        plant: the machine and its data, of which samples can be left out.
        weights: (n,) of the samples of each channel. noises: of each channel. budget: of the fits.

    Attributes:
        constant: what is to be added to the sum of their squares. counts: (r,) samples that each stands for.
    """

    def __init__(self, plant: Thinnable, weights: Sequence[Array], noises: Sequence[Noise], budget: Budget) -> None:
        edges = np.unique(
            [end for own in (*plant.nuisances, *plant.timing_errors, *varying_of(plant)) for end in own.during]
        )
        edges = edges[np.isfinite(edges)]
        channels = zip(plant.channels, _reference(plant), weights, noises, strict=True)
        self._layouts = [_laid_out(*channel, edges) for channel in channels]
        self._noises = list(noises)
        self._coefficients = [np.array(noise.coefficients, dtype=np.float64) for noise in noises]
        self._plant = plant.thinned([layout.kept for layout in self._layouts])
        self._recordings = tuple(plant.channels)
        self._groups: dict[tuple[Nuisance, ...], list[ColumnGroup]] = {}
        self._budget, self._strokes = budget, max(1, len(strokes_of_plant(plant)))
        self.constant = math.fsum(layout.constant for layout in self._layouts)
        self.counts = np.concatenate([layout.counts for layout in self._layouts])

    def without_limit(self) -> Condensed:
        """These rows without a limit of work."""
        same = copy.copy(self)
        same._budget = Budget.unlimited()
        return same

    @functools.cached_property
    def places(self) -> RowPlaces:
        """Time and stroke of each row, whether it is in motion, and its weight."""
        parts = [(layout.times, layout.groups, layout.moves, layout.steady) for layout in self._layouts]
        return places_of([channel.recording for channel in self._recordings], parts)

    def groups(self, nuisances: tuple[Nuisance, ...]) -> list[ColumnGroup]:
        """Nuisances in groups, of which no two act on the same row."""
        if nuisances not in self._groups:
            times = [layout.times for layout in self._layouts]
            self._groups[nuisances] = group_columns([reach_of(nuisance, times) for nuisance in nuisances])
        return self._groups[nuisances]

    def residuals(self, values: Mapping[str, float]) -> Array:
        """(r,) whitened, weighted residuals of all channels in a row (measured − predicted).

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        self._budget.count(self._strokes)
        shown = [prediction[:, None] for prediction in self._plant.predict(values)]
        targets = np.concatenate([layout.target for layout in self._layouts])
        return targets - self._combined(shown)[:, 0]

    def sensitivities(
        self, values: Mapping[str, float], directions: Sequence[Direction]
    ) -> tuple[Array, NDArray[np.bool_]]:
        """(r, k) derivatives of the residuals along directions, and (k,) where the plant knows them.

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        self._budget.count(self._strokes, len(directions))
        return whitened_sensitivities(self._plant, values, directions, lambda columns: -self._combined(columns))

    def whitened_columns(self, columns: Mapping[int, Array]) -> dict[int, tuple[slice, Array]]:
        """The slice of rows of some channels, and (r, q) whitened, weighted columns of (n, q) of all their samples.

        Of a block that is the weighted mean, as of its readings: what rings and hums within it is not one sample's.
        """
        found, start = {}, 0
        for index, (layout, noise) in enumerate(zip(self._layouts, self._noises, strict=True)):
            stop = start + len(layout.at)
            if index in columns:
                own = np.empty(columns[index].shape)
                noise.whiten_into(own, columns[index], layout.squares)
                total = np.add.reduceat(layout.squares, layout.starts)
                used = total > 0.0
                sums = np.add.reduceat(own, layout.starts, axis=0)[used]
                found[index] = slice(start, stop), sums / np.sqrt(total[used])[:, None]
            start = stop
        return found

    def _combined(self, columns: Sequence[Array]) -> Array:
        """(r, k) of all channels, whitened and weighted, from (m, k) each of the samples that are simulated."""
        found = np.empty((len(self.counts), columns[0].shape[1]))
        start = 0
        for of_channel, layout, coefficients in zip(columns, self._layouts, self._coefficients, strict=True):
            own = found[start : start + len(layout.at)]
            given = np.ascontiguousarray(of_channel)
            at, lags, scale = (
                np.ascontiguousarray(column, dtype=np.float64) for column in (layout.at, layout.lags, layout.scale)
            )
            numbers = (at, lags, scale, coefficients)
            _combine()(
                own.ctypes.data, given.ctypes.data, *own.shape, *(column.ctypes.data for column in numbers)
            )  # fmt: skip
            start += len(own)
        return found


def whitened_sensitivities(
    plant: Plant,
    values: Mapping[str, float],
    directions: Sequence[Direction],
    whiten: Callable[[Sequence[Array]], Array],
) -> tuple[Array, NDArray[np.bool_]]:
    """(r, k) derivatives of residuals along directions, no rows where none is known, and (k,) which the plant knows.

    Args:
        plant: the machine. values, directions: as of its `sensitivities`.
        whiten: what makes derivatives of residuals of those of each channel.

    Raises:
        SimulationError: the machine cannot be simulated with these values.
    """
    nothing = np.empty((0, len(directions)))
    if not directions or not isinstance(plant, Differentiable):
        return nothing, np.zeros(len(directions), dtype=bool)
    columns, known = plant.sensitivities(values, directions)
    return (whiten(columns) if known.any() else nothing), known


def _reference(plant: Plant) -> list[Array]:
    """What the declared machine would show in each channel; nothing where it cannot be simulated."""
    try:
        return plant.predict({})
    except SimulationError:
        return [np.zeros_like(channel.data) for channel in plant.channels]


def _laid_out(channel: Channel, reference: Array, weight: Array, noise: Noise, edges: Array) -> _Layout:
    """The rows of a channel.

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
        kept, np.searchsorted(kept, middle), lags, root * gain, root * mean,
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


def combine(
    found: Block, columns: Block, rows: int, count: int, at: Block, lags: Block, scale: Block, coefficients: Block
) -> None:  # fmt: skip
    """Whiten and weight columns of `count` numbers a sample: (rows, count)."""
    for row in range(rows):
        out = found[row * count :]
        place = int(at[row])
        own = columns[place * count :]
        for column in range(count):
            out[column] = own[column]
        most = int(lags[row])
        for lag in range(1, most + 1):
            before = columns[(place - lag) * count :]
            coefficient = coefficients[lag - 1]
            for column in range(count):
                out[column] -= coefficient * before[column]
        factor = scale[row]
        for column in range(count):
            out[column] *= factor


@made_once
def _combine() -> Any:
    return native(combine)
