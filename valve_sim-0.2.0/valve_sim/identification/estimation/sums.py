"""What a fit needs of long recordings: sums over their residuals, gathered piece by piece."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.estimation.noise import Noise
from valve_sim.identification.plants.protocol import Array, Channel, Piece


class Sums(NamedTuple):
    """Sums over n whitened, weighted residuals e and their derivatives J along k directions.

    Attributes:
        squares: eᵀ e. gradient: (k,) Jᵀ e. information: (k, k) Jᵀ J.
    """

    squares: float
    gradient: Array
    information: Array


class Weighted(NamedTuple):
    """A channel, its noise, and (n,) how much each of its samples counts."""

    channel: Channel
    noise: Noise
    weight: Array


def summed(pieces: Iterable[Piece], channels: Sequence[Weighted], count: int) -> Sums:
    """Add up the pieces of a prediction; `count`: how many derivatives they have."""
    total = np.zeros((1 + count, 1 + count))
    before = [np.empty((0, 1 + count)) for _ in channels]
    for piece in pieces:
        own, known = channels[piece.channel], before[piece.channel]
        rows = _rows(piece, own.channel, known)
        first, order = len(known), len(own.noise.coefficients)
        before[piece.channel] = rows[max(0, len(rows) - order) :].copy()
        white = np.empty_like(rows)
        own.noise.whiten_into(white, rows, own.weight[piece.start - first : piece.start + len(rows) - first])
        total += gram(white[first:], white[first:])
    return Sums(float(total[0, 0]), total[0, 1:], total[1:, 1:])


def _rows(piece: Piece, channel: Channel, before: Array) -> Array:
    """(n, 1 + k) measured less shown, and derivatives of that, after the rows that colour the noise of the first."""
    rows = np.empty((len(before) + len(piece.shown), before.shape[1]))
    rows[: len(before)] = before
    own = rows[len(before) :]
    np.subtract(channel.data[piece.samples], piece.shown, out=own[:, 0])
    np.negative(piece.columns, out=own[:, 1:])
    return rows
