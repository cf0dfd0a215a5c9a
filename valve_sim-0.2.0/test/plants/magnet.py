"""An electromagnet that lifts a ball off its support, in volts, ohms, henries and newtons.

The coil's inductance is L(z) = L0 + K / (1 + z / d), so that the magnet pulls with i² K / (2 d (1 + z / d)²), and
V = R i + L i' + L'(z) z' i. The ball's mass is free in flight, bounces on the magnet and lies on its support. Fourth-
order Runge–Kutta steps of current, distance and velocity; nothing of it is from the package or its benchmarks, which
write the flux linkage over the resistance, with another law of the gap.
"""

from typing import NamedTuple

import numpy as np

from .common import FloatArray, compiled_entry

SAMPLE, STEPS = 5e-3, 40  # s; steps in it
DUTY_RATE = 0.1  # 1/s
GRAVITY = 9.81
REBOUND, SLOW = 0.35, 0.02  # of the velocity; m/s
SENSOR_END = 0.02  # m


class Rig(NamedTuple):
    """As built, SI. `lifting` is the K of the coil, `pulling` that which moves the ball: another magnet may do that."""

    supply: float = 11.7
    drop: float = 0.6
    resistance: float = 4.17
    inductance: float = 0.12
    lifting: float = 0.045
    pulling: float = 0.045
    gap: float = 6e-3
    mass: float = 0.06054
    permanent: float = 0.0  # V s/m: the ball is a magnet of its own
    warming: float = 0.0  # K/(A² s)


class Measured(NamedTuple):
    """(n,) arrays as a rig would write them, and the truth where the ball lifts.

    `lifted` is the distance in m and the current in A at which the pull is the ball's weight.
    """

    times: FloatArray
    current: FloatArray
    distance: FloatArray
    duty: FloatArray
    lifted: tuple[float, float]


@compiled_entry
def _run(rig, start, duty, is_held):  # type: ignore[no-untyped-def]
    """(n, 2) current and distance at each sample, and the current at which the ball lifts."""
    shown = np.empty((len(duty), 2))
    h = SAMPLE / STEPS
    state = np.zeros(4)  # current, distance, velocity, temperature
    state[1] = start
    lifted = 0.0
    k = np.empty((4, 4))
    for n in range(len(duty)):
        shown[n, 0], shown[n, 1] = state[0], state[1]
        voltage = rig.supply * duty[n] - rig.drop
        for _ in range(STEPS):
            if lifted == 0.0 and not is_held:
                pull = 0.5 * state[0] ** 2 * rig.pulling / rig.gap / (1.0 + state[1] / rig.gap) ** 2
                if pull > rig.mass * GRAVITY:
                    lifted = state[0]
            for stage in range(4):
                share = 0.0 if stage == 0 else h if stage == 3 else 0.5 * h
                y = state + share * k[stage - 1] if stage > 0 else state.copy()
                wide = 1.0 + y[1] / rig.gap
                total = rig.inductance + rig.lifting / wide
                slope = -rig.lifting / rig.gap / wide**2
                back = slope * y[2] * y[0] - rig.permanent * y[2]
                hot = rig.resistance * (1.0 + 0.00393 * y[3])
                k[stage, 0] = (voltage - hot * y[0] - back) / total
                if y[0] <= 0.0 and k[stage, 0] < 0.0:
                    k[stage, 0] = 0.0  # the bridge's transistors do not pass it
                is_free = lifted > 0.0 and not (y[1] <= 0.0 and y[2] == 0.0)
                k[stage, 1] = y[2] if is_free else 0.0
                k[stage, 2] = GRAVITY - 0.5 * y[0] ** 2 * rig.pulling / rig.gap / wide**2 / rig.mass if is_free else 0.0
                k[stage, 3] = rig.warming * y[0] ** 2
            state += h / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
            if state[1] < 0.0:
                state[1] = 0.0
                state[2] = -REBOUND * state[2] if state[2] < -SLOW else 0.0
    return shown, lifted


def recorded(rig: Rig, start: float, seed: int) -> Measured:
    """One jump from a support: the duty cycle rises until the ball lifts, and on to 1.

    Args:
        rig: as built. start: m, distance of the support. seed: of the sensors' noise.
    """
    times = SAMPLE * np.arange(round(1.0 / DUTY_RATE / SAMPLE))
    return _seen(rig, start, times, np.minimum(1.0, DUTY_RATE * times), seed, is_held=False)


def held(rig: Rig, distance: float, seed: int) -> Measured:
    """Steps of the duty cycle, on and off for a second each, with the ball held at a distance in m."""
    times = SAMPLE * np.arange(round(11.0 / SAMPLE))
    second = np.floor(times)
    duty = np.where(second % 2 == 1, 0.1 * (second + 1) / 2, 0.0)
    return _seen(rig, distance, times, duty, seed, is_held=True)


def _seen(rig: Rig, start: float, times: FloatArray, duty: FloatArray, seed: int, *, is_held: bool) -> Measured:
    """What the rig's sensors make of it: noise, and a zero of the current sensor that is not 0."""
    random = np.random.default_rng(seed)
    shown, lifted = _run(rig, start, duty, is_held)
    current = shown[:, 0] + random.uniform(0.02, 0.03) + random.normal(0.0, 6e-3, len(times))
    distance = np.clip(shown[:, 1] + random.normal(0.0, 2e-5, len(times)), 0.0, SENSOR_END)
    return Measured(times, np.maximum(current, 0.0), distance, duty, (start, lifted))
