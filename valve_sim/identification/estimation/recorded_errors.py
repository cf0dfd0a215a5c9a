"""What a fit says of the errors of its recordings: their sizes, whether they are there, and what they add to ±.

A size s has the posterior p(s) L(s | others at their best), on a grid. Z, its integral, over Z + L(0) is the
probability that the error is there. What is estimated of the machine depends on the sizes: over these grids its
covariance is larger by the mean excess and by the spread of the estimates (theory, "The errors of a recording").
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.errors import ERRORS
from valve_sim.identification.estimation.errors.error import LARGEST, SMALLEST
from valve_sim.identification.estimation.linearised import BySizes, Linearised
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.structured_noise import GONE, Group, StructuredNoise, shown_by
from valve_sim.identification.plants.protocol import Array, Channel, Plant
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.variation import stroke_of

POINTS: Final = 40
"""Of the grid of a size, evenly spaced in the logarithm."""
SPREAD: Final = 12
"""Places on it at which estimates are worked out: those of the largest probability."""
PICTURED: Final = 200
"""Points of a picture."""
LIKELY: Final = 0.9
"""Probability from which an error is said to be there."""
OF_CLOCKS: Final = ("clock_offset", "clock_rate", "command_stamps")
"""Errors that every recording has, and that findings on a fit say by themselves."""
EVEN: Final = 0.5
"""Probability from which an error is expected of further data."""
TENTH: Final = 0.1
"""Of a standard error: the step of a difference quotient."""
FORGOTTEN: Final = 1e-3
"""Share of the largest probability, below which a size is as good as impossible."""


@dataclass(frozen=True)
class RecordedError:
    """An error of one recording.

    Attributes:
        recording: its number. error: which, by its name in report.json. title: for people.
        size, stderr: posterior mean and standard deviation, SI. low, high: 95 % interval. unit: SI.
        probability: of the error against its absence. what_to_do: one sentence.
        detail: what else is known: the frequency of a mount, or what varies from stroke to stroke.
        at, shown: (n,) and (n,) a picture of it: what it adds over time, s, over what is shown, or by stroke.
        over: what `at` is: "time", "position" or "stroke"; empty where there is no picture.
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
    detail: str = ""
    at: Array = field(default_factory=lambda: np.empty(0), compare=False, repr=False)
    shown: Array = field(default_factory=lambda: np.empty(0), compare=False, repr=False)
    over: str = ""

    @property
    def is_likely(self) -> bool:
        """Whether it is said to be there."""
        return self.probability >= LIKELY


CLOCKS_OF_TABLES: Final = ("time column", "rate")
"""`Trace.clock` of recordings whose commands and samples have one clock."""
ONE_CLOCK: Final = "look for a delay of the sensor or of the driver: commands and samples of a table share one clock"


class _Found(NamedTuple):
    """Size, standard deviation, 95 % interval and probability of an error."""

    size: float
    stderr: float
    low: float
    high: float
    probability: float

    def over(self, span: float) -> _Found:
        """This size over the range of the sensor, as a share of 1."""
        return _Found(self.size / span, self.stderr / span, self.low / span, self.high / span, self.probability)


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
        sources = {own.recording: own.name.rpartition(": ")[0] or own.name for own in plant.channels}
        seen = {own.recording for at, own in enumerate(plant.channels) if np.any(problem.weight(at) > 0.0)}
        due = {own for own in seen if (id(plant), own) not in done}
        for entry in recorded_errors(result):
            if entry.recording in due:
                found.setdefault(sources[entry.recording], []).append(entry)
        done |= {(id(plant), own) for own in due}
    return {source: tuple(entries) for source, entries in found.items()}


def _of_clocks(result: Fit) -> Iterator[RecordedError]:
    """Offset and rate of clocks, which have priors without a size to be learned."""
    for at, own in enumerate(result.nuisances, start=len(result.free)):
        if own.error not in ("clock_offset", "clock_rate"):
            continue
        value, error = result.values[own.name], math.sqrt(max(0.0, float(result.covariance[at, at])))
        # Savage and Dickey: what the density at 0 was before the data over what it is after them.
        odds = math.exp(min(700.0, 0.5 * (value / error) ** 2)) * error / own.sigma if error > 0.0 else math.inf
        size = _Found(value, error, value - 1.96 * error, value + 1.96 * error, 1.0 / (1.0 + 1.0 / odds))
        recording = result.problem.plant.channels[own.channels[0]].recording
        yield _with_advice_on_clock(_entry(recording, own.error, size, own.unit), result.problem.plant)


def _with_advice_on_clock(entry: RecordedError, plant: Plant) -> RecordedError:
    """Of a table, whose commands and samples share a clock, another advice than to synchronise two."""
    if isinstance(plant, ValvePlant) and plant.traces[entry.recording].clock in CLOCKS_OF_TABLES:
        return replace(entry, what_to_do=ONE_CLOCK)
    return entry


def _of_stamps(result: Fit) -> Iterator[RecordedError]:
    """The scatter of commands' stamps, of a fit that estimates them."""
    numbers: dict[int, list[int]] = {}
    for at, own in enumerate(result.nuisances):
        if own.error == "command_stamps":
            numbers.setdefault(result.problem.plant.channels[own.channels[0]].recording, []).append(at)
    for recording, places in numbers.items():
        late = np.array([result.values[result.nuisances[at].name] for at in places])
        size = math.sqrt(float(np.mean(np.square(late))))
        # Of so many draws the standard deviation is known to this share.
        error = size / math.sqrt(2.0 * len(late))
        found = _Found(size, error, max(0.0, size - 1.96 * error), size + 1.96 * error, 1.0)
        yield replace(
            _entry(recording, "command_stamps", found, "s"), at=np.arange(1.0, len(late) + 1.0), shown=late,
            over="command",
        )  # fmt: skip


def _of_sizes(result: Fit) -> Iterator[RecordedError]:
    """Errors with columns or nuisances of a size."""
    noise, rows = result.problem.errors, result.problem.error_rows
    if noise is None or rows is None:
        return
    model = Linearised(result)
    by_sizes, sizes = model.by_sizes(), model.sizes
    for number, group in enumerate(noise.groups):
        recording, unit = _of(group, result)
        if by_sizes.is_estimated[number]:
            found = _found(by_sizes, sizes, number, noise)
        else:
            found = _Found(0.0, 0.0, 0.0, GONE * group.scale, 0.0)
        if group.error.is_relative:
            found, unit = found.over(group.span), "–"
        yield _pictured(_entry(recording, group.error.name, found, unit, _detail(group, noise)), result, group)


def _found(by_sizes: BySizes, sizes: Array, number: int, noise: StructuredNoise) -> _Found:
    """What the data say of an error: its size, or what is reported of its coefficients."""
    group = noise.groups[number]
    at_sizes, weights, probability = sizes[number : number + 1], np.ones(1), 1.0
    if not group.error.is_known:
        at_sizes, weights, probability = _posterior(by_sizes, sizes, number, group)
    if group.error.amount is None:
        mean = float(weights @ at_sizes)
        spread = math.sqrt(max(0.0, float(weights @ np.square(at_sizes - mean))))
        low, high = np.interp([0.025, 0.975], np.cumsum(weights) - 0.5 * weights, at_sizes).tolist()
        return _Found(mean, spread, low, high, probability)
    # Over the sizes that are possible, as the machine's values are.
    amount_of, samples = group.error.amount, noise.columns_of(number)
    chosen = np.argsort(weights)[-SPREAD:]
    shares = weights[chosen] / np.sum(weights[chosen])
    amounts, variances = np.empty(len(chosen)), np.empty(len(chosen))
    for place, size in enumerate(at_sizes[chosen].tolist()):
        at, covariance = by_sizes.coefficients(_with(sizes, number, size), number)
        amounts[place] = amount_of(at, samples)
        step = TENTH * np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
        slope = np.array([(amount_of(at + own, samples) - amounts[place]) for own in np.diag(step)]) / step
        variances[place] = float(slope @ covariance @ slope)
    value = float(shares @ amounts)
    error = math.sqrt(max(0.0, float(shares @ (variances + np.square(amounts - value)))))
    if group.error.is_known:
        odds = math.exp(min(700.0, 0.5 * (value / error) ** 2)) * error / group.scale
        probability = 1.0 / (1.0 + 1.0 / odds)
    return _Found(value, error, value - 1.96 * error, value + 1.96 * error, probability)


def _detail(group: Group, noise: StructuredNoise) -> str:
    """The frequency of a mount, or what varies."""
    if isinstance(group.key, str):
        return "" if group.error.name == "supply" else group.key.partition("[")[0].replace("_", " ")
    modes = noise.modes.get(group.key, ()) if group.error.name == "ringing" else ()
    return " and ".join(f"{mode.frequency:.0f} Hz" for mode in modes)


def _pictured(entry: RecordedError, result: Fit, group: Group) -> RecordedError:
    """An error of a recording with the picture of what it adds."""
    noise = result.problem.errors
    assert noise is not None
    if isinstance(group.key, str):
        own = [one for one in result.nuisances if one.group == group.key]
        if len(own) < 2:
            return entry
        values = np.array([result.values[one.name] for one in own])
        strokes = np.array([float(stroke_of(one.name)) + 1.0 for one in own])
        return replace(entry, at=strokes, shown=values, over="stroke")
    channel = result.problem.plant.channels[group.key]
    shown = shown_by(noise, result.recording, [group.error.name])[group.key]
    if group.error.name in ("scale", "bend"):
        at, over = channel.data, "position"
        order = np.argsort(at, kind="stable")
        at, shown = at[order], shown[order]
    else:
        at, over = channel.times, "time"
    few = np.unique(np.linspace(0, len(at) - 1, PICTURED).astype(np.intp))
    return replace(entry, at=at[few], shown=shown[few], over=over)


def _of(group: Group, result: Fit) -> tuple[int, str]:
    """The number of the recording of a group, and the unit of its size."""
    problem = result.problem
    assert problem.errors is not None
    if isinstance(group.key, int):
        channel: Channel = problem.plant.channels[group.key]
        return channel.recording, channel.unit
    own = next(one for one in problem.errors.varying if one.group == group.key)
    return problem.plant.channels[own.channels[0]].recording, own.unit


def _entry(recording: int, name: str, found: _Found, unit: str, detail: str = "") -> RecordedError:
    error = next(own for own in ERRORS if own.name == name)
    return RecordedError(
        recording, name, error.title, found.size, found.stderr, found.low, found.high, unit, found.probability,
        error.what_to_do, detail,
    )  # fmt: skip


def _posterior(by_sizes: BySizes, sizes: Array, number: int, group: Group) -> tuple[Array, Array, float]:
    """(n,) sizes, (n,) their probabilities, and the probability that there is an error at all."""
    coarse = np.linspace(math.log(SMALLEST * group.scale), math.log(LARGEST * group.scale), POINTS)
    step = coarse[1] - coarse[0]
    # Finer about the most probable one.
    fine = np.linspace(-1.5 * step, 1.5 * step, POINTS) + math.log(sizes[number])
    places = np.unique(np.clip(np.concatenate([coarse, fine]), coarse[0], coarse[-1]))
    at = np.exp(places)
    costs = by_sizes.costs_of(sizes, number, at)
    least = float(costs.min())
    mass = np.exp(least - costs) * at / group.scale * np.gradient(places)
    # A size of the smallest is none: what the data say of none is what they say there, without the prior's density.
    none = math.exp(least - float(costs[0]) - group.error.log_prior(float(at[0]), group.scale))
    total = float(np.sum(mass))
    return at, mass / total, total / (total + none)


def expected_sizes(result: Fit) -> Array:
    """(g,) sizes that errors of further data of the same machine and sensors are expected to have.

    The root of the mean square over the posterior: as large is a further coefficient expected to be. An error that is
    less probable than that there is none is taken to be none, or it would cost sensitivity wherever it is not. The
    posterior is by the rows by which the size was learned, or read at rest.
    """
    noise = result.problem.errors
    if noise is None:
        return np.empty(0)
    model = Linearised(result)
    beside, at_rest, found = model.by_sizes(), model.at_rest(), model.sizes.copy()
    for number, group in enumerate(noise.groups):
        by_sizes = at_rest if group.is_read else beside
        if by_sizes.is_learned[number]:
            at, weights, probability = _posterior(by_sizes, model.sizes, number, group)
            is_there = probability > EVEN
            found[number] = math.sqrt(float(weights @ np.square(at))) if is_there else group.bounds[0]
    return found


def _with(sizes: Array, number: int, size: float) -> Array:
    changed = sizes.copy()
    changed[number] = size
    return changed


def with_uncertain_sizes(result: Fit) -> Fit:
    """A fit whose covariance allows for the sizes of its recordings' errors being estimates."""
    noise = result.problem.errors
    if noise is None:
        return result
    model = Linearised(result)
    by_sizes, sizes, count = model.by_sizes(), model.sizes, len(result.coordinates)
    steps, covariance = by_sizes.estimates(sizes, count)
    further = np.zeros((count, count))
    for number, group in enumerate(noise.groups):
        if not by_sizes.is_learned[number]:
            continue
        at, weights, _ = _posterior(by_sizes, sizes, number, group)
        chosen = np.argsort(weights)[-SPREAD:]
        chosen = chosen[weights[chosen] > FORGOTTEN * weights[chosen[-1]]]
        shares = weights[chosen] / np.sum(weights[chosen])
        for size, share in zip(at[chosen].tolist(), shares.tolist(), strict=True):
            moved, wider = by_sizes.estimates(_with(sizes, number, size), count)
            further += share * (wider - covariance + np.outer(moved - steps, moved - steps))
    # Sizes whose own coordinates they are have no say in their own errors.
    values, vectors = np.linalg.eigh(0.5 * (further + further.T))
    return replace(result, further=np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T))
