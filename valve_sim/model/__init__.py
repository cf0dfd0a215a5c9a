"""The physics of the valve: parameters, equations, effects, event-accurate simulation. Knows no ROS, file or clock.

Names are loaded when they are first asked for: compiled code takes half a second to load, and who only reads a
recording needs none of it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from valve_sim.model.core_types import EventKind, Phase
    from valve_sim.model.drives import Drive
    from valve_sim.model.effects import CATALOGUE, Effect, Severity, Tag
    from valve_sim.model.errors import ParameterError, SimulationError, ValveError
    from valve_sim.model.parameters import DECLARED, Parameter, ValveParameters
    from valve_sim.model.response import Event, Response, published_times
    from valve_sim.model.simulation import TOLERANCE, simulate
    from valve_sim.model.stepper import CoilReading, Reading, Stepper
    from valve_sim.model.tolerances import EXACT, Tolerances
    from valve_sim.model.valve import Valve

__all__ = [
    "CATALOGUE",
    "DECLARED",
    "EXACT",
    "TOLERANCE",
    "CoilReading",
    "Drive",
    "Effect",
    "Event",
    "EventKind",
    "Parameter",
    "ParameterError",
    "Phase",
    "Reading",
    "Response",
    "Severity",
    "SimulationError",
    "Stepper",
    "Tag",
    "Tolerances",
    "Valve",
    "ValveError",
    "ValveParameters",
    "published_times",
    "simulate",
]

_MODULES: Final = {
    "core_types": ("EventKind", "Phase"),
    "drives": ("Drive",),
    "effects": ("CATALOGUE", "Effect", "Severity", "Tag"),
    "errors": ("ParameterError", "SimulationError", "ValveError"),
    "parameters": ("DECLARED", "Parameter", "ValveParameters"),
    "response": ("Event", "Response", "published_times"),
    "simulation": ("TOLERANCE", "simulate"),
    "stepper": ("CoilReading", "Reading", "Stepper"),
    "tolerances": ("EXACT", "Tolerances"),
    "valve": ("Valve",),
}
_HOMES: Final = {name: module for module, names in _MODULES.items() for name in names}


def __dir__() -> list[str]:
    """The public names, loaded or not: for completion in a shell, and for the reference."""
    return __all__


if not TYPE_CHECKING:  # for type checkers a name that is not listed is none

    def __getattr__(name: str) -> object:
        """Load the module of a name that is first asked for."""
        if name not in _HOMES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        found = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = found
        return found
