"""Ringing: the mount of the sensor is kicked by each contact of the plungers and rings at a frequency of its own.

A contact takes momentum from the plungers, which the mount gets: what the sensor shows after it is

    p/p₀ · e^(−t/τ) (b₁ sin ωt + b₂ cos ωt),   p₀ that of all that moves at 0.3 m/s

with coefficients that are the same for all contacts at one place. Contacts differ from each other by more than that, so
each has a pair of its own beside. Frequencies and decays are not linear: `modes_in` looks for them in what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize

from valve_sim.identification.estimation.errors.error import Mode, RecordingError, Seen
from valve_sim.identification.plants.protocol import Array

LOWEST, HIGHEST = 200.0, 5000.0
"""Hz, between which mounts of sensors ring."""
FREQUENCIES: Final = 40
"""Of the grid, evenly spaced in the logarithm."""
DECAYS: Final = (0.6e-3, 1.5e-3, 4e-3)
"""s, of the grid."""
SHORTEST_DECAY, LONGEST_DECAY = 0.3e-3, 8e-3
"""s, half of the grid's shortest and twice its longest: what dies away faster is a contact, and slower a hum."""
FASTEST: Final = 0.4
"""Of the sampling rate, up to which a mode is looked for."""
LONGEST: Final = 6.0
"""Decays after which a mode has died away."""


def _ring(seen: Seen, mode: Mode) -> tuple[Array, Array]:
    """(n, k) sine and cosine of a mode after each of k contacts, times its momentum."""
    since = seen.times[:, None] - seen.contacts.times
    is_after = (since >= 0.0) & (since < LONGEST * mode.decay)
    within = since[is_after]
    size = np.exp(-within / mode.decay) * np.broadcast_to(seen.contacts.impulses, since.shape)[is_after]
    angle = 2.0 * math.pi * mode.frequency * within
    waves = np.zeros((2, *since.shape))
    waves[:, is_after] = size * np.sin(angle), size * np.cos(angle)
    return waves[0], waves[1]


def columns(seen: Seen) -> Array:
    """(n, q) for each mode and each place where plungers meet a sine and a cosine."""
    found = [
        wave[:, seen.contacts.places == place].sum(axis=1)
        for mode in seen.modes
        for place in np.unique(seen.contacts.places)
        for wave in _ring(seen, mode)
    ]
    return np.column_stack(found) if found else np.empty((len(seen.times), 0))


def own_columns(seen: Seen) -> Array:
    """(n, q) for each mode and each contact a sine and a cosine."""
    found = [wave for mode in seen.modes for wave in _ring(seen, mode)]
    return np.hstack(found) if found else np.empty((len(seen.times), 0))


def amount(coefficients: Array) -> float:
    """The largest amplitude of a mode, after an impact of all that moves at 0.3 m/s."""
    return float(np.max(np.hypot(coefficients[0::2], coefficients[1::2])))


RINGING: Final = RecordingError(
    "ringing", "ringing of the mount",
    "stiffen the mount, or fix it to another body than the valve's", columns=columns, amount=amount,
    share=1.6e-3,
)  # fmt: skip
"""Prior: 2 µm of 1.23 mm after an impact at 0.3 m/s."""
RINGING_SCATTER: Final = RecordingError(
    "ringing_scatter", "ringing that differs from contact to contact",
    RINGING.what_to_do, columns=own_columns,
    share=4e-4,
)  # fmt: skip
"""Prior: 0.5 µm. With 40 % from contact to contact a recording without it reads as something unnamed."""


def grid(interval: float) -> list[Mode]:
    """Modes that are tried for samples at this interval, s."""
    highest = min(HIGHEST, FASTEST / interval)
    if highest <= LOWEST:
        return []
    frequencies = np.geomspace(LOWEST, highest, FREQUENCIES).tolist()
    return [Mode(frequency, decay) for frequency in frequencies for decay in DECAYS]


def refined(mode: Mode, cost: Callable[[Mode], float], interval: float) -> Mode:
    """The mode of the least cost near one of the grid, by a simplex in the logarithms of frequency and decay.

    Args:
        mode: of the grid. cost: of a mode. interval: of the samples, s.
    """
    start: Any = np.log([mode.frequency, mode.decay])
    simplex = start + np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.5]])
    limits = np.log([(LOWEST, min(HIGHEST, FASTEST / interval)), (SHORTEST_DECAY, LONGEST_DECAY)])
    options: Any = {"initial_simplex": np.clip(simplex, *limits.T), "maxfev": 60, "xatol": 1e-4, "fatol": 1e-2}

    def cost_at(logs: Array) -> float:
        return cost(Mode(*np.exp(logs).tolist()))

    found = minimize(cost_at, start, method="Nelder-Mead", bounds=limits.tolist(), options=options)
    return Mode(*np.exp(found.x).tolist())
