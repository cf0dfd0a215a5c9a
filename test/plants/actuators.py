"""Actuators of ten kinds: the true rates of change of each, and small steps that integrate them.

Steps are by the midpoint rule, with dry friction as what takes a velocity towards 0. Nothing of it is from the package.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import yaml
from numba import njit

SUBSTEPS: Final = 60


class Kind(NamedTuple):
    """A kind of actuator, as the file beside this one has it, which says what each entry means."""

    plant: dict[str, Any]
    values: list[float]
    sizes: dict[str, float]
    slides: int
    inertia: int
    drive: dict[str, Any]
    rates: Callable[..., Any]


@njit
def march(rates, slides, inertia, start, times, inputs, p, e):  # type: ignore[no-untyped-def]
    shown = np.zeros((len(times), len(start)))
    s = start.copy()
    for i in range(len(times)):
        shown[i] = s
        if i == len(times) - 1:
            break
        h = (times[i + 1] - times[i]) / SUBSTEPS
        for k in range(SUBSTEPS):
            u0 = inputs[i] + (inputs[i + 1] - inputs[i]) * k / SUBSTEPS
            u1 = inputs[i] + (inputs[i + 1] - inputs[i]) * (k + 0.5) / SUBSTEPS
            half = s + 0.5 * h * rates(s, u0, p, e)
            s = s + h * rates(half, u1, p, e)
            if slides >= 0:
                v = s[slides]
                s[slides] = np.sign(v) * max(0.0, abs(v) - h * (e[0] / p[inertia]))
    return shown


@njit
def axis_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    x, v = s[0], s[1]
    force = u - p[1] * v + e[1] - e[2] * v * abs(v) - e[3] * x
    return np.array([v, force / p[0]])


@njit
def arm_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    q, w = s[0], s[1]
    return np.array([w, (u - p[1] * w - e[1] * np.sin(q) + e[2] - e[3] * q) / p[0]])


@njit
def spring_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    x, v = s[0], s[1]
    return np.array([v, (u - p[1] * v - p[2] * x - e[1] * x**3 + e[2] - e[3] * v * abs(v)) / p[0]])


@njit
def coil_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    i = s[0]
    drop = e[0] * np.tanh(i / 1e-6) if e[0] > 0.0 else 0.0
    return np.array([(u - p[0] * i - drop + e[1]) * (1.0 + e[2] * i * i) / p[1]])


@njit
def tank_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    h = s[0]
    return np.array([(u - p[0] * np.sqrt(h + 0.01) - e[0] * h - e[1] * max(0.0, h - 0.35) + e[2]) / p[1]])


@njit
def heater_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    t = s[0]
    return np.array([(p[0] * u - t - e[0] * t * t + e[1] - e[2] * max(0.0, t - 30.0)) / p[1]])


@njit
def motor_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    i, w = s[0], s[1]
    return np.array([(u - p[0] * i - p[1] * w) / p[2], (p[1] * i - p[3] * w + e[1] - e[2] * w * abs(w)) / p[4]])


@njit
def voice_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    i, x, v = s[0], s[1], s[2]
    pull = p[1] * (1.0 - e[1] * x * x) * i
    return np.array(
        [(u - p[0] * i - p[1] * (1.0 - e[1] * x * x) * v) / p[2], v, (pull - p[3] * v - p[4] * x + e[2]) / p[5]]
    )


@njit
def valve_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    y, x = s[0], s[1]
    through = y - max(-e[0], min(e[0], y))
    return np.array([(u - y) / p[0], p[1] * through + e[1] - e[2] * x])


@njit
def two_rates(s, u, p, e):  # type: ignore[no-untyped-def]
    a, va, b, vb = s[0], s[1], s[2], s[3]
    twist = a - b
    pull = p[2] * twist + p[3] * (va - vb) + e[2] * twist**3
    return np.array([va, (u - pull - p[4] * va) / p[0], vb, (pull - e[1] * vb * abs(vb) + e[3]) / p[1]])


RATES: Final[dict[str, Callable[..., Any]]] = {
    "slide": axis_rates, "arm": arm_rates, "spring": spring_rates, "coil": coil_rates, "tank": tank_rates,
    "heater": heater_rates, "motor": motor_rates, "voice_coil": voice_rates, "cylinder": valve_rates,
    "two_inertias": two_rates,
}  # fmt: skip
"""True rates of change of each kind, of (states, input, values, sizes of effects)."""
_READ: Final = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
KINDS: Final = {name: Kind(**own, rates=RATES[name]) for name, own in _READ.items()}
