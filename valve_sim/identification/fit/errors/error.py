"""What an error of a recording is: columns, the prior of its size, and what a laboratory can do about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from valve_sim.identification.plants.protocol import Array, Contacts


class Mode(NamedTuple):
    """One way in which a sensor's mount rings.

    Attributes:
        frequency: Hz. decay: time constant, s.
    """

    frequency: float
    decay: float


class Seen(NamedTuple):
    """What the columns of an error are made from.

    Attributes:
        times: (n,) s, of the samples. shown: (n,) what the model shows, in the channel's unit.
        span: range of the channel, in its unit. knots: (c,) s, between which the zero of a sensor drifts evenly.
        contacts: impacts that shake the sensor. modes: of its mount.
        low: where the range begins, in the channel's unit.
    """

    times: Array
    shown: Array
    span: float
    knots: Array
    contacts: Contacts
    modes: tuple[Mode, ...] = ()
    low: float = 0.0


@dataclass(frozen=True)
class RecordingError:
    """An error of a recording.

    Attributes:
        name: in report.json. title: for people.
        what_to_do: one sentence for the laboratory.
        columns: (n, q) of what each coefficient of size 1 adds to a channel; None of an error that acts on the machine,
            whose coefficients are nuisances of the plant.
        share: scale of the prior of its size, as a share of the channel's range; 0: there is none, unless the sensor
            says so.
        is_known: whether its size is that scale, as a data sheet says it, and not learned.
        is_normal: whether the prior of the size is half of a normal density, not of a Cauchy density.
        at_rest: whether its size is read while the machine is still, where nothing else moves what is shown: in motion
            it would follow what a model lacks.
        stays: whether another recording of the same valve and sensor has an error of the same size.
        amount: of (q,) coefficients and their (n, q) columns, if any, what is reported of them; None: the size that
            they share.
        is_relative: whether that is reported as a share of the channel's range.
    """

    name: str
    title: str
    what_to_do: str
    columns: Callable[[Seen], Array] | None = None
    share: float = 0.0
    is_known: bool = False
    is_normal: bool = False
    at_rest: bool = False
    stays: bool = False
    amount: Callable[[Array, Array], float] | None = None
    is_relative: bool = False
