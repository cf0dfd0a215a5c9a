"""What both plants hand out and take, and the compiler switch they share."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
AnyFunction = TypeVar("AnyFunction", bound=Callable[..., object])


# Names and parameters of the effects, as docs/reference/effects.md lists them.
CATALOGUE: dict[str, tuple[str, ...]] = {
    "coulomb_friction": ("force",),
    "stiction": ("force", "breakaway", "stribeck_velocity"),
    "asymmetric_friction": ("force_opening", "force_closing", "damping_opening", "damping_closing"),
    "constant_force": ("force",),
    "rest_attraction": ("force",),
    "drive_gain": ("gain",),
    "coil_lag": ("time_constant",),
    "eddy_lag": ("time_constant",),
    "coil_heating": ("temperature_rate", "cooling_time_constant"),
    "magnetic_saturation": ("current",),
    "residual_magnetism": ("current",),
    "pressure_force": ("force", "equalisation_time"),
    "quadratic_drag": ("coefficient",),
    "squeeze_film": ("coefficient", "film_thickness"),
    "stop_bounce": ("restitution_stop", "restitution_seat"),
    "pickup_impact": ("velocity_ratio",),
    "spring_hardening": ("coefficient",),
    "stroke_offset": ("offset",),
    "gap_offset": ("offset",),
    "sensor_delay": ("delay",),
    "sensor_bandwidth": ("cutoff_frequency",),
    "sensor_gain": ("gain",),
}


def check_effects(effects: Mapping[str, Mapping[str, float]], known: Mapping[str, tuple[str, ...]]) -> None:
    """Raise ValueError for a name or a parameter that would be ignored silently."""
    for name, values in effects.items():
        if name not in known or set(values) != set(known[name]):
            raise ValueError(f"effect {name} with {sorted(values)}: known are {dict(known)}")


def compiled(function: AnyFunction) -> AnyFunction:
    """Compile with numba, keep the machine code on disk, and keep the signature for the type checker.

    No wrappers for Python, which take longer to compile than the code: only other compiled functions can call it.
    """
    options: dict[str, Any] = {
        "cache": True,
        "error_model": "numpy",
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
    }
    return cast(AnyFunction, numba.njit(**options)(function))


def compiled_entry(function: AnyFunction) -> AnyFunction:
    """As `compiled`, for a function that Python calls."""
    return cast(AnyFunction, numba.njit(cache=True, error_model="numpy")(function))


class PlantEvent(NamedTuple):
    """A switch of the plant: time in s, what happened, pilot position in m and velocity in m/s just before it."""

    time: float
    kind: str
    position: float
    velocity: float


class PlantRun(NamedTuple):
    """What an ideal recorder sees: arrays of the length of the sample times.

    Positions in m are as the sensor shows them (delay, bandwidth and gain in), without noise. The velocity in m/s is
    the pilot plunger's own, at the same (delayed) instant. The current in A is never delayed.
    """

    time: FloatArray
    pilot_position: FloatArray
    main_position: FloatArray
    pilot_velocity: FloatArray
    coil_current: FloatArray
    events: tuple[PlantEvent, ...]

    def first(self, kind: str) -> float:
        """Time in s of the first event of this kind; StopIteration when there is none."""
        return next(event.time for event in self.events if event.kind == kind)


class Plant(Protocol):
    """A valve that can be driven: at rest and closed at time 0, which is before every command and sample."""

    def simulate(self, command_times: FloatArray, volts: FloatArray, sample_times: FloatArray) -> PlantRun:
        """Drive with voltages held from each command time (s, ascending) on; 0 V before the first."""
        ...
