"""How large the errors of a recording are: sizes and modes learned beside a model, before others are compared with it.

    hold each size at 0.3 of its prior's scale; fit
    repeat: look for modes of the sensor's mount in what is left; sizes of the most probable evidence; fit again
    until ln p gains less than 1

Each hypothesis of a search then has the most probable sizes of its own (`linearised`); these are where it starts.

`fit_recording` estimates the errors of a recording on a machine that stays as it is: those of clocks and stamps, too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.estimation.errors.error import Mode
from valve_sim.identification.estimation.errors.ringing import columns, grid, refined
from valve_sim.identification.estimation.findings import leaves_more_than_noise
from valve_sim.identification.estimation.linearised import Linearised, OrthogonalProjector
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.estimation.structured_noise import StructuredNoise, seen_by, structured_noise
from valve_sim.identification.plants.protocol import HasSensors, Nuisance, Sensor
from valve_sim.model import SimulationError

MOST_ROUNDS: Final = 4
"""Of fits and sizes."""
SETTLED: Final = 1.0
"""Gain of ln p in a round, below which sizes have settled."""
MOST_MODES: Final = 2
"""Of one mount."""
WORTH: Final = 8.0
"""Gain of ln p from which a mode is one."""
RINGS: Final = 20e-3
"""s after a contact, in which ringing is looked for."""
PLAINLY: Final = 4.0
"""Standard deviations of a sum of squares beyond which more than noise is left after contacts."""

Fitted = Callable[[Problem, Fit | None], Fit]
"""The best fit to a problem, begun where another has ended, if any."""
DRAWS: Final = 32
"""Errors of the stamps that are drawn to start a fit from."""
ROBUST: Final = 20.0
"""σ: scale of the cost by which these are compared, so that one impact at another time does not decide."""
REDRAWN: Final = 3
"""Largest number of draws."""


def with_learned_errors(
    problem: Problem,
    fitted: Fitted,
    near: Fit | None = None,
    known: StructuredNoise | None = None,
    held: Mapping[str, float] | None = None,
    *,
    reads_at_rest: bool = True,
) -> tuple[Problem, Fit]:
    """A problem with the errors of its recordings as large as they are beside a model, and the model's fit.

    Args:
        problem: data and noise. fitted: fits the model.
        near: a fit of it with other errors, near which those are that are looked for; None: nothing is known of them.
        known: errors of other recordings of the same machine by the same sensors, whose mounts ring in no other ways.
        held: sizes that are not learned, by the names of `StructuredNoise.known_sizes`.
        reads_at_rest: whether drift and hum are read while the machine is still, else in motion as well, where they
            would follow what the model lacks. With `near` or `known` they are read as those were.

    Raises:
        SimulationError: the machine cannot be simulated.
    """
    if near is None:
        errors = None if problem.is_long else structured_noise(problem.plant, {}, {} if known is None else known.modes)
    else:
        errors = None if problem.errors is None else problem.errors.with_varying()
    if errors is None:
        return problem, fitted(problem, near)
    problem = problem.with_errors(errors.as_known(known).held_at(held or {}))
    best = fitted(problem, near)
    assert problem.errors is not None
    before = problem.errors if near is not None and known is None else known
    if reads_at_rest if before is None else any(own.is_read for own in before.groups):
        problem = problem.with_errors(problem.errors.with_read(Linearised(best).sizes_at_rest()))
        best = fitted(problem, best)
    for _ in range(MOST_ROUNDS):
        resized = relearned(best, known)
        again = fitted(resized, best)
        gain = again.log_evidence - best.log_evidence
        if gain > 0.0:
            problem, best = resized, again
        if gain < SETTLED:
            break
    return problem, best


def with_forgotten_errors(problem: Problem, values: Mapping[str, float]) -> Problem:
    """A problem with errors of its recordings as large as they are before the data are asked.

    Beside a model that lacks something, learned errors imitate what it lacks, most of all numbers of the machine that
    vary from stroke to stroke; so there are none of these.

    Args:
        problem: with learned errors. values: by which its machine is simulated.
    """
    assert problem.errors is not None
    # Columns that had the shape of what is left out would explain it in the machine's place.
    varying = {own.name for own in problem.errors.varying}
    kept = {name: value for name, value in values.items() if name not in varying}
    few = structured_noise(problem.plant, kept, {}, problem.errors.unlearned())
    assert few is not None
    return problem.with_errors(few.without_varying())


def relearned(best: Fit, known: StructuredNoise | None = None) -> Problem:
    """The problem of a fit with the sizes and modes of its recordings' errors that are most probable beside it.

    Args:
        best: the fit. known: as of `with_learned_errors`.
    """
    problem, plant = best.problem, best.problem.plant
    assert problem.errors is not None
    assert isinstance(plant, HasSensors)

    def beside(modes: Mapping[int, tuple[Mode, ...]], before: StructuredNoise) -> tuple[float, StructuredNoise]:
        errors = structured_noise(plant, best.values, modes, before)
        assert errors is not None
        model = Linearised(replace(best, problem=problem.with_errors(errors)))
        return model.integrated, errors.resized(model.best_sizes)

    most, errors = beside(problem.errors.modes, problem.errors)
    for channel, sensor in plant.sensors(best.values).items():
        # What was found beside another fit is some hertz off, and then there is one more as far as it may be.
        for place, mode in enumerate(errors.modes.get(channel, ())):
            others = _without(errors.modes[channel], place)
            _, without = beside({**errors.modes, channel: others}, errors)
            closer = refined_mode(replace(best, problem=problem.with_errors(without)), channel, sensor, mode)
            found, further = beside({**errors.modes, channel: (*others, closer)}, errors)
            if found > most:
                most, errors = found, further
        modes, there = errors.modes.get(channel, ()), replace(best, problem=problem.with_errors(errors))
        if known is not None or len(modes) == MOST_MODES or not rings(there, channel, sensor):
            continue
        another = likely_mode(there, channel, sensor)
        if another is not None:
            found, further = beside({**errors.modes, channel: (*modes, another)}, errors)
            if found > most + WORTH:
                most, errors = found, further
    return problem.with_errors(errors.as_known(known))


def _without(modes: tuple[Mode, ...], place: int) -> tuple[Mode, ...]:
    return (*modes[:place], *modes[place + 1 :])


def rings(result: Fit, channel: int, sensor: Sensor) -> bool:
    """Whether more than noise is left of a channel soon after parts have met."""
    places = result.problem.rows.places
    times = sensor.contacts.times
    if not len(times):
        return False
    since = places.time - times[np.clip(np.searchsorted(times, places.time) - 1, 0, None)]
    own = (places.channel == channel) & (since >= 0.0) & (since < RINGS) & (places.steady > 0.0)
    left = result.problem.without_errors(result.left.condensed()[:, None])[own, 0]
    count = len(left)
    return count > 0 and float(left @ left) > count + PLAINLY * math.sqrt(2.0 * count)


def likely_mode(result: Fit, channel: int, sensor: Sensor) -> Mode | None:
    """The mode that explains most of what is left of a channel, all else that was fitted at its best; None of noise."""
    gain, candidates = _gain_of_modes(result, channel, sensor), grid(_interval(result, channel))
    if not candidates:
        return None
    best = max(candidates, key=gain)
    return refined(best, lambda mode: -gain(mode), _interval(result, channel)) if gain(best) > WORTH else None


def refined_mode(result: Fit, channel: int, sensor: Sensor, mode: Mode) -> Mode:
    """The mode near another one that explains most of what is left of a channel."""
    gain = _gain_of_modes(result, channel, sensor)
    return refined(mode, lambda one: -gain(one), _interval(result, channel))


def _interval(result: Fit, channel: int) -> float:
    """Of the samples, s."""
    return float(np.median(np.diff(result.problem.plant.channels[channel].times)))


def _gain_of_modes(result: Fit, channel: int, sensor: Sensor) -> Callable[[Mode], float]:
    """What χ² falls by with a mode, all else that was fitted at its best."""
    problem, own = result.problem, result.problem.plant.channels[channel]
    outside, shown = OrthogonalProjector(result), np.zeros(len(own.times))

    def gain(mode: Mode) -> float:
        waves = columns(seen_by(sensor, own, shown, (mode,)))
        where, found = problem.rows.whitened_columns({channel: waves})[channel]
        moved = np.zeros((len(result.left.condensed()), waves.shape[1]))
        moved[where] = found
        return outside.gain(moved)

    return gain


def fit_recording(problem: Problem, machine: Mapping[str, float], known: StructuredNoise | None = None) -> Fit:
    """What a machine of known values shows of a recording, once the errors of the recording are estimated.

    Errors of the commands' stamps are among them where the evidence is for it: most recorders stamp commands well, and
    a few stamp them when they happen to receive them. A plunger that turns beside a contact touches it or does not, by
    some microseconds of a stamp: where more than noise is left, the fit begins again from other stamps.

    Errors of its sensors are as large as the problem has them; where it has none, they are learned beside the machine.

    Args:
        problem: the recording. machine: values of the machine by name; what is missing is as declared.
        known: errors of other recordings of the same machine by the same sensors.

    Raises:
        SimulationError: the machine cannot be simulated.
    """
    if problem.errors is not None:
        return _fitted(problem, machine, None)
    return with_learned_errors(problem, lambda one, begun: _fitted(one, machine, begun), known=known)[1]


def _fitted(problem: Problem, machine: Mapping[str, float], begun: Fit | None) -> Fit:
    """The best fit of clocks and stamps for given errors of the sensors, begun where another has ended, if any."""
    plant = problem.plant
    clocks = tuple(own for own in problem.nuisances if not own.is_of_machine)
    plain = fit(problem, (), {} if begun is None else begun.values, nuisances=clocks, fixed=machine)
    if not plant.timing_errors:
        return plain
    nuisances = (*clocks, *plant.timing_errors)
    stamped = fit(problem, (), plain.values, nuisances=nuisances, fixed=machine)
    best = max(plain, stamped, key=lambda found: found.log_evidence)
    for seed in range(REDRAWN):
        if not leaves_more_than_noise(best):
            break
        start = likely_stamps(problem, plant.timing_errors, {**machine, **plain.values}, seed)
        again = fit(problem, (), {**plain.values, **start}, nuisances=nuisances, fixed=machine)
        best = max(best, again, key=lambda found: found.log_evidence)
    return best


def likely_stamps(
    problem: Problem, stamps: Sequence[Nuisance], values: Mapping[str, float], seed: int
) -> dict[str, float]:
    """Errors of the stamps, drawn from their priors: of several draws the best for what each of them acts on.

    Args:
        problem: the recording. stamps: their errors. values: of all else. seed: of the draws.
    """
    random = np.random.default_rng(seed)
    costs = []
    draws = [
        {own.name: own.sigma * z for own, z in zip(stamps, random.standard_normal(len(stamps)).tolist(), strict=True)}
        for _ in range(DRAWS)
    ]
    count = sum(len(channel.data) for channel in problem.plant.channels)
    for draw in draws:
        try:
            residuals = problem.residuals({**values, **draw})
        except SimulationError:
            residuals = np.full(count, np.inf)
        costs.append(np.log1p(np.square(residuals / ROBUST)))
    reaches = {own.name: problem.every_row.reach(own) for own in stamps}
    best = {name: int(np.argmin([cost[reach].sum() for cost in costs])) for name, reach in reaches.items()}
    return {name: draws[index][name] for name, index in best.items()}
