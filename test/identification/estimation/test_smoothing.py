"""Penalised curves in a fit: the weights follow from the data, and the curve is the one behind them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.model.effects import basis

COUNT = 40
NOISE = 0.1


class Found(NamedTuple):
    """(n,) a curve, its standard errors, and those if the weights were known; and its prior."""

    curve: np.ndarray
    stderr: np.ndarray
    stderr_of_known: np.ndarray
    smooth: Smoothness


def fitted(truth: np.ndarray, places: np.ndarray, seed: int) -> Found:
    """A curve through noisy values of a function, by the weights that the data choose."""
    measured = truth + NOISE * np.random.default_rng(seed).standard_normal(len(places))
    shapes = basis(places, 0.0, 1.0, COUNT) / NOISE
    # A level beside the curve, held near 0, as other parameters of a fit are.
    columns = np.column_stack([np.ones(len(places)) / NOISE, shapes])
    information = columns.T @ columns
    information[0, 0] += 1e6
    where, at = np.arange(1, COUNT + 1), np.zeros(COUNT + 1)
    smooth = Smoothness(tuple(f"c{number}" for number in where), -np.inf)
    gradient = -columns.T @ (measured / NOISE)
    for _ in range(12):
        smooth = smooth.chosen(information, gradient + information @ at, at, where)
        normal = information.copy()
        normal[np.ix_(where, where)] += smooth.precision
        at = np.linalg.solve(normal, -gradient)
    known = np.linalg.inv(normal)[np.ix_(where, where)]
    covariance = smooth.covariance(information, gradient + information @ at, at, where)
    own = shapes * NOISE
    errors = [np.sqrt(np.einsum("ij,jk,ik->i", own, one, own)) for one in (covariance, known)]
    return Found(own @ at[where], errors[0], errors[1], smooth)


PLACES = np.linspace(0.0, 1.0, 400)
BUMP = np.exp(-(((PLACES - 0.4) / 0.07) ** 2))
WAVES = np.sin(2 * np.pi * 3 * PLACES)


@pytest.mark.parametrize("truth", [BUMP, WAVES, 0.3 * PLACES], ids=["bump", "waves", "line"])
def test_a_known_curve_comes_back_from_noisy_data(truth: np.ndarray) -> None:
    errors, covered = [], []
    for seed in range(8):
        curve, stderr, *_ = fitted(truth, PLACES, seed)
        errors.append(float(np.sqrt(np.mean((curve - truth) ** 2))))
        covered.append(float(np.mean(np.abs(curve - truth) < 2.0 * stderr)))
    # Forty coefficients without a penalty leave NOISE * sqrt(40 / 400), a third of the noise.
    assert max(errors) < 0.3 * NOISE
    assert np.mean(covered) > 0.85


@pytest.mark.long
def test_a_band_holds_a_narrow_bump() -> None:
    """Smoothing bends a narrow bump of twice the noise; how much is as uncertain as the weights."""
    bump = 2.0 * NOISE * np.exp(-(((PLACES - 0.4) / 0.05) ** 2))
    near = np.abs(PLACES - 0.4) < 0.1
    found = [fitted(bump, PLACES, seed) for seed in range(30)]
    held = [float(np.mean((np.abs(one.curve - bump) < 2.0 * one.stderr)[near])) for one in found]
    known = [float(np.mean((np.abs(one.curve - bump) < 2.0 * one.stderr_of_known)[near])) for one in found]
    assert np.mean(held) > np.mean(known) + 0.01
    assert np.mean(held) > 0.92
    everywhere = [float(np.mean(np.abs(one.curve - bump) < 2.0 * one.stderr)) for one in found]
    assert 0.92 < np.mean(everywhere) < 0.99
