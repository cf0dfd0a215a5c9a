"""What is compiled for a set of effects, and the blocks of valves that have them."""

from __future__ import annotations

import ctypes
import functools
import struct
import threading
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core import driver, gas_steps, layout, modes, steps
from valve_sim.model.core.equations import build
from valve_sim.model.core.kernels import NAMES, Kernels
from valve_sim.model.core.lowering import lowered
from valve_sim.model.core.machine import QUICKLY, WELL, Library, library, made_once
from valve_sim.model.core.symbols import Effect
from valve_sim.model.errors import ParameterError

Array = NDArray[np.float64]
POINTER: Final = ctypes.c_void_p
_SLOTS: Final = {name: getattr(layout, name.upper()) for name in NAMES}
_DOUBLE, _INTEGER = ctypes.c_double, ctypes.c_int64
_SIGNATURES: Final[dict[str, tuple[Any, ...]]] = {
    "whole": (_INTEGER, *[POINTER] * 3, _INTEGER, POINTER, _INTEGER, POINTER, _INTEGER, POINTER, _INTEGER,
              *[_DOUBLE] * 3),
    "drive": (_INTEGER, *[POINTER] * 3, _INTEGER, _DOUBLE, _INTEGER, POINTER, _INTEGER, POINTER, _INTEGER,
              *[POINTER] * 2, _INTEGER, *[POINTER] * 4, _INTEGER),
    "batch": (_INTEGER, *[POINTER] * 3, _INTEGER, _INTEGER, _DOUBLE, POINTER, _INTEGER, _DOUBLE, _INTEGER, POINTER,
              _INTEGER, POINTER),
    "start": (None, *[POINTER] * 4, _INTEGER, _DOUBLE),
    "renumber": (None, *[POINTER] * 4),
    "settle": (None, POINTER),
    "set_pressures": (None, *[POINTER] * 2),
    "advance": (_INTEGER, POINTER, _DOUBLE),
    "command": (_INTEGER, POINTER, _DOUBLE, _DOUBLE),
    "halt": (_INTEGER, POINTER, _DOUBLE),
}  # fmt: skip
"""What each function of the integrator that Python calls returns and takes."""


def as_double(address: int) -> float:
    """A double of the same bits as an address."""
    return float(struct.unpack("<d", struct.pack("<q", address))[0])


@made_once
def integrator(has_gas: bool) -> Library:
    """The compiled integrator; that of valves without gas takes a third less time to compile."""
    zeros = () if has_gas else ("b[at.DENSITY]",)
    return library(f"driver {zeros}", lambda: lowered(driver.FUNCTIONS, tuple(_SIGNATURES), zeros))


@made_once
def _entry(name: str, has_gas: bool) -> Any:
    return ctypes.CFUNCTYPE(*_SIGNATURES[name])(integrator(has_gas).address(name))


OFTEN: Final = 300
"""Runs of a plan that are worth compiling it well: it takes as long as some hundred runs of some strokes save by it."""


class Plan:
    """The equations of a set of effects, compiled: quickly at first, and well once they have been used often.

    Both give the same numbers to the last bit. Half of the sets of effects that a diagnosis asks for run once.

    Args:
        effects: in the order in which they act. shapes: values of the parameters that shape these.
        freewheels: whether the current may freewheel. has_gas, has_demand: see `equations.build`.
        width: directions of derivatives, to any parameters; 0 for none.
    """

    def __init__(
        self,
        effects: Sequence[Effect],
        *,
        shapes: Sequence[float] = (),
        freewheels: bool = False,
        has_gas: bool = False,
        has_demand: bool = False,
        width: int = 0,
    ) -> None:
        self._equations = functools.partial(
            build, effects, shapes=shapes, freewheels=freewheels, has_gas=has_gas, has_demand=has_demand
        )
        self._width, self._runs, self._libraries, self._has_gas = width, 0, list[Library](), has_gas
        system = self._equations()
        kernels = Kernels(system, width)
        if kernels.guard_count > layout.MOST_GUARDS or len(system.parameters) > layout.MOST_NUMBERS:
            raise ParameterError(
                f"effects {', '.join(effect.name for effect in effects)}: found {kernels.guard_count} comparisons and "
                f"{len(system.parameters)} numbers, expected at most {layout.MOST_GUARDS} and {layout.MOST_NUMBERS}; "
                "take one out"
            )
        self._key = f"{system.trace.digest()} {width}"
        self.parameters, self.states = system.parameters, kernels.names
        self.blank = blank = np.zeros(layout.SIZE)
        self._load(kernels, QUICKLY)
        blank[layout.STATES] = len(kernels.names)
        blank[layout.GUARDS] = kernels.guard_count
        blank[layout.IS_CHECKED] = kernels.is_checked
        blank[layout.HAS_PEAK] = system.peak is not None
        blank[layout.IS_FLUX] = system.flux_slope is not None
        blank[layout.WIDTH] = width
        blank[layout.NUMBER_COUNT] = len(system.parameters)
        is_integrated = any(state.after is None for name, state in system.states.items() if name != "density")
        warm = kernels.names.index("temperature") if "temperature" in kernels.names else len(kernels.names)
        blank[layout.WARM] = warm if is_integrated else -1.0
        if has_gas:
            blank[layout.DENSITY] = layout.COIL + kernels.names.index("density")
            blank[layout.HAS_DEMAND] = has_demand
            blank[layout.READS_TIME] = system.reads_time
            blank[layout.GAS_STEP] = gas_steps.FIRST_STEP
        if kernels.curve is not None:
            slots = (layout.CURVE, layout.LOW_GUARD, layout.HIGH_GUARD)
            blank[list(slots)] = kernels.curve
        blank[layout.MODE] = modes.CLOSED
        blank[layout.DIRECTION] = 1.0
        blank[layout.LONGEST] = steps.ANY_STEP

    def _load(self, kernels: Kernels, effort: int) -> None:
        """Have blocks call code that was made with some effort; earlier ones go on with theirs, which is kept."""
        self._libraries.append(library(self._key, kernels.text, effort))
        for name in kernels.made:
            self.blank[_SLOTS[name]] = as_double(self._libraries[-1].address(name))

    def use(self, runs: int = 1) -> None:
        """Count runs; after many of them blocks are given better code."""
        before, self._runs = self._runs, self._runs + runs
        if before < OFTEN <= self._runs:
            self._load(Kernels(self._equations(), self._width), WELL)

    def entry(self, name: str) -> Any:
        """A function of the integrator that Python can call with blocks; it releases the interpreter's lock."""
        return _entry(name, self._has_gas)

    def block(self, numbers: Array, tolerance: float, start: float, tangents: Array | None = None) -> Array:
        """The block of a valve that rests closed and without current at a time, s.

        Args:
            numbers: in the order of `parameters`. tolerance: relative error of one step.
            tangents: (layout.SIZE, width) those of the numbers, completed; None without derivatives.
        """
        block = np.empty(layout.SIZE)
        address = block.ctypes.data
        beside = address if tangents is None else tangents.ctypes.data
        self.entry("start")(address, beside, self.blank.ctypes.data, numbers.ctypes.data, len(numbers), start)
        block[layout.TOLERANCE] = tolerance
        return block


_LOCK: Final = threading.Lock()


def plan_of(
    effects: tuple[Effect, ...],
    shapes: tuple[float, ...] = (),
    width: int = 0,
    *,
    freewheels: bool = False,
    has_gas: bool = False,
    has_demand: bool = False,
    runs: int = 1,
) -> Plan:
    """The plan of a set of effects for some runs, made once a process, by one thread at a time.

    Whoever keeps a block keeps its plan, too: the block calls code that goes with it.
    """
    with _LOCK:
        found = _kept_plan(effects, shapes, width, freewheels, has_gas, has_demand)
        found.use(runs)
    return found


@functools.lru_cache(maxsize=512)
def _kept_plan(effects: tuple[Effect, ...], shapes: tuple[float, ...], width: int, *has: bool) -> Plan:
    freewheels, has_gas, has_demand = has
    return Plan(effects, shapes=shapes, freewheels=freewheels, has_gas=has_gas, has_demand=has_demand, width=width)
