"""A force of unknown origin, as a curve that is fitted: uniform cubic B-splines (Eilers and Marx 1996; de Boor 1978).

With knots every h from `low` to `high` and s = (y − low)/h, the curve is a cubic in s whose third derivative jumps at
each knot k, by what the third differences of the coefficients c differ there:

    f(s) = P(s) + Σ_k j_k max(0, s − k)³,
    P(s) = [(1 − s)³ c1 + (3 s³ − 6 s² + 4) c2 + (1 + 3 s + 3 s² − 3 s³) c3 + s³ c4]/6

Each knot is a comparison, so that a step ends there. Beyond `low` and `high` f keeps its value. Over x and t the force
is f, over x·u² it is f(x) u². Over v, x·v and t·v f is a damping, and the force is −f v.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from valve_sim.core.effects.entry import Effect, Motion, Own
from valve_sim.core.tracer import Node, maximum, minimum, where
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import Parameter

VARIABLES: Final = ("x", "v", "t", "x·v", "x·u²", "t·v")
"""What the map is a function of; a second factor multiplies it."""
MOST: Final = 14
FEWEST: Final = 4
NAMES: Final = tuple(f"c{number}" for number in range(1, MOST + 1))


def curve(m: Motion, own: Own) -> Node:
    """The force, N."""
    variable, count = VARIABLES[int(own.variable.value or 0.0)], int(own.count.value or 0.0)
    place = {"x": m.x, "v": m.v, "t": m.t}[variable[0]]
    intervals = float(count - 3)
    s = minimum(maximum((place - own.low) * (intervals / (own.high - own.low)), 0.0), intervals)
    value = spline(s, [own.named(name) for name in NAMES[:count]])
    if variable == "x·u²":
        return value * m.u * m.u
    return -value * m.v if "v" in variable else value


def spline(s: Node, c: list[Node]) -> Node:
    """The curve at s, in intervals from the first knot."""
    third = [c[i + 3] - 3.0 * c[i + 2] + 3.0 * c[i + 1] - c[i] for i in range(len(c) - 3)]
    powers = [
        (c[0] + 4.0 * c[1] + c[2]) / 6.0, (c[2] - c[0]) / 2.0, (c[0] - 2.0 * c[1] + c[2]) / 2.0, third[0] / 6.0,
    ]  # fmt: skip
    for k in range(1, len(third)):
        jump = (third[k] - third[k - 1]) / 6.0
        for power, share in enumerate((-(k**3), 3 * k**2, -3 * k, 1)):
            powers[power] = powers[power] + where(s > float(k), jump * float(share), 0.0)
    return powers[0] + s * (powers[1] + s * (powers[2] + s * powers[3]))


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
    shapes=("variable", "count"),
    unpack=unpack,
)
