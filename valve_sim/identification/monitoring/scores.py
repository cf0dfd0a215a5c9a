"""Scores of one stroke against the baseline: is its residual larger than the noise, and in which direction?

A stroke's residual is whitened for the sensor's noise, drift and hum. What differs from stroke to stroke is estimated
too, as nuisance parameters with priors as large as commissioning has found it: an error of each command's stamp, the
sensor's zero, and how far the stroke's dampings, seat load and preload are from their means. The residual is projected
on the change that each effect of the catalogue would make. With e the whitened residual, a the whitened change, N what
these change and P their prior variance,

    score = aᵀ W e / √(aᵀ W a),        W = (I + N P Nᵀ)⁻¹,

is standard normal under noise, errors of the recording and the commissioned valve, and the most powerful statistic for
that effect (the matched filter; Kay, Fundamentals of Statistical Signal Processing II, 1998, section 4.4): theory, eq.
(62). A last score is the size of the residual in any direction, for faults that the catalogue lacks: eq. (63).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from valve_sim.identification.fit.columns import Columns, columns_of, known_name
from valve_sim.identification.fit.gram import root_mean_square
from valve_sim.identification.fit.intervals import Interval, covariance_interval
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.recorded_errors import expected_sizes
from valve_sim.identification.fit.recordings import usual_sizes
from valve_sim.identification.fit.residual_tests import moving_residuals
from valve_sim.identification.fit.result import Fit, fit
from valve_sim.identification.fit.starts import SMALL, Near, switched_on
from valve_sim.identification.fit.unknown import Unknown, hypothesis, known, unknowns_of
from valve_sim.identification.monitoring.command_timing import UNINFORMATIVE
from valve_sim.identification.monitoring.stroke_delays import rough_shifts, start_before
from valve_sim.identification.plants.commissioned import Commissioned, CommissionedCurrent, commission_current
from valve_sim.identification.plants.protocol import Array, perturbed
from valve_sim.identification.plants.recording_errors import CLOCK_SIGMA
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.plants.valve_model import DAMPINGS, dampings_of
from valve_sim.identification.plants.valve_sensors import as_it_began
from valve_sim.model import EXACT, SimulationError, Valve, simulate
from valve_sim.recordings import Trace

SIZE: Final = "size"
"""Name of the score of the residual's size."""
DELAYS: Final = ("opening delay", "closing delay")
"""Names of the scores of the stamps' errors."""
FINEST: Final = {"position": 0.05e-6, "current": 20e-6}
"""m and A: smallest noise that is assumed, as a simulated valve has none: the repeatability of the paper's laser, and
what 14 bits resolve of 1 A."""
MOST_SHIFTS: Final = 6
"""Largest number of commands whose stamp errors are all estimated; of more (a ramp), only the first and last."""
LEAST_SENSITIVITY: Final = 1e-3
"""Standard deviations by which an effect of its prior scale must move a stroke to be scored."""
STILL: Final = 1e-5
"""m/s: below it the model rests."""
MOST_ROUNDS: Final = 4
"""Of fits and sizes of errors, while commissioning."""
SETTLED: Final = 0.2
"""Largest change of the logarithm of a size at which the sizes have settled."""
POOR_FIT: Final = 2.0
"""χ² per sample beyond which the fit begins once more, with commands as they are stamped."""
MEDIAN_OF_NORMAL: Final = 0.6745
"""Median absolute value of a standard normal number."""
EXTREME_SIGMAS: Final = 3.0
"""Standard deviations that the largest of some forty normal numbers rarely exceeds."""
ZERO: Final = 0.1
"""Of the stroke: standard deviation of a sensor's zero, which each stroke shows by itself. It wanders for as long as a
monitor runs; where it is farther off than this, a valve at rest is taken not to have closed."""
FURTHEST: Final = 15.0
"""Standard deviations of a stamp's error to which its starting value is clipped."""


@dataclass(frozen=True)
class Baseline:
    """A valve as it was commissioned.

    Attributes:
        valve: the declared one with refitted dampings, and with estimates of declared values that have a tolerance.
        lateness: s by which its motion is later than its stamps say: the clock offset, and the mean error of a command.
        scatter: s, standard deviation of a command's own error, as estimated. jitter: s, as used, never less.
        noise: of the position or, without positions, of the current.
        covariance: (k, k) of what was estimated.
        current: how the measured current relates to the model's; None where there is none that can be used.
        estimated: (k,) names of what was: the dampings, then declared values that have a tolerance.
        has_positions: whether it was commissioned on positions; else on the current alone.
        error_sizes: of what the recording adds to a stroke and of what varies of the valve from stroke to stroke, by
            the names of `columns.known_name`.
    """

    valve: Valve
    lateness: float
    scatter: float
    jitter: float
    noise: Noise
    covariance: Array
    current: CommissionedCurrent | None = None
    estimated: tuple[str, ...] = DAMPINGS
    has_positions: bool = True
    error_sizes: Mapping[str, float] = field(default_factory=dict)

    @property
    def commissioned(self) -> Commissioned:
        """The valve, with what is known of its values."""
        return Commissioned(self.valve, self.estimated, self.covariance)


@dataclass(frozen=True)
class Scored:
    """One stroke compared with the baseline.

    Attributes:
        scores: by name of a direction, each about standard normal while nothing has changed.
        shifts: (commands,) s, estimated errors of the stamps.
        rms: of the position's residual, m, or of the current's, A.
    """

    scores: Mapping[str, float]
    shifts: Array
    rms: float


def score_stroke(trace: Trace, baseline: Baseline, jitter: float | None = None) -> Scored:
    """Compare one stroke with the baseline.

    Args:
        trace: one stroke, from rest.
        baseline: the valve as commissioned.
        jitter: s, standard deviation of its commands' times; None: the commissioned one. With `UNINFORMATIVE` delays
            are not scored.

    Raises:
        SimulationError: the commissioned valve cannot be simulated.
    """
    stroke = _Stroke(trace, baseline, jitter)
    result = stroke.fit(())
    return _scored(stroke, result, stroke.effect_directions(result))


def score_at_levels(trace: Trace, baseline: Baseline, levels: Sequence[float]) -> dict[float, Scored]:
    """Score a stroke for several standard deviations of the commands' times, s; the scores are by these.

    What effects change is computed once: it depends on the stroke, and hardly on errors of its stamps.

    Raises:
        SimulationError: the commissioned valve cannot be simulated.
    """
    directions: list[tuple[str, Array]] = []
    found = {}
    for level in levels:
        stroke = _Stroke(trace, baseline, level)
        result = stroke.fit(())
        directions = directions or list(stroke.effect_directions(result))
        found[level] = _scored(stroke, result, directions)
    return found


def _scored(stroke: _Stroke, result: Fit, directions: Iterable[tuple[str, Array]]) -> Scored:
    """The scores of a stroke whose stamps' errors were estimated, along what effects change."""
    # To first order about the fit: scores must not depend on where it stopped.
    scores = {SIZE: _size(stroke.problem, result.gaussian.left_at_best)}
    named = [*directions, *stroke.delay_directions(result)]
    if named:
        squares, seen = result.gaussian.beyond(np.column_stack([change for _, change in named]))
        for (name, _), power, product in zip(named, np.diag(squares).tolist(), seen.tolist(), strict=True):
            if power > LEAST_SENSITIVITY**2:
                # The fit's residual is measured less predicted, and so is the change of it that an effect makes.
                scores[name] = -product / math.sqrt(power)
    return Scored(scores, stroke.shifts(result), stroke.rms(result))


def refitted(trace: Trace, baseline: Baseline, jitter: float | None = None) -> dict[str, Interval]:
    """The dampings by this stroke alone, with 95 % intervals; arguments: see `score_stroke`.

    Raises:
        SimulationError: the valve cannot be simulated.
    """
    dampings = dampings_of(baseline.valve)
    result = _Stroke(trace, baseline, jitter).fit(dampings)
    return {name: covariance_interval(result, name) for name in dampings}


def commission(traces: Sequence[Trace], valve: Valve, noise: float) -> Baseline:
    """Fit dampings, clock and the scatter of the commands to the first strokes, all together.

    Declared values with a tolerance are estimated along; what they come to is how the valve is while healthy.

    Args:
        traces: one stroke each.
        valve: the declared valve.
        noise: standard deviation of the position sensor, m; 0 to estimate it.

    Raises:
        SimulationError: the declared valve cannot be simulated.
    """
    plant = ValvePlant([_judged(trace, valve) for trace in traces], valve, is_watched=True)
    kind = plant.channels[0].kind
    given = None
    if noise > 0.0 and kind == "position":
        given = {kind: Noise(noise, noise, (), 0.0, len(traces[0].times))}
    measured = _at_least_finest(Problem(plant, noises=given).noises[kind], kind)
    rough = {
        f"command_error[{index},{command}]": lateness
        for index, trace in enumerate(traces)
        for command, lateness in enumerate(rough_shifts(trace, valve, 0.0))
    }
    prior = max(CLOCK_SIGMA, float(np.max(np.abs(list(rough.values())))) / FURTHEST)
    problem, result = _with_stroke_errors(Problem(plant, noises={kind: measured}), rough, prior)
    if given is None and measured.samples == 0:
        # Its rests were too short to show the noise by themselves; what the fit leaves of them does.
        learned = Problem(plant, noises={kind: _at_least_finest(_noise_at_rest(plant, result), kind)})
        problem, result = _with_stroke_errors(learned, result.values, prior)
    late = [
        result.values[f"clock_offset[{index}]"] + result.values.get(f"command_error[{index},{command}]", 0.0)
        for index, trace in enumerate(traces)
        for command in range(len(trace.drive.times))
    ]
    lateness = float(np.median(late))
    scatter = _scatter(np.abs(np.array(late) - lateness))
    index = result.of_machine
    names = [result.names[at] for at in index]
    estimated, covariance = plant.propagated(names, result.covariance[np.ix_(index, index)])
    commissioned = replace(plant.with_values({name: result.values[name] for name in names}), tolerances=EXACT)
    return Baseline(
        commissioned,
        lateness,
        scatter,
        max(CLOCK_SIGMA, scatter),
        problem.noises[kind],
        covariance,
        commission_current(traces, commissioned) if kind == "position" else None,
        estimated,
        kind == "position",
        {known_name(problem.columns.groups[name]): size for name, size in expected_sizes(result).items()},
    )


def _with_stroke_errors(problem: Problem, start: Mapping[str, float], prior: float) -> tuple[Problem, Fit]:
    """The problem with what differs from stroke to stroke as large as the strokes show it, and the fit beside that.

    Short strokes of a slow sensor show no rest. The model is right here, so that drift and hum are learned in motion,
    too. The prior of the stamps' errors, s, is wide enough for the largest; each is well determined by its stroke.
    """
    plant = problem.plant
    problem = problem.condensed().with_columns(columns_of(plant, {}, {}))
    columns, unknowns = problem.columns, unknowns_of(plant)
    stamps = [known(error._replace(sigma=prior)) for error in plant.timing_errors]
    every = [*unknowns.base, *unknowns.known, *stamps, *columns.varying, *columns.unknowns]
    sizes = usual_sizes(columns.groups)
    best = fit(problem, every, start, sizes=sizes)
    for _ in range(MOST_ROUNDS):
        suited = best.gaussian.with_best_sizes().sizes
        change = max((abs(math.log(suited[name] / sizes[name])) for name in columns.groups), default=0.0)
        sizes = dict(suited)
        best = fit(problem, every, best.values, sizes=sizes)
        if change < SETTLED:
            break
    return problem, best


def _noise_at_rest(plant: ValvePlant, result: Fit) -> Noise:
    """White noise, from the residuals where the model rests and does not start within a sample."""
    valve = plant.with_values(result.values)
    squares, count = 0.0, 0
    for index, (channel, shown) in enumerate(zip(plant.channels, result.shown(), strict=True)):
        trace, offset = plant.traces[index], result.values[f"clock_offset[{index}]"]
        speed = np.abs(
            simulate(
                as_it_began(valve, trace), trace.drive, channel.times - offset, start_time=start_before(trace, offset)
            ).pilot_velocity
        )
        is_still = channel.kept(np.convolve(speed > STILL, [1, 1, 1], mode="same") == 0)
        squares += float(np.sum(np.square(channel.kept(channel.data - shown)[is_still])))
        count += int(np.count_nonzero(is_still))
    sigma = math.sqrt(squares / max(1, count))
    return Noise(sigma, sigma, (), 0.0, count)


def _scatter(apart: Array) -> float:
    """Standard deviation of stamp errors, robust: the upper end of the 95 % interval from their median absolute value.

    A network or a scheduler delays a command now and then, and will again: the largest must be covered too.
    """
    middle = float(np.median(apart)) / MEDIAN_OF_NORMAL
    bound = middle * (1.0 + 2.0 * 1.17 / math.sqrt(2.0 * len(apart)))
    return max(bound, float(np.max(apart)) / EXTREME_SIGMAS)


def _at_least_finest(noise: Noise, kind: str) -> Noise:
    finest = FINEST[kind]
    return noise if noise.sigma >= finest else Noise(finest, finest, (), noise.step, noise.samples)


class _Stroke:
    """The fit of one stroke: clocks fixed, free what differs from stroke to stroke."""

    def __init__(self, trace: Trace, baseline: Baseline, jitter: float | None) -> None:
        self._trace = trace
        self._baseline = baseline
        self._jitter = baseline.jitter if jitter is None else jitter
        self._plant = ValvePlant([_judged(trace, baseline.valve)], baseline.valve, is_watched=True)
        self._fixed = {"clock_offset[0]": baseline.lateness, "clock_rate[0]": 0.0}
        problem = Problem(self._plant, noises={self._plant.channels[0].kind: baseline.noise})
        columns = columns_of(self._plant, self._fixed, {}) if baseline.error_sizes else Columns()
        self.problem = problem.with_columns(columns)
        usual = usual_sizes(columns.groups)
        known_sizes = baseline.error_sizes
        self._sizes = {
            name: known_sizes.get(known_name(own), usual[name]) for name, own in columns.groups.items()
        }  # fmt: skip

    def fit(self, free: Sequence[str]) -> Fit:
        """Estimate what differs from stroke to stroke, and the parameters in `free`: their own in this stroke."""
        unknowns, columns = unknowns_of(self._plant, free), self.problem.columns
        varying = () if free else columns.varying
        every = [
            *unknowns.base,
            *unknowns.known,
            *self._shifts(),
            *varying,
            *columns.unknowns,
        ]
        rough = rough_shifts(self._trace, self._baseline.valve, self._baseline.lateness)
        furthest = FURTHEST * self._jitter
        start = {
            f"command_error[0,{index}]": float(np.clip(shift, -furthest, furthest)) for index, shift in enumerate(rough)
        }
        result = fit(self.problem, every, start, held=self._fixed, sizes=self._sizes)
        if result.chi2 < POOR_FIT * self.problem.effective_samples:
            return result
        # A fault of the stroke, or a bad starting point: contacts make shallow local minima.
        again = fit(self.problem, every, {}, held=self._fixed, sizes=self._sizes)
        return min((result, again), key=lambda found: found.chi2)

    def effect_directions(self, result: Fit) -> Iterator[tuple[str, Array]]:
        """Names, and the change of the residuals by a small effect of each: dampings and the catalogue."""
        plant = self._plant
        for name in plant.base:
            values = {**result.values, name: perturbed(plant.parameter(name), plant.declared(name))}
            with contextlib.suppress(SimulationError):
                yield name, self.problem.residuals(values) - result.residuals
        for effect in plant.effects.values():
            own = hypothesis(plant, effect)
            switches = [one for one in own.frees if one.is_switch]
            for switch in switches:
                alone = replace(own, frees=tuple(one for one in own.frees if one is switch or not one.is_switch))
                values = {**result.values, **own.off(), **next(switched_on(alone, Near((SMALL,), has_shapes=False)))}
                with contextlib.suppress(SimulationError):
                    name = effect.name if len(switches) == 1 else f"{effect.name}.{switch.name.partition('.')[2]}"
                    yield name, self.problem.residuals(values) - result.residuals

    def delay_directions(self, result: Fit) -> Iterator[tuple[str, Array]]:
        """What errors of the first and the last stamp change, where these are scored."""
        if self._jitter >= UNINFORMATIVE:
            return
        last = len(self._shifts()) - 1
        for place in sorted({0, last}):
            of_stamp = result.names.index(self._shifts()[place].name)
            yield DELAYS[min(place, 1)], result.gaussian.sums.moved[:, of_stamp] * self._jitter

    def shifts(self, result: Fit) -> Array:
        """(commands,) s, errors of the stamps."""
        return np.array([result.values[own.name] for own in self._shifts()])

    def rms(self, result: Fit) -> float:
        """Root mean square of measured less shown position, m, or current, A; the recording's errors are shown, too."""
        (shown,) = result.shown()
        channel = self._plant.channels[0]
        return root_mean_square(channel.kept(channel.data - shown))

    def _shifts(self) -> list[Unknown]:
        errors = list(self._plant.timing_errors)
        chosen = errors if len(errors) <= MOST_SHIFTS else [errors[0], errors[-1]]
        return [known(own._replace(sigma=self._jitter)) for own in chosen]


def _size(problem: Problem, left: Array) -> float:
    """Sum of squares over the samples in motion as a normal score (Wilson and Hilferty 1931)."""
    moving = moving_residuals(problem, left)
    count = len(moving)
    if count == 0:
        return 0.0
    ratio = float(moving @ moving) / count
    narrow = 2.0 / (9.0 * count)
    return float(np.cbrt(ratio) - 1.0 + narrow) / math.sqrt(narrow)


def _judged(trace: Trace, valve: Valve) -> Trace:
    """A stroke as it is compared: by its positions without the current, which only fault isolation uses.

    The current may be timed by its reception. The zero of the positions is the stroke's own.
    """
    if not trace.has_positions:
        return trace
    return replace(trace, coil_current=None, zero_error=ZERO * valve.parameters.stroke)
