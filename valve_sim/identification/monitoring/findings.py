"""A stroke as cut out of the stream, and what is found of it, as data: a fault, its use, or why it has none."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from valve_sim.model import Reading
from valve_sim.recordings import Trace


class StrokeState(enum.Enum):
    """The use that was made of a stroke."""

    COMMISSIONING = enum.auto()
    """It is one of the first, to which the baseline is fitted."""
    WATCHING = enum.auto()
    """It was compared with the baseline."""
    TIMING_UNCERTAIN = enum.auto()
    """Only its shape was compared: samples carry stamps, commands do not."""
    NOT_JUDGED = enum.auto()
    """It could not be compared."""


@dataclass(frozen=True)
class DidNotOpen:
    """The pilot plunger did not reach the main plunger; travel: m, how far it came."""

    travel: float


@dataclass(frozen=True)
class OpenedPartly:
    """The valve opened to `travel` of its `stroke`, m."""

    travel: float
    stroke: float


@dataclass(frozen=True)
class WaitsForPressure:
    """The pilot is open, and the pressure that it relieves still holds the main plunger; travel: m, as far as the gap.

    Of a valve with gas, longer than the model waits.
    """

    travel: float


@dataclass(frozen=True)
class DidNotClose:
    """Without voltage the pilot plunger stayed at `position`, m."""

    position: float


Fault: TypeAlias = DidNotOpen | OpenedPartly | WaitsForPressure | DidNotClose


class Unusable(enum.Enum):
    """Why a stroke cannot be compared with the model, whatever the valve did."""

    TIMED_OUT = enum.auto()
    """It did not end before `stroke_timeout`."""
    TOO_LONG = enum.auto()
    """It has more samples or commands than are kept."""
    NOT_AT_REST = enum.auto()
    """The valve or the model was not at rest when it began."""
    PRESSURE_UNKNOWN = enum.auto()
    """With gas: it began before its samples, or before a pressure at an end of the valve was first heard."""
    TOO_FEW_SAMPLES = enum.auto()
    """Too few samples between its first command and its last."""
    OTHER_SENSOR = enum.auto()
    """The valve was commissioned on positions, and it has none; or the other way round."""
    HELD_TOO_BRIEFLY = enum.auto()
    """The valve was held open for less than half as long as commanded: when its voltage was off is too uncertain."""
    SAMPLES_MISSING = enum.auto()
    """Samples are missing while it moved."""
    COMMANDS_UNSEEN = enum.auto()
    """The coil's voltage, which shows the commands of other strokes, does not show those of this one."""
    UNCOMMANDED = enum.auto()
    """It moved otherwise than by the commands that came in: some were lost or late."""
    HEARD_LATE = enum.auto()
    """Its samples came in so late that its commands may have been late, or lost, too."""

    @property
    def is_incomplete(self) -> bool:
        """Whether messages are missing or late, so that it says nothing about the valve."""
        cls = Unusable
        return self in (cls.TOO_FEW_SAMPLES, cls.SAMPLES_MISSING, cls.COMMANDS_UNSEEN, cls.UNCOMMANDED, cls.HEARD_LATE)


@dataclass(frozen=True)
class TimingTooUncertain:
    """The model was open for `held` s only: a valve whose commands' times are uncertain need not have opened."""

    held: float


@dataclass(frozen=True)
class NotSimulated:
    """The stroke could not be compared with the model, for the reason that the simulation or the fit gave."""

    reason: str


Remark: TypeAlias = Unusable | TimingTooUncertain | NotSimulated | Fault
"""Why a stroke was not compared with the baseline."""


class Prediction(NamedTuple):
    """The model at the time of one sample; the residual is measured less predicted, m, or A by the current alone."""

    reading: Reading
    residual: float


class StrokeRecord(NamedTuple):
    """One stroke as it was cut out.

    Attributes:
        number: from 0 on. time: of the opening command, s. trace: times since `trace.epoch_ns`.
        remark: why it cannot be compared with the model; None if it can.
        opened, closed: whether the valve was seen to; None where the model did not, where timing was too uncertain, or
            where the current alone does not say so.
        fault: what went wrong; None where nothing did.
        arrival_spread: s, largest delay of its samples above the smallest of late; nan where arrivals are not known,
            and where the coil's voltage says when its commands took effect.
        stamp: ROS time of the opening command, ns; 0 where the times are of no clock.
        is_dated: whether the coil's voltage says when its commands took effect.
    """

    number: int
    time: float
    trace: Trace
    remark: Remark | None
    opened: bool | None
    closed: bool | None
    fault: Fault | None
    arrival_spread: float = math.nan
    stamp: int = 0
    is_dated: bool = False


class Occasion(NamedTuple):
    """Of which valve something is said, and when.

    Attributes:
        valve: full name of its node. stroke: number of the last stroke that it is said of.
        stamp: ROS time of that stroke's opening command, ns.
    """

    valve: str
    stroke: int
    stamp: int
