"""Effects that the reference model lacks: one file each, with everything about its effect.

The fit, parameter files, reports and the reference page follow from the entry. An effect enters the model by

* `term`, a force f(x, v, u, t, *parameters) of plain arithmetic in newtons, + opens,
* `force`, `friction` or `square`, expressions of the symbols of the equations: a force, the level of a dry friction, or
  the square of the current that pulls,
* `adds_to`, a declared parameter that is larger by one of its own, or
* `changes`, another value of a number that the equations have.

The `EFFECT` of every module here takes part. So does every effect that an installed package names in the entry-point
group `valve_sim.effects`, and what a program registers.
"""

from valve_sim.model.effects.catalogue import CATALOGUE, ENTRY_POINTS, Catalogue, check_effects
from valve_sim.model.effects.entry import Effect, Severity, Tag, Term
from valve_sim.model.effects.force_map import (
    FORCE_MAP_COEFFICIENTS,
    FORCE_MAP_VARIABLES,
    basis,
    is_damping,
)

__all__ = [
    "CATALOGUE",
    "ENTRY_POINTS",
    "FORCE_MAP_COEFFICIENTS",
    "FORCE_MAP_VARIABLES",
    "Catalogue",
    "Effect",
    "Severity",
    "Tag",
    "Term",
    "basis",
    "check_effects",
    "is_damping",
]
