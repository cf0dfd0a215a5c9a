"""Threads that a node can ask to end."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable

from valve_sim.model import Stepper, Valve


class StoppableThread(threading.Thread):
    """A daemon thread whose `run` returns soon after `stop` was called: it looks at `is_stopping`.

    Attributes:
        is_stopping: whether `stop` was called.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name=name, daemon=True)
        self.is_stopping = False
        self._stopping = threading.Event()

    def wake(self) -> None:
        """Interrupt what the thread waits for, if anything, so that it sees that it is to end."""

    def stop(self, timeout: float) -> bool:
        """Ask the thread to end; whether it has ended within `timeout`, s."""
        self.is_stopping = True
        self._stopping.set()
        self.wake()
        if self.is_alive():
            self.join(timeout)
        return not self.is_alive()


class Repeating(StoppableThread):
    """A thread that does something again and again, with pauses.

    Args:
        name: of the thread.
        act: is done. pause: s until it is done next.
        fail: called with what went wrong, if anything did; the thread then ends.
    """

    def __init__(
        self, name: str, act: Callable[[], object], pause: Callable[[], float], fail: Callable[[Exception], None]
    ) -> None:
        super().__init__(name)
        self._act, self._pause, self._fail = act, pause, fail

    def run(self) -> None:
        """The thread."""
        try:
            while not self._stopping.wait(self._pause()):
                self._act()
        except Exception as error:
            if not self.is_stopping:
                self._fail(error)


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
