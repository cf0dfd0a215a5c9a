"""What a fit frees: one record for every number, whatever it is of.

A fit moves coordinates z, in which numbers are about Gaussian. An `Unknown` says what number a coordinate stands for,
which values of a run it enters, what is known of it beforehand, and on which samples it acts. Unknowns of one `Group`
share a size s, the standard deviation of their normal prior, which is itself estimated.

`unknowns_of` makes all of them from what a plant declares; nothing else does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal

import numpy as np

from valve_sim.identification.fit.priors import Cauchy, Normal, Prior, lowest, prior_of
from valve_sim.identification.plants.protocol import (
    Array,
    EffectChoice,
    ForceMap,
    Nuisance,
    Plant,
    SharedSize,
    from_internal,
    internal_bounds,
    internal_scale,
    to_internal,
    value_slope,
)
from valve_sim.model.parameters import Parameter

DIFFERENCE: Final = 2e-3
"""Step of a difference quotient, in prior scales: theory, eq. (28)."""
SIZES: Final = 71
"""Sizes of a group that are looked at, even in the logarithm."""
SMALLEST, LARGEST = 1e-3, 1e2
"""Shares of a group's scale between which its size is looked for: next to nothing, and far beyond."""

GONE: Final = 0.02
"""Of a group's scale: a size that is as good as none."""

Law = Literal["cauchy", "normal", "known"]


@dataclass(frozen=True)
class Group:
    """Unknowns that share a size s.

    Attributes:
        key: the channel, by its index, what varies of the machine, or a name; `error`: which error of a recording it
            is.
        scale: of the prior of s, in the unit of the coordinates.
        law: half a Cauchy density, half a normal one, or none: s is the scale.
        at_rest: whether s is read while the machine is still: in motion it would follow what the model lacks.
        is_held: whether s is known from elsewhere, and not learned.
        stays: whether another recording of the same machine has the same s.
        of_machine: whether the unknowns act on the machine, and not on what a sensor shows.
    """

    key: int | SharedSize | str
    error: str
    scale: float
    law: Law = "cauchy"
    at_rest: bool = False
    is_held: bool = False
    stays: bool = False
    of_machine: bool = False

    @property
    def name(self) -> str:
        """One name for each group of a plant."""
        return f"{self.error}[{self.key}]"

    @property
    def is_change(self) -> bool:
        """Whether it is by how much an effect differs from stroke to stroke."""
        return isinstance(self.key, SharedSize) and bool(self.key.effect)

    @property
    def is_learned(self) -> bool:
        """Whether the data say how large s is."""
        return self.law != "known" and not self.is_held

    def log_prior(self, size: Array) -> Array:
        """Ln of the prior density of (n,) sizes over the scale, which has no unit: models with other groups compare."""
        share = np.square(np.asarray(size) / self.scale)
        if self.law == "known":
            return np.zeros_like(share)
        if self.law == "normal":
            return np.asarray(0.5 * math.log(2.0 / math.pi) - 0.5 * share)
        return np.asarray(math.log(2.0 / math.pi) - np.log1p(share))

    @cached_property
    def grid(self) -> Array:
        """(n,) sizes that are looked at."""
        if self.law == "known":
            return np.array([self.scale])
        return np.asarray(self.scale * np.geomspace(SMALLEST, LARGEST, SIZES))


@dataclass(frozen=True)
class Unknown:
    """One number that a fit may free.

    Attributes:
        name: for people and files. unit: SI.
        prior: density of the coordinate z. start: z where nothing is freed. lower, upper: range of z.
        scale: of z: what a search takes for a large step. step: of a difference quotient in z.
        parameter: whose value z stands for; None: z is the value.
        slopes: how the values of a run change with the value, by name; empty: the value of this name is the number.
        column: number of the column of errors whose coefficient z is; −1: it is none, and a run depends on it.
        group: what shares a size with it; its prior is then normal, with that size.
        of_machine: whether it is a number of the machine, the same in each of its recordings.
        is_freed: whether it is refitted, not known beforehand: a damping, a parameter of an effect.
        is_switch: whether an effect is off at `start`; else it shapes the effect.
        claimed: values that the name may have.
        replaces: names of what it takes the place of. nuisance: by which samples it acts on, where not on all.
    """

    name: str
    prior: Prior
    start: float
    lower: float = -math.inf
    upper: float = math.inf
    scale: float = 1.0
    step: float = DIFFERENCE
    unit: str = "–"
    parameter: Parameter | None = None
    slopes: Mapping[str, float] = field(default_factory=dict, hash=False)
    column: int = -1
    group: Group | None = None
    of_machine: bool = True
    is_freed: bool = False
    is_switch: bool = False
    claimed: tuple[float, float] = (-math.inf, math.inf)
    replaces: tuple[str, ...] = ()
    nuisance: Nuisance | None = None

    @property
    def is_linear(self) -> bool:
        """Whether it is a coefficient of a column, which no run depends on."""
        return self.column >= 0

    @property
    def is_tolerated(self) -> bool:
        """Whether it is a declared value of the machine that is known within a tolerance."""
        return self.of_machine and not self.is_freed and self.group is None and isinstance(self.prior, Normal)

    def value(self, z: float) -> float:
        """The number that a coordinate stands for, in its unit."""
        return z if self.parameter is None else from_internal(self.parameter, z)

    def coordinate(self, value: float) -> float:
        """The inverse of `value`, within the range."""
        z = value if self.parameter is None else to_internal(self.parameter, value)
        return min(max(z, self.lower), self.upper)

    def slope(self, z: float) -> float:
        """D value / d z; infinite where the value is."""
        return 1.0 if self.parameter is None else value_slope(self.parameter, z)

    def is_there(self, sizes: Mapping[str, float]) -> bool:
        """Whether it is more than none, given sizes of groups by name; those that are missing have their scale.

        A bend is always there: what it would explain is not seen otherwise.
        """
        if self.group is None or self.group.error == "bend":
            return True
        return sizes.get(self.group.name, self.group.scale) > GONE * self.group.scale

    def moves(self, z: float) -> dict[str, float]:
        """How the values of a run move with z, by name."""
        slope = self.slope(z)
        return {name: slope * by for name, by in self.slopes.items()} if self.slopes else {self.name: slope}


@dataclass(frozen=True)
class Hypothesis:
    """What may be missing or wrong.

    Attributes:
        name: of the effect, or `valve.<name>` of a declared value. frees: what it adds to what is freed.
        held: values of a run that it fixes, by name: where the splines of a curve lie.
        choice: the plant's entry; None of a curve. confused_with: names that data often cannot tell from it.
    """

    name: str
    frees: tuple[Unknown, ...]
    held: Mapping[str, float] = field(default_factory=dict, hash=False)
    choice: EffectChoice | None = None
    confused_with: tuple[str, ...] = ()

    @property
    def is_declared_value(self) -> bool:
        """Whether it says that a declared value is wrong."""
        return self.choice is not None and self.choice.is_declared_value

    def off(self) -> dict[str, float]:
        """The values at which it changes nothing, of a shape as first expected, by name."""
        return {own.name: own.value(own.start) for own in self.frees}


def freed(plant: Plant, name: str, entry: Parameter | None = None) -> Unknown:
    """A parameter of the machine or of an effect, to be refitted.

    Args:
        plant: the machine. name: as its `parameter` has it.
        entry: as a hypothesis lists it: where it may be claimed, and where it is off, a declared value as declared.

    Raises:
        KeyError: there is no such parameter.
    """
    parameter, prior = plant.parameter(name), prior_of(plant, name)
    (lower, upper), scale = internal_bounds(parameter), internal_scale(parameter)
    lower = max(lower, lowest(prior))
    start = min(max(to_internal(parameter, plant.declared(name)), lower), upper)
    claimed = (-math.inf, math.inf) if entry is None else (entry.lower, entry.upper)
    return Unknown(
        name, prior, start, lower, upper, scale, max(DIFFERENCE * scale, 1e-5 * abs(start)), parameter.unit, parameter,
        is_freed=True, is_switch=entry is not None and entry.off is not None, claimed=claimed,
    )  # fmt: skip


def known(nuisance: Nuisance, group: Group | None = None) -> Unknown:
    """What a plant declares with a standard deviation: errors of clocks and stamps, values with a tolerance."""
    lower, upper = nuisance.bounds
    replaces = (nuisance.same_as,) if nuisance.same_as else ()
    return Unknown(
        nuisance.name, Normal(nuisance.mean, nuisance.sigma), min(max(nuisance.mean, lower), upper), lower, upper,
        nuisance.sigma, nuisance.step, nuisance.unit, group=group, of_machine=nuisance.is_of_machine,
        replaces=replaces, nuisance=nuisance,
    )  # fmt: skip


def hypothesis(plant: Plant, choice: EffectChoice) -> Hypothesis:
    """An effect that may be missing, or a declared value that may be wrong."""
    frees = tuple(freed(plant, choice.free_name(own), own) for own in choice.parameters)
    return Hypothesis(choice.name, frees, choice=choice, confused_with=tuple(choice.confused_with))


def curve(own: ForceMap, force: float, count: int) -> Hypothesis:
    """A smooth force over one variable: level and slope, and bends of it that share a size, which is learned.

    With c the coefficients of its B-splines, the bends are the second differences: c = a + b k + Dᵀ (D Dᵀ)⁻¹ d, so that
    a curve is smooth as far as the data let it (a P-spline; Eilers and Marx, Statist. Sci. 11, 1996, p. 89).

    Args:
        own: the plant's curve. force: scale of its level, N or N·s/m. count: of its B-splines.
    """
    second = np.diff(np.eye(count), 2, axis=0)
    bends = second.T @ np.linalg.inv(second @ second.T)
    level = Group(own.variable, "curve", force, "normal", of_machine=True)
    bend = Group(own.variable, "bends", 0.3 * force, of_machine=True)
    columns = [(level, np.ones(count)), (level, np.linspace(-1.0, 1.0, count))]
    columns += [(bend, bends[:, place]) for place in range(count - 2)]
    name = f"curve({own.variable})"
    frees = tuple(
        Unknown(
            f"{name}.{place}", Normal(0.0, group.scale), 0.0, scale=group.scale, step=DIFFERENCE * group.scale,
            unit="N", slopes=dict(zip(own.coefficients, column.tolist(), strict=False)), group=group, is_freed=True,
            is_switch=True,
        )
        for place, (group, column) in enumerate(columns)
    )  # fmt: skip
    return Hypothesis(name, frees, {**own.fixed, own.count: float(count)})


@dataclass(frozen=True)
class Unknowns:
    """All that may be freed of a plant.

    Attributes:
        base: refitted in every fit. known: estimated along in every fit, with their priors.
        stamps: errors of the commands' stamps, a group of whose size the data decide, most often nothing.
        hypotheses: by name.
    """

    base: tuple[Unknown, ...]
    known: tuple[Unknown, ...]
    stamps: tuple[Unknown, ...]
    hypotheses: Mapping[str, Hypothesis]


def unknowns_of(plant: Plant, free: Sequence[str] | None = None) -> Unknowns:
    """What may be freed of a plant, but for the errors of its recordings.

    Args:
        plant: the machine. free: names that every fit frees; default what the plant says.

    Raises:
        KeyError: there is no such name.
    """
    groups = {own.sigma: Group(own.error, own.error, own.sigma) for own in plant.timing_errors}
    return Unknowns(
        tuple(freed(plant, name) for name in (plant.base if free is None else free)),
        tuple(known(own) for own in plant.nuisances),
        tuple(known(own, groups[own.sigma]) for own in plant.timing_errors),
        {name: hypothesis(plant, choice) for name, choice in plant.effects.items()},
    )


def released(own: Unknown, freeing: Sequence[Unknown]) -> Cauchy | None:
    """The prior of a declared value with a tolerance where a hypothesis takes it for wrong; None: it does not."""
    for one in freeing:
        if not isinstance(one.prior, Cauchy):
            continue
        if one.name == own.name:
            return one.prior
        if one.name in own.replaces and own.nuisance is not None:
            slope = abs(own.nuisance.same_slope)
            mean = own.prior.mean if isinstance(own.prior, Normal) else own.start
            return Cauchy(mean, one.prior.scale / slope, one.prior.mass)
    return None
