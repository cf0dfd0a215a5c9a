"""How large the errors of a recording are: sizes and modes learned beside a model, before others are compared with it.

    hold each size at 0.3 of its prior's scale; fit
    repeat: look for modes of the sensor's mount in what is left; sizes of the most probable evidence; fit again
    until ln p gains less than 1

Each hypothesis of a search then has the most probable sizes of its own (`linearised`); these are where it starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.estimation.errors.error import Mode
from valve_sim.identification.estimation.errors.ringing import columns, grid, refined
from valve_sim.identification.estimation.linearised import Linearised
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.projection import OrthogonalProjector
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.structured_noise import StructuredNoise, seen_by, structured_noise
from valve_sim.identification.plants.protocol import HasSensors, Sensor

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
