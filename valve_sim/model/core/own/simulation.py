"""A machine of a user's own, simulated with the derivatives of what its sensors show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core.hybrid import driver
from valve_sim.model.core.hybrid import layout as at
from valve_sim.model.core.hybrid.compiled import NO_CHANGES, TOLERANCE, Array, Changes, Compiled, Room, Run
from valve_sim.model.core.hybrid.description import Case
from valve_sim.model.core.hybrid.system import System
from valve_sim.model.core.own.equations import Equations
from valve_sim.model.core.own.grammar import Expr
from valve_sim.model.errors import SimulationError

STEPS_EACH: Final = 200
"""Steps that a run may take for each knot and sample, and `STEPS_MORE` besides: a stiff machine takes more."""
STEPS_MORE: Final = 200_000
WIDTHS: Final = (0, 4, 8, 12, 16)
"""Directions of derivatives that kernels are compiled for; more are taken in several runs."""
LIVE_EVENTS: Final = 4096
"""Events that a piece of a live run may have; later ones are not told."""
MOST_LIVE: Final = 4_000_000
"""Steps of a piece of a live run."""
MOST_DRIVEN: Final = 2_000_000
"""Changes of inputs that are kept, with the inputs."""


class Inputs(NamedTuple):
    """What drives a machine.

    Attributes:
        times: (k,) s, ascending. levels: (k, i) in SI. held: (i,) True where a level holds until the next one; else a
            straight line joins them. Before the first and after the last they are constant.
    """

    times: Array
    levels: Array
    held: NDArray[np.bool_]


class Event(NamedTuple):
    """A transition that happened: when, s, and its name in the file."""

    time: float
    name: str


class Shown(NamedTuple):
    """What a run shows.

    Attributes:
        outputs: (n, outputs) in SI. slopes: (n, outputs, directions). events: those with a name. steps: that it took.
    """

    outputs: Array
    slopes: Array
    events: tuple[Event, ...]
    steps: int


class Machine:
    """The compiled equations of a machine with some of its effects on.

    Args:
        equations: what it does. free: names of parameters that derivatives may be taken to.

    Raises:
        EquationsError: there are more states, switches and so on than the engine has room for.
    """

    def __init__(self, equations: Equations, free: Sequence[str]) -> None:
        self.equations = equations
        self._system = System(equations.described())
        self._free = tuple(free)
        self._compiled: dict[int, Compiled] = {}
        self._driven: dict[tuple[int, float], tuple[Inputs, Changes]] = {}

    def run(
        self,
        numbers: Mapping[str, float],
        start: Mapping[str, float],
        inputs: Inputs,
        samples: Array,
        directions: Sequence[Mapping[str, float]] = (),
        start_time: float | None = None,
        most: int | None = None,
        tolerance: float = TOLERANCE,
        moves: Array | None = None,
    ) -> Shown:
        """What the outputs are at some times.

        Args:
            numbers: all parameters by name. start: states at `start_time`. inputs: what drives it.
            samples: (n,) s, ascending, of which none is before the start.
            directions: along each a derivative is taken: parameters and states at the start, by how much they change;
                a state's name stands for its start.
            start_time: s; default the first sample or the first time of the inputs, whichever is earlier.
            most: steps that it may take; default so many that hardly any equations need more.
            tolerance: relative error of a step, of the largest size that a state has had so far.
            moves: (k, 1 + i, directions) derivatives of the times of the inputs, where they step, and of their levels;
                None: they are known.

        Raises:
            SimulationError: a number is not finite, or the run takes too many steps.
        """
        if not len(samples):
            outputs = len(self.equations.outputs)
            return Shown(np.empty((0, outputs)), np.empty((0, outputs, len(directions))), (), 0)
        samples = np.ascontiguousarray(samples, dtype=np.float64)
        begins = min(samples[0], inputs.times[0]) if len(inputs.times) else samples[0]
        changes = self._changes(inputs, float(begins if start_time is None else start_time))
        states, values = self._start(numbers, start)
        if most is None:
            most = STEPS_MORE + STEPS_EACH * (changes.count + len(samples))
        runs = []
        for first in range(0, len(directions), WIDTHS[-1]) or (0,):
            part = directions[first : first + WIDTHS[-1]]
            compiled = self._with_width(next(own for own in WIDTHS if own >= len(part)))
            driven = changes
            if moves is not None:
                of_changes = np.zeros((changes.count, moves.shape[1], compiled.width))
                kept = min(changes.count, len(moves))
                of_changes[-kept:, :, : len(part)] = moves[-kept:, :, first : first + len(part)]
                driven = Changes(changes.rows, of_changes)
            runs.append(compiled.run(states, values, part, driven, samples, most, tolerance))
            self.check(runs[-1])
        if len(runs) == 1:
            return Shown(runs[0].outputs, runs[0].slopes, self._events(runs[0].events), runs[0].steps)
        slopes = np.concatenate([done.slopes for done in runs], axis=2)
        return Shown(runs[0].outputs, slopes, self._events(runs[0].events), runs[0].steps)

    def stepped(
        self, numbers: Mapping[str, float], start: Mapping[str, float], levels: Sequence[float], time: float = 0.0,
        tolerance: float = TOLERANCE,
    ) -> Live:  # fmt: skip
        """The machine live, from a time on, s; `levels` of its inputs, SI, hold until they change; else as `run`."""
        compiled, room = self._with_width(0), Room(0, LIVE_EVENTS)
        compiled.begin(room, *self._start(numbers, start), _held(time, levels), tolerance)
        return Live(self, compiled, room, levels)

    def _start(self, numbers: Mapping[str, float], start: Mapping[str, float]) -> tuple[Array, Array]:
        states = np.array([start[name] for name in self.equations.derivatives])
        values = self.values(numbers)
        if not math.isfinite(states.sum() + values.sum()):
            raise SimulationError("a parameter or a state at the start is not finite")
        return states, values

    def values(self, numbers: Mapping[str, float]) -> Array:
        """Parameters in the order of the engine."""
        return np.array([numbers[name] for name in self.equations.parameters])

    def _changes(self, inputs: Inputs, time: float) -> Changes:
        """What inputs do from a time on, s; known of those that drive it again and again."""
        key = id(inputs), time
        found = self._driven.get(key)
        if found is None or found[0] is not inputs:
            if sum(len(kept.times) for kept, _ in self._driven.values()) > MOST_DRIVEN:
                self._driven.clear()
            found = self._driven[key] = inputs, Changes(_changes(inputs, time))
        return found[1]

    def _with_width(self, width: int) -> Compiled:
        if width not in self._compiled:
            self._compiled[width] = Compiled(self._system, self._free, width)
        return self._compiled[width]

    def _events(self, events: Array) -> tuple[Event, ...]:
        found = [Event(time, case.event) for time, case in self.cases(events)]
        return tuple(event for event in found if event.name)

    def cases(self, events: Array) -> list[tuple[float, Case[Expr]]]:
        """Of each event its time, s, and which case of which transition it was."""
        transitions = self.equations.transitions
        return [(float(time), transitions[int(which)].cases[int(case)]) for time, which, case in events]

    def check(self, done: Run) -> None:
        """Refuse a run that came to nothing.

        Raises:
            SimulationError: it took too many steps, time stands still, or a number is not finite.
        """
        if done.outcome == driver.TOO_MANY:
            raise SimulationError(
                f"{done.steps:,} steps did not reach the end: the equations are too fast for the recording"
            )
        if done.outcome == driver.STANDS_STILL:
            stalls = done.time - driver.MOST_STALLED * driver.PROGRESS
            last = sorted({int(which) + 1 for time, which, _ in done.events if time >= stalls})
            which = f"transitions {', '.join(map(str, last))} of the file" if last else "its switches"
            raise SimulationError(
                f"time stands still at {done.time:.6g} s: {which} happen again and again; "
                "add a mode in which the machine rests"
            )
        if done.outcome == driver.NOT_FINITE or not np.all(np.isfinite(done.outputs)):
            raise SimulationError(f"a state or output is not finite from {done.time:.6g} s on")


class Piece(NamedTuple):
    """What a machine that is stepped shows.

    Attributes:
        outputs: (outputs,) in SI. events: those with a name since the piece before.
        entered: the modes that began since then, each with its region.
        modes: the mode in force in each region, by the region's name.
    """

    outputs: Array
    events: tuple[Event, ...]
    entered: tuple[tuple[str, str], ...]
    modes: Mapping[str, str]


class Live:
    """A machine that is stepped: what it shows at times that are not known beforehand is what one run shows then.

    Args:
        machine: made it. compiled: without directions. room: in which it has begun. levels: of its inputs, SI.
    """

    def __init__(self, machine: Machine, compiled: Compiled, room: Room, levels: Sequence[float]) -> None:
        self._machine, self._compiled, self._room, self._levels = machine, compiled, room, tuple(levels)
        time = float(room.block[at.TIME])
        self._untold = [self._step(time, _held(time, levels))]
        machine.check(self._untold[0])

    def advance(self, time: float) -> Piece:
        """What it shows at a time, s.

        Raises:
            SimulationError: a number is not finite, or time stands still.
        """
        return self._shown(self._step(time))

    def change(self, time: float, levels: Sequence[float]) -> Piece:
        """The same, of inputs that have other levels, SI, from that time on."""
        self._levels = tuple(levels)
        return self._shown(self._step(time, _held(time, levels)))

    def renumber(self, time: float, numbers: Mapping[str, float]) -> Piece:
        """The same, with other values of all parameters from that time on; states go on."""
        here = _held(time, self._levels)
        values = self._machine.values(numbers)
        self._untold.append(self._step(time, here))
        self._room.block[at.NUMBERS : at.NUMBERS + len(values)] = values
        return self._shown(self._step(time, here))

    def _step(self, time: float, changes: Changes = NO_CHANGES) -> Run:
        return self._compiled.advance(self._room, changes, np.array([time]), MOST_LIVE)

    def _shown(self, done: Run) -> Piece:
        self._machine.check(done)
        runs, self._untold = [*self._untold, done], []
        cases = [case for run in runs if len(run.events) for case in self._machine.cases(run.events)]
        events = tuple([Event(time, case.event) for time, case in cases if case.event])
        entered = tuple([pair for _, case in cases for pair in case.to.items()])
        regions, numbers = self._machine.equations.regions, self._room.block[at.MODE : at.MODE + at.MOST_REGIONS]
        modes = {name: tuple(own)[int(number)] for (name, own), number in zip(regions.items(), numbers, strict=False)}
        return Piece(done.outputs[0], events, entered, modes)


def _held(time: float, levels: Sequence[float]) -> Changes:
    return Changes(np.array([[time, *(number for level in levels for number in (level, 0.0))]]))


def _changes(inputs: Inputs, time: float) -> Array:
    """(k, 1 + 2 inputs) from a time on, s: when inputs change, and from then on a value and a slope of each."""
    times, levels, held = inputs
    count = len(held)
    if not len(times):
        return np.array([[time] + [0.0] * (2 * count)])
    slopes = np.zeros((len(times), count))
    lasts = np.diff(times)[:, None]
    # Of two rows of one time, at which an input steps, the second counts.
    slopes[:-1, ~held] = np.diff(levels[:, ~held], axis=0) / np.where(lasts > 0.0, lasts, math.inf)
    first = max(0, int(np.searchsorted(times, time, side="right")) - 1)
    changes = np.empty((len(times) - first, 1 + 2 * count))
    changes[:, 0], changes[:, 1::2], changes[:, 2::2] = times[first:], levels[first:], slopes[first:]
    begun = time - times[first]
    if begun < 0.0:  # before the first time they are as they begin
        before = np.concatenate([[time], np.column_stack([levels[0], np.zeros(count)]).ravel()])
        return np.vstack([before, changes])
    changes[0, 0] = time
    changes[0, 1::2] += begun * slopes[first]
    return changes


def level_at(times: Array, of: Array, levels: Array, *, is_held: bool) -> Array:
    """(n,) an input at some times: held from each of its own times `of` to the next, or straight between them."""
    if is_held:
        return np.asarray(levels[np.maximum(np.searchsorted(of, times, side="right") - 1, 0)])
    return np.interp(times, of, levels)


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
