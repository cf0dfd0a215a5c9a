"""The false-alarm probability of the search: a bootstrap of the whole search on noise, theory, eqs. (55) and (56).

A catalogue of some twenty effects, each with its shapes, finds something in any noise. How much is estimated from the
residual of the best model: it is cut into blocks, and each block is multiplied by a random number, which keeps size,
colour and quantisation (block wild bootstrap; Shao, J. Am. Stat. Assoc. 105, 2010, p. 218). All effects are then fitted
to it, linearly about the declared model: one Gauss–Newton step, together with dampings, clock offset and stamps. The
largest gain of S over all effects and shapes is what the search finds in that noise. The search goes on to a second
effect only where the first was decisive, so that the first effect is enough.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from scipy.special import chdtrc, chdtri

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.selection.score_test import Outside, directions_of

RESAMPLES: Final = 2000
BLOCK: Final = 64
"""Samples multiplied by one number: many correlation times of the whitened residual."""


class FalseAlarm(NamedTuple):
    """How much the search finds in noise alone.

    Attributes:
        probability: that it finds as much as it found here. gain: what it found, in S. usual: the 99 % quantile of
            what it finds in noise. resamples: how many were tried.
    """

    probability: float
    gain: float
    usual: float
    resamples: int


NOT_ASKED: Final = FalseAlarm(1.0, 0.0, 0.0, 0)
"""Where the time was too short for the bootstrap."""


def false_alarm(base: Fit, best: Fit, seed: int = 0) -> FalseAlarm:
    """Bootstrap the search.

    Args:
        base: without effects, its nuisances those of `best`.
        best: the fit whose residual is white.
        seed: of the random numbers, so that a diagnosis repeats.
    """
    gain = base.score - best.score
    random = np.random.default_rng(seed)
    largest = np.zeros(RESAMPLES)
    weights = random.standard_normal((RESAMPLES, -(-len(best.residuals) // BLOCK)))
    outside = Outside(base)
    for effect in base.problem.plant.effects.values():
        if effect.is_declared_value:
            # What noise does to it, its tolerance takes up: its column is one of the base's.
            continue
        price = len(effect.free_names()) * math.log(base.problem.effective_samples)
        for directions in directions_of(base, effect):
            basis = outside.basis(directions)
            found = weights @ _by_block(basis * best.residuals[:, None])
            gains = np.sum(np.square(found), axis=1) / base.problem.variance_inflation - price
            largest = np.maximum(largest, gains)
    probability = (1.0 + float(np.count_nonzero(largest >= gain))) / (1.0 + RESAMPLES)
    return FalseAlarm(probability, gain, float(np.quantile(largest, 0.99)), RESAMPLES)


def false_alarm_of_few(base: Fit, best: Fit, tried: int) -> FalseAlarm:
    """The same by theory, where a few effects were pointed at and no others searched for.

    In noise χ² falls as its distribution says, for each of the effects (Bonferroni).

    Args:
        base, best: as of `false_alarm`. tried: how many effects were pointed at.
    """
    added = max(1, len(best.free) - len(base.free))
    fall = (base.chi2 - best.chi2) / best.problem.variance_inflation
    probability = min(1.0, tried * float(chdtrc(added, max(fall, 0.0))))
    price = added * math.log(base.problem.effective_samples)
    return FalseAlarm(probability, base.score - best.score, float(chdtri(added, 0.01 / tried)) - price, 0)


def _by_block(products: Array) -> Array:
    """(n, p) → (blocks, p) sums over blocks."""
    return np.asarray(np.add.reduceat(products, np.arange(0, len(products), BLOCK), axis=0))
