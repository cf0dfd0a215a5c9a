"""The opening of a valve as users of SciPy write it: plain Python functions, contacts as events."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from valve_sim.model import Valve

TIMES: Final = np.linspace(1e-4, 15e-3, 150)
"""s: the outputs of an opening."""
TOLERANCE: Final = 1e-8


def equations(valve: Valve, moving_main: bool, unseated: float) -> Callable[[float, Any], list[float]]:
    """Rates of [x, v, u, w] while opening, in plain Python."""
    d, effects = valve.declared(), valve.effects
    friction = effects.get("coulomb_friction", {}).get("force", 0.0)
    drag = effects.get("quadratic_drag", {}).get("coefficient", 0.0)
    eddy = effects.get("eddy_lag", {}).get("time_constant", 0.0)
    pressure = effects.get("pressure_force", {"force": 0.0, "equalisation_time": 1.0})
    knee = effects.get("magnetic_saturation", {}).get("current", float("inf")) ** -2

    def rates(t: float, y: Any) -> list[float]:
        x, v, u, w = y
        square = (w if eddy else u) ** 2
        square *= (1.0 + knee) / (1.0 + square * knee)
        force = square * (d["a0"] + x * (d["a1"] + x * (d["a2"] + x * d["a3"]))) - friction - drag * v * abs(v)
        if moving_main:
            force -= d["spring_preload"] + d["spring_rate"] * x + d["main_damping"] * v
            if pressure["force"]:
                force -= pressure["force"] * np.exp(-(t - unseated) / pressure["equalisation_time"])
            acceleration = force / d["moving_mass"]
        else:
            acceleration = (force - d["pilot_damping"] * v) / d["pilot_mass"]
        return [v, acceleration, (1.0 - u) / d["coil_time_constant"], (u - w) / eddy if eddy else 0.0]

    return rates


def unseating(valve: Valve) -> tuple[float, Any]:
    """Time, s, and [x, v, u, w] at which the pull exceeds dry friction: SciPy on the coil alone, as RK45 users do."""
    friction = valve.effects.get("coulomb_friction", {}).get("force", 0.0)
    if friction == 0.0:
        return 0.0, np.zeros(4)
    moving = equations(valve, False, 0.0)

    def closed(t: float, y: Any) -> list[float]:
        return [0.0, 0.0, *moving(t, y)[2:]]

    def lift(t: float, y: Any) -> float:
        return moving(t, y)[1]

    lift.terminal = True  # type: ignore[attr-defined]
    solution = solve_ivp(closed, (0.0, TIMES[-1]), np.zeros(4), rtol=TOLERANCE, atol=TOLERANCE * 1e-2, events=lift)
    return float(solution.t_events[0][0]), solution.y_events[0][0]


def scipy_opening(valve: Valve) -> tuple[float, float]:
    """Times of pick-up and stop, s, by SciPy RK45 with two terminal events."""
    start, y, found = *unseating(valve), []
    unseated = start
    for moving_main, contact in ((False, valve.parameters.pilot_gap), (True, valve.parameters.stroke)):

        def reach(_t: float, y: Any, contact: float = contact) -> float:
            return float(y[0] - contact)

        reach.terminal = True  # type: ignore[attr-defined]
        solution = solve_ivp(
            equations(valve, moving_main, unseated), (start, TIMES[-1]), y, method="RK45", rtol=TOLERANCE,
            atol=TOLERANCE * np.array([1e-5, 1e-2, 1e-2, 1e-2]), events=reach, t_eval=TIMES[start < TIMES],
        )  # fmt: skip
        start, y = float(solution.t_events[0][0]), solution.y_events[0][0]
        found.append(start)
    return found[0], found[1]
