"""Bend: the sensor's curve is not straight over the range, by what its data sheet calls linearity."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.polynomial.legendre import legvander

from valve_sim.identification.fit.errors.error import RecordingError, Seen
from valve_sim.identification.plants.protocol import Array

PLACES: Final = 101
"""Over the range, at which the largest deviation is looked for."""
LARGEST_DEGREE: Final = 5
"""Of the polynomials: with fewer an S of 3 µm leaves 0.3 µm, and a damping that is off by four standard errors."""


def columns(seen: Seen) -> Array:
    """(n, 6) polynomials of what is shown that are 0 at both ends, each less likely than the one before it."""
    return _curves(np.clip((seen.shown - seen.low) / seen.span, 0.0, 1.0))


def amount(coefficients: Array, _: Array) -> float:
    """The largest deviation from a straight line."""
    return float(np.max(np.abs(_curves(np.linspace(0.0, 1.0, PLACES)) @ coefficients)))


def _curves(at: Array) -> Array:
    degrees = np.arange(LARGEST_DEGREE + 1)
    return np.asarray((at * (1.0 - at))[:, None] * legvander(2.0 * at - 1.0, LARGEST_DEGREE) / (1.0 + 0.5 * degrees))


BEND: Final = RecordingError(
    "bend", "linearity of the sensor",
    "mount the sensor without tilt in the middle of its range, or calibrate its curve", columns=columns,
    amount=amount, stays=True,
    share=1e-3,
)  # fmt: skip
"""Prior: half-Cauchy 0.1 % of the range, the usual line of a data sheet on linearity."""
