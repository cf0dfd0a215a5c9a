"""Whether a fitted effect is significantly on, and lies where its name may be claimed."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.plants.protocol import EffectChoice, to_internal

EXCLUDES_OFF: Final = 1.96
"""Standard errors that an effect must be away from 'off'."""


def is_away_from_off(result: Fit, choice: EffectChoice) -> bool | None:
    """Whether a parameter of an effect is significantly away from off; None where one is on or beyond a bound."""
    away = False
    if not is_within_claim(result, choice):
        return None
    errors = np.sqrt(np.maximum(np.diag(result.covariance), 0.0))
    for parameter in choice.parameters:
        name = choice.free_name(parameter)
        index = result.free.index(name)
        at = float(result.coordinates[index])
        if parameter.off is None:
            if result.on_bound(name) is not None:
                return None
            continue
        off = to_internal(parameter, parameter.off)
        if result.on_bound(name) is not None and not math.isclose(at, off, abs_tol=1e-12):
            return None
        away = away or (abs(at - off) > EXCLUDES_OFF * float(errors[index]) and at != off)
    return away


def is_within_claim(result: Fit, choice: EffectChoice) -> bool:
    """Whether every parameter of an effect was fitted to where its name may be claimed."""
    return all(
        parameter.lower <= result.values[choice.free_name(parameter)] <= parameter.upper
        for parameter in choice.parameters
    )
