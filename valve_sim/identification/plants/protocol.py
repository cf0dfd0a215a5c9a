"""What identification sees of a machine: named parameters, effects that may be on, and what sensors would show.

The valve is one plant (`valve`), a machine of a user's equations another (`own`). Fits and diagnoses know only this
protocol.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model import Valve
from valve_sim.model.errors import SimulationError
from valve_sim.model.parameters import Parameter

Array = NDArray[np.float64]

SMALL_MOVE: Final = 0.05
"""Prior scales of a parameter: a perturbation that shows in which direction it changes the residual."""
RELEASED: Final = 10.0
"""Tolerances by which a declared value is expected to be off, if it is wrong: theory, eq. (82)."""
LARGEST_EXPONENT: Final = 709.0
"""e to this is still a double."""
FARTHEST: Final = 20.0
"""Standard deviations of its prior within which a nuisance is searched."""
READABLE_UNITS: Final = {"m": (1e6, "µm"), "A": (1e3, "mA"), "Pa": (1e-3, "kPa")}
"""SI unit to factor and name of the display unit."""
KEY_OF_UNIT: Final = {"µm": "um", "mA": "ma", "kPa": "kpa"}
"""Display unit to what a name in JSON ends with: rmse_um."""
Condition = tuple[float, ...]
"""Numbers by which conditions of strokes are equal or not, and are put in order: neighbours are alike."""
Role = Literal["response", "actuation"]
"""What a channel shows: the machine's response, by which models are judged, or the actuator that drives it.

An actuator's form may be one that no effect explains, so it is believed only as far as effects explain it.
"""


class SharedSize(NamedTuple):
    """What nuisances of one size have in common.

    Attributes:
        what: differs, by a name for people. recording: number of the recording in which it does.
        effect: whose parameter it is; empty: it is none of an effect.
    """

    what: str
    recording: int
    effect: str = ""

    def __str__(self) -> str:
        """As in names of sizes: damping[0]."""
        return f"{self.what}[{self.recording}]"


class Nuisance(NamedTuple):
    """A quantity with a prior, estimated in every fit: a recording's error, or a declared value with a tolerance.

    Attributes:
        name, unit: what it is. sigma: of its prior N(mean, sigma).
        channels: indices of the channels that it acts on; empty: on all.
        during: s, from when to when it acts on them, by their times.
        step: by how much it is moved for a difference quotient, in `unit`.
        mean: of its prior. lower, upper: its range.
        is_of_machine: whether it is a value of the machine, the same in each of its recordings.
        same_as: a parameter of an effect that is the same thing; where that is freed, this one is not needed.
        same_slope: by how much that parameter changes for each unit of this one, about the mean of the prior.
        error: the error of the recording that it is a part of, by its name in report.json, whose size is learned.
        group: nuisances of one group share a size; `sigma` is then the scale of the prior of that.
        number: what it moves: a number of the machine, `<effect>.<parameter>`, or an error by its name.
        recording: the number of the one recording in which it does; −1: in all of them.
        part: the number of the stroke, the command or the window in which it does; −1: in the whole recording.
    """

    name: str
    sigma: float
    unit: str
    channels: tuple[int, ...] = ()
    during: tuple[float, float] = (-math.inf, math.inf)
    step: float = 1e-6
    mean: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    is_of_machine: bool = False
    same_as: str = ""
    same_slope: float = 1.0
    error: str = ""
    group: SharedSize | None = None
    number: str = ""
    recording: int = -1
    part: int = -1

    @property
    def bounds(self) -> tuple[float, float]:
        """Where an estimate may be: within `FARTHEST` standard deviations and within the range."""
        return max(self.lower, self.mean - FARTHEST * self.sigma), min(self.upper, self.mean + FARTHEST * self.sigma)


@dataclass(frozen=True)
class EffectChoice:
    """A hypothesis of a diagnosis: an effect that it may add, or a declared value that may be wrong.

    Attributes:
        name: of the effect, or `valve.<name>` of a declared value.
        parameters: what is freed: of an effect as `<name>.<parameter>`, of a declared value by the plain name, so that
            the nuisance of that name is dropped; `off` is the declared value then. The range is where the name may be
            claimed; fits search that of `Plant.parameter`.
        confused_with: names of others that data often cannot tell from this one.
        is_declared_value: whether it is a declared value.
        is_on: whether it is an effect that is declared already, and may be of another size.
        start: values, of its parameters and beside them, that a fit starts from, too; none where none are known.
        places: by free name, values that a threshold among its parameters is started from: quantiles of what it acts
            on, since a fit that starts beyond all data has no slope that would lead it among them.
    """

    name: str
    parameters: tuple[Parameter, ...]
    confused_with: tuple[str, ...] = ()
    is_declared_value: bool = False
    is_on: bool = False
    start: Mapping[str, float] = field(default_factory=dict, compare=False)
    places: Mapping[str, Sequence[float]] = field(default_factory=dict, compare=False)

    @property
    def is_declared(self) -> bool:
        """Whether it says that something declared is wrong, not that something is missing."""
        return self.is_declared_value or self.is_on

    def free_name(self, parameter: Parameter) -> str:
        """The name by which a fit frees one of the parameters."""
        return parameter.name if self.is_declared_value else f"{self.name}.{parameter.name}"

    def free_names(self) -> tuple[str, ...]:
        """The names that a fit frees."""
        return tuple(map(self.free_name, self.parameters))


@dataclass(frozen=True)
class ForceMap:
    """A force of unknown origin that a fit may add: a curve of B-splines over one variable.

    Attributes:
        variable: what it is a function of, e.g. "x" or "t·v".
        coefficients: names of the B-splines' coefficients, from low to high.
        fixed: values that place them.
        low, high: the range of the variable, in `unit`; the curve is constant beyond.
        count: name of the value that says how many coefficients there are.
        least: value that no coefficient may fall below. ends: names of the values in `fixed` that are low and high.
    """

    variable: str
    coefficients: tuple[str, ...]
    fixed: Mapping[str, float]
    low: float
    high: float
    unit: str
    count: str
    least: float = -math.inf
    ends: tuple[str, ...] = ()

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the coefficients that a fit frees."""
        return self.coefficients

    @property
    def held(self) -> dict[str, float]:
        """Names that a fit keeps fixed: the place of the B-splines."""
        return {**self.fixed, self.count: float(len(self.coefficients))}


@dataclass(frozen=True)
class Channel:
    """One measured signal: what a fit compares with the prediction.

    Attributes:
        name: for people, e.g. "train.mcap: pilot_position".
        kind: of sensor, e.g. "position", "current" or "force": signals of one kind share their noise.
        times: (n,) s. data: (n,) in `unit`; what is left out is to lie between the readings beside it.
        quiet: (n,) True where the machine is known to be still, so that what is seen is the sensor's noise.
        group: (n,) the stroke (or window) that each sample belongs to, from 0 on; hold-out takes whole groups.
        unit: SI.
        role: what the channel shows.
        recording: which recording it is of; groups of one number in one recording are one stroke.
        drifts: whether the signal drifts while the machine is still, and the plant or its sensor's errors tell how: a
            current while its coil heats, a position while its sensor warms up.
        resolution: by how much data and prediction differ for numerical reasons alone: rounded stamps, rounded values,
            the tolerance of an integrator. No noise is taken to be smaller.
        noise: standard deviation of its white noise where that is known beforehand, in `unit`; 0: the data show it.
        left_out: (n,) True where a reading is no measurement and takes part in nothing; None where all are.
        source: of the recording, for people; empty: it is called as the channel.
    """

    name: str
    kind: str
    times: Array
    data: Array
    quiet: NDArray[np.bool_]
    group: NDArray[np.integer]
    unit: str = "m"
    role: Role = "response"
    recording: int = 0
    drifts: bool = False
    resolution: float = 0.0
    noise: float = 0.0
    left_out: NDArray[np.bool_] | None = None
    source: str = ""

    @property
    def count(self) -> int:
        """Number of measurements."""
        return len(self.data) - (0 if self.left_out is None else int(np.count_nonzero(self.left_out)))

    def kept(self, values: Array, samples: slice = slice(None)) -> Array:
        """Those of measurements among one value for each of these samples, (m,)."""
        return values if self.left_out is None else values[~self.left_out[samples]]

    @property
    def readable(self) -> tuple[float, str]:
        """Factor from SI and name of the display unit."""
        return READABLE_UNITS.get(self.unit, (1.0, self.unit))


@dataclass(frozen=True)
class Experiment:
    """A recording that could be made.

    Attributes:
        words: for people, e.g. "11 V for 4 ms".
        simulated: the recording, without noise, as if the machine had the given values.
        commands: (s, input) from 0 on, each held until the next: what drives the machine; empty where it is not said.
    """

    words: str
    simulated: Callable[[Mapping[str, float]], Plant]
    commands: tuple[tuple[float, float], ...] = ()


def primary_channels(plant: Plant) -> list[int]:
    """Indices of the channels in which errors are reported: responses, of the first one's kind and so of one unit."""
    responses = [index for index, channel in enumerate(plant.channels) if channel.role == "response"]
    indices = responses or list(range(len(plant.channels)))
    kind = plant.channels[indices[0]].kind
    return [index for index in indices if plant.channels[index].kind == kind]


def strokes_of_plant(plant: Plant) -> list[tuple[int, int]]:
    """(recording, group) of every stroke that a response shows, in order."""
    channels = plant.channels
    responses = [channel for channel in channels if channel.role == "response"] or channels
    return sorted({(channel.recording, int(group)) for channel in responses for group in np.unique(channel.group)})


class Direction(NamedTuple):
    """A way in which values change together.

    Attributes:
        slopes: name to the derivative of its value to the coordinate along the direction.
        step: of that coordinate: small against what changes a prediction's derivative.
    """

    slopes: Mapping[str, float]
    step: float


class Sensitivities(NamedTuple):
    """Derivatives of a prediction.

    Attributes:
        columns: for each channel (n, k): along k directions; none where nothing is known.
        known: (k,) where they are known; what stands in other columns means nothing.
        shown: for each channel what `predict` returns; none where nothing is known.
    """

    columns: list[Array]
    known: NDArray[np.bool_]
    shown: Sequence[Array] = ()


class Piece(NamedTuple):
    """A stretch of what a channel would show, in its unit.

    Attributes:
        channel: index of it. start: of the first sample among its samples.
        shown: (n,). columns: (n, k) derivatives along k directions.
    """

    channel: int
    start: int
    shown: Array
    columns: Array

    @property
    def samples(self) -> slice:
        """Indices of these samples in the channel."""
        return slice(self.start, self.start + len(self.shown))


class Contacts(NamedTuple):
    """Impacts that shake a sensor.

    Attributes:
        times: (k,) s, by the stamps of the samples. impulses: (k,) momentum that is lost, over that of all that moves
            at 0.3 m/s. places: (k,) numbers of the places where parts meet.
    """

    times: Array
    impulses: Array
    places: NDArray[np.int64]


NO_CONTACTS: Final = Contacts(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64))
"""Of a sensor that nothing shakes."""


class Sensor(NamedTuple):
    """What the errors of a sensor depend on.

    Attributes:
        span: range of what it shows, in the channel's unit.
        knots: (c,) s, of the commands, between which its zero drifts evenly, two for each stroke; None: where each
            group of its channel begins, and half-way to the next.
        contacts: impacts that shake it.
        shares: by the name of an error ("zero", "drift", "hum", "scale", "bend", "ringing", "ringing_scatter") the
            scale of its prior, as a share of the range, where it is known to be another than the usual one; 0: there
            is none.
        alike: the channel whose errors are as large, where recordings are strokes of one; None: its own.
        low: where its range begins, in the channel's unit.
        is_true_at_rest: whether the model is right while the machine is still, as where nothing moves: drift and hum
            are then read there alone, if it is still in most strokes. Else they are learned in motion, too.
    """

    span: float
    knots: Array | None = None
    contacts: Contacts = NO_CONTACTS
    shares: Mapping[str, float] = {}
    alike: int | None = None
    low: float = 0.0
    is_true_at_rest: bool = True


class Advice(NamedTuple):
    """What a plant's owner should record next, in whole sentences without the full stop.

    Attributes:
        ambiguous: why one stroke cannot tell effects apart. first: after a single stroke. more: after several.
    """

    ambiguous: str
    first: str
    more: str


GENERIC_ADVICE: Final = Advice(
    "one stroke cannot tell an effect from what is refitted anyway",
    "Record next: at least eight strokes under different conditions, in one recording",
    "Record next: strokes under conditions not used yet",
)


class Wording(NamedTuple):
    """What a report calls what belongs to a plant.

    Attributes:
        part: a group of a channel. refitted: the declared model with its base refitted.
        unknown_noise: what to do if the noise of a sensor cannot be seen, a sentence; empty: nothing.
        says_exact: whether a report says that no declared value has a tolerance.
        corrected: the kind of file that `save_corrected` writes; empty: it writes none.
        uses: commands with that file, {file}, and with options for recordings like these, {options}.
    """

    part: str = "part"
    refitted: str = "the declared model, refitted,"
    unknown_noise: str = ""
    says_exact: bool = False
    corrected: str = ""
    uses: tuple[str, ...] = ()


class Meaning(NamedTuple):
    """What an effect is on a real machine, in sentences; empty where nothing is known.

    Attributes:
        severity: its size beside something familiar. cause: what it is. advice: what to do.
    """

    severity: str = ""
    cause: str = ""
    advice: str = ""


class Estimate(NamedTuple):
    """What a fit says of a machine.

    Attributes:
        values: of all that was estimated, by name.
        names: (k,) of those that are of the machine. covariance: (k, k) of their values, 0 where it is not known.
    """

    values: Mapping[str, float]
    names: Sequence[str]
    covariance: Array


class Followed(NamedTuple):
    """The positions that a model computes for a recording in which none were measured.

    Attributes:
        source: of the recording. times: (n,) s. strokes: (n,) number of the stroke of each, from 0 on.
        position, stderr: (n,) m; a plant gives no errors.
    """

    source: str
    times: Array
    strokes: NDArray[np.integer]
    position: Array
    stderr: Array


class Plant:
    """A machine with its measured data: what it inherits from here it has nothing of, and of the rest it states it."""

    @property
    def channels(self) -> Sequence[Channel]:
        """The measured channels."""
        raise NotImplementedError

    @property
    def base(self) -> Sequence[str]:
        """The parameters that are refitted before any effect is claimed."""
        return ()

    @property
    def nuisances(self) -> Sequence[Nuisance]:
        """Always estimated: clock offsets, and declared values with a tolerance."""
        return ()

    @property
    def timing_errors(self) -> Sequence[Nuisance]:
        """Estimated where the data ask for it: errors of each command's stamp."""
        return ()

    @property
    def varying(self) -> Sequence[Nuisance]:
        """Errors of the recordings that act on the machine, in groups whose sizes are learned.

        Each has an `error`, "supply" or "stroke_variation", and a `group`; `predict` takes their values by name.
        """
        return ()

    @property
    def effects(self) -> Mapping[str, EffectChoice]:
        """The effects that may be missing, by name."""
        return {}

    @property
    def force_maps(self) -> Sequence[ForceMap]:
        """Curves that stand for what no named effect explains."""
        return ()

    @property
    def experiments(self) -> Sequence[Experiment]:
        """Recordings that could be made next, where the plant knows any."""
        return ()

    @property
    def advice(self) -> Advice:
        """What its owner should record next."""
        return GENERIC_ADVICE

    @property
    def short_step(self) -> float | None:
        """Step of a difference quotient to try before the usual one, in prior scales; None: the usual one serves."""
        return None

    def parameter(self, name: str) -> Parameter:
        """Unit and range of anything that can be freed."""
        raise NotImplementedError

    def declared(self, name: str) -> float:
        """The declared value of a parameter, or the value at which an effect's parameter changes nothing."""
        raise NotImplementedError

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """What each channel would show. Called from several threads at once, so it keeps nothing between calls.

        Args:
            values: freed parameters and nuisances by name; the rest is as declared. Effects that appear are on.
        """
        raise NotImplementedError

    def sensitivities(self, values: Mapping[str, float], directions: Sequence[Direction]) -> Sensitivities:
        """The derivatives of what `predict` returns, as far as they are known without difference quotients.

        Args:
            values: see `predict`; every name of a direction is among them.
            directions: at least one.

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        return Sensitivities([], np.zeros(len(directions), dtype=bool))

    @property
    def comes_in_pieces(self) -> bool:
        """Whether predictions can be had piece by piece, so that long recordings fit in memory."""
        return False

    def pieces(self, values: Mapping[str, float], directions: Sequence[Direction]) -> Iterator[Piece] | None:
        """What `predict` and `sensitivities` return; None where derivatives along one of the directions are not known.

        Each sample of each channel is in one piece, and the pieces of a channel come in order.

        Args:
            values, directions: see `sensitivities`; without directions no derivative is asked for.

        Raises:
            SimulationError: the machine cannot be simulated with these values; also while iterating.
        """
        return None

    @property
    def can_be_thinned(self) -> bool:
        """Whether `thinned` takes less time, and what it shows of a sample is the same whichever others it shows."""
        return False

    def thinned(self, kept: Sequence[NDArray[np.intp]]) -> Plant:
        """This plant with some samples of each channel, of which the first is one."""
        raise NotImplementedError

    def sensors(self, values: Mapping[str, float]) -> Mapping[int, Sensor]:
        """The sensors that err, by the index of their channel; `predict` shows nothing of their errors.

        What they say is part of every hypothesis, with sizes that are learned.

        Args:
            values: see `predict`: they say when parts meet.

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        return {}

    def changing(self, effect: str) -> Sequence[Nuisance]:
        """How much parameters of an effect differ in each stroke, as of `varying`; none where not known."""
        return ()

    def condition_of(self, recording: int, group: int) -> Condition | None:
        """The condition under which a stroke was made; None where that is not known."""
        return None

    # -- what reports and corrected models need beside the fit -------------------------------------------------------

    @property
    def wording(self) -> Wording:
        """What reports call what belongs to it."""
        return Wording()

    def meaning(self, effect: str, values: Mapping[str, float]) -> Meaning:
        """What one of its effects is on a real machine; values: of the effect's parameters that were estimated."""
        return Meaning()

    @property
    def travel(self) -> float | None:
        """Position at the stop, m; None where there is none."""
        return None

    def dampings_at(self, positions: Array) -> NDArray[np.int64]:
        """(n,) which of its dampings acts at each of these positions, m."""
        return np.zeros(len(positions), dtype=np.int64)

    def currents_at(self, times: Array, values: Mapping[str, float]) -> Array:
        """(n,) current over rated current at the times of a channel, s; 1 where it is not known."""
        return np.ones(len(times))

    @property
    def follows_positions(self) -> bool:
        """Whether positions that were not measured follow from what was."""
        return False

    def followed_positions(self, values: Mapping[str, float]) -> Sequence[Followed]:
        """The positions of each recording that has none, if they follow; values: see `predict`.

        Raises:
            SimulationError: the machine cannot be simulated with these values.
        """
        return ()

    def has_one_clock(self, recording: int) -> bool:
        """Whether commands and samples of a recording are known to share a clock."""
        return False

    def stroke_voltages(self, values: Mapping[str, float]) -> tuple[float, ...]:
        """Voltages of full strokes that should be recorded next, V; none where it is driven by something else."""
        return ()

    def with_values(self, values: Mapping[str, float]) -> Valve:
        """The valve that values describe; its tolerances stay as declared.

        Raises:
            TypeError: the machine is no valve.
        """
        raise TypeError("the machine is no valve")

    def estimated(self, estimate: Estimate) -> Valve:
        """The valve with the values of a fit, whose errors are its tolerances.

        Raises:
            TypeError: the machine is no valve.
        """
        raise TypeError("the machine is no valve")

    def save_corrected(self, path: Path, estimate: Estimate, effects: Sequence[str], provenance: str) -> bool:
        """Write the file of the machine with the values of a fit; whether there is such a file.

        Args:
            effects: names of those to take in. provenance: where the values are from, for its comments.

        Raises:
            ValveError: it cannot be written.
        """
        return False


def finite_prediction(plant: Plant, values: Mapping[str, float]) -> list[Array]:
    """What a plant predicts with these values.

    Raises:
        SimulationError: the machine cannot be simulated with them, or shows something that is not finite.
    """
    try:
        shown = plant.predict(values)
    except ArithmeticError as error:
        raise SimulationError(f"{plant.channels[0].name}: the model has no result: {error}") from error
    for column, channel in zip(shown, plant.channels, strict=True):
        if not np.all(np.isfinite(column)):
            raise SimulationError(f"{channel.name}: the model shows something that is not finite")
    return list(shown)


def _is_logarithmic(parameter: Parameter) -> bool:
    """Whether a parameter is a scale (a time constant, a film) that is searched by its logarithm."""
    return parameter.off is None and parameter.lower > 0.0 and not parameter.infinite_at_upper


def _is_reciprocal(parameter: Parameter) -> bool:
    """Whether a parameter has no effect, or is not visible, at infinity and is therefore searched by its reciprocal."""
    return parameter.infinite_at_upper or (parameter.off is not None and math.isinf(parameter.off))


def _exp(coordinate: float) -> float:
    """The exponential of a coordinate, infinite beyond the largest double, where `math.exp` raises."""
    return math.exp(coordinate) if coordinate < LARGEST_EXPONENT else math.inf


def to_internal(parameter: Parameter, value: float) -> float:
    """The coordinate in which a parameter is searched: its value, its reciprocal or its logarithm: theory, eq. (27)."""
    if _is_reciprocal(parameter):
        return 0.0 if math.isinf(value) else 1.0 / value
    return math.log(value) if _is_logarithmic(parameter) else value


def from_internal(parameter: Parameter, coordinate: float) -> float:
    """The inverse of `to_internal`."""
    if _is_reciprocal(parameter):
        most = parameter.upper if parameter.infinite_at_upper else math.inf
        return most if coordinate <= 0.0 else min(1.0 / coordinate, most)
    if _is_logarithmic(parameter):
        return min(max(_exp(coordinate), parameter.lower), parameter.upper)
    return coordinate


def internal_slope(parameter: Parameter, coordinate: float) -> float:
    """|d value / d coordinate|; infinite where the value is."""
    if _is_reciprocal(parameter):
        return math.inf if coordinate <= 0.0 or coordinate**2 == 0.0 else 1.0 / coordinate**2
    return _exp(coordinate) if _is_logarithmic(parameter) else 1.0


def value_slope(parameter: Parameter, coordinate: float) -> float:
    """The derivative d value / d coordinate, with its sign; infinite where the value is."""
    slope = internal_slope(parameter, coordinate)
    return -slope if _is_reciprocal(parameter) else slope


def internal_bounds(parameter: Parameter) -> tuple[float, float]:
    """The bounds of the internal coordinate."""
    if _is_reciprocal(parameter):
        return (1.0 / parameter.upper if parameter.infinite_at_upper else 0.0), 1.0 / parameter.lower
    if _is_logarithmic(parameter):
        return math.log(parameter.lower), math.log(parameter.upper)
    return parameter.lower, parameter.upper


def internal_scale(parameter: Parameter) -> float:
    """The prior scale in the internal coordinate."""
    if _is_reciprocal(parameter):
        return 1.0 / parameter.prior_scale
    return 1.0 if _is_logarithmic(parameter) else abs(parameter.prior_scale)


def perturbed(parameter: Parameter, value: float, size: float = SMALL_MOVE) -> float:
    """A value perturbed by so many of its prior scales, within its range: for directional derivatives."""
    at = to_internal(parameter, value)
    lower, upper = internal_bounds(parameter)
    step = size * internal_scale(parameter)
    return from_internal(parameter, min(max(at + step if at + step <= upper else at - step, lower), upper))
