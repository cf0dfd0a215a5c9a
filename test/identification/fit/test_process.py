"""A process beside a model, taken apart in its eigenvectors, against the whole covariance matrix written out."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from identification.fit.linear_plant import LinearPlant
from identification.freed import fit
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.process import BLOCK, SHARED, TAUS, Cell, Process
from valve_sim.identification.fit.process import LENGTHS as SHARES
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.rows import RowPlaces
from valve_sim.identification.plants.protocol import Array, Channel, EffectChoice, Nuisance
from valve_sim.model import Parameter

STEP, SAMPLES, SIGMA = 1e-3, 120, 0.5
LENGTHS = tuple(share * 0.5 * 45.0 * STEP for share in SHARES)
"""s: shares of half of the time for which it moves in a stroke."""
TIMES = np.arange(SAMPLES) * STEP
STROKE = (np.arange(SAMPLES) >= SAMPLES // 2).astype(int)
STILL = np.arange(SAMPLES) % (SAMPLES // 2) >= 45
"""The last quarter of each of the two strokes; 45 samples are no whole number of blocks."""
COLUMNS = np.random.default_rng(3).standard_normal((2 * SAMPLES, 4))
WIDE = Nuisance("wide", 3.0, "m")
NARROW = Nuisance("narrow", 0.05, "m")


class TwoSensors(LinearPlant):
    """Two channels of the same two strokes; the second one sits where the first does not and is still as long."""

    def __init__(self, data: Array) -> None:
        super().__init__(data)
        switch = Parameter("size", "m", "added", -1e6, 1e6, 0.3, 0.0)
        self.effects = {"e": EffectChoice("e", (switch,))}
        self.parameters = {"e.size": switch}
        self.channels = [
            Channel(f"sensor {number}", kind, TIMES, own, STILL, STROKE)
            for number, (kind, own) in enumerate(zip(("position", "current"), np.split(data, 2), strict=True))
        ]

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        names = ("wide", "narrow", "level", "e.size")
        return np.split(COLUMNS @ np.array([values.get(name, 0.0) for name in names]), 2)


def problem(seed: int = 1, slow: float = 0.0) -> Problem:
    random = np.random.default_rng(seed)
    data = SIGMA * random.standard_normal(2 * SAMPLES) + 0.8 * COLUMNS[:, 0]
    data += slow * np.tile(np.sin(2.0 * np.pi * TIMES / 0.03) * ~STILL, 2)
    known = Noise(SIGMA, SIGMA, (), 0.0, 10_000)
    return Problem(TwoSensors(data), noises={"position": known, "current": known})


def covariance(places: RowPlaces, cell: Cell) -> Array:
    """V = 1 + τ² U K Uᵀ written out, row by row of the definition."""
    count = len(places.time)
    blocks: list[list[int]] = []
    for stroke in np.unique(places.stroke):
        for channel in np.unique(places.channel):
            own = [row for row in range(count) if places.moves[row] and places.stroke[row] == stroke]
            own = [row for row in own if places.channel[row] == channel]
            blocks += [own[start : start + BLOCK] for start in range(0, len(own), BLOCK)]
    blocks = [block for block in blocks if block]
    indicator = np.zeros((count, len(blocks)))
    for number, block in enumerate(blocks):
        indicator[block, number] = 1.0 / math.sqrt(len(block))
    kernel = np.zeros((len(blocks), len(blocks)))
    for one, first in enumerate(blocks):
        for other, second in enumerate(blocks):
            if places.stroke[first[0]] == places.stroke[second[0]]:
                apart = abs(np.mean(places.time[first]) - np.mean(places.time[second]))
                alike = 1.0 if places.channel[first[0]] == places.channel[second[0]] else SHARED
                kernel[one, other] = alike * math.exp(-apart / LENGTHS[cell.length])
                kernel[one, other] *= math.sqrt(len(first) * len(second))
    return np.eye(count) + cell.tau**2 * indicator @ kernel @ indicator.T


def in_closed_form(result: Fit) -> tuple[float, Array]:
    """Ln p(data) without and, for each cell, with a process: of normal numbers, with the covariance written out."""
    spread = np.array([own.sigma for own in result.nuisances])
    columns = COLUMNS[:, : len(spread)] / SIGMA * spread
    data = np.concatenate([channel.data for channel in result.problem.plant.channels]) / SIGMA

    def of(dense: Array) -> float:
        whole = dense + columns @ columns.T
        return -0.5 * float(data @ np.linalg.solve(whole, data)) - 0.5 * float(np.linalg.slogdet(whole)[1])

    places = result.problem.rows.places
    cells = [[of(covariance(places, Cell(tau, at))) for at in range(len(LENGTHS))] for tau in TAUS.tolist()]
    return of(np.eye(2 * SAMPLES)), np.array(cells)


@pytest.mark.parametrize("slow", [0.0, 0.7])
def test_the_evidence_is_that_of_the_whole_covariance(slow: float) -> None:
    """Noise alone speaks against a process, and a slow error for it."""
    result = fit(problem(slow=slow), (), {}, nuisances=[WIDE, NARROW])
    plain, cells = in_closed_form(result)
    process = Process(result.problem)
    spread = result.gaussian.spread(process)
    assert result.log_evidence == pytest.approx(plain, abs=1e-6)
    prior = np.array([2.0 / math.pi / (1.0 + tau**2) * tau * math.log(2.0) for tau in TAUS])
    weighted = cells + np.log(prior)[:, None] - math.log(len(LENGTHS))
    # Beyond the peak, where nothing counts, it is not worked out.
    assert spread.log_evidence == pytest.approx(float(np.logaddexp.reduce(weighted.ravel())), abs=1e-3)
    best = np.unravel_index(np.argmax(weighted), weighted.shape)
    assert spread.cell == Cell(float(TAUS[int(best[0])]), int(best[1]))
    shares = np.exp(weighted - np.logaddexp.reduce(weighted.ravel()))
    assert spread.tau == pytest.approx(float(shares.sum(axis=1) @ TAUS), rel=1e-3)
    assert spread.log_evidence - plain > 10.0 if slow else spread.log_evidence - plain < -1.0
    beside = result.gaussian.beside(process, spread.cell)
    determinants = 0.5 * float(process.log_determinants(spread.cell).sum())
    assert beside.log_evidence - determinants == pytest.approx(float(cells[best]), abs=1e-6)
