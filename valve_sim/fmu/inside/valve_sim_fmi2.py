"""The script of a unit: a valve behind pythonfmu's interface of an FMI 2.0 slave.

pythonfmu imports it in the tool that loads the unit. The class must be defined here: of a script without functions the
library frees the names.
"""

from __future__ import annotations

import uuid
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real
from pythonfmu.enums import Fmi2Initial, Fmi2Status

try:
    from valve_sim import __version__
    from valve_sim.files.parameter_files import load_valve
    from valve_sim.fmu.cosimulation import CoSimulatedValve, KeptState
    from valve_sim.fmu.description import complete
    from valve_sim.fmu.export import NEEDED, PARAMETER_FILE
    from valve_sim.model import ValveError
except ImportError as error:
    raise ImportError(
        "this unit runs the Python package valve_sim, which the Python that loads it does not have; pip install it"
    ) from error

_KINDS: Final = {"real": Real, "integer": Integer, "boolean": Boolean}
_INITIAL: Final = {"parameter": Fmi2Initial.exact, "output": Fmi2Initial.calculated}
_DESCRIPTION: Final = "Pilot-operated solenoid valve of a hydrogen vessel, with events located exactly inside a step."


class ValveSim(Fmi2Slave):  # type: ignore[misc]  # the library has no types
    """The valve of the unit's resources, which an FMI 2.0 master steps."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        file = Path(self.resources) / PARAMETER_FILE
        # The same version and parameter file are the same unit.
        self.guid = uuid.uuid5(uuid.NAMESPACE_URL, f"valve_sim/{__version__}/{file.read_text(encoding='utf-8')}")
        self.description, self.start_time = f"{_DESCRIPTION} {NEEDED}", 0.0
        self.steps = CoSimulatedValve(load_valve(file))
        for entry in self.steps.variables:
            is_parameter = entry.causality == "parameter"
            varies = "tunable" if is_parameter else "continuous" if entry.kind == "real" else "discrete"
            variable = _KINDS[entry.kind](
                entry.name,
                causality=Fmi2Causality[entry.causality],
                variability=Fmi2Variability[varies],
                initial=_INITIAL.get(entry.causality),
                description=entry.description,
                getter=partial(self.steps.get, entry.name),
                setter=partial(self.steps.set, entry.name),
            )
            self.register_variable(variable, nested=False)

    def to_xml(self, model_options: Any = ()) -> Element:
        """The model description."""
        references = {variable.name: variable.value_reference for variable in self.vars.values()}
        return complete(super().to_xml(dict(model_options)), self.steps.variables, references)

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Begin at a time in s; the steps have the package's own tolerance."""
        self.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Begin with the inputs and parameters as they are set; where they do not go together, the first step fails."""
        with suppress(ValveError):
            self.steps.start(self.start_time)

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Step on; False with a line in the log where that is not possible: an exception would end the master, too."""
        try:
            self.steps.step(current_time, step_size)
        except ValveError as error:
            self.log(str(error), Fmi2Status.error)
            return False
        return True

    def _get_fmu_state(self) -> KeptState:
        return self.steps.keep()

    def _set_fmu_state(self, state: KeptState) -> None:
        self.steps.restore(state)
