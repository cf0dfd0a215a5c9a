"""The columns of the recordings' errors among the rows of a fit: each acts on the rows of its own channel alone."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.gram import gram
from valve_sim.identification.plants.protocol import Array


class Block(NamedTuple):
    """The columns of one channel: the rows that they act on, the numbers (p,) of the columns, and (m, p) values."""

    rows: slice
    places: NDArray[np.intp]
    values: Array


class WhiteColumns:
    """Whitened, weighted columns (r, q), of which only what is not zero is held.

    Args:
        blocks: of the channels. rows: r. count: q.
    """

    def __init__(self, blocks: Sequence[Block], rows: int, count: int) -> None:
        self.blocks, self.rows, self.count = tuple(blocks), rows, count
        self._chosen: dict[tuple[int, ...], WhiteColumns] = {}

    def chosen(self, places: Sequence[int]) -> WhiteColumns:
        """Some of the columns, in the order of their numbers here; the same object each time."""
        key = tuple(places)
        if key not in self._chosen:
            blocks = []
            for block in self.blocks:
                own = np.isin(block.places, key)
                if own.any():
                    blocks.append(Block(block.rows, np.searchsorted(key, block.places[own]), block.values[:, own]))
            self._chosen[key] = WhiteColumns(blocks, self.rows, len(key))
        return self._chosen[key]

    @cached_property
    def products(self) -> Array:
        """(q, q) Bᵀ B."""
        found = np.zeros((self.count, self.count))
        for block in self.blocks:
            found[np.ix_(block.places, block.places)] = gram(block.values, block.values)
        return found

    def onto(self, rows: Array) -> Array:
        """(q, m) Bᵀ times (r, m) rows, or (q,) of (r,)."""
        found = np.zeros((self.count, *rows.shape[1:]))
        for block in self.blocks:
            found[block.places] = gram(block.values, rows[block.rows])
        return found

    def __matmul__(self, coefficients: Array) -> Array:
        """(r,) B times (q,) coefficients."""
        found = np.zeros(self.rows)
        for block in self.blocks:
            found[block.rows] += block.values @ coefficients[block.places]
        return found

    def dense(self) -> Array:
        """(r, q) all of them."""
        found = np.zeros((self.rows, self.count))
        for block in self.blocks:
            found[block.rows, block.places] = block.values
        return found
