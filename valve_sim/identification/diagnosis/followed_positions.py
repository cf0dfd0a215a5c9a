"""The position that follows from a coil's current, where none was measured, and how well it is known."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.covariance_root import covariance_root
from valve_sim.identification.plants.protocol import Followed
from valve_sim.model import SimulationError


def followed_positions(found: Fit, rivals: Sequence[tuple[Fit, float]] = ()) -> list[Followed]:
    """Positions by the fitted model, with standard errors by the delta method, of all recordings without positions.

    With the covariance C = S Sᵀ of what was estimated, the variance of x is Σ_j ((x(θ + s_j) − x(θ − s_j)) / 2)²: each
    column s_j is a step of one standard error, so that what an impact bends over that range is not lost. Directions in
    which a simulation fails are left out. Other models of the same recordings, of weights w_k against 1, that have the
    positions x_k, add Σ_k w_k (x_k − x)² / (1 + Σ_k w_k).
    """
    plant = found.problem.plant
    middle = plant.followed_positions(found.values)
    squares = [np.zeros(len(own.position)) for own in middle]
    for pair in a_standard_error_apart(found):
        try:
            ahead, behind = (plant.followed_positions(values) for values in pair)
        except SimulationError:
            continue
        for place, (one, other) in enumerate(zip(ahead, behind, strict=True)):
            squares[place] += np.square(0.5 * (one.position - other.position))
    total = 1.0 + sum(weight for _, weight in rivals)
    for rival, weight in rivals:
        try:
            theirs = plant.followed_positions(rival.values)
        except SimulationError:
            continue
        for place, (one, other) in enumerate(zip(theirs, middle, strict=True)):
            squares[place] += weight / total * np.square(one.position - other.position)
    return [own._replace(stderr=np.sqrt(square)) for own, square in zip(middle, squares, strict=True)]


def a_standard_error_apart(found: Fit) -> Iterator[tuple[Mapping[str, float], Mapping[str, float]]]:
    """What was estimated, one standard error to either side along each s_j of the square root of its covariance."""
    for step in covariance_root(found.covariance).T:
        yield found.values_at(found.coordinates + step), found.values_at(found.coordinates - step)
