"""The script of an FMI 2.0 unit: a valve of valve_sim behind the interface of pythonfmu."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pythonfmu import Boolean, Fmi2Causality, Fmi2Slave, Fmi2Variability, Integer, Real
from pythonfmu.enums import Fmi2Initial, Fmi2Status

try:
    from valve_sim.fmu.unit import ValveUnit
except ImportError as error:
    raise ImportError(
        "this unit runs the Python package valve_sim, which the Python that loads it does not have; pip install it"
    ) from error

if TYPE_CHECKING:
    from valve_sim.fmu.cosimulation import KeptState


class ValveSim(ValveUnit, Fmi2Slave):  # type: ignore[misc]  # the library has no types
    """A valve that an FMI 2.0 master steps."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        initial = {"parameter": Fmi2Initial.exact, "output": Fmi2Initial.calculated}
        kinds = {"real": Real, "integer": Integer, "boolean": Boolean}
        self.open_valve(kinds, Fmi2Causality, Fmi2Variability, initial)

    def setup_experiment(self, start_time: float, stop_time: float | None, tolerance: float | None) -> None:
        """Begin at a time in s; the steps have the package's own tolerance."""
        self.start_time = start_time

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Step on; False with a line in the log where that is not possible."""
        if refusal := self.refusal(current_time, step_size):
            self.log(refusal, Fmi2Status.error)
        return not refusal

    def _get_fmu_state(self) -> KeptState:
        return self.steps.keep()

    def _set_fmu_state(self, state: KeptState) -> None:
        self.steps.restore(state)
