"""Detection limits, from plant (a) itself: how large an effect must be to stand out of the noise.

One rule for all: the change of the pilot position over the training profile, whitened as the noise of the recording
asks, has a sum of squares of 3.3² standard deviations after dampings and clock have been refitted to it. Dampings are
free; the clock offset, and with command jitter every command's stamp, pays for itself by its prior.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Final

import numpy as np
from plants.common import FloatArray
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, train_profile

from benchmarks.campaign.effects import CATALOGUED, Effects, Scale

DETECTABLE: Final = 3.3
"""Standard deviations."""
CLOCK_PRIOR: Final = 50e-6
"""s: of a bag's clock offset, and of the error of each command's stamp."""
DAMPINGS: Final = ("pilot_damping", "main_damping")
DECLARED_DAMPING: Final = {name: float(np.asarray(CAMPAIGN_VALVE[name])) for name in DAMPINGS}
DAMPING_STEP, TIME_STEP = 2e-3, 0.4e-6
"""Steps of the central differences, N·s/m and s."""
REFITS: Final = 10
"""Gauss-Newton steps at most, with the tangents of the declared plant."""
WORTH_A_REFIT: Final = 0.99
"""A step that leaves more than this of the distance is the last."""
CLOSE_ENOUGH: Final = 0.02
"""Of the logarithm of the distance."""
MOST_STEPS: Final = 12


class Yardstick:
    """Measures how far an effect moves plant (a) away from what dampings and clock can imitate.

    Args:
        recorder: what the noise is like.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self._profile = train_profile()
        self._sigma = math.hypot(recorder.position_noise, recorder.quantisation / math.sqrt(12.0))
        self._times = np.arange(round(self._profile.duration * recorder.sample_rate)) / recorder.sample_rate
        # Rows: the time by which each command is late for each of the unknown times.
        commands = len(self._profile.times)
        self._delays = np.ones((1, commands))
        if recorder.command_jitter > 0.0:
            self._delays = np.vstack([self._delays, np.eye(commands)])
        columns = [self._tangent(index) for index in range(len(DAMPINGS) + len(self._delays))]
        self._imitate = np.linalg.pinv(np.column_stack(columns))

    @property
    def samples(self) -> int:
        """Of a recording."""
        return len(self._times)

    def distance(self, effects: Effects) -> float:
        """Standard deviations by which the change stands out after dampings and clock are refitted."""
        target = self._position(effects, np.zeros(len(self._imitate)))
        unknowns = np.zeros(len(self._imitate))
        least = math.inf
        for _ in range(REFITS):
            missed = self._whitened(target - self._position({}, unknowns), unknowns)
            distance = float(np.linalg.norm(missed))
            if distance > WORTH_A_REFIT * least:
                return min(distance, least)
            least = distance
            unknowns = unknowns + self._imitate @ missed
        return least

    def _position(self, effects: Effects, unknowns: FloatArray) -> FloatArray:
        """What an ideal sensor shows; `unknowns` are in the units of their steps."""
        damping = {
            name: max(0.0, DECLARED_DAMPING[name] + DAMPING_STEP * float(unknown))
            for name, unknown in zip(DAMPINGS, unknowns[: len(DAMPINGS)], strict=True)
        }
        late = TIME_STEP * (unknowns[len(DAMPINGS) :] @ self._delays)
        plant = DeclaredPlant(effects=effects, parameters=damping)
        return plant.simulate(self._profile.times + late, self._profile.volts, self._times).pilot_position

    def _tangent(self, index: int) -> FloatArray:
        """Whitened change of the position for one step of an unknown, and of what its prior charges."""
        step = np.zeros(len(DAMPINGS) + len(self._delays))
        step[index] = 0.5
        return self._whitened(self._position({}, step) - self._position({}, -step), -2.0 * step)

    def _whitened(self, change: FloatArray, unknowns: FloatArray) -> FloatArray:
        colour = self._recorder.colour
        white = np.concatenate([change[:1], (change[1:] - colour * change[:-1]) / math.sqrt(1.0 - colour**2)])
        return np.concatenate([white / self._sigma, -TIME_STEP / CLOCK_PRIOR * unknowns[len(DAMPINGS) :]])


@cache
def yardstick(recorder: Recorder) -> Yardstick:
    """The yardstick of a kind of noise, made once in a process."""
    return Yardstick(recorder)


def size_at(
    distance: float, name: str, scale: Scale, shape: Mapping[str, float], recorder: Recorder, sign: float = 1.0
) -> float:
    """The size, without its sign, at which an effect stands out by a number of standard deviations.

    Secant steps on logarithms: the distance grows with the size, mostly in proportion.
    """
    measure = yardstick(recorder)

    def error(log_size: float) -> float:
        parameters = scale.parameters(sign * math.exp(log_size), shape)
        return math.log(max(measure.distance({name: parameters}), 1e-6) / distance)

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


def detection_limit(name: str, shape: Mapping[str, float], recorder: Recorder) -> float:
    """The detection limit of an effect, as a size; of both signs the less visible one's."""
    return _limit(name, tuple(sorted({**shape, **CATALOGUED[name].limit_shape}.items())), recorder)


@cache
def _limit(name: str, shape: tuple[tuple[str, float], ...], recorder: Recorder) -> float:
    scale = CATALOGUED[name]
    signs = (1.0, -1.0) if scale.is_signed else (1.0,)
    return max(size_at(DETECTABLE, name, scale, dict(shape), recorder, sign) for sign in signs)
