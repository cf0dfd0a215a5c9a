"""Ringing: the mount of the sensor is kicked by each contact of the plungers and rings at a frequency of its own.

A contact takes momentum from the plungers, which the mount gets: what the sensor shows after it is

    p/p₀ · e^(−t/τ) (b₁ sin ωt + b₂ cos ωt),   p₀ that of all that moves at 0.3 m/s

with coefficients that are the same for all contacts at one place. Contacts differ from each other by more than that, so
each has a pair of its own beside. Frequencies and decays are not linear: `modes_in` looks for them in what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np

from valve_sim.identification.fit.errors.error import Mode, RecordingError, Seen
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


def _rings(seen: Seen, mode: Mode) -> Iterator[tuple[slice, Array]]:
    """For each contact the samples in which a mode rings after it, and (2, m) its sine and cosine there."""
    begins = np.searchsorted(seen.times, seen.contacts.times)
    ends = np.searchsorted(seen.times, seen.contacts.times + LONGEST * mode.decay)
    contacts = zip(begins.tolist(), ends.tolist(), seen.contacts.times, seen.contacts.impulses, strict=True)
    for begin, end, time, impulse in contacts:
        since = seen.times[begin:end] - time
        angle = 2.0 * math.pi * mode.frequency * since
        yield slice(begin, end), impulse * np.exp(-since / mode.decay) * np.stack([np.sin(angle), np.cos(angle)])


def columns(seen: Seen) -> Array:
    """(n, q) for each mode and each place where plungers meet a sine and a cosine."""
    places, which = np.unique(seen.contacts.places, return_inverse=True)
    found = np.zeros((len(seen.times), len(seen.modes), len(places), 2))
    for number, mode in enumerate(seen.modes):
        for place, (during, waves) in zip(which.tolist(), _rings(seen, mode), strict=True):
            found[during, number, place] += waves.T
    return found.reshape(len(seen.times), -1)


def own_columns(seen: Seen) -> Array:
    """(n, q) for each mode and each contact a sine and a cosine."""
    found = np.zeros((len(seen.times), len(seen.modes), len(seen.contacts.times), 2))
    for number, mode in enumerate(seen.modes):
        for contact, (during, waves) in enumerate(_rings(seen, mode)):
            found[during, number, contact] = waves.T
    return found.reshape(len(seen.times), -1)


def amount(coefficients: Array, _: Array) -> float:
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
    """The mode of the least cost near one of the grid, by a simplex in the logarithms of frequency and decay."""
    from scipy.optimize import minimize

    start: Any = np.log([mode.frequency, mode.decay])
    simplex = start + np.array([[0.0, 0.0], [0.03, 0.0], [0.0, 0.5]])
    limits = np.log([(LOWEST, min(HIGHEST, FASTEST / interval)), (SHORTEST_DECAY, LONGEST_DECAY)])
    options: Any = {"initial_simplex": np.clip(simplex, *limits.T), "maxfev": 60, "xatol": 1e-4, "fatol": 1e-2}

    def cost_at(logs: Array) -> float:
        return cost(Mode(*np.exp(logs).tolist()))

    found = minimize(cost_at, start, method="Nelder-Mead", bounds=limits.tolist(), options=options)
    return Mode(*np.exp(found.x).tolist())
