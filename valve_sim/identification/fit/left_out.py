"""Predictions of strokes that a fit has not seen, from the sums of one linearisation: theory, section 9.

Without a group of strokes the data's products lack those of its rows, so that each group costs two factorisations and
no simulation. The machine, scale and bend of a sensor, the supply and what varies of the machine come from the other
strokes; of those that are left out only clock, stamps, drift and hum are estimated again, and by how much an effect
differs in them that changes from stroke to stroke.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.gaussian import Gaussian
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.model import Model, Sums
from valve_sim.identification.fit.problem import Mask, Problem
from valve_sim.identification.fit.unknown import Group
from valve_sim.identification.plants.protocol import Array, Condition, Plant, primary_channels
from valve_sim.identification.plants.stroke_choice import SAME

FEWEST: Final = 3
"""Groups, of which a mean has a standard error that means something."""
MOST: Final = 12
"""Groups: of more conditions neighbours are left out together."""
VOLTS: Final = 0.5
"""V, within which commands are of one condition."""
KEPT_ERRORS: Final = ("scale", "bend", "supply", "stroke_variation")
"""Errors of a recording that strokes do not have by themselves."""
LITTLE: Final = 1e-12
"""Of its diagonal, added to the information of what nothing determines."""


Stroke = tuple[int, int]
"""(recording, group)."""


class Part(NamedTuple):
    """Strokes that are left out together.

    Attributes:
        words: for people: their condition. strokes: of it. numbers: of them among the rows.
    """

    words: str
    strokes: tuple[Stroke, ...]
    numbers: tuple[int, ...]

    def takes(self, problem: Problem, *, inside: bool) -> Mask:
        """Which samples of a problem are in this part, or outside of it, as `Problem.restricted` takes it."""
        channels = problem.plant.channels

        def mask(index: int, groups: NDArray[np.integer]) -> NDArray[np.bool_]:
            own = [group for recording, group in self.strokes if recording == channels[index].recording]
            found: NDArray[np.bool_] = np.isin(groups, own)
            return (found if inside else ~found) & (problem.weight(index) > 0.0)

        return mask


@dataclass(frozen=True)
class LeftOut:
    """What each part is predicted to be by the others.

    Attributes:
        squares: (g,) of the response in motion less its prediction, in standard deviations of the noise.
        counts: (g,) of its samples. estimates: (g, k) coordinates without each part.
    """

    squares: Array
    counts: Array
    estimates: Array

    @property
    def log_rms(self) -> Array:
        """(g,) ln of the error of each part."""
        return np.asarray(0.5 * np.log(np.maximum(self.squares, 1e-300) / self.counts))


def parts_of(problem: Problem) -> list[Part]:
    """What is left out in turn: conditions; strokes, where there are too few of these; none, where of these, too."""
    if problem.is_long:
        return []
    strokes = _moving_strokes(problem)
    for key_of in (_condition, _alone):
        found: dict[_Key, list[int]] = {}
        for number, stroke in strokes.items():
            found.setdefault(key_of(problem.plant, stroke), []).append(number)
        if len(found) >= FEWEST:
            keys = sorted(found)
            return [
                Part(
                    " to ".join(dict.fromkeys((own[0].words, own[-1].words))),
                    tuple(strokes[number] for key in own for number in found[key]),
                    tuple(number for key in own for number in found[key]),
                )
                for own in _neighbours(keys)
            ]
    return []


class _Key(NamedTuple):
    order: tuple[float, ...]
    words: str


def _neighbours(keys: Sequence[_Key]) -> list[list[_Key]]:
    """Keys, those beside each other together where there are too many."""
    count = min(MOST, len(keys))
    edges = [round(place * len(keys) / count) for place in range(count + 1)]
    return [list(keys[start:stop]) for start, stop in itertools.pairwise(edges)]


def _condition(plant: Plant, stroke: Stroke) -> _Key:
    """Of a valve the voltages of a stroke's commands, and to an octave for how long it was held; else the recording."""
    recording, group = stroke
    name = next(own.source or own.name for own in plant.channels if own.recording == recording)
    numbers = plant.condition_of(recording, group)
    if numbers is None:
        return _Key((float(recording),), name)
    levels = levels_of(numbers)
    octaves = [round(steps * math.log2(1.0 + SAME)) for steps in numbers[1::2]]
    held = [(volts, octave) for volts, octave in zip(levels, octaves, strict=True) if volts != 0.0]
    words = ", ".join(f"{volts:g} V for about {1e3 * 2.0**octave:.0f} ms" for volts, octave in held) or "no command"
    several = len({own.recording for own in plant.channels}) > 1
    return _Key((*itertools.chain.from_iterable(held), float(recording)), f"{name}: {words}" if several else words)


def levels_of(condition: Condition) -> list[float]:
    """The voltages of a valve's condition, V, as far as they are told apart."""
    return [VOLTS * round(volts / VOLTS) for volts in condition[::2]]


def _alone(plant: Plant, stroke: Stroke) -> _Key:
    several = len({own.recording for own in plant.channels}) > 1
    words = f"stroke {stroke[1] + 1}" + (f" of recording {stroke[0] + 1}" if several else "")
    return _Key((float(stroke[0]), float(stroke[1])), words)


def response_in_motion(problem: Problem) -> NDArray[np.bool_]:
    """(r,) rows of the response while the machine moves; all of them, where it is never known to be still or moving."""
    places = problem.rows.places
    responses = np.isin(places.channel, primary_channels(problem.plant))
    moving = responses & places.moves
    return moving if moving.any() else responses


def _moving_strokes(problem: Problem) -> dict[int, Stroke]:
    """The strokes in which the response is seen in motion, by their number among the rows."""
    places, found = problem.rows.places, dict[int, Stroke]()
    rows = np.flatnonzero(response_in_motion(problem))
    numbers, first = np.unique(places.stroke[rows], return_index=True)
    for number, row in zip(numbers.tolist(), rows[first].tolist(), strict=True):
        channel = problem.plant.channels[places.channel[row]]
        sample = min(int(np.searchsorted(channel.times, places.time[row])), len(channel.times) - 1)
        found[number] = (channel.recording, int(channel.group[sample]))
    return found


# -- predictions -------------------------------------------------------------------------------------------------------


def is_own(model: Model) -> NDArray[np.bool_]:
    """(k + q,) what is estimated of strokes that are predicted: clock, stamps, drift, hum, and effects that change."""
    return np.array([not own.of_machine and not _is_kept(own.group) for own in model.unknowns], dtype=bool)


def _is_kept(group: Group | None) -> bool:
    return group is not None and group.error in KEPT_ERRORS and not group.is_change


def left_out(gaussian: Gaussian, parts: Sequence[Part]) -> LeftOut:
    """Each part predicted by the others.

    Args:
        gaussian: where a fit to all of them ended.

    Raises:
        numpy.linalg.LinAlgError: the others do not determine what is freed.
    """
    rows, seen = gaussian.sums.rows, response_in_motion(gaussian.model.problem)
    squares, counts, estimates = [], [], []
    for part in parts:
        inside = _inside(gaussian, part)
        rest = _without(gaussian, rows[inside])
        move = predicting(gaussian, rest, rest.step()[0])
        chosen = rows[inside & seen]
        left = chosen[:, -1] + chosen[:, :-1] @ move
        squares.append(float(left @ left))
        counts.append(float(len(left)))
        estimates.append(gaussian.z + move[: gaussian.count])
    return LeftOut(np.array(squares), np.array(counts), np.array(estimates))


def expected_log_rms(gaussian: Gaussian, parts: Sequence[Part], tau: float = 0.0) -> Array:
    """(g,) ln of the error that the posterior expects of each part, in standard deviations of the noise.

    Args:
        gaussian, parts: see `left_out`. tau: τ, of something unnamed.

    Raises:
        numpy.linalg.LinAlgError: the others do not determine what is freed.
    """
    rows, seen, own = gaussian.sums.rows, response_in_motion(gaussian.model.problem), is_own(gaussian.model)
    found = []
    for part in parts:
        inside = _inside(gaussian, part)
        machine, errors = (rows[inside & seen, :-1][:, chosen] for chosen in (~own, own))
        if own.any():  # which follow where the machine is another
            machine = machine - errors @ _solved(gaussian.M[np.ix_(own, own)], gaussian.M[np.ix_(own, ~own)])
        covariance = _without(gaussian, rows[inside]).inverse[np.ix_(~own, ~own)]
        open_ = np.einsum("rk,kl,rl->r", machine, covariance, machine, optimize=True)
        found.append(0.5 * math.log(1.0 + tau**2 + float(np.mean(open_))))
    return np.array(found)


def _inside(gaussian: Gaussian, part: Part) -> NDArray[np.bool_]:
    return np.isin(gaussian.model.problem.rows.places.stroke, part.numbers)


def _without(gaussian: Gaussian, rows: Array) -> Gaussian:
    """A fit linearised without some rows."""
    sums = gaussian.sums
    others = Sums(sums.moved, sums.fixed, sums.products - gram(rows, rows), sums.constant)
    return Gaussian(gaussian.model, gaussian.z, others, gaussian.sizes, gaussian.known)


def predicting(whole: Gaussian, rest: Gaussian, step: Array) -> Array:
    """(k + q,) the step by which all data are predicted: what is their own by themselves, all else by the others.

    Args:
        whole, rest: linearised at one place, with all data and with the others alone. step: (k,) what these say.
    """
    k = rest.count
    move = np.concatenate([step, np.zeros(len(rest.M) - k)])
    if k < len(move):
        move[k:] = _solved(rest.M[k:, k:], -(rest.g[k:] + rest.M[k:, :k] @ step))
    own = is_own(rest.model)
    if own.any():
        kept = ~own
        move[own] = _solved(whole.M[np.ix_(own, own)], -(whole.g[own] + whole.M[np.ix_(own, kept)] @ move[kept]))
    return move


def left_by(gaussian: Gaussian) -> Array:
    """(r,) residuals of a fit where it ended, the errors of the sensors at their best; none of a long recording."""
    coefficients = predicting(gaussian, gaussian, np.zeros(gaussian.count))[gaussian.count :]
    return np.asarray(gaussian.sums.left + gaussian.sums.fixed @ coefficients)


def _solved(matrix: Array, right: Array) -> Array:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = matrix * np.outer(scale, scale) + LITTLE * np.eye(len(matrix))
    return np.asarray((scale * np.linalg.solve(unit, (scale * right.T).T).T).T)
