"""Bounded Gauss–Newton with Levenberg's damping: one minimisation of the sum of squares of whitened residuals.

Of a long recording residuals and derivatives are added up piece by piece, and never held.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.estimation.column_groups import ColumnGroup
from valve_sim.identification.estimation.gram import gram, sum_squares
from valve_sim.identification.estimation.priors import Elsewhere, Prior, lowest, prior_of_nuisance, pulls_of
from valve_sim.identification.estimation.problem import Problem
from valve_sim.identification.estimation.result import FIRST_DAMPING, NO_INFORMATION, Fit, MachineKnowledge
from valve_sim.identification.estimation.smoothing import Smoothness
from valve_sim.identification.plants.protocol import (
    Array,
    Direction,
    Nuisance,
    from_internal,
    internal_bounds,
    internal_scale,
    short_step_of,
    to_internal,
    value_slope,
)
from valve_sim.model import Parameter, SimulationError

DIFFERENCE: Final = 2e-3
"""Step of a difference quotient, in prior scales of its parameter: theory, eq. (28)."""
SHOWS: Final = 0.02
"""Root of the sum of squares, in σ, of the change of residuals along a plant's short step; one that changes less shows
rounding, and the usual step is taken."""
MOST_ITERATIONS: Final = 40
TRIAL: Final = 6
"""Iterations that fits side by side make before they are compared."""
MIN_ITERATIONS: Final = 3
"""Iterations that a fit may make before it is asked whether it can still reach its goal."""
MIN_ITERATIONS_OF_CURVE: Final = 6
"""Iterations before a fit with a nearly straight curve is asked: within these its weights can become any others."""
PRUNING_FACTOR: Final = 10.0
"""Times the last decrease, or the next that is promised, beyond which a goal is out of reach: each decrease is smaller
than the one before, and where by a tenth of it, all that are left come to ten."""
CONVERGED: Final = 1e-2
"""A fit has converged when a step would lower χ² by less than this: a tenth of a standard error."""
CURVE_CONVERGED: Final = 0.3
"""A fit with a smooth curve has converged when a step would lower χ² by less than this: its columns are less exact."""
WEIGHTS_HOLD: Final = 3.0
"""Decrease of χ² below which the weights of a curve are no longer chosen anew."""
LARGEST_DAMPING: Final = 1e4
"""Of λ in theory, eq. (29): beyond it no step lowers the criterion and the fit stops."""
FINE: Final = 1e-4
"""Step along which the rules are differentiated that make a run of values, in steps of a difference quotient."""
STANDING: Final = Direction({}, 1.0)
"""In place of one whose derivative is infinite: along which nothing changes."""
FEW: Final = 4
"""Up to this many nuisances, derivatives are renewed in every step; of more they are reused while they serve."""


class SolverOptions(NamedTuple):
    """How far a fit is carried.

    Attributes:
        goal: χ² that is of interest: a fit that cannot reach it any more is given up. Default: all are.
        made: iterations that were made before, from other values to these. most: at which the fit ends.
        is_near: whether it starts where a fit has ended, so that nothing need be held first.
    """

    goal: float = math.inf
    made: int = 0
    most: int = MOST_ITERATIONS
    is_near: bool = False


WHOLE: Final = SolverOptions()
"""Until a fit has converged."""


def along(name: str, parameter: Parameter, coordinate: float) -> Direction:
    """The direction of a parameter's internal coordinate, or `STANDING` where it has none."""
    slope = value_slope(parameter, coordinate)
    return Direction({name: slope}, FINE * DIFFERENCE * internal_scale(parameter)) if math.isfinite(slope) else STANDING


class End(NamedTuple):
    """Where a descent ended; derivatives are those of the place, or None where nothing has asked for them yet.

    The gradient is half that of the criterion, as of the last derivatives.
    """

    at: Array
    cost: float
    residuals: Array
    jacobian: Array | None
    information: Array
    gradient: Array
    converged: bool
    damping: float
    chi2_lower_bound: float


class Descent:
    """One minimisation in internal coordinates, with their bounds and difference quotients.

    Args:
        problem: data and noise. free: parameters to free. nuisances: estimated along, with their priors.
        fixed: values to hold. prior: as of `fit`.
    """

    holds_rows = True
    """Whether residuals and derivatives are those of each sample."""

    def __init__(
        self,
        problem: Problem,
        free: tuple[str, ...],
        nuisances: tuple[Nuisance, ...],
        fixed: dict[str, float],
        prior: MachineKnowledge | Smoothness | None,
    ) -> None:
        smooth = prior if isinstance(prior, Smoothness) else None
        self.problem, self.free, self.nuisances, self.fixed, self.smooth = problem, free, nuisances, fixed, smooth
        self.parameters = [problem.plant.parameter(name) for name in free]
        bounds = [internal_bounds(parameter) for parameter in self.parameters]
        bounds += [nuisance.bounds for nuisance in nuisances]
        self.priors: list[Prior] = [*(problem.prior(name) for name in free), *map(prior_of_nuisance, nuisances)]
        self.lower = np.array([max(low, lowest(own)) for (low, _), own in zip(bounds, self.priors, strict=True)])
        self.upper = np.array([high for _, high in bounds])
        scales = [internal_scale(parameter) for parameter in self.parameters]
        self.steps = np.array([DIFFERENCE * s for s in scales] + [n.step for n in nuisances])
        short = short_step_of(problem.plant)
        self._reuses = len(nuisances) > FEW and short is None
        self._short_steps = {} if short is None else {index: short * size for index, size in enumerate(scales)}
        self._centre: Array = np.zeros(len(bounds))
        self._known = self._take(prior) if isinstance(prior, MachineKnowledge) else None
        self._curve = np.array([free.index(name) for name in smooth.names] if smooth else [], dtype=np.int64)
        self._small = CONVERGED if smooth is None else CURVE_CONVERGED
        self._weights_hold = False
        self._min_iterations = MIN_ITERATIONS if smooth is None else MIN_ITERATIONS_OF_CURVE
        if smooth is not None:
            for index in self._curve.tolist():
                self.priors[index] = Elsewhere()
            self.lower[self._curve] = np.maximum(self.lower[self._curve], smooth.least)
        self.rows = problem.rows
        self._nuisance_columns: Array | None = None

    @cached_property
    def _groups(self) -> list[ColumnGroup]:
        """Nuisances that share a simulation; a fit in sums does not ask: its residuals are too many to be numbered."""
        return self.rows.groups(self.nuisances)

    def _take(self, known: MachineKnowledge) -> Array:
        """The information of other data, in the order of this fit; their priors and means are replaced."""
        names = [*self.free, *(nuisance.name for nuisance in self.nuisances)]
        order = [names.index(name) for name in known.names]
        self._centre[order] = known.coordinates
        for index in order:
            self.priors[index] = Elsewhere()
        matrix = np.zeros((len(names), len(names)))
        matrix[np.ix_(order, order)] = known.information
        return matrix

    def start(self, values: Mapping[str, float]) -> Array:
        """(k + m,) internal coordinates of values, as `fit` takes them, within bounds."""
        plant = self.problem.plant
        coordinates = [
            to_internal(parameter, values.get(name, plant.declared(name)))
            for name, parameter in zip(self.free, self.parameters, strict=True)
        ]
        coordinates += [values.get(nuisance.name, nuisance.mean) for nuisance in self.nuisances]
        return np.clip(np.array(coordinates, dtype=np.float64), self.lower, self.upper)

    def values(self, at: Array) -> dict[str, float]:
        """By name, in their units."""
        values = dict(self.fixed)
        for name, parameter, coordinate in zip(self.free, self.parameters, at, strict=False):
            values[name] = from_internal(parameter, float(coordinate))
        for nuisance, coordinate in zip(self.nuisances, at[len(self.free) :], strict=True):
            values[nuisance.name] = float(coordinate)
        return values

    def residuals(self, at: Array) -> Array | None:
        """Residuals, or None where the model cannot be simulated."""
        try:
            residuals = self.rows.residuals(self.values(at))
        except SimulationError:
            return None
        return residuals if np.all(np.isfinite(residuals)) else None

    def jacobian(self, at: Array, residuals: Array) -> Array:
        """(n, k + m) derivatives; columns of many nuisances are reused while they serve.

        By the plant's own derivatives where it knows them, else by forward differences (backward at an upper bound).
        Nuisances of one group act on disjoint samples: they share a column, which is parted.
        """
        count, kept = len(self.free), self._nuisance_columns
        own = self._groups if kept is None else []
        groups = [[index] for index in range(count)] + [[count + index for index in group.members] for group in own]
        shared, known = self._sensitivities(at, groups)
        if groups and len(groups) == len(at) and known.all():
            columns = shared
        else:
            columns = np.zeros((len(residuals), len(at)))
            for index in range(count):
                columns[:, index] = shared[:, index] if known[index] else self._column(at, index, residuals)
            for place, group in enumerate(own, start=count):
                self._fill(columns[:, count:], group, at, residuals, shared[:, place] if known[place] else None)
        if kept is None:
            self._nuisance_columns = columns[:, count:]
        else:
            columns[:, count:] = kept
        return columns

    def _sensitivities(self, at: Array, groups: list[list[int]]) -> tuple[Array, NDArray[np.bool_]]:
        """(n, g) derivatives along the sum of each group, and (g,) where the plant knows them."""
        directions = [self.direction(at, group) for group in groups]
        is_inside = np.array([direction is not STANDING for direction in directions], dtype=bool)
        try:
            columns, known = self.rows.sensitivities(self.values(at), directions)
        except SimulationError:
            return np.empty((0, len(groups))), np.zeros(len(groups), dtype=bool)
        return columns, known & is_inside

    def direction(self, at: Array, group: list[int]) -> Direction:
        """Along the sum of the coordinates of a group."""
        if group[0] < len(self.free):
            (index,) = group
            return along(self.free[index], self.parameters[index], float(at[index]))
        names = [self.nuisances[index - len(self.free)].name for index in group]
        return Direction(dict.fromkeys(names, 1.0), FINE * float(min(self.steps[group])))

    def _fill(self, columns: Array, group: ColumnGroup, at: Array, residuals: Array, shared: Array | None) -> None:
        """Fill in the columns of a group among (n, m) of all nuisances, from that of its sum where it is known.

        Members that do not decouple take a simulation each.
        """
        members, indices = group.members, [len(self.free) + index for index in group.members]
        if shared is not None:
            if len(members) == 1:
                columns[:, members[0]] = shared
                return
            if group.part(shared, columns):
                return
            apart, known = self._sensitivities(at, [[index] for index in indices])
            if known.all():
                columns[:, members] = apart
                return
        elif len(members) > 1:
            perturbed, steps = at.copy(), self.steps[indices]
            perturbed[indices] += np.where(at[indices] + steps > self.upper[indices], -steps, steps)
            there = self.residuals(perturbed)
            if there is not None and group.part(there - residuals, columns):
                columns[:, members] /= (perturbed - at)[indices]
                return
        for member, index in zip(members, indices, strict=True):
            columns[:, member] = self._column(at, index, residuals)

    def _column(self, at: Array, index: int, residuals: Array) -> Array:
        if index in self._short_steps:
            short = self._short_steps[index]
            actual, change = self._change(at, index, -short if at[index] >= self.upper[index] else short, residuals)
            if change is not None and np.linalg.norm(change) > SHOWS:
                return change / actual
            del self._short_steps[index]
        step = self.steps[index]
        if abs(at[index]) > 0.0 and index < len(self.free):
            step = max(step, 1e-5 * abs(at[index]))
        for size in (step, -step, 0.1 * step, -0.1 * step):
            actual, change = self._change(at, index, size, residuals)
            if change is not None:
                return change / actual
        return np.zeros(len(residuals))

    def _change(self, at: Array, index: int, size: float, residuals: Array) -> tuple[float, Array | None]:
        """The step that is made of one of this size, within bounds, and what it changes if it can be simulated."""
        perturbed = at.copy()
        perturbed[index] = min(max(at[index] + size, self.lower[index]), self.upper[index])
        actual = float(perturbed[index] - at[index])
        there = self.residuals(perturbed) if actual != 0.0 else None
        return actual, None if there is None else there - residuals

    def begin(self, at: Array, begun: Fit | None) -> tuple[Array, Array]:
        """Residuals and their derivatives where a descent begins; of a fit that is gone on with, as far as it has them.

        Raises:
            SimulationError: the model cannot be simulated there.
        """
        residuals = None if begun is None else begun.left.at_hand
        jacobian = None if begun is None else begun.derivatives.at_hand
        if residuals is not None and jacobian is not None:
            self._nuisance_columns = jacobian[:, len(self.free) :]
            return residuals, jacobian
        residuals = self.residuals(at) if residuals is None else residuals
        if residuals is None:
            raise SimulationError("the model cannot be simulated at the start of the fit")
        return residuals, self.jacobian(at, residuals)

    def descend(self, at: Array, effort: SolverOptions = WHOLE, begun: Fit | None = None) -> End:
        """Gauss–Newton with Levenberg's damping, variables on a bound held while the gradient points outwards."""
        jacobian: Array | None
        residuals, jacobian = self.begin(at, begun)
        damping = FIRST_DAMPING if begun is None else begun.damping
        converged, decrease, chi2_lower_bound = False, 0.0, -math.inf
        # Columns that serve a fit that is gone on with may be those of some steps before.
        is_stale = begun is not None and begun.derivatives.at_hand is not None and self._reuses
        of_data = self.normal(at, residuals, jacobian)
        information, gradient = self._with_curve(at, *of_data)
        cost = self._cost(at, residuals)  # the weight of a curve is another now
        for iteration in range(effort.made, effort.most):
            move, gain = self.step(at, information, gradient, damping)
            if gain < self._small:
                converged = True
                break
            chi2_lower_bound = cost - PRUNING_FACTOR * max(gain, decrease)
            if iteration >= self._min_iterations and chi2_lower_bound > effort.goal:
                break
            candidate = np.clip(at + move, self.lower, self.upper)
            there = self.residuals(candidate)
            new_cost = self._cost(candidate, there) if there is not None else math.inf
            if there is not None and new_cost < cost:
                decrease = cost - new_cost
                converged = decrease < self._small
                self._weights_hold = self._weights_hold or decrease < WEIGHTS_HOLD
                damping = max(1e-9, damping * (0.1 if decrease > 0.5 * gain else 0.5))
                if not self._reuses or decrease > 0.01 * cost:
                    self._nuisance_columns = None
                is_stale = self._nuisance_columns is not None
                at, residuals, cost = candidate, there, new_cost
            elif is_stale:
                self._nuisance_columns, is_stale = None, False
            else:
                damping *= 10.0
                if damping > LARGEST_DAMPING:
                    converged = True
                    break
                # The derivatives are those of before; the weights of a curve are chosen once more.
                information, gradient = self._with_curve(at, *of_data)
                cost = self._cost(at, residuals)
                continue
            if converged:
                # The last step was too small to change the information; of most fits nobody asks for more.
                jacobian = None
                break
            jacobian = self.jacobian(at, residuals)
            of_data = self.normal(at, residuals, jacobian)
            information, gradient = self._with_curve(at, *of_data)
            cost = self._cost(at, residuals)
        return End(at, cost, residuals, jacobian, information, gradient, converged, damping, chi2_lower_bound)

    def normal(self, at: Array, residuals: Array, jacobian: Array) -> tuple[Array, Array]:
        """Information matrix and half the gradient of the criterion, priors included but for that of a curve."""
        if self.problem.whitens:
            both = self.problem.whitened(np.column_stack([jacobian, residuals]))
            jacobian, residuals = both[:, :-1], both[:, -1]
        return self.with_priors(at, gram(jacobian, jacobian), gram(jacobian, residuals))

    def with_priors(self, at: Array, of_data: Array, pull: Array) -> tuple[Array, Array]:
        """Information and half the gradient with priors, from JᵀJ and Jᵀe of the residuals and their derivatives."""
        _, half_slopes, curvatures = pulls_of(self.priors, at)
        information = of_data + np.diag(curvatures)
        if not np.all(np.isfinite(information)):
            # A pilot plunger of next to no mass, for one, whose derivatives are squared beyond all numbers.
            raise SimulationError("the model's derivatives are too large where the fit has led")
        gradient = pull + half_slopes
        if self._known is not None:
            information += self._known
            gradient += self._known @ (at - self._centre)
        return information, gradient

    def _with_curve(self, at: Array, information: Array, gradient: Array) -> tuple[Array, Array]:
        """Information and gradient with the prior of a smooth curve, whose weights are chosen anew until they hold."""
        if self.smooth is not None:
            curve = self._curve
            if not self._weights_hold:
                self.smooth = self.smooth.chosen(information, gradient, at, curve)
            information, gradient = information.copy(), gradient.copy()
            information[np.ix_(curve, curve)] += self.smooth.precision
            gradient[curve] += self.smooth.precision @ at[curve]
        return information, gradient

    def _cost(self, at: Array, residuals: Array) -> float:
        if self.problem.whitens:
            residuals = self.problem.whitened(residuals[:, None])[:, 0]
        prior = float(np.sum(pulls_of(self.priors, at)[0]))
        if self._known is not None:
            prior += float((at - self._centre) @ self._known @ (at - self._centre))
        if self.smooth is not None:
            prior += float(at[self._curve] @ self.smooth.precision @ at[self._curve])
        return sum_squares(residuals) + self.rows.constant + prior

    def step(self, at: Array, information: Array, gradient: Array, damping: float) -> tuple[Array, float]:
        """The damped step within bounds, and the decrease that it promises."""
        scale = np.maximum(np.diag(information), 1e-300)
        held = ((at <= self.lower) & (gradient > 0)) | ((at >= self.upper) & (gradient < 0)) | (scale <= NO_INFORMATION)
        size = 1.0 / np.sqrt(scale)
        normal = information * (size[:, None] * size)
        normal.flat[:: len(at) + 1] *= 1.0 + damping
        normal.flat[:: len(at) + 1] += 1e-12
        move = np.zeros(len(at))
        for _ in range(len(at)):
            moving = ~held
            if not moving.any():
                break
            own, rest = normal, gradient
            if held.any():
                own = normal[moving][:, moving]
                rest = gradient[moving] + information[moving][:, held] @ move[held]
            move[moving] = -size[moving] * np.linalg.solve(own, size[moving] * rest)
            beyond = moving & ((at + move < self.lower) | (at + move > self.upper))
            if not beyond.any():
                break
            move[beyond] = np.clip(at[beyond] + move[beyond], self.lower[beyond], self.upper[beyond]) - at[beyond]
            held = held | beyond
        gain = -float(2.0 * gradient @ move + move @ information @ move)
        return move, max(gain, 0.0)


class NotInPieces(Exception):  # noqa: N818 -- internal: the fit is made as that of a short recording
    """A derivative is not known."""


class DescentInSums(Descent):
    """A `Descent` that sums over pieces of a recording; all its derivatives are those of the place.

    In place of the residuals stands one number with their sum of squares, and in place of the derivatives nothing: they
    are worked out where their products are asked for. Arguments as of `Descent`.
    """

    holds_rows = False

    def begin(self, at: Array, begun: Fit | None) -> tuple[Array, Array]:
        """Begin a descent as `Descent` does; of a fit that is continued only its place is taken over."""
        return super().begin(at, None)

    def residuals(self, at: Array) -> Array | None:
        """(1,) the root of their sum of squares, or None where the model cannot be simulated."""
        try:
            sums = self.rows.sums(self.values(at), ())
        except SimulationError:
            return None
        if sums is None:
            raise NotInPieces
        return np.array([math.sqrt(sums.squares)]) if math.isfinite(sums.squares) else None

    def jacobian(self, at: Array, residuals: Array) -> Array:
        """None yet."""
        return np.empty((0, len(at)))

    def normal(self, at: Array, residuals: Array, jacobian: Array) -> tuple[Array, Array]:
        """Information matrix and half the gradient of the criterion, priors included but for that of a curve."""
        directions = [self.direction(at, [index]) for index in range(len(at))]
        if STANDING in directions:
            raise NotInPieces
        try:
            sums = self.rows.sums(self.values(at), directions)
        except SimulationError as error:
            raise NotInPieces from error
        if sums is None:
            raise NotInPieces
        return self.with_priors(at, sums.information, sums.gradient)
