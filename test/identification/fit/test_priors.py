"""Priors: densities that integrate to one, and which one every freed number has."""

from __future__ import annotations

import itertools
import math

import pytest
from scipy.integrate import quad

from identification.fit.linear_plant import LinearPlant, measured
from valve_sim.identification.fit.priors import (
    HALF,
    Cauchy,
    Even,
    LogNormal,
    Normal,
    Prior,
    prior_of,
)
from valve_sim.identification.plants.protocol import EffectChoice
from valve_sim.model import Parameter

NORMAL, CAUCHY, ONE_SIDED = Normal(0.3, 0.02), Cauchy(-1.0, 0.4), Cauchy(2.0, 0.4, HALF)
LOG_NORMAL, EVEN = LogNormal(1.4, 0.7), Even(-2.0, 3.5)


@pytest.mark.parametrize(
    ("prior", "pieces"),
    [
        (NORMAL, (0.1, 0.3, 0.5)),
        (CAUCHY, (-math.inf, -1.0, math.inf)),
        (ONE_SIDED, (2.0, math.inf)),
        (LOG_NORMAL, (0.0, 1.4, math.inf)),
        (EVEN, (-2.0, 3.5)),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_density_integrates_to_one(prior: Prior, pieces: tuple[float, ...]) -> None:
    parts = [
        quad(lambda at: math.exp(prior.log_density(at)) if at > 0.0 or prior is not LOG_NORMAL else 0.0, low, high)[0]
        for low, high in itertools.pairwise(pieces)
    ]
    assert sum(parts) == pytest.approx(1.0, abs=1e-6)


class Declared(LinearPlant):
    """A plant whose refitted value is declared."""

    def parameter(self, name: str) -> Parameter:
        return Parameter("level", "m", "", 0.0, 10.0, 1.0) if name == "level" else super().parameter(name)

    def declared(self, name: str) -> float:
        return 1.4 if name == "level" else super().declared(name)


TWO_SIDED = Parameter("two_sided", "N", "", -5.0, 5.0, 0.3, 0.0)
UPWARDS = Parameter("upwards", "N", "", 0.0, 5.0, 0.3, 0.0)
DOWNWARDS = Parameter("downwards", "1", "", 0.0, 1.0, 0.3, 1.0)
SHAPE = Parameter("shape", "s", "", 1e-3, 1e-1, 1e-2)
FOR_EVER = Parameter("for_ever", "s", "", 0.1, 100.0, 2.0, infinite_at_upper=True)
NEVER = Parameter("never", "A", "", 0.5, math.inf, 4.0, math.inf)


def test_every_freed_number_has_the_prior_of_its_kind() -> None:
    every = EffectChoice("e", (TWO_SIDED, UPWARDS, DOWNWARDS, SHAPE, FOR_EVER, NEVER))
    plant = Declared(measured(), effects=[every])
    assert prior_of(plant, "level") == LogNormal(1.4)
    assert prior_of(plant, "e.two_sided") == Cauchy(0.0, 0.3)
    assert prior_of(plant, "e.upwards") == Cauchy(0.0, 0.3, HALF)
    assert prior_of(plant, "e.downwards") == Cauchy(1.0, 0.3, HALF)
    assert prior_of(plant, "e.shape") == Even(math.log(1e-3), math.log(1e-1))
    # Of the rate: slower, down to none within what can be seen, is as likely as faster.
    assert prior_of(plant, "e.for_ever") == Cauchy(0.01, 0.5, HALF)
    assert prior_of(plant, "e.never") == Cauchy(0.0, 0.25, HALF)
