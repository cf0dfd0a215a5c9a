"""Commands from a measured voltage: when it stepped, to which level, and how well both are known.

The force grows with the square of the voltage, and 1 mV of 10 V changes the estimate of the pilot plunger's damping by
as much as all the noise of two strokes, so neither the time nor the level of a step can be taken as exact.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.recordings.motion import sample_noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LEVEL_SIGMAS = 10.0
"""Levels nearer to each other than this many standard deviations of the noise are one."""
REST_SIGMAS = 6.0
REST_SHARE = 0.002
"""A voltage rests while `SHORTEST_LEVEL` samples stay within this much of the noise or the span: a ramp does not."""
LEVEL_SHARE = 0.04
"""Levels nearer than this share of the whole span are one: ripple and droop are no commands."""
SHORTEST_LEVEL = 3
"""Samples; a shorter rest is part of the transition from one level to the next."""
SMALLEST_SPAN = 0.05
"""V; a voltage that stays within this was never switched."""
DIODE = 1.5
"""V, of a freewheeling diode at most, or of two in a row."""
OVER_DIODE = 2.0
"""Times that, which the voltage before exceeds: it was switched on."""
ZERO_SHARE = 0.03
"""Levels below this share of the highest are 0 V: the rest is the probe's offset."""


OFFSET_SIGMAS = 3.0
"""A voltage at rest that is further than this many standard errors from 0 shows the probe's offset."""
UNIFORM = 1.0 / np.sqrt(12.0)
"""Standard deviation of a uniform distribution over an interval of length 1."""
BATCHES = 8
"""Parts of a level whose means show slow noise, ripple and droop."""
SHORTEST_BATCH = 5
"""Samples."""
COARSEST = 1.0 / 128.0
"""Share of the span that a converter's step has at most: 8 bits over twice the span."""
ROUNDING = 1e-9
"""Share of the largest reading below which two readings differ for rounding alone."""
SMALLEST_ERROR = 1e-9
"""V: no mean is known more accurately."""


class NoStepError(ValueError):
    """A voltage never changes, so that there is no command in it: one line with what it shows, and the remedy."""


class Steps(NamedTuple):
    """A voltage as commands, and standard deviations of their errors.

    Attributes:
        times: s, shape (k,), the first being the first sample's, the others those of steps.
        volts: V, shape (k,), from each time on.
        time_errors: s, shape (k,); the first is 0: there is no step.
        volt_errors: V, shape (k,); 0 where the level is 0 V. Of levels that read alike the error is one and the same.
        offset: V, what the probe shows of 0 V; it is taken off the levels.
        are_input: Whether the levels, held from step to step, are what the coil saw. Those of a voltage that goes on
            changing between its steps are not; its samples are then the input.
        freewheeled: How often the voltage was that of a diode through which the coil's current died away.
    """

    times: Array
    volts: Array
    time_errors: Array
    volt_errors: Array
    offset: float = 0.0
    are_input: bool = True
    freewheeled: int = 0

    def findings(self, name: str) -> list[str]:
        """Return what was made of a measured voltage of this name, one sentence each."""
        count = len(self.times) - 1
        if self.are_input:
            found = [f"{name}: {count} steps of the measured voltage were taken for the commands"]
        elif count:
            found = [
                f"{name}: the measured voltage itself is the input, because it goes on changing between its steps; "
                f"{count} of these were taken for the commands"
            ]
        else:
            found = [f"{name}: the measured voltage itself is the input, because it changes without a step"]
        if self.freewheeled:
            found.append(f"{name}: a diode's voltage after {self.freewheeled} of the steps to 0 V is no command")
        if self.offset:
            found.append(f"{name}: {self.offset:.3g} V at rest were taken for the probe's offset, and off all levels")
        return found


def find_steps(times: Array, volts: Array) -> Steps:
    """Return when a measured voltage changed its level, and to which, piecewise constant.

    A level is the mean of the samples that rest at it between two steps. A step from one sample to the next is dated in
    the middle between them, because nothing more is known; a slower one where linear interpolation crosses the middle
    between the levels. It may have happened anywhere between the last sample that rests at the old level and the first
    at the new one.

    Args:
        times: s, strictly ascending, shape (n,).
        volts: V, finite, shape (n,).

    Raises:
        NoStepError: The voltage never changes.
    """
    span = float(np.ptp(volts)) if len(volts) else 0.0
    sigma = sample_noise(volts)
    if span < max(SMALLEST_SPAN, 2.0 * LEVEL_SIGMAS * sigma) and span < 0.5 * float(np.abs(volts).max(initial=0.0)) + (
        SMALLEST_SPAN
    ):
        raise NoStepError(
            f"the voltage stays between {volts.min(initial=np.inf):.4g} and {volts.max(initial=-np.inf):.4g} "
            "V: no step in it, so no command; name the coil's voltage, and check unit: and scale:"
        )
    level_of, levels = _all_levels(volts, sigma, span)
    at = np.flatnonzero(level_of >= 0)
    places = np.flatnonzero(np.diff(level_of[at])) + 1
    which = level_of[at[np.concatenate([[0], places])]]
    edges, time_errors = _dates(times, volts, levels[which], at[places - 1], at[places])
    is_off = np.abs(levels[which]) < ZERO_SHARE * float(np.abs(levels).max())
    is_diode = _are_of_a_diode(levels[which], is_off)
    means, errors = np.zeros(len(which)), np.zeros(len(which))
    pieces = [volts[rests] for rests in np.split(at, places)]
    held = levels[which][np.searchsorted(at[places], np.arange(len(volts)), side="right")]
    are_input = float(np.sqrt(np.mean(np.square(volts - held)))) <= max(LEVEL_SHARE * span, LEVEL_SIGMAS * sigma)
    are_input = are_input and not is_diode.any()
    step = _converter_step(pieces, span)
    for alike in (is_off, ~is_off & ~is_diode):  # a supply that is on is noisier than one that is off
        if alike.any():
            means[alike], errors[alike] = _means([pieces[place] for place in np.flatnonzero(alike)], step)
    # What decays to 0 V rests at no level, and so shows no offset.
    offset, offset_error = _offset(means[is_off], errors[is_off]) if are_input else (0.0, 0.0)
    is_off |= is_diode
    # Where the current through a diode has died away nothing is commanded.
    kept = ~(is_off & np.concatenate([[False], is_diode[:-1]]))
    return Steps(
        np.array([float(times[0]), *edges])[kept],
        np.where(is_off, 0.0, means - offset)[kept],
        np.array([0.0, *time_errors])[kept],
        np.where(is_off, 0.0, np.hypot(errors, offset_error))[kept],
        offset,
        are_input,
        int(is_diode.sum()),
    )


def _are_of_a_diode(levels: Array, is_off: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(k,) levels of a diode that a switched-off coil's own current opens: small, of the other sign than before."""
    found = np.zeros(len(levels), dtype=bool)
    before = levels[:-1]
    found[1:] = (levels[1:] * before < 0.0) & (np.abs(levels[1:]) <= DIODE) & (np.abs(before) > OVER_DIODE * DIODE)
    found[:-1] &= is_off[1:]
    return found & ~is_off


def held_between(values: Array) -> Array:
    """The values of a column, (n,), of a log of changes with what is held where its cells are empty (NaN).

    It is such a log where most cells are empty and no value is that of the one before it.
    """
    there = np.isfinite(values)
    changes = values[there]
    if not 0 < len(changes) < len(values) / 2 or not (np.diff(changes) != 0.0).all():
        return values
    first = int(np.argmax(there))
    return np.concatenate([values[:first], changes[np.cumsum(there[first:]) - 1]])


def held_steps(times: Array, volts: Array) -> Steps:
    """Return the commands of rows that hold the voltage in force: each lies between its first row and the one before.

    Args:
        times: s, strictly ascending, shape (n,).
        volts: V, finite, shape (n,).
    """
    first = np.flatnonzero(np.diff(volts)) + 1
    starts, waits = np.concatenate([[0], first]), np.concatenate([[0.0], times[first] - times[first - 1]])
    return Steps(times[starts] - 0.5 * waits, volts[starts], UNIFORM * waits, np.zeros(len(starts)))


def count_levels(volts: Array) -> int:
    """Return how many levels a voltage has; 0 where it rests nowhere."""
    return len(_all_levels(volts, sample_noise(volts), float(np.ptp(volts)))[1]) if len(volts) else 0


def _dates(
    times: Array, volts: Array, found: Array, last: NDArray[np.intp], first: NDArray[np.intp]
) -> tuple[list[float], Array]:
    """Return when steps were, and the standard deviations of that, s.

    Args:
        times: Shape (n,).
        volts: Shape (n,).
        found: Levels before, between and after the steps, V, shape (k + 1,).
        last: The last samples at the levels before, shape (k,).
        first: The first samples at the levels after, shape (k,).
    """
    edges = [
        0.5 * float(times[old] + times[new])
        if new == old + 1
        else _crossing(times[old : new + 1], volts[old : new + 1], 0.5 * (before + after))
        for old, new, (before, after) in zip(last, first, itertools.pairwise(found), strict=True)
    ]
    return edges, UNIFORM * (times[first] - times[last])


def _means(pieces: Sequence[Array], step: float) -> tuple[Array, Array]:
    """Return the means of the pieces of a signal, each at rest, and their standard errors.

    Slow noise, ripple and droop are found by how much more the means of parts scatter than white noise lets them; a
    coarse converter by its steps: where noise does not reach from one to the next, averaging does not help.
    """
    counts = np.array([len(piece) for piece in pieces], dtype=np.float64)
    means = np.array([float(np.mean(piece)) for piece in pieces])
    variance = float(sum(np.sum(np.square(piece - mean)) for piece, mean in zip(pieces, means, strict=True)))
    variance /= max(1.0, float(np.sum(counts - 1.0)))
    errors = np.sqrt(variance * max(1.0, _slowness(pieces, variance)) / counts)
    if step > 0.0:
        noise = max(0.0, variance - (UNIFORM * step) ** 2)
        errors = np.hypot(errors, UNIFORM * step * np.exp(-2.0 * np.pi**2 * noise / step**2))
    return means, errors


def _slowness(pieces: Sequence[Array], variance: float) -> float:
    """Return by how much the variance of means exceeds that of white noise; 1 where there is too little to tell."""
    squares, degrees = 0.0, 0
    for piece in pieces:
        length = len(piece) // BATCHES
        if length >= SHORTEST_BATCH:
            parts = np.mean(piece[: BATCHES * length].reshape(BATCHES, length), axis=1)
            squares += length * float(np.sum(np.square(parts - np.mean(parts))))
            degrees += BATCHES - 1
    return squares / degrees / variance if degrees and variance > 0.0 else 1.0


def _converter_step(pieces: Sequence[Array], span: float) -> float:
    """Return the step of a coarse converter, V; 0 where readings at rest are too many to be counted.

    Where noise reaches no step, nothing shows how wide it is: it is then taken to be as wide as that of 8 bits.
    """
    readings = [np.unique(piece) for piece in pieces]
    if sum(map(len, readings)) >= 0.5 * sum(map(len, pieces)):
        return 0.0
    apart = np.concatenate([np.diff(found) for found in readings])
    apart = apart[apart > ROUNDING * max(float(np.abs(found).max()) for found in readings)]
    return float(np.median(apart)) if len(apart) else COARSEST * span


def _offset(means: Array, errors: Array) -> tuple[float, float]:
    """Return what is shown of 0 V, and its standard error; none where it is as near to 0 as it can be told."""
    if not len(means):
        return 0.0, 0.0
    weights = 1.0 / np.square(np.maximum(errors, SMALLEST_ERROR))
    offset, error = float(np.sum(weights * means) / np.sum(weights)), float(1.0 / np.sqrt(np.sum(weights)))
    return (offset, error) if abs(offset) > OFFSET_SIGMAS * error else (0.0, 0.0)


def _all_levels(volts: Array, sigma: float, span: float) -> tuple[NDArray[np.intp], Array]:
    """Return each sample's level (-1 on the way from one to the next) and the levels, V, ascending."""
    rest, distance = max(REST_SIGMAS * sigma, REST_SHARE * span), max(LEVEL_SIGMAS * sigma, LEVEL_SHARE * span)
    return _levels(volts, rest, distance)


def _levels(volts: Array, rest: float, distance: float) -> tuple[NDArray[np.intp], Array]:
    """Return each sample's level (-1 on the way from one to the next) and the levels, V, ascending.

    Args:
        volts: Shape (n,).
        rest: V; `SHORTEST_LEVEL` samples within it rest.
        distance: V; two levels are at least half of it apart.
    """
    count = len(volts)
    if count < SHORTEST_LEVEL:
        return np.zeros(count, dtype=np.intp), volts[:1]
    windows = np.lib.stride_tricks.sliding_window_view(volts, SHORTEST_LEVEL)
    middle, is_still = np.median(windows, axis=1), np.ptp(windows, axis=1) <= rest
    if not is_still.any():
        return np.zeros(count, dtype=np.intp), np.array([float(np.median(volts))])
    resting = np.sort(middle[is_still])
    groups = np.split(resting, np.flatnonzero(np.diff(resting) > 0.5 * distance) + 1)
    levels = np.array([float(np.median(group)) for group in groups])
    borders = 0.5 * (levels[1:] + levels[:-1])
    level_of = np.full(count, -1, dtype=np.intp)
    for place in range(SHORTEST_LEVEL):
        level_of[place : count - SHORTEST_LEVEL + 1 + place][is_still] = np.searchsorted(borders, middle[is_still])
    return level_of, levels


def _crossing(times: Array, volts: Array, middle: float) -> float:
    """When the voltage first crossed the middle, by a straight line, between a resting sample and the next one."""
    is_over = (volts - middle) * np.sign(volts[-1] - volts[0]) >= 0.0
    first = max(1, int(np.argmax(is_over)))
    low, high = volts[first - 1], volts[first]
    share = (middle - low) / (high - low) if high != low else 1.0
    return float(times[first - 1] + np.clip(share, 0.0, 1.0) * (times[first] - times[first - 1]))
