"""An axis with dry friction, integrated by small steps: written apart from the package, for its integrator to meet."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True)  # type: ignore[untyped-decorator]
def rubbing_axis(
    times: Array, force: Array, mass: float, viscous: float, level: float, breakaway: float = 0.0, speed: float = 0.1
) -> tuple[Array, Array]:
    """Position and velocity, (n,), of an axis at rest at 0 that a force on straight lines between samples drives.

    In a small step friction takes the velocity towards 0 and not beyond, which is what sticking is.
    """
    substeps = 400
    x, v = 0.0, 0.0
    position, velocity = np.zeros(len(times)), np.zeros(len(times))
    for i in range(len(times) - 1):
        position[i], velocity[i] = x, v
        h = (times[i + 1] - times[i]) / substeps
        for k in range(substeps):
            drive = force[i] + (force[i + 1] - force[i]) * (k + 0.5) / substeps
            held = level + breakaway * np.exp(-((v / speed) ** 2))
            pushed = v + h * (drive - viscous * (v + 0.5 * h * (drive - viscous * v) / mass)) / mass
            slowed = pushed - np.sign(pushed) * min(h * held / mass, abs(pushed))
            x += 0.5 * h * (v + slowed)
            v = slowed
    position[-1], velocity[-1] = x, v
    return position, velocity
