"""A force of unknown origin, as a curve that is fitted."""

from __future__ import annotations

from typing import Final

from valve_sim.model.effects.entry import Effect, Tag
from valve_sim.model.parameters import Parameter

FORCE_MAP_VARIABLES: Final = ("x", "v", "t", "x·v", "x·u²", "t·v")
"""What a force map is a function of; a second factor multiplies it."""
FORCE_MAP_KNOTS: Final = tuple(f"f{knot}" for knot in range(1, 9))
"""The knots of a force map, evenly spaced from `low` to `high`."""


def force_map(
    x: float,
    v: float,
    u: float,
    t: float,
    variable: float,
    low: float,
    high: float,
    *knots: float,
) -> float:
    """The curve at the place that `variable` names, times the factor that it names, N."""
    at = x
    if variable == 1.0:
        at = v
    elif variable in (2.0, 5.0):
        at = t
    factor = 1.0
    if variable in (3.0, 5.0):
        factor = v
    elif variable == 4.0:
        factor = u * u
    place = min(max((at - low) / (high - low), 0.0), 1.0) * 7.0
    left = min(int(place), 6)
    s = place - left
    # Catmull–Rom: a cubic through the knots with a continuous slope.
    before, here = knots[max(left - 1, 0)], knots[left]
    there, after = knots[left + 1], knots[min(left + 2, 7)]
    slope_here, slope_there = 0.5 * (there - before), 0.5 * (after - here)
    rise = there - here
    value = here + s * (
        slope_here + s * (3.0 * rise - 2.0 * slope_here - slope_there + s * (slope_here + slope_there - 2.0 * rise))
    )
    return factor * value


EFFECT = Effect(
    "force_map",
    "a force of unknown origin, as a smooth curve through eight knots",
    (
        Parameter("variable", "–", "index into x, v, t, x·v, x·u², t·v", 0, 5, 0.0),
        Parameter("low", "m, m/s or s", "where the first knot is", -1e6, 1e6, 0.0),
        Parameter("high", "m, m/s or s", "where the last knot is", -1e6, 1e6, 1.0),
        *(Parameter(name, "N or N·s/m", "force at a knot", -1e5, 1e5, 0.05, 0.0) for name in FORCE_MAP_KNOTS),
    ),
    "Catmull and Rom 1974",
    title="Force of unknown origin",
    on_a_real_valve="A force that no effect of the catalogue explains acts on the plungers.",
    what_to_do="Look at where it acts, and compare it with what is known of the valve there.",
    term=force_map,
    named=False,
    tags=(Tag.FORCE,),
)
