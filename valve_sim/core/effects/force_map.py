"""A force of unknown origin, as a curve that is fitted: uniform cubic B-splines (Eilers and Marx 1996; de Boor 1978).

With knots every h from `low` to `high`, z = (y − low)/h, i = ⌊z⌋ and d = z − i, of the coefficients c four act at a
place y of the variable:

    f = [c_i + 4 c_{i+1} + c_{i+2}]/6 + [c_{i+2} − c_i]/2 d + [c_i − 2 c_{i+1} + c_{i+2}]/2 d²
        + [c_{i+3} − 3 c_{i+2} + 3 c_{i+1} − c_i]/6 d³

Each knot is a comparison, so that a step ends there. Beyond `low` and `high` f keeps its value, or repeats itself over
a period of x or t. Over x and t the force is f, over x·u² it is f(x) u². Over v, x·v and t·v f is a damping, and the
force is −f v.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from valve_sim.core.effects.entry import Effect, Motion, Own
from valve_sim.core.tracer import Node, spline
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import Parameter

VARIABLES: Final = ("x", "v", "t", "x·v", "x·u²", "t·v", "x, periodic", "t, periodic")
"""What the map is a function of; a second factor multiplies it, and a periodic one repeats from low to high."""
MOST: Final = 40
FEWEST: Final = 4
NAMES: Final = tuple(f"c{number}" for number in range(1, MOST + 1))


def curve(m: Motion, own: Own) -> Node:
    """The force, N."""
    variable = VARIABLES[int(own.variable.value or 0.0)]
    periodic = "periodic" in variable
    if "v" in variable and m.v.value == 0.0:
        return m.v  # a damping, of plungers at rest
    y = {"x": m.x, "v": m.v, "t": m.t}[variable[0]]
    intervals = own.count if periodic else own.count - 3.0
    place = (y - own.low) * (intervals / (own.high - own.low))
    value = spline(place, intervals, "force_map.c1", periodic=periodic)
    if variable == "x·u²":
        return value * m.u * m.u
    return -value * m.v if "v" in variable else value


def unpack(found: Mapping[str, object], where_found: str) -> Mapping[str, object]:
    """The parameters one by one, of a map whose coefficients are given as a list.

    Raises:
        ParameterError: it is no list of so many numbers.
    """
    if "coefficients" not in found:
        return found
    given = found["coefficients"]
    if not isinstance(given, list | tuple) or not FEWEST <= len(given) <= MOST:
        raise ParameterError(
            f"{where_found}.coefficients: found {given!r}, expected a list of {FEWEST} to {MOST} numbers"
        )
    rest = {name: value for name, value in found.items() if name != "coefficients"}
    return {**rest, "count": len(given), **dict(zip(NAMES, [*given, *[0.0] * (MOST - len(given))], strict=True))}


EFFECT = Effect(
    name="force_map",
    title="Force of unknown origin",
    summary="a force of unknown origin, as a smooth curve of cubic B-splines",
    parameters=(
        Parameter("variable", "–", f"from 0 on: {'; '.join(VARIABLES)}", 0, len(VARIABLES) - 1, 0.0),
        Parameter("low", "m, m/s or s", "where the curve begins; constant below", -1e6, 1e6, 0.0),
        Parameter("high", "m, m/s or s", "where the curve ends; constant above", -1e6, 1e6, 1.0),
        Parameter("count", "–", "of the coefficients", FEWEST, MOST, FEWEST),
        *(Parameter(name, "N or N·s/m", f"coefficient {name[1:]}", -1e5, 1e5, 0.05, 0.0) for name in NAMES),
    ),
    source="Eilers and Marx 1996, DOI 10.1214/ss/1038425655",
    on_a_real_valve="A force that no effect of the catalogue explains acts on the plungers.",
    what_to_do="Look at where it acts, and compare it with what is known of the valve there.",
    force=curve,
    shapes=("variable",),
    unpack=unpack,
)
