"""The discrepancy's structured algebra beside the whole covariance matrix, written out for a small recording."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest

from identification.selection.linear_plant import LinearPlant
from valve_sim.identification.estimation.linearised import Linearised
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.rows import RowPlaces
from valve_sim.identification.fit.result import fit
from valve_sim.identification.plants.protocol import Array, Channel, EffectChoice, Nuisance
from valve_sim.identification.selection.discrepancy import (
    BLOCK,
    SHARED,
    SIZES,
    Cell,
    Discrepancy,
)
from valve_sim.model import Parameter

STEP, SAMPLES, SIGMA = 1e-3, 120, 0.5
LENGTHS = (0.01, 0.04)
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
    return np.eye(count) + cell.size**2 * indicator @ kernel @ indicator.T


def in_closed_form(result: Fit, further: Array | None = None) -> tuple[float, Array]:
    """Ln p(data) without and, for each cell, with a discrepancy: of normal numbers, with the covariance written out."""
    spread = np.array([own.sigma for own in result.nuisances])
    columns = COLUMNS[:, : len(spread)] / SIGMA * spread
    if further is not None:
        columns = np.hstack([columns, further])
    data = np.concatenate([channel.data for channel in result.problem.plant.channels]) / SIGMA

    def of(dense: Array) -> float:
        whole = dense + columns @ columns.T
        return -0.5 * float(data @ np.linalg.solve(whole, data)) - 0.5 * float(np.linalg.slogdet(whole)[1])

    places = result.problem.rows.places
    cells = [[of(covariance(places, Cell(size, at))) for at in range(len(LENGTHS))] for size in SIZES]
    return of(np.eye(2 * SAMPLES)), np.array(cells)


@pytest.mark.parametrize(("slow", "is_wider"), [(0.0, True), (0.7, False)])
def test_the_evidence_is_that_of_the_whole_covariance(slow: float, *, is_wider: bool) -> None:
    result = fit(problem(slow=slow), (), {}, nuisances=[WIDE, NARROW])
    further = 0.7 * COLUMNS[:, 2:3] if is_wider else None
    plain, cells = in_closed_form(result, further)
    found = Discrepancy(result.problem.rows.places, LENGTHS)
    model = Linearised(result, further)
    without, spread = model.log_evidence(model.sizes), found.spread(model)
    assert without == pytest.approx(plain, abs=1e-6)
    prior = np.array([2.0 / math.pi / (1.0 + size**2) * size * math.log(2.0) for size in SIZES])
    weighted = cells + np.log(prior)[:, None] - math.log(len(LENGTHS))
    assert spread.log_evidence == pytest.approx(float(np.logaddexp.reduce(weighted.ravel())), abs=1e-6)
    best = np.unravel_index(np.argmax(weighted), weighted.shape)
    assert spread.cell == Cell(SIZES[int(best[0])], int(best[1]))
    if further is None:
        assert without == pytest.approx(result.log_evidence, abs=1e-4)
        assert found.spread(Linearised(result)).log_evidence == pytest.approx(spread.log_evidence, abs=1e-9)


def test_noise_alone_speaks_against_a_discrepancy_and_a_slow_error_for_it() -> None:
    odds = []
    for slow in (0.0, 0.7):
        result = fit(problem(slow=slow), (), {}, nuisances=[WIDE, NARROW])
        model = Linearised(result)
        without, spread = (
            model.log_evidence(model.sizes),
            Discrepancy(result.problem.rows.places, LENGTHS).spread(model),
        )
        odds.append(spread.log_evidence - without)
    assert odds[0] < -1.0
    assert odds[1] > 10.0
