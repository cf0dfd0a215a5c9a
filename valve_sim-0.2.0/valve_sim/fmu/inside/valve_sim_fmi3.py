"""The script of an FMI 3.0 unit: a valve of valve_sim behind the interface of pythonfmu3."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Status, Fmi3StepResult, Fmi3Variability, Int32
from pythonfmu3.enums import Fmi3Initial

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


class ValveSim(Fmi3Slave):  # type: ignore[misc]  # the library has no types
    """A valve that an FMI 3.0 master steps."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        file = Path(self.resources) / PARAMETER_FILE
        self.guid, self.description = token(file), f"{DESCRIPTION} {NEEDED}"
        self.time = self.start_time = 0.0
        self.steps = CoSimulatedValve(load_valve(file))
        time = Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous)
        self.register_variable(time, nested=False)
        kinds = {"real": Float64, "integer": Int32, "boolean": Boolean}
        for entry in self.steps.variables:
            is_parameter = entry.causality == "parameter"
            variability = "tunable" if is_parameter else "continuous" if entry.kind == "real" else "discrete"
            variable = kinds[entry.kind](
                entry.name,
                causality=Fmi3Causality[entry.causality],
                variability=Fmi3Variability[variability],
                initial=Fmi3Initial.exact if is_parameter else None,
                description=entry.description,
                getter=partial(self.steps.get, entry.name),
                setter=partial(self.steps.set, entry.name),
            )
            self.register_variable(variable, nested=False)

    def to_xml(self, model_options: Any = ()) -> Element:
        """The model description."""
        references = {found.name: found.value_reference for found in self.vars.values()}
        return complete(super().to_xml(dict(model_options)), self.steps.variables, references)

    def setup_experiment(self, start_time: float) -> None:
        """Begin at a time in s."""
        self.time = self.start_time = start_time

    def exit_initialization_mode(self) -> None:
        """Begin with the inputs and parameters as they are set; where they do not go together, the first step fails."""
        with suppress(ValveError):
            self.steps.start(self.start_time)

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Step on; an error is a status with its line in the log."""
        try:
            self.steps.step(current_time, step_size)
        except ValveError as error:
            self.log(str(error), Fmi3Status.error)
            return Fmi3StepResult(status=Fmi3Status.error)
        self.time = current_time + step_size
        return Fmi3StepResult()

    def _get_fmu_state(self) -> tuple[float, KeptState]:
        return self.time, self.steps.keep()

    def _set_fmu_state(self, state: tuple[float, KeptState]) -> None:
        self.time, kept = state
        self.steps.restore(kept)
