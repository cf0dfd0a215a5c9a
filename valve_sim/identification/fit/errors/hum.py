"""Hum: the mains, 50 or 60 Hz with harmonics and a steady phase, in a sensor's supply or its ground."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.fit.errors.error import RecordingError, Seen
from valve_sim.identification.plants.protocol import Array

MAINS: Final = (50.0, 60.0)
"""Hz."""
HARMONICS: Final = (1, 2, 3, 4, 5)
"""Of the mains: rectifiers make the second, transformers the third and the fifth."""


def columns(seen: Seen) -> Array:
    """(n, 20) sines and cosines."""
    return waves(seen.times - seen.times[0], rates(seen.times))


def rates(times: Array) -> Array:
    """(h,) rad/s of the harmonics that (n,) samples can show: those above half their rate would repeat lower ones."""
    usual = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    every = 2.0 * math.pi * np.outer(MAINS, HARMONICS).ravel()
    return np.asarray(every[every * usual < math.pi])


def waves(times: Array, own: Array) -> Array:
    """(n, 2 h) sines, then cosines, at (n,) times, s, of (h,) rates, rad/s."""
    angles = np.outer(times, own)
    return np.hstack([np.sin(angles), np.cos(angles)])


def amount(coefficients: Array, _: Array) -> float:
    """The amplitude of all of it: the root of the sum of squares of the harmonics' amplitudes."""
    return float(np.linalg.norm(coefficients))


HUM: Final = RecordingError(
    "hum", "hum of the mains",
    "ground the sensor at one point and keep its cable away from the mains", columns=columns, amount=amount,
    share=4e-4, at_rest=True,
)  # fmt: skip
"""Prior: 0.5 µm of 1.23 mm."""
