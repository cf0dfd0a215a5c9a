"""A plant whose sensor shows a sum of known columns, so that what a fit of it gains is known by least squares alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.plants.protocol import Array, Channel, EffectChoice, ForceMap, Nuisance, Plant
from valve_sim.model import Parameter

SAMPLES, STROKES = 1000, 8
SIGMA = 0.5
TIMES = np.arange(SAMPLES) / 1000.0
COLUMNS = np.random.default_rng(11).standard_normal((SAMPLES, 12))
"""Without any relation to each other but chance."""


class LinearPlant(Plant):
    """Shown: `level` times the first column, and what `shown` makes of the values."""

    base: Sequence[str] = ("level",)
    channels: Sequence[Channel] = ()
    nuisances: Sequence[Nuisance] = ()
    effects: Mapping[str, EffectChoice] = MappingProxyType({})
    force_maps: Sequence[ForceMap] = ()

    def __init__(
        self,
        data: Array,
        shown: Callable[[Mapping[str, float]], Array | float] = lambda values: 0.0,
        *,
        effects: Sequence[EffectChoice] = (),
        nuisances: Sequence[Nuisance] = (),
        force_maps: Sequence[ForceMap] = (),
        still: Array | None = None,
    ) -> None:
        self.shown, self.nuisances, self.force_maps = shown, nuisances, force_maps
        self.effects = {effect.name: effect for effect in effects}
        self.parameters = {effect.free_name(one): one for effect in effects for one in effect.parameters}
        quiet = np.zeros(SAMPLES, bool) if still is None else still
        self.channels = [Channel("made", "position", TIMES, data, quiet, np.arange(SAMPLES) * STROKES // SAMPLES)]

    def parameter(self, name: str) -> Parameter:
        return self.parameters.get(name, Parameter(name, "m", "of a sum", -1e6, 1e6, 1.0, 0.0))

    def declared(self, name: str) -> float:
        return self.parameter(name).neutral

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        return [values.get("level", 0.0) * COLUMNS[:, 0] + self.shown(values)]


def problem_of(plant: LinearPlant) -> Problem:
    """With noise that is known."""
    noises = {"position": Noise(SIGMA, SIGMA, (), 0.0, 10_000)}
    return Problem(plant, noises=noises)


def measured(seed: int = 5) -> Array:
    """Two of the first column and noise."""
    return np.asarray(2.0 * COLUMNS[:, 0] + SIGMA * np.random.default_rng(seed).standard_normal(SAMPLES))
