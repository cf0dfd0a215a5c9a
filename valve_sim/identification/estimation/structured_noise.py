"""The errors of a recording as noise of known forms: columns B, and sizes s of their coefficients.

What a sensor shows is the truth, noise, and B b with b ~ N(0, S), S the squares of the sizes s of each error. Over all
values of b the whitened residuals have the covariance

    V = 1 + B S Bᵀ = 1 + U diag(λ) Uᵀ,    V^(−1/2) = 1 − U diag(1 − 1/√(1 + λ)) Uᵀ,    |V| = Π (1 + λ)

so that a fit whose rows are whitened by V^(−1/2) has estimated all of b along, with its prior, and frees no
parameter for it. (Gaussian processes of pulsar timing are treated so: van Haasteren and Vallisneri, Phys. Rev. D 90,
2014, 104012.) The coefficients are b̂ = (Bᵀ B + S⁻¹)⁻¹ Bᵀ e where they are asked for: to be shown, or taken out.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.estimation.errors import ERRORS
from valve_sim.identification.estimation.errors.error import LARGEST, SMALLEST, Mode, RecordingError, Seen
from valve_sim.identification.estimation.gram import gram
from valve_sim.identification.plants.protocol import Array, Channel, HasSensors, Nuisance, Plant, Sensor

HELD: Final = 0.3
"""Of the scale of its prior, the size of an error before the data are asked."""
GONE: Final = 1e-2
"""Of the scale of its prior: nuisances of a smaller size are left out of fits."""
ROUNDING: Final = 1e-10
"""Of the largest, below which an eigenvalue is rounding."""


class Group(NamedTuple):
    """Coefficients of an error that share a size.

    Attributes:
        key: the channel by its index, or the group's name of nuisances. error: which.
        scale: of the prior of the size, in the unit of the coefficients.
        is_read: whether the size has been read at rest, and is not learned any more.
        is_held: whether the size is known from elsewhere.
        span: range of the channel, in its unit. shows_rest: whether the size can be read at rest.
    """

    key: int | str
    error: RecordingError
    scale: float
    is_read: bool = False
    is_held: bool = False
    span: float = 1.0
    shows_rest: bool = True

    @property
    def is_learned(self) -> bool:
        """Whether the size is learned beside a model."""
        return not (self.error.is_known or self.is_read or self.is_held)

    @property
    def is_of_machine(self) -> bool:
        """Whether the error acts on the machine, and not on what a sensor shows."""
        return isinstance(self.key, str)

    @property
    def kind(self) -> str:
        """What it is in any recording: of nuisances the name without the recording's number."""
        return self.key.partition("[")[0] if isinstance(self.key, str) else ""

    @property
    def held(self) -> float:
        """The size before the data are asked."""
        return self.scale if self.error.is_known else HELD * self.scale

    @property
    def bounds(self) -> tuple[float, float]:
        """Between which the size is looked for."""
        return (self.scale, self.scale) if self.error.is_known else (SMALLEST * self.scale, LARGEST * self.scale)

    def is_gone(self, size: float) -> bool:
        """Whether an error of a size is as good as none."""
        return size < GONE * self.scale


class ChannelColumns(NamedTuple):
    """The columns of a channel.

    Attributes:
        samples: (n, q), of coefficients in the channel's unit. owners: (q,) number of the group of each.
    """

    samples: Array
    owners: NDArray[np.intp]


@dataclass(frozen=True)
class StructuredNoise:
    """The errors of all recordings of a plant.

    Attributes:
        groups: of coefficients. sizes: (g,) of each, in the unit of its channel.
        columns: by the index of the channel. modes: of the mount of the sensor of each channel.
        varying: nuisances of the plant whose sizes are learned; their prior's standard deviation is its scale.
    """

    groups: tuple[Group, ...]
    sizes: Array
    columns: Mapping[int, ChannelColumns]
    modes: Mapping[int, tuple[Mode, ...]]
    varying: tuple[Nuisance, ...] = ()

    @property
    def numbers(self) -> dict[tuple[int | str, str], int]:
        """By key and name of the error, the number of each group."""
        return {(own.key, own.error.name): number for number, own in enumerate(self.groups)}

    @property
    def nuisances(self) -> tuple[Nuisance, ...]:
        """Those of the plant that are there, with the sizes that they have."""
        found, numbers = [], self.numbers
        for own in self.varying:
            number = numbers[own.group, own.error]
            size = float(self.sizes[number])
            if not self.groups[number].is_gone(size):
                found.append(own._replace(sigma=size))
        return tuple(found)

    def columns_of(self, number: int) -> Array:
        """(n, q) columns of a group, of the first of its channels; (0, 1) of an error that acts on the machine."""
        for samples, owners in self.columns.values():
            if np.any(owners == number):
                return samples[:, owners == number]
        return np.empty((0, 1))

    def resized(self, sizes: Array) -> StructuredNoise:
        """These errors with other sizes."""
        return replace(self, sizes=sizes)

    def as_known(self, known: StructuredNoise | None) -> StructuredNoise:
        """These errors; those of the machine and of its sensors' curves are as large as other recordings have them.

        What is held there is held here.
        """
        if known is None:
            return self
        held = {_known_name(own) for own in known.groups if own.is_held}
        same = self.held_at({name: size for name, size in known.known_sizes.items() if name in held})
        sizes = {(own.kind, own.error.name): size for own, size in zip(known.groups, known.sizes.tolist(), strict=True)}
        kept = [
            sizes.get((own.kind, own.error.name), size) if own.error.stays else size
            for own, size in zip(same.groups, same.sizes.tolist(), strict=True)
        ]
        return same.resized(np.array(kept))

    @property
    def known_sizes(self) -> dict[str, float]:
        """The size of each error, by its name and, of what varies of the machine, by what that is."""
        return {_known_name(own): size for own, size in zip(self.groups, self.sizes.tolist(), strict=True)}

    def held_at(self, known: Mapping[str, float]) -> StructuredNoise:
        """These errors with sizes that are known, by the names of `known_sizes`, and are not learned any more."""
        groups = tuple(own._replace(is_held=own.is_held or _known_name(own) in known) for own in self.groups)
        pairs = zip(self.groups, self.sizes.tolist(), strict=True)
        return replace(self, groups=groups, sizes=np.array([known.get(_known_name(own), size) for own, size in pairs]))

    def with_read(self, sizes: Array) -> StructuredNoise:
        """These errors with the sizes, (g,), of those that are read at rest, which are not learned any more."""
        is_read = [own.error.at_rest and own.shows_rest and not own.is_held for own in self.groups]
        groups = tuple(own._replace(is_read=read) for own, read in zip(self.groups, is_read, strict=True))
        return replace(self, groups=groups, sizes=np.where(is_read, sizes, self.sizes))

    def unlearned(self) -> StructuredNoise:
        """These errors as large as before the data are asked, but for those whose size has been read or is held."""
        pairs = zip(self.groups, self.sizes.tolist(), strict=True)
        return self.resized(np.array([size if own.is_read or own.is_held else own.held for own, size in pairs]))

    def without_varying(self) -> StructuredNoise:
        """Without errors that act on the machine, but for those that are held."""
        return self._with_varying(lambda own: own.bounds[0])

    def with_varying(self) -> StructuredNoise:
        """With errors that act on the machine as they are before the data are asked, but for those that are held."""
        return self._with_varying(lambda own: own.held)

    def _with_varying(self, size_of: Callable[[Group], float]) -> StructuredNoise:
        pairs = zip(self.groups, self.sizes.tolist(), strict=True)
        changed = [size_of(own) if own.is_of_machine and not own.is_held else size for own, size in pairs]
        return self.resized(np.array(changed))

    @property
    def log_prior(self) -> float:
        """Ln of the prior density of the sizes."""
        return sum(
            own.error.log_prior(size, own.scale) for own, size in zip(self.groups, self.sizes.tolist(), strict=True)
        )


def _known_name(group: Group) -> str:
    return f"{group.error.name} {group.kind}".rstrip()


def rests_often(channel: Channel) -> bool:
    """Whether the machine is known to be still in most strokes: a single rest does not show how far a zero drifts."""
    return 2 * len(np.unique(channel.group[channel.quiet])) > len(np.unique(channel.group))


def seen_by(sensor: Sensor, channel: Channel, shown: Array, modes: tuple[Mode, ...]) -> Seen:
    """What the columns of a sensor's errors are made from.

    Args:
        sensor: whose. channel: what it has recorded. shown: (n,) what the model shows there. modes: of its mount.
    """
    knots = sensor.knots
    if knots is None:
        begins = channel.times[np.unique(channel.group, return_index=True)[1]]
        edges = np.sort(np.append(begins, channel.times[-1:]))
        knots = np.sort(np.concatenate([edges, 0.5 * (edges[1:] + edges[:-1])]))
    return Seen(channel.times, shown, sensor.span, knots, sensor.contacts, modes, sensor.low)


def structured_noise(
    plant: Plant,
    values: Mapping[str, float],
    modes: Mapping[int, tuple[Mode, ...]],
    before: StructuredNoise | None = None,
) -> StructuredNoise | None:
    """The errors of a plant's sensors; None where it has no sensors that err.

    Args:
        plant: the machine and its data. values: by which it is simulated, for columns of what is shown.
        modes: of the mounts of sensors, by channel. before: whose sizes are kept.

    Raises:
        SimulationError: the machine cannot be simulated with these values.
    """
    if not isinstance(plant, HasSensors):
        return None
    sensors = plant.sensors(values)
    if not sensors and not plant.varying:
        return None
    shown = plant.predict(values)
    groups: list[Group] = []
    columns: dict[int, ChannelColumns] = {}
    for index, sensor in sensors.items():
        channel = plant.channels[index]
        seen = seen_by(sensor, channel, shown[index], modes.get(index, ()))
        key = index if sensor.alike is None else sensor.alike
        shows_rest = sensor.is_true_at_rest and rests_often(plant.channels[key])
        parts, owners = [], []
        for error in ERRORS:
            share = sensor.shares.get(error.name, error.share)
            own = np.empty((0, 0)) if error.columns is None or share == 0.0 else error.columns(seen)
            if own.shape[1]:
                group = Group(key, error, share * sensor.span, span=sensor.span, shows_rest=shows_rest)
                if group not in groups:
                    groups.append(group)
                owners += [groups.index(group)] * own.shape[1]
                parts.append(own)
        if parts:
            columns[index] = ChannelColumns(np.hstack(parts), np.array(owners, dtype=np.intp))
    errors = {error.name: error for error in ERRORS}
    for nuisance in plant.varying:
        group = Group(nuisance.group, errors[nuisance.error], nuisance.sigma)
        if group not in groups:
            groups.append(group)
    known = {} if before is None else dict(zip(before.numbers, before.sizes.tolist(), strict=True))
    same = {} if before is None else {(own.key, own.error.name): own for own in before.groups}
    groups = [same.get((own.key, own.error.name), own)._replace(scale=own.scale) for own in groups]
    sizes = [known.get((own.key, own.error.name), own.held) for own in groups]
    return StructuredNoise(tuple(groups), np.array(sizes), columns, dict(modes), tuple(plant.varying))


class _Block(NamedTuple):
    """What whitens the rows of one channel: (r, q) U, and (q,) 1 − 1/√(1 + λ)."""

    rows: slice
    axes: Array
    shrink: Array


class ErrorRows:
    """The errors on the rows of a fit.

    Args:
        noise: the errors, with their sizes.
        columns: by channel the slice of its rows, and (r, q) its whitened, weighted columns.

    Attributes:
        log_constant: −½ ln |V| with ln of the prior of the sizes.
    """

    def __init__(self, noise: StructuredNoise, columns: Mapping[int, tuple[slice, Array]]) -> None:
        self.noise, self._columns = noise, columns
        self._blocks: list[_Block] = []
        volume = 0.0
        for channel, (rows, own) in columns.items():
            sized = own * noise.sizes[noise.columns[channel].owners]
            eigenvalues, directions = np.linalg.eigh(gram(sized, sized))
            kept = eigenvalues > ROUNDING * max(float(eigenvalues[-1]), 1.0)
            found = eigenvalues[kept]
            volume += float(np.sum(np.log1p(found)))
            axes = sized @ (directions[:, kept] / np.sqrt(found))
            self._blocks.append(_Block(rows, axes, 1.0 - 1.0 / np.sqrt(1.0 + found)))
        self.log_constant = noise.log_prior - 0.5 * volume

    def resized(self, sizes: Array) -> ErrorRows:
        """These errors with other sizes."""
        return ErrorRows(self.noise.resized(sizes), self._columns)

    def whiten(self, rows: Array) -> Array:
        """V^(−1/2) of (r, k) columns."""
        found = rows.copy()
        for block in self._blocks:
            own = rows[block.rows]
            found[block.rows] -= block.axes @ (block.shrink[:, None] * gram(block.axes, own))
        return found

    def dense(self, count: int) -> tuple[Array, NDArray[np.intp]]:
        """(r, q) columns on so many rows, and (q,) the group of each."""
        owners = np.concatenate(
            [np.empty(0, dtype=np.intp), *(self.noise.columns[channel].owners for channel in self._columns)]
        )
        found, start = np.zeros((count, len(owners))), 0
        for rows, own in self._columns.values():
            found[rows, start : start + own.shape[1]] = own
            start += own.shape[1]
        return found, owners

    @functools.cached_property
    def covariances(self) -> dict[int, Array]:
        """(q, q) of the coefficients of each channel, in the channel's unit, where all else is known."""
        found = {}
        for channel, (_, own) in self._columns.items():
            sizes = self.noise.sizes[self.noise.columns[channel].owners]
            sized = own * sizes
            found[channel] = np.linalg.inv(gram(sized, sized) + np.eye(len(sizes))) * np.outer(sizes, sizes)
        return found

    def estimates(self, residuals: Array) -> dict[int, Array]:
        """(q,) coefficients of each channel, in the channel's unit, given (r,) residuals."""
        return {
            channel: covariance @ gram(self._columns[channel][1], residuals[self._columns[channel][0]])
            for channel, covariance in self.covariances.items()
        }


def shown_by(
    noise: StructuredNoise, estimates: Mapping[int, Array], names: Sequence[str] | None = None
) -> dict[int, Array]:
    """(n,) what the errors add to each channel; those of some names, or all."""
    found = {}
    for channel, coefficients in estimates.items():
        samples, owners = noise.columns[channel]
        taken = np.array([names is None or noise.groups[owner].error.name in names for owner in owners.tolist()])
        found[channel] = samples[:, taken] @ coefficients[taken]
    return found
