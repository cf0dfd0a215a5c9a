"""The script of an FMI 3.0 unit: a valve of valve_sim behind the interface of pythonfmu3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pythonfmu3 import Boolean, Float64, Fmi3Causality, Fmi3Slave, Fmi3Status, Fmi3StepResult, Fmi3Variability, Int32
from pythonfmu3.enums import Fmi3Initial

try:
    from valve_sim.fmu.unit import ValveUnit
except ImportError as error:
    raise ImportError(
        "this unit runs the Python package valve_sim, which the Python that loads it does not have; pip install it"
    ) from error

if TYPE_CHECKING:
    from valve_sim.fmu.cosimulation import KeptState


class ValveSim(ValveUnit, Fmi3Slave):  # type: ignore[misc]  # the library has no types
    """A valve that an FMI 3.0 master steps."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.time = 0.0
        time = Float64("time", causality=Fmi3Causality.independent, variability=Fmi3Variability.continuous)
        self.register_variable(time, nested=False)
        kinds = {"real": Float64, "integer": Int32, "boolean": Boolean}
        self.open_valve(kinds, Fmi3Causality, Fmi3Variability, {"parameter": Fmi3Initial.exact})

    def setup_experiment(self, start_time: float) -> None:
        """Begin at a time in s."""
        self.time = self.start_time = start_time

    def do_step(self, current_time: float, step_size: float) -> Fmi3StepResult:
        """Step on; an error is a status with its line in the log."""
        if refusal := self.refusal(current_time, step_size):
            self.log(refusal, Fmi3Status.error)
            return Fmi3StepResult(status=Fmi3Status.error)
        self.time = current_time + step_size
        return Fmi3StepResult()

    def _get_fmu_state(self) -> tuple[float, KeptState]:
        return self.time, self.steps.keep()

    def _set_fmu_state(self, state: tuple[float, KeptState]) -> None:
        self.time, kept = state
        self.steps.restore(kept)
