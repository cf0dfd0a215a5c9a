"""Does the inductance that the current shows pull as hard as the ball is heavy? Co-energy against weight.

A magnet pulls with F = ∂W'/∂x, W' = ∫ R φ dw: what inductance gains as the ball approaches is paid for by motional EMF
and done as work, with no free parameter (Woodson and Melcher, Electromechanical Dynamics, 1968, chapter 3). Where the
ball lifts off its support, that force is its weight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from benchmarks.maglev.plant import BEFORE, Magnet
from benchmarks.maglev.records import MagnetRecord

RESISTANCE: Final = 4.17
"""Ω of the coil, by the owners of the rig (plant/parameters/parameters_lagrangian.m)."""
WEIGHT: Final = 0.06054 * 9.81
"""N of the ball, which they weighed (plant/parameters/parameters_common.m)."""
LIFTED: Final = 0.3e-3
"""m by which the ball has left its support; three times what its distance varies by while it lies 20 mm away."""
SMOOTHED: Final = 8
"""Samples over which distance and current are averaged."""


class Lift(NamedTuple):
    """Where a ball leaves its support.

    Attributes:
        source: the record. distance: m. current: A. before: s that this is before the jump.
    """

    source: str
    distance: float
    current: float
    before: float


def lift_of(record: MagnetRecord) -> Lift:
    """The last time before the jump at which the ball is within `LIFTED` of where it lay `BEFORE` earlier."""
    assert record.jump is not None
    still = max(0, record.jump - round(BEFORE / record.interval))
    lay = float(np.median(record.distance[max(0, still - SMOOTHED) : still + SMOOTHED]))
    last = int(np.flatnonzero(record.distance[: record.jump] > lay - LIFTED)[-1])
    near = slice(max(0, last + 1 - SMOOTHED), last + 1)
    return Lift(
        record.source, float(np.median(record.distance[near])), float(np.mean(record.current[near])),
        float(record.times[record.jump] - record.times[last]),
    )  # fmt: skip


def pull(values: Mapping[str, float], distance: float, current: float) -> float:
    """N: the derivative of the co-energy of a fitted magnet to the way towards it."""
    magnet = Magnet.of(values)
    gap = 1.0 + distance / magnet.gap_length
    inductance = magnet.inductance / gap**2
    gain = 2.0 / (magnet.gap_length * gap)  # −d(inductance)/dz over inductance
    if math.isinf(magnet.ball_flux):
        return 0.5 * RESISTANCE * inductance * gain * current**2
    if inductance == 0.0:
        return 0.0
    # ∫ x sech² x dx = x tanh x − ln cosh x, with x = inductance · w / ball_flux.
    full = inductance * current / magnet.ball_flux
    work = full * math.tanh(full) - math.log(math.cosh(full))
    return RESISTANCE * gain * magnet.ball_flux**2 / inductance * work


def shares_of_weight(values: Mapping[str, float], lifts: Sequence[Lift]) -> list[float]:
    """Pull over weight where each ball lifts: 1 if inductance and force agree."""
    return [pull(values, lift.distance, lift.current) / WEIGHT for lift in lifts]
