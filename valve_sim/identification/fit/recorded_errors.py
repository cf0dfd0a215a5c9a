"""What a fit says of the errors of its recordings: their sizes, whether they are there, and what they add.

A size s has the posterior p(s) L(s | others at their best), on a grid. Z, its integral, over Z + L(0) is the
probability that the error is there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from valve_sim.identification.fit.changes import Change, changes_in
from valve_sim.identification.fit.columns import BY_NAME
from valve_sim.identification.fit.errors import ERRORS
from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.unknown import GONE, Group
from valve_sim.identification.plants.effect_titles import inside_sentence, title_of
from valve_sim.identification.plants.input_edges import INPUT_EDGE
from valve_sim.identification.plants.protocol import Array, Plant, SharedSize
from valve_sim.identification.plants.recording_errors import COMMAND_TIME, VARIATION

PICTURED: Final = 200
"""Points of a picture."""
LIKELY: Final = 0.9
"""Probability from which an error is said to be there."""
OF_CLOCKS: Final = ("clock_offset", "clock_rate", "command_stamps", "input_edges")
"""Errors that every recording has, and that findings on a fit say by themselves."""
OF_STAMPS: Final = {COMMAND_TIME: "command_stamps", INPUT_EDGE: "input_edges"}
"""Errors of which each is the scatter of several nuisances, by what these move."""
EVEN: Final = 0.5
"""Probability from which an error is expected of further data."""
TENTH: Final = 0.1
"""Of a standard error: the step of a difference quotient."""
NOTHING: Final = 0.2
"""Of its mean, below which what a number begins with is nothing: the change over it would be of any size."""
STEADY: Final = "find what changes while it is recorded: it warms, settles or wears; record it again after a rest"


@dataclass(frozen=True)
class RecordedError:
    """An error of one recording.

    Attributes:
        recording: its number. error: which, by its name in report.json. title: for people.
        size, stderr: posterior mean and standard deviation, SI. low, high: 95 % interval. unit: SI.
        probability: of the error against its absence. what_to_do: one sentence.
        about: what else is known: which sensor, the frequency of a mount, or what varies from stroke to stroke.
        at, shown: (n,) and (n,) a picture of it: what it adds over time, s, over what is shown, or by stroke.
        over: what `at` is: "time", "position" or "stroke"; empty where there is no picture.
        changes: how what varies follows the strokes, a phrase each.
    """

    recording: int
    error: str
    title: str
    size: float
    stderr: float
    low: float
    high: float
    unit: str
    probability: float
    what_to_do: str
    about: str = ""
    at: Array = field(default_factory=lambda: np.empty(0), compare=False, repr=False)
    shown: Array = field(default_factory=lambda: np.empty(0), compare=False, repr=False)
    over: str = ""
    changes: tuple[str, ...] = ()

    @property
    def detail(self) -> str:
        """What else is known, and how it follows the strokes."""
        return "; ".join(filter(None, (self.about, *self.changes)))

    @property
    def is_likely(self) -> bool:
        """Whether it is said to be there."""
        return self.probability >= LIKELY


ONE_CLOCK: Final = "look for a delay of the sensor or of the driver: commands and samples of a table share one clock"


class _Amount(NamedTuple):
    """Size, standard deviation, 95 % interval and probability of an error."""

    size: float
    stderr: float
    low: float
    high: float
    probability: float

    def over(self, span: float) -> _Amount:
        """This size over the range of the sensor, as a share of 1."""
        return _Amount(self.size / span, self.stderr / span, self.low / span, self.high / span, self.probability)


def recorded_errors(result: Fit) -> tuple[RecordedError, ...]:
    """The errors of the recordings of a fit, recording by recording, in the order of `ERRORS`."""
    found = [*_of_clocks(result), *_of_stamps(result), *_of_sizes(result)]
    order = [error.name for error in ERRORS]
    return tuple(sorted(found, key=lambda own: (own.recording, order.index(own.error))))


def by_recording(results: Iterable[Fit]) -> dict[str, tuple[RecordedError, ...]]:
    """The errors of the recordings of some fits, by the recording's source.

    Of a recording of which several fits have a part, strokes that are held out say, they are as the first one has them.
    """
    found: dict[str, list[RecordedError]] = {}
    done: set[tuple[int, int]] = set()
    for result in results:
        problem, plant = result.problem, result.problem.plant
        sources = {own.recording: own.source or own.name for own in plant.channels}
        seen = {own.recording for at, own in enumerate(plant.channels) if np.any(problem.weight(at) > 0.0)}
        due = {own for own in seen if (id(plant), own) not in done}
        for entry in recorded_errors(result):
            if entry.recording in due:
                found.setdefault(sources[entry.recording], []).append(entry)
        done |= {(id(plant), own) for own in due}
    return {source: tuple(entries) for source, entries in found.items()}


def _of_clocks(result: Fit) -> Iterator[RecordedError]:
    """Offset and rate of clocks, which have priors without a size to be learned."""
    for own in result.nuisances:
        if own.error not in ("clock_offset", "clock_rate"):
            continue
        place = result.names.index(own.name)
        value, error = result.values[own.name], math.sqrt(max(0.0, float(result.covariance[place, place])))
        # Savage and Dickey: what the density at 0 was before the data over what it is after them.
        odds = math.exp(min(700.0, 0.5 * (value / error) ** 2)) * error / own.sigma if error > 0.0 else math.inf
        size = _Amount(value, error, value - 1.96 * error, value + 1.96 * error, 1.0 / (1.0 + 1.0 / odds))
        yield _with_advice_on_clock(_entry(own.recording, own.error, size, own.unit), result.problem.plant)


def _with_advice_on_clock(entry: RecordedError, plant: Plant) -> RecordedError:
    """Of a table, whose commands and samples share a clock, another advice than to synchronise two."""
    if plant.has_one_clock(entry.recording):
        return replace(entry, what_to_do=ONE_CLOCK)
    return entry


def _of_stamps(result: Fit) -> Iterator[RecordedError]:
    """The scatter of commands' stamps, and of when inputs jumped, of a fit that estimates them."""
    late: dict[tuple[int, str], list[float]] = {}
    for own in result.nuisances:
        if own.number in OF_STAMPS:
            late.setdefault((own.recording, OF_STAMPS[own.number]), []).append(result.values[own.name])
    for (recording, error_of), found in late.items():
        values = np.array(found)
        size = math.sqrt(float(np.mean(np.square(values))))
        # Of so many draws the standard deviation is known to this share.
        error = size / math.sqrt(2.0 * len(values))
        amount = _Amount(size, error, max(0.0, size - 1.96 * error), size + 1.96 * error, 1.0)
        yield replace(
            _entry(recording, error_of, amount, "s"), at=np.arange(1.0, len(values) + 1.0), shown=values,
            over="command" if error_of == "command_stamps" else "jump",
        )  # fmt: skip


def _of_sizes(result: Fit) -> Iterator[RecordedError]:
    """Errors with columns, or that vary of the machine, with a size."""
    gaussian, columns = result.gaussian, result.problem.columns
    places: dict[str, list[int]] = {}
    for place, own in enumerate(result.model.unknowns):
        if own.group is not None:
            places.setdefault(own.group.name, []).append(place)
    for name, group in columns.groups.items():
        recording, unit, span = _of(group, result)
        amount = _Amount(0.0, 0.0, 0.0, GONE * group.scale, 0.0)
        if name in places:
            amount = _amount(gaussian, group, np.array(places[name], dtype=np.intp), result)
        if BY_NAME[group.error].is_relative:
            amount, unit = amount.over(span), "–"
        entry = _with_trend(_entry(recording, group.error, amount, unit, _detail(group, result)), result, group)
        yield _pictured(entry, result, group)


def posterior_of_size(gaussian: Gaussian, group: Group, places: NDArray[np.intp]) -> tuple[Array, float]:
    """(n,) probabilities of the sizes on a group's grid, and the probability that there is an error at all."""
    logs = gaussian.by_size(group, places)
    whole = logs.likelihood + logs.prior + np.log(group.grid / group.scale)
    total = float(logsumexp(whole))
    step = math.log(group.grid[1] / group.grid[0]) if len(group.grid) > 1 else 1.0
    return np.exp(whole - total), 1.0 / (1.0 + math.exp(-min(total + math.log(step), 700.0)))


def _amount(gaussian: Gaussian, group: Group, places: NDArray[np.intp], result: Fit) -> _Amount:
    """What the data say of an error: its size, or what is reported of its coefficients."""
    error = BY_NAME[group.error]
    weights, probability = np.ones(1), 1.0
    if group.law != "known":
        weights, probability = posterior_of_size(gaussian, group, places)
    if error.amount is None:
        mean = float(weights @ group.grid)
        spread = math.sqrt(max(0.0, float(weights @ np.square(group.grid - mean))))
        low, high = np.interp([0.025, 0.975], np.cumsum(weights) - 0.5 * weights, group.grid).tolist()
        return _Amount(mean, spread, low, high, probability)
    # The amplitudes of a group's coefficients, and what they say together.
    samples = _samples_of(group, result, places)
    suited = gaussian.resized({group.name: math.sqrt(float(weights @ np.square(group.grid)))})
    at = np.concatenate([suited.z, np.zeros(len(suited.M) - suited.count)])[places] + suited.best[places]
    covariance = suited.inverse[np.ix_(places, places)]
    step = TENTH * np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    value = error.amount(at, samples)
    slope = np.array([error.amount(at + own, samples) - value for own in np.diag(step)]) / step
    deviation = math.sqrt(max(0.0, float(slope @ covariance @ slope)))
    if group.law == "known" and deviation > 0.0:
        odds = math.exp(min(700.0, 0.5 * (value / deviation) ** 2)) * deviation / group.scale
        probability = 1.0 / (1.0 + 1.0 / odds)
    return _Amount(value, deviation, value - 1.96 * deviation, value + 1.96 * deviation, probability)


def _samples_of(group: Group, result: Fit, places: NDArray[np.intp]) -> Array:
    """(n, q) columns of a group, of the first of its channels; (0, 1) of an error that acts on the machine."""
    columns, unknowns = result.problem.columns, result.model.unknowns
    if group.of_machine:
        return np.empty((0, 1))
    for channel, samples in columns.samples.items():
        first = columns.first[channel]
        own = [unknowns[place].column - first for place in places]
        if all(0 <= place < samples.shape[1] for place in own):
            return samples[:, own]
    return np.empty((0, len(places)))


def _detail(group: Group, result: Fit) -> str:
    """The sensor, where several have the error; the frequency of a mount; or what varies."""
    if isinstance(group.key, SharedSize):
        return "" if group.error == "supply" else _words(group.key, group.key.what)
    assert isinstance(group.key, int)
    modes = result.problem.columns.modes.get(group.key, ()) if group.error == "ringing" else ()
    channels = result.problem.plant.channels
    alike = {channels[other.key].kind for other in result.problem.columns.groups.values()
             if other.error == group.error and isinstance(other.key, int)}  # fmt: skip
    sensor = [channels[group.key].kind.replace("_", " ")] if len(alike) > 1 else []
    return ", ".join([*sensor, *([" and ".join(f"{mode.frequency:.0f} Hz" for mode in modes)] if modes else [])])


def _with_trend(entry: RecordedError, result: Fit, group: Group) -> RecordedError:
    """What varies from stroke to stroke, with how it changes where its deviations are no draws."""
    if group.error != VARIATION or not entry.is_likely:
        return entry
    assert isinstance(group.key, SharedSize)
    found = changes_in(result, group, entry.size).items()
    changes = tuple(_in_words(_words(group.key, number), change) for number, change in found)
    return replace(entry, what_to_do=STEADY, changes=changes) if changes else entry


def _in_words(what: str, change: Change) -> str:
    way, begins = "grows" if change.last > change.first else "falls", 1.0 + change.first
    share = f"by {100.0 * abs(change.last - change.first) / max(begins, NOTHING):.0f} %"
    if change.kind == "line":
        return f"{what} {way} over the strokes {share if begins > NOTHING else 'from nothing'}"
    if change.kind == "some":
        within, without = (", ".join(str(own + 1) for own in each) for each in (change.strokes, change.others))
        return f"{what} acts in strokes {within}, and not in {without}"
    happens = "begins" if begins <= NOTHING else "ends" if 1.0 + change.last <= NOTHING else f"{way} {share}"
    return f"{what} {happens} with stroke {change.strokes[0] + 1}"


def _words(of: SharedSize, number: str) -> str:
    """What varies, in words: an effect by its title, or a number of the machine."""
    return inside_sentence(title_of(of.effect)) if of.effect else number.replace("_", " ")


def _pictured(entry: RecordedError, result: Fit, group: Group) -> RecordedError:
    """An error of a recording with the picture of what it adds."""
    if not isinstance(group.key, int):
        own = [one for one in result.nuisances if one.group == group.key]
        if len(own) < 2:
            return entry
        values = np.array([result.values[one.name] for one in own])
        strokes = np.array([one.part + 1.0 for one in own])
        return replace(entry, at=strokes, shown=values, over="stroke")
    channel = result.problem.plant.channels[group.key]
    shown = result.shown_by(result.coefficients, [group.error])[group.key]
    if group.error in ("scale", "bend"):
        at, over = channel.data, "position"
        order = np.argsort(at, kind="stable")
        at, shown = at[order], shown[order]
    else:
        at, over = channel.times, "time"
    few = np.unique(np.linspace(0, len(at) - 1, PICTURED).astype(np.intp))
    return replace(entry, at=at[few], shown=shown[few], over=over)


def _of(group: Group, result: Fit) -> tuple[int, str, float]:
    """The number of the recording of a group, the unit of its size, and the range of its sensor."""
    problem = result.problem
    if isinstance(group.key, int):
        channel = problem.plant.channels[group.key]
        return channel.recording, channel.unit, problem.columns.spans[group.key]
    own = next(one.nuisance for one in problem.columns.varying if one.group == group)
    assert own is not None
    return own.recording, own.unit, 1.0


def _entry(recording: int, name: str, amount: _Amount, unit: str, detail: str = "") -> RecordedError:
    error = BY_NAME[name]
    return RecordedError(
        recording, name, error.title, amount.size, amount.stderr, amount.low, amount.high, unit, amount.probability,
        error.what_to_do, detail,
    )  # fmt: skip


def expected_sizes(result: Fit) -> dict[str, float]:
    """Sizes that errors of further data of the same machine and sensors are expected to have, by the groups' names.

    The root of the mean square over the posterior: as large is a further coefficient expected to be. An error that is
    less probable than that there is none is taken to be none, or it would cost sensitivity wherever it is not.
    """
    found = {name: result.gaussian.size(own) for name, own in result.problem.columns.groups.items()}
    for name, (group, places) in result.gaussian.groups.items():
        weights, probability = posterior_of_size(result.gaussian, group, places)
        is_there = probability > EVEN
        found[name] = math.sqrt(float(weights @ np.square(group.grid))) if is_there else float(group.grid[0])
    return found
