"""The noise of a sensor, from windows in which the machine is still: theory, eqs. (21) to (25)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.linalg.blas import dtbsv

from valve_sim.identification.fit.errors import hum
from valve_sim.identification.plants.protocol import Channel
from valve_sim.recordings.resting_noise import step_of

Array = NDArray[np.float64]

LARGEST_ORDER: Final = 3
"""Of the autoregression."""
SHORTEST_WINDOW: Final = 100
"""Samples: a shorter quiet window says too little about the noise's colour."""
SHORT_WINDOW: Final = 25
"""Samples: the least where no quiet window is longer; then only the size of the noise is estimated, not its colour."""
BRIDGED: Final = 5
"""Samples left out in a row, such as a spike, between which and their neighbours a line hides little of the noise."""
BLOCK: Final = 64
"""Samples in a block whose mean shows noise slower than the autoregression."""
ENOUGH_AT_REST: Final = 500
"""Samples at seat and at stop from which their noise can be compared."""
PLAINLY_NOISIER: Final = 1.2
"""Standard deviation at one rest over that at the other, beyond chance for that many samples, of coloured noise too."""
DIGITS: Final = 1e-6
"""Of a signal's range: data that are printed to six digits, the least that anybody writes."""
LARGEST_DEGREE: Final = 3
"""Of the drift of what settles."""
PLAIN_DRIFT: Final = 5.0
"""Standard errors of a drift's curve, beyond which it is one: less may be slow noise."""
PLAINLY_MORE: Final = 2.0
"""Times what a model leaves, beyond which noise read at rest was motion; and times a step or rounding, below which it
is these."""
HIDDEN: Final = 0.25
"""Of a step: noise of this standard deviation takes one reading in twenty at rest to another code, less hides."""
DRAWS: Final = 20
"""Of noise like the estimate, by which its bias is known to a quarter of its standard error."""
MOST_DRAWN: Final = 20_000
"""Samples of a draw, and of one window: longer windows have next to no bias."""
SETTLES: Final = 200
"""Samples after which drawn noise has forgotten how it began."""
HUM_PASSES: Final = 3
"""Times that hum is looked for."""
CACHED: Final = 1024
"""Rows that are whitened at a time, so that they stay in the processor's cache."""
COARSE: Final = 2.0
"""A quantisation step above this many standard deviations hides the noise: readings at rest then repeat."""


@dataclass(frozen=True)
class Noise:
    """Noise of one kind of signal: e_t = r_t − Σ φ_k r_{t−k} is white with standard deviation `innovation`.

    Attributes:
        sigma: standard deviation of the noise, in the signal's unit.
        innovation: standard deviation of what whitening leaves; where noise slower than the autoregression makes means
            over blocks scatter by more than white noise would, by as much larger, theory, eq. (24).
        coefficients: (p,) φ, p ≤ 3.
        step: quantisation step, 0 for none seen.
        samples: how many quiet samples it rests on.
    """

    sigma: float
    innovation: float
    coefficients: tuple[float, ...]
    step: float
    samples: int

    def whiten(self, residual: Array) -> Array:
        """Residual in units of the innovation, white if the noise is as estimated; (n,) → (n,)."""
        white = residual.copy()
        for lag, coefficient in enumerate(self.coefficients, start=1):
            white[lag:] -= coefficient * residual[:-lag]
        white /= self.innovation
        return white

    def whiten_into(self, found: Array, columns: Array, weight: Array) -> None:
        """Whiten every column, weighted: (n, k), (n,) → `found`, (n, k), at once, because they are large."""
        self._filter(found, columns)
        found *= (weight / self.innovation)[:, None]

    def _filter(self, found: Array, columns: Array) -> None:
        for start in range(0, len(columns), CACHED):
            end = min(start + CACHED, len(columns))
            found[start:end] = columns[start:end]
            for lag, coefficient in enumerate(self.coefficients[:end], start=1):
                first = max(start, lag)
                found[first:end] -= coefficient * columns[first - lag : end - lag]

    def whiten_rows(self, found: Array, columns: Array, rows: WhiteRows) -> None:
        """Whiten rows of columns, in the signal's unit: (n, k) → `found`, (r, k), which is written."""
        if not self.coefficients:
            np.take(columns, rows.at, axis=0, out=found, mode="clip")
            return
        white = np.empty(columns.shape)
        self._filter(white, columns)
        np.take(white, rows.at, axis=0, out=found, mode="clip")
        found[rows.odd] = columns[rows.at[rows.odd]]
        for coefficient, (late, before) in zip(self.coefficients, rows.late, strict=True):
            found[late] -= coefficient * columns[before]

    def white_rows(self, at: NDArray[np.intp], lags: NDArray[np.intp]) -> WhiteRows:
        """What is whitened of columns.

        Args:
            at: (r,) which row of the columns each is of.
            lags: (r,) over how many rows before it each is whitened; −1: over none.
        """
        odd = np.flatnonzero(lags < np.minimum(at, len(self.coefficients)))
        orders = range(1, len(self.coefficients) + 1)
        late = [odd[lags[odd] >= lag] for lag in orders]
        return WhiteRows(at, odd, [(own, at[own] - lag) for own, lag in zip(late, orders, strict=True)])

    @property
    def is_coarse(self) -> bool:
        """Whether the quantisation step hides the noise."""
        return self.step > COARSE * self.sigma


class WhiteRows(NamedTuple):
    """Which rows of columns are whitened.

    Attributes:
        at: (r,) of which row of the columns each is. odd: those that are not whitened over all rows before them.
        late: for each lag, of the odd ones those that are over so many, and the rows of the columns so much before.
    """

    at: NDArray[np.intp]
    odd: NDArray[np.intp]
    late: list[tuple[NDArray[np.intp], NDArray[np.intp]]]


class Window(NamedTuple):
    """A stretch in which the machine is still: (n,) times, s, and readings, and the name of the channel."""

    times: Array
    values: Array
    channel: str


def estimate_noise(channels: Sequence[Channel], *, may_hum: bool = False) -> Noise:
    """The noise of channels that share a sensor.

    Args:
        channels: of one kind; at least one with samples.
        may_hum: whether hum of the mains is estimated along with their model: what plainly shows of it is no noise.
    """
    if all(channel.noise > 0.0 for channel in channels):
        known = max(channel.noise for channel in channels)
        return Noise(known, known, (), 0.0, sum(channel.count for channel in channels))
    windows = [window for channel in channels for window in quiet_windows(channel)]
    shows_colour = bool(windows)
    if not shows_colour:
        windows = [window for channel in channels for window in quiet_windows(channel, SHORT_WINDOW)]
    step = step_of(np.concatenate([channel.kept(channel.data) for channel in channels]))
    windows = _at_the_quieter_rest(windows)
    if not windows:
        # Never still: the second difference of a smooth motion is nearly all noise.
        bends = np.concatenate([np.diff(channel.data, 2) for channel in channels])
        sigma = max(1.4826 * float(np.median(np.abs(bends))) / math.sqrt(6.0), step / math.sqrt(12.0), _floor(channels))
        return Noise(sigma, sigma, (), step, 0)
    drifts, floor = channels[0].drifts, max(step / math.sqrt(12.0), _floor(channels))
    found = _at_rest(windows, step, floor, drifts=drifts, shows_colour=shows_colour)
    # Beside the noise that is left, more of the hum shows, and more sharply.
    for _ in range(HUM_PASSES if may_hum and shows_colour and found.sigma > floor else 0):
        calm = [
            window
            for name in dict.fromkeys(own.channel for own in windows)
            for window in _without_hum([own for own in windows if own.channel == name], found)
        ]
        found = _at_rest(calm, step, floor, drifts=drifts, shows_colour=shows_colour)
    if step > COARSE * found.sigma:
        # At a low rate the motion itself bends between samples, by more than a step can hide of noise.
        most = math.hypot(step / math.sqrt(12.0), max(found.sigma, HIDDEN * step))
        sigma = max(min(_spread_in_motion(channels, step), most), floor)
        return Noise(sigma, sigma, (), step, found.samples)
    return found


def _at_rest(windows: Sequence[Window], step: float, floor: float, *, drifts: bool, shows_colour: bool) -> Noise:
    """The noise in windows: where a model has the drift of a signal, that is no noise; elsewhere it is."""
    bases = [_drift(own.values) if drifts else _level(own.values) for own in windows]
    values = [_less(own.values, basis) for own, basis in zip(windows, bases, strict=True)]
    samples = sum(map(len, values))
    spread = math.sqrt(sum(float(own @ own) for own in values) / max(1, samples - len(values)))
    if spread < floor:
        return Noise(floor, floor, (), step, samples)
    if step > COARSE * spread:
        return Noise(spread, spread, (), step, samples)
    if not shows_colour:
        return _with_slow_part(Noise(spread, spread, (), step, samples), values, bases, SHORT_WINDOW)
    coefficients, innovation = _autoregression(values, samples)
    found = Noise(spread, innovation, coefficients, step, samples)
    return _with_slow_part(_unbiased(found, [len(own) for own in values], drifts=drifts), values, bases)


def _coloured(noise: Noise, white: Array) -> Array:
    """The noise (n,) that white noise of unit variance (n,) drives: e_t = Σ φ_k e_{t−k} + innovation · white_t.

    A triangular band of ones and −φ_k, solved from its first row on; scipy.signal would take a second to load.
    """
    order = len(noise.coefficients)
    bands = np.repeat(np.concatenate([[1.0], -np.array(noise.coefficients)])[:, None], len(white), axis=1)
    return np.asarray(dtbsv(order, bands, noise.innovation * white, lower=1, diag=1))


def _unbiased(noise: Noise, lengths: Sequence[int], *, drifts: bool) -> Noise:
    """Coloured noise as it is before means and curves of windows are taken off, which take some of what is slow along.

    Noise like the estimate is drawn in such windows and estimated again; what that misses of it, the estimate misses of
    the truth (bootstrap; Efron and Tibshirani 1993, section 10.6).
    """
    if not noise.coefficients:
        return noise
    random, order = np.random.default_rng(DRAWS), len(noise.coefficients)
    # Of a long recording some windows tell as much as all.
    count = 1 + int(np.searchsorted(np.cumsum(lengths), MOST_DRAWN))
    lengths = [min(length, MOST_DRAWN) for length in lengths[:count]]
    again = []
    for _ in range(DRAWS):
        drawn = [_coloured(noise, random.standard_normal(SETTLES + length))[SETTLES:] for length in lengths]
        values = [_less(own, _drift(own) if drifts else _level(own)) for own in drawn]
        size = math.sqrt(sum(float(own @ own) for own in values) / max(1, sum(lengths) - len(values)))
        coefficients, innovation = _autoregression(values, sum(lengths), order)
        # Of the draws the mean square is known: that of what was drawn.
        true = math.sqrt(sum(float(own @ own) for own in drawn) / sum(lengths))
        again.append([*coefficients, innovation / noise.innovation, size / true])
    *means, innovation, size = np.mean(again, axis=0).tolist()
    unbiased = tuple(2.0 * own - mean for own, mean in zip(noise.coefficients, means, strict=True))
    if np.max(np.abs(np.roots([1.0, *(-own for own in unbiased)]))) >= 1.0:
        return noise
    return replace(noise, coefficients=unbiased, innovation=noise.innovation / innovation, sigma=noise.sigma / size)


def _without_hum(windows: Sequence[Window], noise: Noise) -> list[Window]:
    """Windows of one channel less the harmonics of the mains that plainly show above the noise.

    All windows together say how large they are, since their phase is steady. That of another sensor, or of another
    recording, is another.
    """
    start = windows[0].times[0]
    rates = hum.rates(windows[0].times)
    columns = [_white_waves(window, rates, start, noise) for window in windows]
    information = sum((own.T @ own for own, _ in columns), np.zeros((2 * len(rates), 2 * len(rates))))
    pull = sum((own.T @ left for own, left in columns), np.zeros(2 * len(rates)))
    is_plain = np.ones(2 * len(rates), dtype=np.bool_)
    size = np.zeros(2 * len(rates))
    # The least of them is left out until all that are left are plain.
    while is_plain.any():
        kept = np.flatnonzero(is_plain)
        own = information[np.ix_(kept, kept)]
        size[:] = 0.0
        size[kept] = np.linalg.lstsq(own, pull[kept], rcond=1e-10)[0]
        variances = np.full(2 * len(rates), np.inf)
        variances[kept] = np.diag(np.linalg.pinv(own, rcond=1e-10, hermitian=True))
        shown = np.sum(np.square(size.reshape(2, -1)) / variances.reshape(2, -1), axis=0)
        least = int(np.argmin(np.where(is_plain[: len(rates)], shown, np.inf)))
        if shown[least] > PLAIN_DRIFT**2:
            break
        is_plain[[least, least + len(rates)]] = False
    if not is_plain.any():
        return list(windows)
    return [own._replace(values=own.values - hum.waves(own.times - start, rates) @ size) for own in windows]


def _white_waves(window: Window, rates: Array, start: float, noise: Noise) -> tuple[Array, Array]:
    """(n, 2 h) waves and (n,) readings of a window, each less a straight line, in units of the innovation."""
    columns = np.column_stack([hum.waves(window.times - start, rates), window.values])
    lines = np.linalg.qr(legvander(np.linspace(-1.0, 1.0, len(columns)), 1))[0]
    white = np.empty_like(columns)
    noise.whiten_into(white, columns - lines @ (lines.T @ columns), np.ones(len(columns)))
    return white[:, :-1], white[:, -1]


def noise_of_residuals(pieces: Sequence[Array], guess: Noise) -> Noise:
    """The noise of a machine that is never still: what a model leaves, with the colour that it has.

    What that model lacks counts as noise, so that nothing is claimed too easily. Differences of the data would not do:
    of smooth data they show a part of the noise, of jagged data the signal itself.

    Args:
        pieces: (n,) each, measured less modelled, in a row.
        guess: by differences of the data; its quantisation step is kept.
    """
    long = [piece - piece.mean() for piece in pieces if len(piece) > LARGEST_ORDER + 1]
    samples = sum(len(piece) for piece in long)
    spread = math.sqrt(sum(float(piece @ piece) for piece in long) / samples) if samples >= SHORT_WINDOW else 0.0
    floor = guess.step / math.sqrt(12.0)
    if spread <= floor or spread == 0.0:
        return guess
    coefficients, innovation = _autoregression(long, samples)
    found = Noise(spread, max(innovation, 1e-6 * spread), coefficients, guess.step, 0)
    return _with_slow_part(found, long, [_level(piece) for piece in long])


def is_motion(noise: Noise, channels: Sequence[Channel], left: Sequence[Array]) -> bool:
    """Whether noise that was read at rest is plainly more than a model leaves anywhere, so that no rest was one.

    Args:
        noise: of the channels. left: (n,) each, measured less modelled.
    """
    is_read = noise.samples > 0 and not any(channel.noise > 0.0 for channel in channels)
    if not is_read or noise.sigma < PLAINLY_MORE * max(noise.step, _floor(channels)):
        return False
    squares, count = sum(float(own @ own) for own in left), sum(map(len, left))
    return count >= SHORT_WINDOW and noise.sigma > PLAINLY_MORE * math.sqrt(squares / count)


def quiet_windows(channel: Channel, shortest: int = SHORTEST_WINDOW) -> list[Window]:
    """The stretches of a channel in which the machine is still, each of at least `shortest` samples.

    A few that are left out in a row are bridged, so that spikes do not cut windows to pieces; more end a window.
    """
    quiet = channel.quiet
    if channel.left_out is not None:
        quiet = quiet.copy()
        for start, stop in stretches(channel.left_out):
            if stop - start > BRIDGED:
                quiet[start:stop] = False
    return [
        Window(channel.times[start:stop], channel.data[start:stop], channel.name)
        for start, stop in stretches(quiet)
        if stop - start >= shortest
    ]


def stretches(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(start, stop) of each run of True in (n,) mask."""
    if not len(mask):
        return []
    changes = 1 + np.flatnonzero(mask[1:] != mask[:-1])
    edges = np.concatenate([[0] if mask[0] else [], changes, [len(mask)] if mask[-1] else []]).astype(np.intp)
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _at_the_quieter_rest(windows: list[Window]) -> list[Window]:
    """Windows at one rest only, seat or stop, where the other is plainly noisier: vibration is no sensor noise."""
    if not windows:
        return windows
    levels = [float(window.values.mean()) for window in windows]
    middle = 0.5 * (min(levels) + max(levels))
    rests = [
        [window for window, level in zip(windows, levels, strict=True) if (level > middle) == is_high]
        for is_high in (False, True)
    ]
    if any(sum(len(window.values) for window in rest) < ENOUGH_AT_REST for rest in rests):
        return windows
    quieter, louder = sorted(rests, key=_spread)
    return quieter if _spread(louder) > PLAINLY_NOISIER * _spread(quieter) else windows


def _level(window: Array) -> Array:
    """(n, 1) of a window, whose mean is taken off."""
    return np.full((len(window), 1), 1.0 / math.sqrt(len(window)))


def _drift(window: Array) -> Array:
    """(n, d) orthonormal curves that are taken off a window: a straight line, and more where it plainly settles.

    Over three time constants a cubic follows an exponential to half a percent of its height.
    """
    lines = legvander(np.linspace(-1.0, 1.0, len(window)), LARGEST_DEGREE)
    basis = np.linalg.qr(lines)[0]
    sizes = basis.T @ window
    left = window - basis @ sizes
    variance = float(left @ left) / max(1, len(window) - len(sizes))
    plain = np.flatnonzero(np.square(sizes) > PLAIN_DRIFT**2 * variance)
    degree = max(1, int(plain[-1]) if len(plain) else 0)
    return np.asarray(basis[:, : degree + 1])


def _less(window: Array, basis: Array) -> Array:
    """A window without what it has of orthonormal curves."""
    return np.asarray(window - basis @ (basis.T @ window))


def _spread(windows: Sequence[Window]) -> float:
    """Standard deviation within windows."""
    squares = sum(float(np.sum(np.square(own.values - own.values.mean()))) for own in windows)
    return math.sqrt(squares / max(1, sum(len(own.values) - 1 for own in windows)))


def still_runs(data: Array) -> Array:
    """(n,) how many identical readings in a row each sample is one of."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(data)) + 1, [len(data)]])
    lengths = np.diff(edges)
    return np.repeat(lengths, lengths).astype(np.float64)


def readings_near(data: Array, level: float, margin: float) -> int:
    """How many readings there are before the first that is off a level; those long after it are not looked at."""
    done, size = 0, 256
    while done < len(data):
        off = np.flatnonzero(np.abs(data[done : done + size] - level) > margin)
        if len(off):
            return done + int(off[0])
        done, size = done + size, 2 * size
    return len(data)


def _spread_in_motion(channels: Sequence[Channel], step: float) -> float:
    """Noise and rounding together, from the second differences of samples that move by more than two steps.

    At rest a coarse sensor hides its noise; in motion rounding is white (Widrow 1956) and the plunger's own second
    difference is far below a step. Impacts are the outliers that are left out.
    """
    bends = []
    for channel in channels:
        moves = np.abs(channel.data[2:] - channel.data[:-2]) > 2.0 * step
        if channel.left_out is not None:
            moves &= ~(channel.left_out[2:] | channel.left_out[1:-1] | channel.left_out[:-2])
        bends.append(np.diff(channel.data, 2)[moves])
    bend = np.concatenate(bends)
    if len(bend) < 30:
        return 0.0
    kept = bend[np.abs(bend - np.median(bend)) < 4.0 * step]
    return float(np.std(kept)) / math.sqrt(6.0) if len(kept) > 30 else 0.0


def _floor(channels: Sequence[Channel]) -> float:
    """What no noise is smaller than: what rounding makes of noise-free data, and a millionth of the signal's range.

    The millionth stands for what a plant does not say of itself: how accurately it predicts, and with how many digits
    its data were written.
    """
    known = max(channel.resolution for channel in channels)
    return max(known, DIGITS * max(float(np.ptp(channel.data)) for channel in channels)) + 1e-15


def _autoregression(
    windows: Sequence[Array], samples: int, order: int | None = None
) -> tuple[tuple[float, ...], float]:
    """Coefficients and innovation by Burg's recursion over several windows (Burg 1975; Kay 1988, section 7.3).

    Where it is not given, the order is that of the smallest n ln P + 2 m ln n: Schwarz's criterion with twice its
    penalty, theory, eq. (23). Schwarz's own takes 1 in 100 white noises of 2000 samples for coloured, this one fewer
    than 1 in 1000.
    """
    reflections: list[float] = []
    power = sum(float(window @ window) for window in windows) / samples
    coefficients = np.empty(0)
    best = (samples * math.log(power), coefficients, power)
    for count in range(1, (order or LARGEST_ORDER) + 1):
        sums = [_products(window, reflections) for window in windows]
        reflection = 2.0 * sum(product for product, _ in sums) / sum(squares for _, squares in sums)
        reflections.append(reflection)
        coefficients = np.concatenate([coefficients - reflection * coefficients[::-1], [reflection]])
        power *= 1.0 - reflection * reflection
        score = samples * math.log(power) + 2.0 * count * math.log(samples)
        if score < best[0] or count == order:
            best = (score, coefficients.copy(), power)
    return tuple(float(value) for value in best[1]), math.sqrt(best[2])


def _products(window: Array, reflections: Sequence[float]) -> tuple[float, float]:
    """Σ f b and Σ f² + b² of what predictions of a window forward and backward leave, the latter a sample before.

    They are computed again for each order: those of all windows of a long recording would be most of the memory.
    """
    forward = backward = window
    for reflection in reflections:
        forward, backward = (
            forward[1:] - reflection * backward[:-1],
            backward[:-1] - reflection * forward[1:],
        )
    ahead, behind = forward[1:], backward[:-1]
    return float(ahead @ behind), float(ahead @ ahead + behind @ behind)


def _with_slow_part(noise: Noise, windows: Sequence[Array], bases: Sequence[Array], block: int = BLOCK) -> Noise:
    """Noise whose innovation is larger by what noise slower than the autoregression adds to means over blocks."""
    return replace(noise, innovation=noise.innovation * math.sqrt(_excess_of_means(noise, windows, bases, block)))


def _excess_of_means(noise: Noise, windows: Sequence[Array], bases: Sequence[Array], block: int) -> float:
    """Variance of block means over that of white noise, at least 1: theory, eq. (24). 1 where blocks are too few.

    Curves that were taken off windows, (n, d) orthonormal each, took some of white noise along, too.
    """
    squares, expected, count = 0.0, 0.0, 0
    for window, basis in zip(windows, bases, strict=True):
        blocks = len(window) // block
        if not blocks:
            continue
        white, whole = noise.whiten(window), slice(blocks * block)
        squares += float(np.sum(np.square(white[whole].reshape(blocks, block).sum(axis=1)))) / block
        expected += blocks - float(np.sum(np.square(basis[whole].reshape(blocks, block, -1).sum(axis=1)))) / block
        count += blocks
    if count < 10:
        return 1.0
    ratio = squares / expected
    # Chance alone gives a ratio within two standard errors of one.
    return ratio if ratio > 1.0 + 2.0 * math.sqrt(2.0 / expected) else 1.0
