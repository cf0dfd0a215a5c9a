"""Tests of whether a model's residual is white: theory, eq. (43)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import fdtrc

from valve_sim.identification.fit.gram import sum_squares
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.protocol import Array

BLOCKS: Final = (4, 16)
"""Samples in the blocks whose means would show a slow residual."""
SIGNIFICANT: Final = 1e-4
"""Below this p-value, over all tests together, the residual is not white."""


@dataclass(frozen=True)
class Adequacy:
    """Tests of a fit's residuals against the noise, over the samples in which the machine moves.

    Attributes:
        p_value: of the most telling test, all tests counted. worst: that test, in words.
    """

    p_value: float
    worst: str

    @property
    def is_white(self) -> bool:
        """Whether the residual is white."""
        return self.p_value > SIGNIFICANT


def adequacy(result: Fit) -> Adequacy:
    """Test a fit's residuals: their size, and that of their means over short blocks."""
    return whiteness(result.problem, result.unexplained, round(result.effective_parameters))


def whiteness(problem: Problem, residuals: Array, free: int) -> Adequacy:
    """Test whitened residuals to which so many parameters were fitted."""
    moving = moving_residuals(problem, residuals)
    count = len(moving)
    if count < 50:
        return Adequacy(1.0, "too few samples in motion to tell")
    quiet = max(1, min(noise.samples for noise in problem.noises.values()))
    tests = {"the residual is larger than the noise": _size_test(moving, quiet, free)}
    for block in BLOCKS:
        whole = count // block * block
        means = moving[:whole].reshape(-1, block).mean(axis=1) * math.sqrt(block)
        tests[f"the residual drifts over {block} samples"] = _size_test(means, quiet, free)
    worst = min(tests, key=lambda name: tests[name])
    return Adequacy(min(1.0, len(tests) * tests[worst]), worst)


def moving_residuals(problem: Problem, residuals: Array) -> Array:
    """The whitened residuals of samples that take part and in which the machine is not known to be still."""
    pieces, start = [], 0
    for index, channel in enumerate(problem.plant.channels):
        stop = start + len(channel.data)
        takes_part = problem.weight(index) > 0.0
        pieces.append(residuals[start:stop][takes_part & ~channel.quiet])
        start = stop
    return np.concatenate(pieces)


def _size_test(values: Array, quiet: int, free: int) -> float:
    """P-value of Σ values² being noise, whose own variance is known from `quiet` samples only (an F test)."""
    freedom = max(1, len(values) - free)
    ratio = sum_squares(values) / freedom
    return float(fdtrc(freedom, quiet, ratio))
