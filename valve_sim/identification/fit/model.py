"""A problem with some unknowns freed, and its linearisation: everything that follows is made of products of its sums.

At a place z the residuals e of whitened rows, their derivatives J by what moves a run, and the columns B of errors of
the recordings are summed up as [J | B | e]ᵀ [J | B | e].
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.fit.column_groups import ColumnGroup
from valve_sim.identification.fit.gram import gram
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.unknown import Unknown
from valve_sim.identification.fit.white_columns import WhiteColumns
from valve_sim.identification.plants.protocol import Array, Direction
from valve_sim.model import SimulationError

FINE: Final = 1e-4
"""Step along which the rules are differentiated that make a run of values, in steps of a difference quotient."""
STANDING: Final = Direction({}, 1.0)
"""In place of one whose derivative is infinite: along which nothing changes."""
SHOWS: Final = 0.02
"""Root of the sum of squares, in σ, of the change of residuals along a plant's short step; one that changes less shows
rounding, and the usual step is taken."""
SHARES: Final = (1.0, -1.0, 0.1, -0.1)
"""Of the step of a difference quotient: what is tried until one can be simulated."""


@dataclass(frozen=True)
class Sums:
    """A linearisation.

    Attributes:
        moved: (r, k + 1) rows of derivatives J and of residuals e; none of a long recording.
        fixed: −B. products: (k + q + 1, k + q + 1) of [J | −B | e].
        constant: what the rows' criterion is short of that of all samples.
    """

    moved: Array
    fixed: WhiteColumns
    products: Array
    constant: float

    @property
    def left(self) -> Array:
        """(r,) the residuals."""
        return self.moved[:, -1]

    @property
    def rows(self) -> Array:
        """(r, k + q + 1) [J | −B | e]."""
        return np.hstack([self.moved[:, :-1], self.fixed.dense(), self.moved[:, -1:]])


class Model:
    """A problem with some unknowns freed.

    Args:
        problem: data and noise. unknowns: what is freed; coefficients of columns come last.
        held: values of a run that are fixed, by name.
    """

    def __init__(self, problem: Problem, unknowns: Sequence[Unknown], held: Mapping[str, float] | None = None) -> None:
        self.problem, self.held = problem, dict(held or {})
        self.moving = tuple(own for own in unknowns if not own.is_linear)
        self.linear = tuple(own for own in unknowns if own.is_linear)
        self.unknowns = (*self.moving, *self.linear)
        self.index = {own.name: place for place, own in enumerate(self.unknowns)}
        self.lower, self.upper = np.array([(own.lower, own.upper) for own in self.moving]).reshape(-1, 2).T
        self._local = [place for place, own in enumerate(self.moving) if own.nuisance is not None]
        self._places = np.array(self._local, dtype=np.intp)

    @property
    def start(self) -> Array:
        """(k,) coordinates where nothing has been estimated."""
        return np.array([own.start for own in self.moving])

    def at(self, values: Mapping[str, float]) -> Array:
        """(k,) coordinates of values, by name; what is not among them is where nothing has been estimated."""
        return np.array([
            own.coordinate(values[own.name]) if own.name in values else own.start for own in self.moving
        ])  # fmt: skip

    def named(self, z: Array) -> dict[str, float]:
        """The number that each coordinate stands for, by the unknowns' names, and what is held."""
        return {**self.held, **{own.name: own.value(at) for own, at in zip(self.moving, z.tolist(), strict=True)}}

    def values(self, z: Array) -> dict[str, float]:
        """The values of a run, by name."""
        found = dict(self.held)
        for own, at in zip(self.moving, z.tolist(), strict=True):
            value = own.value(at)
            if not own.slopes:
                found[own.name] = value
            for name, by in own.slopes.items():
                found[name] = found.get(name, 0.0) + by * value
        return found

    @cached_property
    def fixed(self) -> WhiteColumns:
        """Derivatives of the residuals by the coefficients of columns."""
        return self.problem.white_columns.chosen([own.column for own in self.linear])

    @cached_property
    def _directed(self) -> list[list[int]]:
        """Which coordinates share a direction: those of no recording have their own."""
        local = set(self._local)
        alone = [[place] for place in range(len(self.moving)) if place not in local]
        return alone + [[self._local[member] for member in own.members] for own in self._column_groups]

    @cached_property
    def _even(self) -> list[Direction | None]:
        """Directions that are the same everywhere: of coordinates that are values themselves; else None."""
        is_even = [all(self.moving[place].parameter is None for place in own) for own in self._directed]
        return [
            self._direction(own, self.start) if even else None
            for own, even in zip(self._directed, is_even, strict=True)
        ]

    @cached_property
    def _shared(self) -> dict[int, ColumnGroup]:
        """By the number of the direction those that are shared."""
        first = len(self._directed) - len(self._column_groups)
        return {first + place: own for place, own in enumerate(self._column_groups) if len(own.members) > 1}

    @cached_property
    def _column_of(self) -> NDArray[np.intp]:
        """(k + 1,) the number of each coordinate's direction, and last that of the residuals."""
        found = np.full(len(self.moving) + 1, len(self._directed))
        for place, members in enumerate(self._directed):
            found[members] = place
        return found

    @cached_property
    def _column_groups(self) -> list[ColumnGroup]:
        return self.problem.rows.groups(
            tuple(own.nuisance for place in self._local if (own := self.moving[place]).nuisance)
        )

    # -- one linearisation ---------------------------------------------------------------------------------------------

    def residuals(self, z: Array) -> Array:
        """(r,) whitened residuals, no part of them explained by columns.

        Raises:
            SimulationError: the machine cannot be simulated there.
        """
        found = self.problem.rows.residuals(self.values(z))
        if not np.isfinite(found).all():
            raise SimulationError("the simulation gives numbers that are not finite")
        return found

    def linearise(self, z: Array) -> Sums:
        """The sums at a place.

        Raises:
            SimulationError: the machine cannot be simulated there.
        """
        if self.problem.is_long and (sums := self._in_pieces(z)) is not None:
            return sums
        return self._summed(self._derivatives(z))

    def tangent(self, z: Array, place: int) -> Array | None:
        """(r,) derivative of the residuals by one coordinate; None where the plant does not know it."""
        found, is_known = self._along(z, [self._direction([place], z)])
        return found[:, 0] if is_known[0] else None

    def _summed(self, moved: Array) -> Sums:
        k, q = len(self.moving), len(self.linear)
        products = np.empty((k + q + 1, k + q + 1))
        outer = np.r_[0:k, k + q]
        products[np.ix_(outer, outer)] = gram(moved, moved)
        cross = self.fixed.onto(moved)
        products[k:-1, outer], products[outer, k:-1] = cross, cross.T
        products[k:-1, k:-1] = self.fixed.products
        if not np.isfinite(products).all():
            raise SimulationError("the derivatives are too large to be squared, or not finite")
        return Sums(moved, self.fixed, products, self.problem.rows.constant)

    def _in_pieces(self, z: Array) -> Sums | None:
        """The sums of a long recording, of which only a piece is held; None where a derivative is not known."""
        directions = [self._direction([place], z) for place in range(len(self.moving))]
        if STANDING in directions:
            return None
        sums = self.problem.rows.sums(self.values(z), directions)
        if sums is None:
            return None
        if not math.isfinite(sums.squares):
            raise SimulationError("the simulation gives numbers that are not finite")
        products = np.empty((len(z) + 1, len(z) + 1))
        products[:-1, :-1], products[-1, -1] = sums.information, sums.squares
        products[:-1, -1] = products[-1, :-1] = sums.gradient
        return Sums(np.empty((0, len(z) + 1)), WhiteColumns((), 0, 0), products, 0.0)

    def _direction(self, places: Sequence[int], z: Array) -> Direction:
        """Along the sum of some coordinates."""
        slopes: dict[str, float] = {}
        for place in places:
            moves = self.moving[place].moves(float(z[place]))
            if not all(map(math.isfinite, moves.values())):
                return STANDING
            slopes |= moves
        return Direction(slopes, FINE * min(self.moving[place].step for place in places))

    def _derivatives(self, z: Array) -> Array:
        """(r, k + 1) derivatives of the residuals, by the plant where it knows them, else by quotients; residuals.

        Unknowns that act on different samples share a direction, whose derivative is parted.
        """
        groups = self._directed
        even = self._even
        found, is_known = self._along(z, [even[n] or self._direction(own, z) for n, own in enumerate(groups)])
        moved, apart = np.take(found, self._column_of, axis=1), list[int]()
        for place in np.flatnonzero(~is_known).tolist():
            apart += groups[place]
        for place, group in self._shared.items():
            moved[:, groups[place]] = 0.0
            if is_known[place] and not group.part(found[:, place], moved, self._places):
                apart += groups[place]
        for_plant = [place for place in apart if any(place in groups[shared] for shared in self._shared)]
        if for_plant:
            found, is_known = self._along(z, [self._direction([place], z) for place in for_plant])
            alone = list(itertools.compress(for_plant, is_known))
            moved[:, alone] = found[:, np.flatnonzero(is_known)]
            apart = [place for place in apart if place not in alone]
        for place in apart:
            moved[:, place] = self._quotient(z, place, moved[:, -1])
        return moved

    def _along(self, z: Array, directions: Sequence[Direction]) -> tuple[Array, NDArray[np.bool_]]:
        """(r, k + 1) derivatives along k directions and residuals, and (k,) where the plant knows the former."""
        stands = np.array([own is STANDING for own in directions], dtype=bool)
        found, is_known = self.problem.rows.linearised(self.values(z), directions)
        if not np.isfinite(found[:, -1]).all():
            raise SimulationError("the simulation gives numbers that are not finite")
        return found, is_known & ~stands

    def _quotient(self, z: Array, place: int, left: Array) -> Array:
        """(r,) a difference quotient by one coordinate, within its range; nothing where none can be simulated."""
        own, short = self.moving[place], self.problem.plant.short_step
        sizes = [share * own.step for share in SHARES]
        if short is not None and own.parameter is not None:
            sizes = [short * own.scale, *sizes]
        for size in sizes:
            there = z.copy()
            there[place] = min(max(z[place] + size, own.lower), own.upper)
            if there[place] == z[place]:
                continue
            with contextlib.suppress(SimulationError):
                change = self.residuals(there) - left
                if size != sizes[0] or len(sizes) == len(SHARES) or float(np.linalg.norm(change)) > SHOWS:
                    return np.asarray(change / (there[place] - z[place]))
        return np.zeros(len(left))
