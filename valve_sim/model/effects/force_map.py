"""A force of unknown origin, as a curve that is fitted: uniform cubic B-splines (Eilers and Marx 1996).

With knots every h from `low` to `high`, z = (y − low)/h, i = ⌊z⌋ and s = z − i, of the K coefficients c four act at a
place y of the variable (de Boor 1978):

    f(y) = [(1 − s)³ c_i + (3 s³ − 6 s² + 4) c_{i+1} + (1 + 3 s + 3 s² − 3 s³) c_{i+2} + s³ c_{i+3}]/6

Below `low` and above `high` f keeps its value there. Over x and t the force
is f, over x·u² it is f(x) u². Where the velocity takes part, over v, x·v and t·v, f ≥ 0 is a damping and the force is
−f v: it can only take energy out. A B-spline whose coefficients are none of them negative is nowhere negative.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core.symbols import Motion, Own
from valve_sim.model.core.tracer import Node, spline
from valve_sim.model.effects.entry import Effect, ListOfParameters, Tag, Values
from valve_sim.model.parameters import Parameter

FORCE_MAP_VARIABLES: Final = ("x", "v", "t", "x·v", "x·u²", "t·v")
"""What a force map is a function of; a second factor multiplies it."""
MOST_COEFFICIENTS: Final = 40
"""So many B-splines a force map may have."""
FEWEST_COEFFICIENTS: Final = 4
"""The B-splines of a single cubic."""
FORCE_MAP_COEFFICIENTS: Final = tuple(f"c{number}" for number in range(1, MOST_COEFFICIENTS + 1))
"""The coefficients of a force map's B-splines, from `low` to `high`; the first of them are used."""


def is_damping(variable: str) -> bool:
    """Whether a force map over this variable is a damping, N·s/m, which is never negative."""
    return "v" in variable


def basis(places: NDArray[np.float64], low: float, high: float, count: int) -> NDArray[np.float64]:
    """The B-splines of a force map at places of its variable.

    Args:
        places: (n,) in the unit of the variable. low, high: as the map's. count: of coefficients.

    Returns:
        (n, count); the rows add up to 1.
    """
    intervals = count - 3
    z = np.clip((np.asarray(places, dtype=np.float64) - low) / (high - low) * intervals, 0.0, intervals)
    left = np.minimum(z.astype(np.int64), intervals - 1)
    s = z - left
    rest = 1.0 - s
    pieces = (rest**3, 4.0 - 3.0 * s**2 * (1.0 + rest), 4.0 - 3.0 * rest**2 * (1.0 + s), s**3)
    matrix = np.zeros((len(z), count))
    for offset, piece in enumerate(pieces):
        matrix[np.arange(len(z)), left + offset] = piece / 6.0
    return matrix


def _expected(values: Values) -> str:
    """What is expected in place of these values; empty where they are sound."""
    if values["low"] >= values["high"]:
        return f"found low {values['low']:g} and high {values['high']:g}, expected low below high"
    if values["variable"] != int(values["variable"]):
        return f"found variable {values['variable']:g}, expected a whole number from 0 to 5"
    variable = FORCE_MAP_VARIABLES[int(values["variable"])]
    least = min(values[name] for name in FORCE_MAP_COEFFICIENTS[: int(values["count"])])
    if is_damping(variable) and least < 0.0:
        return f"found a coefficient of {least:g} N·s/m, expected none below 0: over {variable} the map is a damping"
    return ""


_COEFFICIENTS: Final = ListOfParameters(
    "coefficients", "N or N·s/m", "of the cubic B-splines, from low to high", FORCE_MAP_COEFFICIENTS, "count",
    FEWEST_COEFFICIENTS,
)  # fmt: skip


def curve(m: Motion, own: Own) -> Node:
    """The force, N."""
    variable = FORCE_MAP_VARIABLES[int(own.variable.value or 0.0)]
    if "v" in variable and m.v.value == 0.0:
        return m.v  # a damping, of plungers at rest
    y = {"x": m.x, "v": m.v, "t": m.t}[variable[0]]
    intervals = own.count - 3.0
    place = (y - own.low) * (intervals / (own.high - own.low))
    value = spline(place, intervals, "force_map.c1")
    if variable == "x·u²":
        return value * m.u * m.u
    return -value * m.v if "v" in variable else value


EFFECT = Effect(
    "force_map",
    "a force of unknown origin, as a smooth curve of cubic B-splines",
    (
        Parameter("variable", "–", f"from 0 on: {'; '.join(FORCE_MAP_VARIABLES)}", 0, 5, 0.0),
        Parameter("low", "m, m/s or s", "where the curve begins; constant below", -1e6, 1e6, 0.0),
        Parameter("high", "m, m/s or s", "where the curve ends; constant above", -1e6, 1e6, 1.0),
        Parameter("count", "–", "of the coefficients", FEWEST_COEFFICIENTS, MOST_COEFFICIENTS, FEWEST_COEFFICIENTS),
        *(
            Parameter(name, _COEFFICIENTS.unit, f"coefficient {name[1:]} of the B-splines", -1e5, 1e5, 0.05, 0.0)
            for name in FORCE_MAP_COEFFICIENTS
        ),
    ),
    "Eilers and Marx 1996, DOI 10.1214/ss/1038425655",
    title="Force of unknown origin",
    on_a_real_valve="A force that no effect of the catalogue explains acts on the plungers.",
    what_to_do="Look at where it acts, and compare it with what is known of the valve there.",
    expected=_expected,
    given_as_list=_COEFFICIENTS,
    retired={f"f{knot}": "one of the eight knots of earlier versions" for knot in range(1, 9)},
    named=False,
    tags=(Tag.FORCE,),
    force=curve,
    shapes=("variable",),
)
