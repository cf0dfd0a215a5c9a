"""Detection limits, from plant (a) itself: how large an effect must be to stand out of the noise.

One rule for all: the change of the pilot position over the training profile, whitened as the noise of the recording
asks, has a sum of squares of 3.3² standard deviations after dampings and clock have been refitted to it. Dampings are
free; the clock offset, and with command jitter every command's stamp, pays for itself by its prior. Where declared
values have tolerances, each of them is refitted, too, and pays by its tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import Enum
from functools import cache
from typing import Final

import numpy as np
from plants.common import FloatArray
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, train_profile
from plants.tolerances import NAMES, SHEET_VALVE, Entries, deviated

from benchmarks.campaign.effects import CATALOGUED, Effects, Scale

DETECTABLE: Final = 3.3
"""Standard deviations."""
CLOCK_PRIOR: Final = 50e-6
"""s: of a bag's clock offset, and of the error of each command's stamp."""
DAMPINGS: Final = ("pilot_damping", "main_damping")
DECLARED_DAMPING: Final = {name: float(np.asarray(CAMPAIGN_VALVE[name])) for name in DAMPINGS}
DAMPING_STEP, TIME_STEP, DEVIATION_STEP = 2e-3, 0.4e-6, 1e-3
"""Steps of the central differences, N·s/m, s and tolerances: small, as samples beside a contact bend with it."""
COARSE_STEP: Final = 8e-6
"""s, of the plant where there are many unknowns; moves positions by less than a thousandth of the noise."""
REFITS: Final = 10
"""Gauss-Newton steps at most, with the tangents of the declared plant."""
WORTH_A_REFIT: Final = 0.99
"""A step that leaves more than this of the distance is the last."""
CLOSE_ENOUGH: Final = 0.02
"""Of the logarithm of the distance."""
MOST_STEPS: Final = 12


class Knowledge(Enum):
    """What is known of the declared values."""

    EXACT = "the campaign's valve, exactly"
    SHEET = "the valve with a data sheet, exactly"
    WITHIN = "the valve with a data sheet, within its tolerances"


class Yardstick:
    """Measures how far an effect moves plant (a) away from what dampings, clock and tolerances can imitate.

    Args:
        recorder: what the noise is like.
        knowledge: of the declared values.
    """

    def __init__(self, recorder: Recorder, knowledge: Knowledge = Knowledge.EXACT) -> None:
        self._recorder = recorder
        self._profile = train_profile()
        self._sigma = math.hypot(recorder.position_noise, recorder.quantisation / math.sqrt(12.0))
        self._times = np.arange(round(self._profile.duration * recorder.sample_rate)) / recorder.sample_rate
        self._declared: Entries = CAMPAIGN_VALVE if knowledge is Knowledge.EXACT else SHEET_VALVE
        self._deviating = NAMES if knowledge is Knowledge.WITHIN else ()
        self._step = DeclaredPlant.step if knowledge is Knowledge.EXACT else COARSE_STEP
        # Rows: the time by which each command is late for each of the unknown times.
        commands = len(self._profile.times)
        self._delays = np.ones((1, commands))
        if recorder.command_jitter > 0.0:
            self._delays = np.vstack([self._delays, np.eye(commands)])
        # What a step of each unknown is of its prior's standard deviation; dampings are free.
        self._charges = np.concatenate(
            [
                np.zeros(len(DAMPINGS)),
                np.full(len(self._delays), TIME_STEP / CLOCK_PRIOR),
                np.full(len(self._deviating), DEVIATION_STEP),
            ]
        )
        self._tangents = np.column_stack([self._tangent(index) for index in range(self._charges.size)])
        self._imitate = np.linalg.pinv(self._tangents)

    @property
    def samples(self) -> int:
        """Of a recording."""
        return len(self._times)

    def distance(self, effects: Effects) -> float:
        """Standard deviations by which the change stands out after a refit."""
        target = self._position(effects, np.zeros(self._charges.size))
        unknowns = np.zeros(self._charges.size)
        least = math.inf
        for _ in range(REFITS):
            missed = self._whitened(target - self._position({}, unknowns), unknowns)
            distance = float(np.linalg.norm(missed))
            if distance > WORTH_A_REFIT * least:
                return min(distance, least)
            least = distance
            unknowns = unknowns + self._imitate @ missed
        return least

    def distance_of_deviation(self, name: str) -> float:
        """Distance where one declared value is off by one tolerance, by the tangents: at most 1, its prior's price."""
        index = len(DAMPINGS) + len(self._delays) + self._deviating.index(name)
        change = self._tangents[:, index] / DEVIATION_STEP
        change[len(self._times) :] = 0.0
        return float(np.linalg.norm(change - self._tangents @ (self._imitate @ change)))

    def _position(self, effects: Effects, unknowns: FloatArray) -> FloatArray:
        """What an ideal sensor shows; `unknowns` are in the units of their steps."""
        dampings, times, sheet = np.split(unknowns, np.cumsum([len(DAMPINGS), len(self._delays)]))
        damping = {
            name: max(0.0, DECLARED_DAMPING[name] + DAMPING_STEP * float(unknown))
            for name, unknown in zip(DAMPINGS, dampings, strict=True)
        }
        deviations = dict(zip(self._deviating, (DEVIATION_STEP * sheet).tolist(), strict=True))
        plant = DeclaredPlant(
            effects=effects, parameters={**deviated(self._declared, deviations), **damping}, step=self._step
        )
        late = TIME_STEP * (times @ self._delays)
        return plant.simulate(self._profile.times + late, self._profile.volts, self._times).pilot_position

    def _tangent(self, index: int) -> FloatArray:
        """Whitened change of the position for one step of an unknown, and of what its prior charges."""
        step = np.zeros(self._charges.size)
        step[index] = 0.5
        return self._whitened(self._position({}, step) - self._position({}, -step), -2.0 * step)

    def _whitened(self, change: FloatArray, unknowns: FloatArray) -> FloatArray:
        colour = self._recorder.colour
        white = np.concatenate([change[:1], (change[1:] - colour * change[:-1]) / math.sqrt(1.0 - colour**2)])
        return np.concatenate([white / self._sigma, (-self._charges * unknowns)[len(DAMPINGS) :]])


@cache
def yardstick(recorder: Recorder, knowledge: Knowledge = Knowledge.EXACT) -> Yardstick:
    """The yardstick of a kind of noise, made once in a process."""
    return Yardstick(recorder, knowledge)


def size_at(distance: float, scale: Scale, distance_of: Callable[[float], float]) -> float:
    """The size, without its sign, at which an effect stands out by a number of standard deviations.

    Secant steps on logarithms: the distance grows with the size, mostly in proportion.

    Args:
        distance: in standard deviations. scale: of the effect. distance_of: of a size.
    """

    def error(log_size: float) -> float:
        return math.log(max(distance_of(math.exp(log_size)), 1e-6) / distance)

    before, now = math.log(scale.guess), math.log(0.5 * scale.guess)
    error_before, error_now = error(before), error(now)
    for _ in range(MOST_STEPS):
        if abs(error_now) < CLOSE_ENOUGH:
            break
        slope = (error_now - error_before) / (now - before)
        slope = min(max(slope, 0.3), 4.0)
        before, error_before, now = now, error_now, now - error_now / slope
        error_now = error(now)
    return math.exp(now)


def effect_distance(
    measure: Yardstick, name: str, scale: Scale, shape: Mapping[str, float], sign: float = 1.0
) -> Callable[[float], float]:
    """How far an effect stands out, as a function of its size."""
    return lambda size: measure.distance({name: scale.parameters(sign * size, shape)})


def detection_limit(
    name: str, shape: Mapping[str, float], recorder: Recorder, knowledge: Knowledge = Knowledge.EXACT
) -> float:
    """The detection limit of an effect, as a size; of both signs the less visible one's."""
    return _limit(name, tuple(sorted({**shape, **CATALOGUED[name].limit_shape}.items())), recorder, knowledge)


@cache
def _limit(name: str, shape: tuple[tuple[str, float], ...], recorder: Recorder, knowledge: Knowledge) -> float:
    scale = CATALOGUED[name]
    signs = (1.0, -1.0) if scale.is_signed else (1.0,)
    measure = yardstick(recorder, knowledge)
    return max(size_at(DETECTABLE, scale, effect_distance(measure, name, scale, dict(shape), sign)) for sign in signs)
