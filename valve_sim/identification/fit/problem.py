"""The data of a fit as whitened residuals: measured channels, their noise, and the samples that take part."""

from __future__ import annotations

import contextlib
import copy
import functools
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.fit.columns import Columns
from valve_sim.identification.fit.noise import (
    LARGEST_ORDER,
    SHORT_WINDOW,
    Noise,
    estimate_noise,
    is_motion,
    noise_of_residuals,
    quiet_windows,
    readings_near,
    still_runs,
    stretches,
)
from valve_sim.identification.fit.priors import Prior, prior_of
from valve_sim.identification.fit.rows import CondensedRows, Rows
from valve_sim.identification.fit.white_columns import Block, WhiteColumns
from valve_sim.identification.plants.protocol import (
    Array,
    Plant,
    primary_channels,
)
from valve_sim.model import SimulationError
from valve_sim.recordings.left_out import largest_beside, running_median

STALE: Final = ("white_columns",)
"""What follows from the errors of the recordings and from the noise."""
OF_WEIGHTS: Final = ("_condensed_rows", "every_row", "_weights", "samples", "effective_samples")
"""What follows from the weights of samples; the first two from the noise, too."""
Mask = Callable[[int, NDArray[np.integer]], NDArray[np.bool_]]

LONGEST_RUN: Final = 4
"""Identical readings in a row, beyond which a coarse sensor repeats one reading."""
LONG: Final = 100_000
"""Residuals, some 2.5 s of position and current at 20 kHz: of more a fit does not hold its derivatives."""
APART: Final = 6.0
"""Standard deviations off what is left beside it, at which a reading is as probably no measurement as one."""
EVEN, SURELY = 0.5, 1e-3
"""Probabilities of being a measurement, below which a reading is weighted, and takes no part."""
LEVELS: Final = (256.0, 64.0, 16.0, 4.0, 1.0)
"""By how much readings that stand apart are farther off, in turn."""
OFTEN: Final = 0.25
"""Share of the strokes in which readings stand apart where motion bends, above which it is the model that bends."""
ELSEWHERE: Final = 4.0
"""Steps of a coarse sensor by which the declared model misses it, beyond which the model does not say what is still."""


class Problem:
    """Measured channels, their noise, and which samples take part.

    Args:
        plant: the machine and its data.
        takes_part: (channel index, (n,) groups) → (n,) mask of samples that are fitted; default all.
        noises: noise by kind of channel; default estimated from the channels.
        budget: of the fits to it; default no limit.

    Attributes:
        columns: the errors that its recordings may have.
    """

    def __init__(
        self,
        plant: Plant,
        takes_part: Mask | None = None,
        noises: Mapping[str, Noise] | None = None,
        budget: Budget | None = None,
    ) -> None:
        self.plant = plant
        self._condenses = False
        self.columns = Columns()
        self.budget = budget or Budget.unlimited()
        self.noises = _noises(plant) if noises is None else dict(noises)
        self._given = [self._weight(index, takes_part) for index in range(len(plant.channels))]
        self._trust: dict[int, Array] = {}

    def restricted(self, takes_part: Mask) -> Problem:
        """This problem with other samples taking part; data and noise are kept."""
        same = Problem(self.plant, takes_part, self.noises, self.budget)
        same.columns, same._trust = self.columns, self._trust
        return same

    @functools.cached_property
    def _weights(self) -> list[Array]:
        return [own * self._trust[index] if index in self._trust else own for index, own in enumerate(self._given)]

    @functools.cached_property
    def samples(self) -> int:
        """How many samples take part."""
        return sum(int(np.count_nonzero(weight)) for weight in self._weights)

    @functools.cached_property
    def effective_samples(self) -> float:
        """How many of them are measurements of their own."""
        return float(sum(map(_effective, self._weights)))

    def with_columns(self, columns: Columns) -> Problem:
        """This problem with these errors of its recordings; without any where it is too long for their columns."""
        return self._changed(*STALE, columns=Columns() if self.is_long else columns)

    @functools.cached_property
    def white_columns(self) -> WhiteColumns:
        """(r, q) what coefficients of the recordings' errors take from the residuals of the rows that fits compare."""
        columns, rows = self.columns, self.rows
        blocks = [
            Block(where, columns.first[channel] + np.arange(own.shape[1]), -own)
            for channel, (where, own) in rows.whitened_columns(columns.samples).items()
        ]
        return WhiteColumns(blocks, len(rows.places.time), len(columns.unknowns))

    def _changed(self, *stale: str, **fields: object) -> Problem:
        """This problem with other fields, and without what was worked out from those that they replace."""
        same = copy.copy(self)
        for name in stale:
            same.__dict__.pop(name, None)
        same.__dict__.update(fields)
        return same

    def with_noise_left_by(self, values: Mapping[str, float]) -> Problem:
        """This problem with the noise of what is never still taken from what these values leave of it."""
        never_still = {kind for kind, noise in self.noises.items() if noise.samples == 0}
        pieces = self._left_by(values, never_still)
        return self.with_noises(
            {**self.noises, **{kind: noise_of_residuals(found, self.noises[kind]) for kind, found in pieces.items()}}
        )

    def moves_at_rest(self, values: Mapping[str, float]) -> set[str]:
        """Kinds of channel whose noise at rest is plainly more than these values leave: they moved all the time."""
        pieces = self._left_by(values, set(self.noises))
        return {
            kind
            for kind, found in pieces.items()
            if is_motion(self.noises[kind], [own for own in self.plant.channels if own.kind == kind], found)
        }

    def without_rest(self, kinds: Collection[str]) -> Problem:
        """This problem, of which the noise of some kinds of channel is not known."""
        return self.with_noises({kind: replace(self.noises[kind], samples=0) for kind in kinds}) if kinds else self

    def _left_by(self, values: Mapping[str, float], kinds: set[str]) -> dict[str, list[Array]]:
        """Measured less predicted, in each group of each channel, by kind."""
        shown = self.plant.predict(values)
        pieces: dict[str, list[Array]] = {kind: [] for kind in kinds}
        for index, channel in enumerate(self.plant.channels):
            for group in np.unique(channel.group) if channel.kind in kinds else ():
                chosen = (channel.group == group) & (self.weight(index) > 0.0)
                pieces[channel.kind].append((channel.data - shown[index])[chosen])
        return pieces

    def with_noises(self, noises: Mapping[str, Noise]) -> Problem:
        """This problem with other noise; data and samples are kept."""
        own = {kind: noises.get(kind, noise) for kind, noise in self.noises.items()}
        return self._changed(*STALE, *OF_WEIGHTS[:2], noises=own)

    def without_outliers(self, values: Mapping[str, float], level: float = 1.0) -> Problem:
        """This problem with readings weighted by their probability of being measurements, beside a machine's values.

        What a model lacks is left of many readings in a row, what electronics add of a few: so a reading is compared
        with the running median of what is left. Where motion bends few may be the model's, too, but in many strokes.

        Args:
            values: of the machine. level: by how much a reading is farther off, while values still follow outliers.
        """
        if self.is_long:
            return self
        trust, is_changed = dict(self._trust), False
        for index, (channel, shown) in enumerate(zip(self.plant.channels, self.plant.predict(values), strict=True)):
            noise, given = self.noise_of(index), self._given[index] > 0.0
            left = noise.whiten(channel.data - shown)
            apart = (left - running_median(left)) / level
            is_one = expit(0.5 * (APART**2 - np.square(apart)))
            bends = largest_beside(np.abs(np.diff(shown, 2, prepend=shown[:1], append=shown[-1:]))) > noise.innovation
            is_off = given & (is_one < EVEN)
            if not is_off.any():
                continue
            strokes = np.unique(channel.group[given & bends])
            if len(np.unique(channel.group[is_off & bends])) > OFTEN * len(strokes):
                is_one = np.where(bends, np.square(self._trust.get(index, 1.0)), is_one)
            trust[index], is_changed = np.where(is_one < SURELY, 0.0, np.sqrt(is_one)), True
        return self._changed(*STALE, *OF_WEIGHTS, _trust=trust) if is_changed else self

    def condensed(self) -> Problem:
        """This problem for fits that sum up what is read while the machine is still."""
        return self._changed(*STALE, "_condensed_rows", _condenses=True)

    @property
    def rows(self) -> Rows:
        """What fits compare: each sample, or the equivalent of all of them in fewer rows."""
        return self._condensed_rows or self.every_row

    @functools.cached_property
    def every_row(self) -> Rows:
        """Each sample by itself."""
        return Rows(self.plant, self._weights, self._noise_of_each, self.budget)

    @functools.cached_property
    def _condensed_rows(self) -> CondensedRows | None:
        plant = self.plant
        if not self._condenses or self.is_long or not plant.can_be_thinned:
            return None
        return CondensedRows(plant, self._weights, self._noise_of_each, self.budget)

    @property
    def _noise_of_each(self) -> list[Noise]:
        return [self.noise_of(index) for index in range(len(self.plant.channels))]

    def residuals(self, values: Mapping[str, float]) -> Array:
        """(n,) whitened, weighted residuals of each sample of all channels in a row (measured − predicted).

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        return self.every_row.residuals(values)

    @property
    def noise(self) -> Noise:
        """The noise of the response in which errors are reported."""
        return self.noise_of(primary_channels(self.plant)[0])

    def prior(self, name: str) -> Prior:
        """The prior of a freed parameter, in the coordinate in which it is searched."""
        return prior_of(self.plant, name)

    def noise_of(self, index: int) -> Noise:
        """The noise of a channel."""
        return self.noises[self.plant.channels[index].kind]

    def weight(self, index: int) -> Array:
        """(n,) how much each sample of a channel counts; 0 where it takes no part."""
        return self._weights[index]

    def left_out(self, index: int) -> NDArray[np.bool_] | None:
        """(n,) readings of a channel that are no measurements, or stand apart; None where all are."""
        known = self.plant.channels[index].left_out
        if index not in self._trust:
            return known
        found: NDArray[np.bool_] = self._trust[index] == 0.0
        return found if known is None else known | found

    @property
    def is_long(self) -> bool:
        """Whether a fit only adds its residuals up."""
        return is_long(self.plant)

    def _weight(self, index: int, takes_part: Mask | None) -> Array:
        channel = self.plant.channels[index]
        # One number that stands for all: a weight for each sample of a long recording is large.
        weight: Array = np.broadcast_to(1.0, len(channel.data))
        noise = self.noise_of(index)
        if noise.step > 0.0 and noise.is_coarse:
            # A coarse sensor at rest repeats one reading; a thousand copies are not a thousand measurements. The runs
            # are the declared model's: weights by the readings themselves depend on their errors, which with 1 µm
            # of noise and 5 µm steps biases the dampings by 0.16 standard errors.
            shown = self.plant.predict({})[index]
            runs = still_runs(np.round(shown / noise.step))
            weight = np.where(runs > LONGEST_RUN, 1.0 / np.sqrt(runs), weight)
            is_elsewhere = np.abs(channel.data - shown) > ELSEWHERE * noise.step
            for start, stop in stretches(channel.quiet):
                weight[start:stop] = np.minimum(weight[start:stop], 1.0 / math.sqrt(stop - start))
                # A valve that stays where the declared one moves is still for longer than what is surely quiet.
                still = np.arange(*_stays(channel.data, start, stop, noise.step))
                missed = still[is_elsewhere[still]]
                weight[missed] = np.minimum(weight[missed], 1.0 / math.sqrt(len(still)))
        if channel.left_out is not None:
            # Whitening would carry what is between two readings into those after it, and a line between them is no
            # motion: at 2 kHz it is off by 60 µm. The noise of what is never still is known later: of any order.
            order = len(noise.coefficients) if noise.samples else LARGEST_ORDER
            weight = np.where(_reached(channel.left_out, order), 0.0, weight)
        if takes_part is not None:
            weight = np.where(takes_part(index, channel.group), weight, 0.0)
        return weight


def weigh_outliers(
    problem: Problem, values: Mapping[str, float], again: Callable[[Problem], Mapping[str, float]]
) -> None:
    """Weigh the outliers of a problem, the farthest first, since a fit follows them.

    Args:
        values: of a fit to it. again: told a problem with other weights, fits to it; returns its values.
    """
    for level in LEVELS if problem.without_outliers(values) is not problem else ():
        robust = problem.without_outliers(values, level)
        if robust is not problem:
            problem, values = robust, again(robust)


def is_long(plant: Plant) -> bool:
    """Whether there are so many samples that a fit only adds residuals up, where the plant gives them in pieces."""
    return sum(len(channel.data) for channel in plant.channels) > LONG and plant.comes_in_pieces


def _noises(plant: Plant) -> dict[str, Noise]:
    """The noise of each kind of channel."""
    humming = _humming(plant)
    return {
        kind: estimate_noise([channel for channel in plant.channels if channel.kind == kind], may_hum=kind in humming)
        for kind in sorted({channel.kind for channel in plant.channels})
    }


def _humming(plant: Plant) -> set[str]:
    """Kinds of the channels whose hum fits estimate along; none of a long recording, whose errors have no columns."""
    if is_long(plant):
        return set()
    with contextlib.suppress(SimulationError):
        return {plant.channels[index].kind for index in plant.sensors({})}
    return set()


def shows_rest(plant: Plant) -> bool:
    """Whether a plant's channels are ever known to be still for long enough to show a sensor's noise."""
    return any(quiet_windows(channel, SHORT_WINDOW) for channel in plant.channels)


def _reached(left_out: NDArray[np.bool_], order: int) -> NDArray[np.bool_]:
    """(n,) samples that are left out, and those whose whitened residuals rest on one."""
    found = left_out.copy()
    for lag in range(1, order + 1):
        found[lag:] |= left_out[:-lag]
    return found


def _effective(weight: Array) -> float:
    """How many samples there are, of which copies of one reading count once."""
    return float(np.sum(np.minimum(weight, 1.0) ** 2)) if any(weight.strides) else float(len(weight))


def _stays(data: Array, start: int, stop: int, step: float) -> tuple[int, int]:
    """Where a coarse sensor that is still from `start` to `stop` begins and ends to read so, but for one step."""
    level, margin = float(np.median(data[start:stop])), 1.5 * step
    return start - readings_near(data[:start][::-1], level, margin), stop + readings_near(data[stop:], level, margin)
