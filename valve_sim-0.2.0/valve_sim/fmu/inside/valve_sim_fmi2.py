"""The script of an FMI 2.0 unit: a valve of valve_sim behind the interface of pythonfmu."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real
from pythonfmu.enums import Fmi2Initial, Fmi2Status

try:
    from valve_sim.files.parameter_files import load_valve
    from valve_sim.fmu.cosimulation import CoSimulatedValve, KeptState
    from valve_sim.fmu.description import complete
    from valve_sim.fmu.identity import DESCRIPTION, NEEDED, PARAMETER_FILE, token
    from valve_sim.model import ValveError
except ImportError as error:
    raise ImportError(
        "this unit runs the Python package valve_sim, which the Python that loads it does not have; pip install it"
    ) from error


class ValveSim(Fmi2Slave):  # type: ignore[misc]  # the library has no types
    """A valve that an FMI 2.0 master steps."""

    description = f"{DESCRIPTION} {NEEDED}"

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        file = Path(self.resources) / PARAMETER_FILE
        self.guid = token(file)
        self.start_time = 0.0
        self.steps = CoSimulatedValve(load_valve(file))
        kinds = {"real": Real, "integer": Integer, "boolean": Boolean}
        for entry in self.steps.variables:
            is_parameter = entry.causality == "parameter"
            variability = "tunable" if is_parameter else "continuous" if entry.kind == "real" else "discrete"
            initial = {"parameter": Fmi2Initial.exact, "output": Fmi2Initial.calculated, "input": None}
            variable = kinds[entry.kind](
                entry.name,
                causality=Fmi2Causality[entry.causality],
                variability=Fmi2Variability[variability],
                initial=initial[entry.causality],
                description=entry.description,
                getter=partial(self.steps.get, entry.name),
                setter=partial(self.steps.set, entry.name),
            )
            self.register_variable(variable, nested=False)

    def to_xml(self, model_options: Any = ()) -> Element:
        """The model description."""
        references = {found.name: found.value_reference for found in self.vars.values()}
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
