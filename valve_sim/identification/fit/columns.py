"""The errors of a recording as unknowns: coefficients of columns, and numbers of the machine that vary.

What a sensor shows is the truth, noise, and B b, with coefficients b ~ N(0, s²) of columns B that each kind of error
has (`errors`): drift, hum, scale, bend, ringing. What varies of the machine from stroke to stroke, and the resistance
of its source, are numbers of the machine with the same kind of prior. The sizes s are learned beside a model.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from valve_sim.identification.fit.errors import ERRORS
from valve_sim.identification.fit.errors.error import Mode, RecordingError, Seen
from valve_sim.identification.fit.errors.hum import HUM
from valve_sim.identification.fit.priors import Normal
from valve_sim.identification.fit.unknown import DIFFERENCE, Group, Law, Unknown, known
from valve_sim.identification.plants.protocol import Array, Channel, Nuisance, Plant, Sensor, SharedSize

BY_NAME: Final[Mapping[str, RecordingError]] = {error.name: error for error in ERRORS}


@dataclass(frozen=True)
class Columns:
    """The errors of all recordings of a plant.

    Attributes:
        unknowns: coefficients of columns, in the order of the columns. varying: what acts on the machine.
        samples: by the index of a channel, (n, q) what its coefficients of size 1 add to each of its samples.
        first: by the index of a channel, the number of its first column.
        modes: of the mounts of the sensors, by channel.
        spans: by the index of a channel, the range of its sensor, in the channel's unit.
        changing: effects that differ from stroke to stroke.
    """

    unknowns: tuple[Unknown, ...] = ()
    varying: tuple[Unknown, ...] = ()
    samples: Mapping[int, Array] = field(default_factory=dict)
    first: Mapping[int, int] = field(default_factory=dict)
    modes: Mapping[int, tuple[Mode, ...]] = field(default_factory=dict)
    spans: Mapping[int, float] = field(default_factory=dict)
    changing: tuple[str, ...] = ()

    @property
    def groups(self) -> dict[str, Group]:
        """By name, all groups of both."""
        return {own.group.name: own.group for own in (*self.unknowns, *self.varying) if own.group}

    def held_at(self, sizes: Mapping[str, float]) -> Columns:
        """These errors, those with a size that is known no longer learned; by the names of `known_name`."""

        def held(own: Unknown) -> Unknown:
            if own.group is None or known_name(own.group) not in sizes:
                return own
            return replace(own, group=replace(own.group, is_held=True))

        return replace(self, unknowns=tuple(map(held, self.unknowns)), varying=tuple(map(held, self.varying)))


def known_name(group: Group) -> str:
    """What a group is in any recording: of what varies of the machine, the name without the recording's number."""
    kind = group.key.what if isinstance(group.key, SharedSize) else ""
    return f"{group.error} {kind}".rstrip()


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


def columns_of(
    plant: Plant, values: Mapping[str, float], modes: Mapping[int, tuple[Mode, ...]], changing: tuple[str, ...] = ()
) -> Columns:
    """The errors that the recordings of a plant may have.

    Args:
        plant: the machine and its data. values: by which it is simulated, for columns of what is shown.
        modes: of the mounts of its sensors, by channel. changing: effects that differ from stroke to stroke.

    Raises:
        SimulationError: the machine cannot be simulated with these values.
    """
    sensors = plant.sensors(values)
    shown = plant.predict(values) if sensors else []
    unknowns: list[Unknown] = []
    samples, first = dict[int, Array](), dict[int, int]()
    for index, sensor in sensors.items():
        channel = plant.channels[index]
        seen = seen_by(sensor, channel, shown[index], modes.get(index, ()))
        key = index if sensor.alike is None else sensor.alike
        rests = rests_often(plant.channels[key])
        parts, first[index] = [], len(unknowns)
        for error in ERRORS:
            share = sensor.shares.get(error.name, error.share)
            own = np.empty((0, 0)) if error.columns is None or share == 0.0 else error.columns(seen)
            if not own.shape[1]:
                continue
            # Where the model may be wrong at rest, what stays there is not the sensor's; what hums is.
            reads = rests and (sensor.is_true_at_rest or error is HUM)
            group = _group(key, error, share * sensor.span, reads_at_rest=reads)
            parts.append(own)
            unknowns += [
                Unknown(
                    f"{group.name}.{number}@{index}", Normal(0.0, group.scale), 0.0, scale=group.scale,
                    step=DIFFERENCE * group.scale, unit=channel.unit, column=len(unknowns) + number, group=group,
                    of_machine=False,
                )
                for number in range(own.shape[1])
            ]  # fmt: skip
        samples[index] = np.hstack(parts) if parts else np.empty((len(channel.times), 0))
    varying = [*plant.varying, *changes_of(plant, changing)]
    spans = {index: own.span for index, own in sensors.items()}
    return Columns(tuple(unknowns), varying_unknowns(varying), samples, first, dict(modes), spans, changing)


def changes_of(plant: Plant, effects: Iterable[str]) -> list[Nuisance]:
    """How much some effects differ from stroke to stroke."""
    return [own for effect in effects for own in plant.changing(effect)]


def varying_unknowns(varying: Sequence[Nuisance]) -> tuple[Unknown, ...]:
    """What acts on the machine, with the groups whose sizes are learned."""
    return tuple(
        known(own, _group(own.group, BY_NAME[own.error], own.sigma)) for own in varying if own.group is not None
    )


def _group(key: int | SharedSize, error: RecordingError, scale: float, *, reads_at_rest: bool = False) -> Group:
    law: Law = "known" if error.is_known else "normal" if error.is_normal else "cauchy"
    return Group(
        key, error.name, scale, law, error.at_rest and reads_at_rest, stays=error.stays,
        of_machine=isinstance(key, SharedSize),
    )  # fmt: skip
