"""A search among hypotheses whose fits are written down, so that what it tries and keeps is known without a simulator.

Effects have names of one letter. A key such as "ab" stands for the hypothesis of effects a and b, "ab'" for the same
with errors of the commands' stamps, "" for the declared model.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from valve_sim.identification.selection.cross_validation import CrossValidation
from valve_sim.identification.selection.hypotheses import Search
from valve_sim.identification.selection.table import Hypothesis

from valve_sim.identification.estimation.budget import OutOfTimeError
from valve_sim.identification.estimation.descent import TRIAL, WHOLE, Effort
from valve_sim.identification.estimation.result import Rows
from valve_sim.identification.plants.protocol import (
    Array,
    EffectChoice,
    Nuisance,
    from_internal,
    internal_bounds,
    internal_scale,
    to_internal,
)
from valve_sim.identification.selection import criteria, hypotheses, stepwise
from valve_sim.identification.selection.residual_tests import Adequacy
from valve_sim.model import Parameter, SimulationError

SIZE = Parameter("size", "N", "added", -100.0, 100.0, 2.0, 0.0)
STAMP = Nuisance("stamp[0]", 1e-4, "s")


def of(key: str) -> Hypothesis:
    return Hypothesis(tuple(sorted(key.rstrip("'"))), key.endswith("'"))


def key_of(hypothesis: Hypothesis) -> str:
    return "".join(hypothesis.effects) + ("'" if hypothesis.timing else "")


@dataclass(eq=False)
class MadeUpFit:
    """What a search reads of a fit."""

    problem: Any
    key: str
    free: tuple[str, ...]
    chi2: float
    values: dict[str, float]
    coordinates: Array
    covariance: Array
    residuals: Array
    chi2_of_declared: float = 0.0
    chi2_of_recordings: float = 0.0
    stamp_variance: float = 1.0
    variance_inflation: float = 1.0
    converged: bool = True
    reach: float = -math.inf
    derivatives: Rows = field(default_factory=lambda: Rows(np.empty((0, 0)), lambda: np.empty((0, 0))))

    @property
    def score(self) -> float:
        return self.chi2

    @property
    def evidence(self) -> float:
        return self.chi2 + 3.0

    def on_bound(self, name: str) -> str | None:
        lower, upper = internal_bounds(self.problem.plant.parameter(name))
        at = float(self.coordinates[self.free.index(name)])
        return "lower" if at <= lower else "upper" if at >= upper else None


@dataclass
class World:
    """Fits by key.

    Attributes:
        scores: S and χ² of each; one that is not listed explains nothing beyond the best of its parts, and its effects
            are not significantly on.
        white: the p-values of the residuals that are white; others have 1e-9.
        annealed: scores that only annealing finds.
        sizes: of a parameter, by key and name, in standard errors; default 5 where listed, else 0.
        gains: by the score test, of each key.
        left_out: root mean square of what the strokes left out miss, of 100 samples.
        misses: each of 50 whitened residuals; default that of the declared model.
        timing: whether stamps may err. stamp_variances: how far they are off, by key; default 1.
        tolerances: of declared values.
        curve: S of a smooth curve without a name that leaves nothing, where there is one; asked: how often for it.
        ends_with: the key at whose fit it is when that is carried on.
        unfinished: effects that fits of a few iterations do not settle. stuck: those whose fits will come no lower.
        efforts: key and effort of each fit.
        out_of_time: keys at whose fit the time is used up. fails: whether nothing can be simulated from a start.
        missed: the residual of values. told: progress, as told. starts: key, start and robust scales of each fit.
    """

    scores: Mapping[str, float]
    effects: Mapping[str, EffectChoice]
    white: Mapping[str, float] = field(default_factory=dict)
    annealed: Mapping[str, float] = field(default_factory=dict)
    sizes: Mapping[tuple[str, str], float] = field(default_factory=dict)
    gains: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    left_out: Mapping[str, float] = field(default_factory=dict)
    misses: Mapping[str, float] = field(default_factory=dict)
    timing: bool = False
    stamp_variances: Mapping[str, float] = field(default_factory=dict)
    tolerances: tuple[Nuisance, ...] = ()
    curve: float = math.inf
    asked: int = 0
    out_of_time: Sequence[str] = ()
    unfinished: str = ""
    stuck: str = ""
    ends_with: str = ""
    fails: Callable[[Mapping[str, float]], bool] = lambda start: False
    missed: Callable[[Mapping[str, float]], float] = lambda values: 0.0
    told: list[tuple[str, float]] = field(default_factory=list)
    starts: list[tuple[str, dict[str, float], tuple[float, ...]]] = field(default_factory=list)
    efforts: list[tuple[str, Effort]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        parameters = {effect.free_name(one): one for effect in self.effects.values() for one in effect.parameters}
        parameters["gain"] = Parameter("gain", "N", "of all", 0.0, 1e3, 4.0)
        stamps = (STAMP,) if self.timing else ()
        plant = SimpleNamespace(
            effects=self.effects, base=("gain",), nuisances=self.tolerances, timing_errors=stamps,
            parameter=parameters.__getitem__, declared=lambda name: 7.0 if name == "gain" else parameters[name].off,
        )  # fmt: skip
        self.problem = SimpleNamespace(
            plant=plant,
            variance_inflation=1.0,
            samples=50,
            effective_samples=50.0,
            residuals=self._residuals,
            rows=SimpleNamespace(residuals=self._residuals, counts=np.ones(1), constant=0.0),
        )

    def _residuals(self, values: Mapping[str, float]) -> Array:
        return np.array([self.missed(values)])

    def search(self) -> Search:
        return Search(self.problem, lambda what, share: self.told.append((what, share)))  # type: ignore[arg-type]

    def score(self, key: str) -> float:
        if key in self.scores:
            return self.scores[key]
        mark = "'" if key.endswith("'") else ""
        effects = key.rstrip("'")
        parts = [effects.replace(member, "") + mark for member in effects] or [effects]
        return min(map(self.score, parts)) + 9.0

    def fit(
        self,
        problem: Any,
        free: Sequence[str],
        start: Mapping[str, float] | MadeUpFit,
        *,
        nuisances: Sequence[Nuisance],
        effort: Effort = WHOLE,
    ) -> MadeUpFit:
        """In place of a real one."""
        start = start.values if isinstance(start, MadeUpFit) else start
        names = [name for name, effect in self.effects.items() if set(effect.free_names()) & set(free)]
        key = "".join(sorted(names)) + ("'" if STAMP in nuisances else "")
        with self._lock:
            self.efforts.append((key, effort))
            self.starts.append((key, dict(start), tuple(effort.robust)))
        if key in self.out_of_time or (effort.made and key == self.ends_with):
            raise OutOfTimeError("no time is left")
        if self.fails(start):
            raise SimulationError("it cannot be simulated")
        score = self.score(key)
        if effort.robust:
            score = self.annealed.get(key, score)
        found, scales = [], []
        for name in free:
            parameter = problem.plant.parameter(name)
            # A standard error is a tenth of the prior scale.
            scales.append(0.1 * internal_scale(parameter))
            neutral = parameter.off if parameter.off is not None else parameter.prior_scale
            usual = 5.0 if key in self.scores else 0.0
            at = to_internal(parameter, neutral) + self.sizes.get((key, name), usual) * scales[-1]
            lower, upper = internal_bounds(parameter)
            found.append(min(max(at, lower), upper))
        own = {name: from_internal(problem.plant.parameter(name), at) for name, at in zip(free, found, strict=True)}
        values = {"at": score, **own}
        return MadeUpFit(
            self.problem,
            key,
            tuple(free),
            score,
            values,
            np.array(found),
            np.diag(np.square(scales)),
            np.full(50, self.misses.get(key, self.misses.get("", 0.0))),
            converged=effort.most > TRIAL or not set(key) & set(self.unfinished),
            reach=score if set(key) & set(self.stuck) else -math.inf,
            stamp_variance=self.stamp_variances.get(key, 1.0),
        )

    def use(self, patch: pytest.MonkeyPatch) -> World:
        """Put these fits and tests in the place of the real ones."""

        def adequacy(result: MadeUpFit) -> Adequacy:
            return Adequacy(1.0 if result.key == "curve" else self.white.get(result.key, 1e-9), "made up", 0.0)

        def curves(search: Search, base: MadeUpFit) -> list[SimpleNamespace]:
            self.asked += 1
            return [SimpleNamespace(fit=replace(base, key="curve", chi2=self.curve))] if self.curve < math.inf else []

        def left_out(result: MadeUpFit) -> CrossValidation | None:
            size = self.left_out.get(result.key)
            return None if size is None else CrossValidation(np.full(100, size), 100.0 * size**2, 2)

        patch.setattr(hypotheses, "fit", self.fit)
        patch.setattr(criteria, "adequacy", adequacy)
        patch.setattr(criteria, "cross_validate", left_out)
        patch.setattr(stepwise, "fit_curves", curves)
        patch.setattr(stepwise, "score_gains", lambda result: self.gains.get(result.key, {}))
        return self


def switches(names: str) -> dict[str, EffectChoice]:
    """Effects of one size each."""
    return {name: EffectChoice(name, (SIZE,)) for name in names}
