"""The model made ready beside the thread that steps it: loaded in half a second, or compiled at a first start."""

from __future__ import annotations

import gc
from collections.abc import Callable

from valve_sim.model import Stepper, Valve
from valve_sim.nodes.stoppable import StoppableThread


def load_stepper(valve: Valve) -> None:
    """Have every function at hand that a valve is stepped by."""
    stepper = Stepper(valve)
    stepper.command(1e-3, valve.parameters.reference_voltage)
    stepper.set_valve(valve, 2e-3)
    if valve.gas is not None:
        stepper.supply(2e-3, valve.gas.inlet_pressure)
        stepper.set_demand_pressure(2e-3, valve.gas.demand_pressure)
    stepper.advance(3e-3)
    # What is loaded now stays; collecting it as garbage would stop the thread that steps for tens of milliseconds.
    gc.freeze()


class ModelLoader(StoppableThread):
    """A thread that makes the model ready; while it compiles it cannot be stopped.

    Args:
        load: does it. fail: called with what went wrong, if anything did.
    """

    def __init__(self, load: Callable[[], None], fail: Callable[[Exception], None]) -> None:
        super().__init__("model loader")
        self._load, self._fail = load, fail

    def run(self) -> None:
        """The thread."""
        try:
            self._load()
        except Exception as error:
            if not self.is_stopping:
                self._fail(error)
