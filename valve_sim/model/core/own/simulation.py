"""A machine of a user's own, simulated with the derivatives of what its sensors show."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core import machine
from valve_sim.model.core.lowering import lowered
from valve_sim.model.core.own import driver
from valve_sim.model.core.own import layout as at
from valve_sim.model.core.own.kernels import Kernels
from valve_sim.model.core.own.system import Equations, EquationsError, System, build
from valve_sim.model.errors import SimulationError

Array = NDArray[np.float64]

TOLERANCE: Final = 1e-9
"""Relative error of a step, of the largest size that a state has had so far."""
STEPS_EACH: Final = 200
"""Steps that a run may take for each knot and sample, and `STEPS_MORE` besides: a stiff machine takes more."""
STEPS_MORE: Final = 200_000
WIDTHS: Final = (0, 4, 8, 12, 16)
"""Directions of derivatives that kernels are compiled for; more are taken in several runs."""
LIMITS: Final = (
    ("states", at.MOST_STATES), ("inputs", at.MOST_INPUTS), ("outputs", at.MOST_OUTPUTS),
    ("parameters", at.MOST_NUMBERS),
)  # fmt: skip


class Inputs(NamedTuple):
    """What drives a machine.

    Attributes:
        times: (k,) s, ascending. levels: (k, i) in SI. held: (i,) True where a level holds until the next one; else a
            straight line joins them. Before the first and after the last they are constant.
    """

    times: Array
    levels: Array
    held: NDArray[np.bool_]


class Machine:
    """The compiled equations of a machine with some of its effects on.

    Args:
        equations: what it does. free: names of parameters and inputs that derivatives may be taken to.

    Raises:
        EquationsError: there are more states, switches and so on than the integrator has room for.
    """

    def __init__(self, equations: Equations, free: Sequence[str]) -> None:
        self.system: System = build(equations)
        system = self.system
        for what, most in LIMITS:
            count = len(getattr(system, what))
            if count > most:
                raise EquationsError(f"found {count} {what}, expected at most {most}")
        if len(system.guards) > at.MOST_GUARDS:
            raise EquationsError(f"found {len(system.guards)} switches, expected at most {at.MOST_GUARDS}")
        self._free = tuple(free)
        self._libraries: dict[int, machine.Library] = {}

    def _library(self, width: int) -> machine.Library:
        if width not in self._libraries:
            key = f"own {self.system.trace.digest()} {self._signature()} {width}"
            self._libraries[width] = machine.library(
                key, lambda: Kernels(self.system, self._free, width).text(), is_straight=True
            )
        return self._libraries[width]

    def _signature(self) -> str:
        system = self.system
        groups = (
            system.rates, system.outputs, system.guards, system.alphas, system.sliding_rates, system.sliding_outputs
        )  # fmt: skip
        indices = [[node.index for node in group] for group in groups]
        return f"{indices} {system.states} {system.inputs} {system.parameters} {system.sliding} {self._free}"

    def run(
        self,
        numbers: Mapping[str, float],
        start: Mapping[str, float],
        inputs: Inputs,
        samples: Array,
        directions: Sequence[Mapping[str, float]] = (),
        start_time: float | None = None,
        most: int | None = None,
    ) -> tuple[Array, Array]:
        """What the outputs are at some times.

        Args:
            numbers: all parameters by name. start: states at `start_time`. inputs: what drives it.
            samples: (n,) s, ascending, of which none is before the start.
            directions: along each a derivative is taken: parameters and states at the start, by how much they change;
                a state's name stands for its start.
            start_time: s; default the first sample or the first time of the inputs, whichever is earlier.
            most: steps that it may take; default so many that hardly any equations need more.

        Returns:
            (n, outputs) in SI, and (n, outputs, directions).

        Raises:
            SimulationError: a number is not finite, or the run takes too many steps.
        """
        if not len(samples):
            return np.empty((0, len(self.system.outputs))), np.empty((0, len(self.system.outputs), len(directions)))
        shown, columns = np.empty(0), []
        width = WIDTHS[-1]
        parts = [directions[i : i + width] for i in range(0, len(directions), width)] or [()]
        for part in parts:
            shown, slopes, _ = self._run(numbers, start, inputs, samples, part, start_time, most)
            columns.append(slopes[:, :, : len(part)])
        return shown, np.concatenate(columns, axis=2)

    def steps(
        self, numbers: Mapping[str, float], start: Mapping[str, float], inputs: Inputs, samples: Array,
        start_time: float | None = None,
    ) -> int:  # fmt: skip
        """How many steps a run takes; arguments and errors as of `run`."""
        return self._run(numbers, start, inputs, samples, (), start_time, None)[2] if len(samples) else 0

    def _run(
        self, numbers: Mapping[str, float], start: Mapping[str, float], inputs: Inputs, samples: Array,
        directions: Sequence[Mapping[str, float]], start_time: float | None, most: int | None,
    ) -> tuple[Array, Array, int]:  # fmt: skip
        system = self.system
        width = next(own for own in WIDTHS if own >= len(directions))
        library = self._library(width)
        block, tangents = np.zeros(at.SIZE), np.zeros(at.SIZE * max(width, 1))
        names = ("move", "slide", "at", "look", "row")
        for slot, name in zip((at.MOVE, at.SLIDE, at.AT, at.LOOK, at.ROW), names, strict=True):
            block[slot : slot + 1].view(np.int64)[0] = library.address(name)
        begins = min(samples[0], inputs.times[0]) if len(inputs.times) else samples[0]
        block[at.TIME] = begins if start_time is None else start_time
        block[at.TOLERANCE] = TOLERANCE
        block[at.STATES], block[at.GUARDS] = len(system.states), len(system.guards)
        block[at.OUTPUTS], block[at.INPUTS] = len(system.outputs), len(system.inputs)
        block[at.SLIDING], block[at.WIDTH] = len(system.sliding), width
        for k, (guard, snap) in enumerate(zip(system.sliding, system.snaps, strict=True)):
            block[at.SLIDE_GUARD + k] = guard
            block[at.SNAP + k] = -1 if snap is None else system.states.index(snap)
        slots = {name: at.STATE + i for i, name in enumerate(system.states)}
        slots |= {name: at.NUMBERS + i for i, name in enumerate(system.parameters)}
        for name, slot in slots.items():
            block[slot] = start[name] if slot < at.END else numbers[name]
        for i, name in enumerate(system.states):
            block[at.PEAK + i] = abs(start[name])
        for column, direction in enumerate(directions):
            for name, by in direction.items():
                if name in slots:
                    tangents[slots[name] * width + column] = by
        if not np.all(np.isfinite(block[at.STATE : at.END])) or not np.all(np.isfinite(block[at.NUMBERS :])):
            raise SimulationError("a parameter or a state at the start is not finite")
        levels = np.ascontiguousarray(inputs.levels, dtype=np.float64)
        knots, held = np.ascontiguousarray(inputs.times, dtype=np.float64), inputs.held.astype(np.float64)
        samples = np.ascontiguousarray(samples, dtype=np.float64)
        out = np.zeros((len(samples), len(system.outputs)))
        slopes = np.zeros((len(samples), len(system.outputs), max(width, 1)))
        steps = STEPS_MORE + STEPS_EACH * (len(knots) + len(samples)) if most is None else most
        arrays = (block, tangents, knots, levels, held, samples, out, slopes)
        outcome = _driver()(*(array.ctypes.data for array in arrays), len(knots), len(samples), steps)
        if outcome == driver.TOO_MANY:
            raise SimulationError(
                f"{steps:,} steps did not reach the end: the equations are too fast for the recording"
            )
        if outcome == driver.NOT_FINITE or not np.all(np.isfinite(out)):
            raise SimulationError(f"a state or output is not finite from {block[at.TIME]:.6g} s on")
        return out, slopes, int(block[at.TAKEN])


@machine.made_once
def _loaded() -> machine.Library:
    return machine.library("own driver", lambda: lowered(driver.FUNCTIONS, ("run",)))


@machine.made_once
def _driver():  # type: ignore[no-untyped-def]
    pointers, integers = [ctypes.c_void_p] * 8, [ctypes.c_int64] * 3
    return ctypes.CFUNCTYPE(ctypes.c_int64, *pointers, *integers)(_loaded().address("run"))


def without_straight(inputs: Inputs) -> Inputs:
    """The inputs without the times at which none of them changes its slope."""
    times, levels, held = inputs
    if len(times) < 3:
        return inputs
    keep = np.zeros(len(times), dtype=bool)
    keep[[0, -1]] = True
    for i, is_held in enumerate(held):
        own = levels[:, i]
        if is_held:
            keep[1:] |= np.diff(own) != 0.0
        else:
            slopes = np.diff(own) / np.diff(times)
            keep[1:-1] |= slopes[1:] != slopes[:-1]
    return Inputs(times[keep], levels[keep], held)
