"""A pilot-operated solenoid valve of an ultra-high-pressure hydrogen vessel: simulated, identified, diagnosed.

    import valve_sim as vs

    valve = vs.load_valve("my_valve.yaml")     # or vs.default_valve()
    run = vs.simulate(valve, vs.Drive.of([0.01, 0.04], [9.0, 0.0]), times)
    trace = vs.read("bags/friction")           # or of any log: vs.read("scope.csv", "map.yaml")
    fitted = vs.identify(trace, valve)         # dampings, or what `free` names
    found = vs.diagnose(trace, valve)          # which effect the valve lacks
    vs.validate("bags/friction", valve).passed # whether it predicts a recording, named by its path
    print(found), found.table(), found.residual(), found.plot()

Names are loaded when they are first asked for, so that a program that needs one of them does not wait for all.
"""

from __future__ import annotations

import os

TYPE_CHECKING = False  # of `typing`, which would be loaded before a program handles signals
if TYPE_CHECKING:
    from typing import Final

# NumPy reads this where it is loaded. The matrices of a fit are thin: threads of the linear algebra wait for each
# other, and beside other work a diagnosis has taken 240 CPU seconds for 32. What a user has set stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

if TYPE_CHECKING:
    from valve_sim.api import (
        Diagnosis,
        Identification,
        Residual,
        Simulation,
        Validation,
        diagnose,
        identify,
        read,
        simulate,
        validate,
    )
    from valve_sim.files.parameter_files import default_valve, load_valve
    from valve_sim.files.plant_files import load_plant
    from valve_sim.files.recording_map import load_map
    from valve_sim.identification.fit.budget import Budget
    from valve_sim.model.drives import Drive
    from valve_sim.model.valve import Valve

__version__ = "0.2.0"

__all__ = [
    "Budget",
    "Diagnosis",
    "Drive",
    "Identification",
    "Residual",
    "Simulation",
    "Validation",
    "Valve",
    "default_valve",
    "diagnose",
    "identify",
    "load_map",
    "load_plant",
    "load_valve",
    "read",
    "simulate",
    "validate",
]

_MODULES: Final = {
    "api": (
        "Diagnosis",
        "Identification",
        "Residual",
        "Simulation",
        "Validation",
        "diagnose",
        "identify",
        "read",
        "simulate",
        "validate",
    ),
    "files.parameter_files": ("default_valve", "load_valve"),
    "files.plant_files": ("load_plant",),
    "files.recording_map": ("load_map",),
    "identification.fit.budget": ("Budget",),
    "model.drives": ("Drive",),
    "model.valve": ("Valve",),
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
        import importlib

        found = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
        globals()[name] = found
        return found
