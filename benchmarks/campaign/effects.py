"""How large an effect is: one number for each, from which all its parameters follow, with shapes that are drawn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

Values = dict[str, float]
Shape = Mapping[str, float]
Effects = dict[str, Values]


@dataclass(frozen=True)
class Scale:
    """A family of parameter sets of one effect, ordered by size.

    Attributes:
        parameters: from a size (0 is off, of either sign where `is_signed`) and a shape.
        guess: a size at which the effect shows clearly.
        largest: the upper end of what is drawn; what is physically sensible.
        shapes: range of each shape parameter, drawn evenly in the logarithm, or evenly if the range begins at 0.
        is_signed: whether the catalogue allows both signs.
        most: what physics cannot exceed.
        limit_shape: what takes the place of the drawn shape where the detection limit is worked out.
    """

    parameters: Callable[[float, Shape], Values]
    guess: float
    largest: float
    shapes: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    is_signed: bool = False
    limit_shape: Mapping[str, float] = field(default_factory=dict)
    most: float = math.inf

    def middle(self) -> Values:
        """The shape in the middle of all ranges."""
        return {name: math.sqrt(low * high) if low > 0.0 else high / 2.0 for name, (low, high) in self.shapes.items()}

    def draw_shape(self, random: np.random.Generator) -> Values:
        """A shape within the ranges."""
        return {
            name: log_uniform(random, low, high) if low > 0.0 else random.uniform(low, high)
            for name, (low, high) in self.shapes.items()
        }

    def draw_sign(self, random: np.random.Generator) -> float:
        """1, or -1 as often where that makes sense."""
        return -1.0 if self.is_signed and random.random() < 0.5 else 1.0


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """A number drawn evenly in the logarithm."""
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _amplitude(name: str) -> Callable[[float, Shape], Values]:
    """The size is this parameter; what shapes the effect keeps its own names."""
    return lambda size, shape: {name: size, **shape}


def _gain(size: float, shape: Shape) -> Values:
    return {"gain": 1.0 + size}


def _stiction(size: float, shape: Shape) -> Values:
    return {
        "force": size * shape["coulomb_share"],
        "breakaway": size,
        "stribeck_velocity": shape["stribeck_velocity"],
    }


def _asymmetric_friction(size: float, shape: Shape) -> Values:
    """A positive size rubs more while opening, a negative one while closing."""
    larger, smaller = abs(size), abs(size) * shape["weaker_share"]
    return {
        "force_opening": larger if size > 0.0 else smaller,
        "force_closing": smaller if size > 0.0 else larger,
        "damping_opening": abs(size) * shape["damping_opening"],
        "damping_closing": abs(size) * shape["damping_closing"],
    }


CATALOGUED: Final[Mapping[str, Scale]] = {
    "coulomb_friction": Scale(_amplitude("force"), 0.01, 0.5),
    "stiction": Scale(_stiction, 0.01, 0.5, {"coulomb_share": (0.3, 1.0), "stribeck_velocity": (0.01, 0.05)}),
    "asymmetric_friction": Scale(
        _asymmetric_friction,
        0.01,
        0.5,
        # The damping is in N·s/m for each N of the larger Coulomb level.
        {"weaker_share": (0.2, 0.7), "damping_opening": (2.0, 10.0), "damping_closing": (2.0, 10.0)},
        is_signed=True,
    ),
    "constant_force": Scale(_amplitude("force"), 0.01, 1.0, is_signed=True),
    "rest_attraction": Scale(_amplitude("force"), 0.02, 1.0, is_signed=True),
    "drive_gain": Scale(_gain, 2e-3, 0.15, is_signed=True),
    "coil_lag": Scale(_amplitude("time_constant"), 1e-5, 2e-3),
    "eddy_lag": Scale(_amplitude("time_constant"), 1e-5, 2e-3),
    "coil_heating": Scale(_amplitude("temperature_rate"), 1.0, 500.0, {"cooling_time_constant": (0.3, 10.0)}),
    # The size is 1/u_s²: u² (1 + size) / (1 + size u²).
    "magnetic_saturation": Scale(lambda size, shape: {"current": size**-0.5}, 0.01, 1.0),
    "residual_magnetism": Scale(_amplitude("current"), 0.1, 0.5),
    "pressure_force": Scale(_amplitude("force"), 0.05, 1.5, {"equalisation_time": (2e-3, 20e-3)}),
    "quadratic_drag": Scale(_amplitude("coefficient"), 1.0, 50.0),
    "squeeze_film": Scale(_amplitude("coefficient"), 1.0, 50.0, {"film_thickness": (30e-6, 200e-6)}),
    "stop_bounce": Scale(
        lambda size, shape: {"restitution_stop": size, "restitution_seat": size * shape["seat_share"]},
        0.1,
        0.6,
        {"seat_share": (0.5, 1.0)},
        # Nothing presses the pilot back on its seat, so that even a rebound too slow to be one shows there.
        limit_shape={"seat_share": 0.0},
        most=0.9,
    ),
    # The size is the lost share of the velocity; a plastic impact loses 0.187.
    "pickup_impact": Scale(lambda size, shape: {"velocity_ratio": 1.0 - size}, 0.01, 0.187),
    "spring_hardening": Scale(_amplitude("coefficient"), 1e7, 5e8, is_signed=True),
    "stroke_offset": Scale(_amplitude("offset"), 1e-6, 20e-6, is_signed=True),
    "gap_offset": Scale(_amplitude("offset"), 1e-6, 20e-6, is_signed=True),
    "sensor_delay": Scale(_amplitude("delay"), 1e-4, 2e-3),
    # The size is the time constant of the low-pass, s.
    "sensor_bandwidth": Scale(
        lambda size, shape: {"cutoff_frequency": 1.0 / (2.0 * math.pi * size)},
        1e-5,
        1e-3,
    ),
    "sensor_gain": Scale(_gain, 1e-4, 0.02, is_signed=True),
}
"""Those of the catalogue, by size. Pressure holds the main plunger down; lags, drag and losses have one sign."""

UNCATALOGUED: Final[Mapping[str, Scale]] = {
    "force_bump": Scale(
        _amplitude("amplitude"), 0.1, 3.0, {"centre": (0.2e-3, 1.0e-3), "width": (0.05e-3, 0.2e-3)}, is_signed=True
    ),
    "force_ripple": Scale(
        _amplitude("amplitude"), 0.1, 3.0, {"wavelength": (0.1e-3, 0.4e-3), "phase": (0.0, 2.0 * math.pi)}
    ),
    "vibration": Scale(_amplitude("amplitude"), 0.1, 3.0, {"frequency": (60.0, 400.0), "phase": (0.0, 2.0 * math.pi)}),
    "damping_drift": Scale(_amplitude("rate"), 1.0, 60.0),
    "damping_bump": Scale(_amplitude("amplitude"), 1.0, 60.0, {"centre": (0.3e-3, 1.0e-3), "width": (0.1e-3, 0.3e-3)}),
}
"""Plant (a)'s disturbances without a name in the catalogue, by size."""

CONFUSION_CLASSES: Final = (
    {"coulomb_friction", "stiction", "asymmetric_friction", "squeeze_film"},
    {"stroke_offset", "sensor_gain"},
    {"rest_attraction", "drive_gain"},
)
"""Effects that physics makes look alike; a pair is not drawn from one class."""


def are_confusable(first: str, second: str) -> bool:
    """Whether both are in one class that physics makes."""
    return any({first, second} <= members for members in CONFUSION_CLASSES)
