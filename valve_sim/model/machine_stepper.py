"""A machine of a plant file stepped in real time, by the same compiled engine as a whole run."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import Final, NamedTuple

from valve_sim.model.core.own.simulation import Event, Live, Machine, Piece
from valve_sim.model.stepper import CoilReading

_NAN: Final = math.nan
_Change = Callable[[Live, float], Piece]
"""Changes a machine from a time on, s."""


class MachineReading(NamedTuple):
    """A machine at one time, in the terms of a valve's `Reading`: m, A, V; NaN is what no output of it shows.

    Attributes:
        phase: the number of the mode that is in force, 0 without modes. entered: those that began since the reading
            before. modes: the mode in force in each region. events: those with a name since the reading before.
    """

    time: float
    pilot_position: float
    main_position: float
    coil_current: float
    coil_voltage: float
    phase: int
    entered: tuple[int, ...]
    modes: Mapping[str, str]
    events: tuple[Event, ...]
    pilot_velocity: float = _NAN
    main_velocity: float = _NAN
    attraction: float = _NAN
    main_effort: float = _NAN


class Channels(NamedTuple):
    """What is read of a machine: its outputs `position`, `main_position` and `current`, and the modes of a region.

    Attributes:
        delays: s by which each of these outputs is late, by its name; what has no entry is no output.
        region: whose modes are the phases; empty: it has no modes. phase_delay: s by which they are late.
    """

    delays: Mapping[str, float]
    region: str = ""
    phase_delay: float = 0.0


class MachineStepper:
    """A machine stepped in real time; its state does not depend on the size of the steps.

    Args:
        machine: what is stepped; its one input is the voltage at the coil. channels: what is read.
        numbers: its parameters. start: its states at the start. input_delay: s by which a voltage acts late.

    Raises:
        SimulationError: it cannot start with these numbers.
    """

    def __init__(
        self, machine: Machine, channels: Channels, numbers: Mapping[str, float], start: Mapping[str, float],
        input_delay: float = 0.0,
    ) -> None:  # fmt: skip
        self._machine, self._channels, self._start, self._input_delay = machine, channels, start, input_delay
        self._numbers = numbers
        self._places = {name: tuple(machine.equations.outputs).index(name) for name in channels.delays}
        region = machine.equations.regions.get(channels.region, {})
        self._phases = {mode: number for number, mode in enumerate(region)}
        self.reset(0.0)

    @property
    def volts(self) -> float:
        """The voltage in force, V."""
        return self._volts

    def reset(self, time: float) -> None:
        """Start again at `time`, s, without voltage."""
        delays = {0.0, self._channels.phase_delay, *self._channels.delays.values()}
        self._views = {delay: _View(self._live(self._numbers, time), time, delay) for delay in delays}
        self._volts = 0.0
        self._read(time)

    def command(self, time: float, volts: float) -> tuple[CoilReading, CoilReading]:
        """Set the voltage in force from `time` on, s, not before the latest time stepped to.

        Returns:
            the coil just before and just after.
        """
        self._read(time)
        before = self._coil(time)
        if volts != self._volts:
            self._volts = float(volts)
            self._change(time + self._input_delay, lambda live, at: live.change(at, (volts,)))
            self._read(time)
        return before, self._coil(time)

    def set_numbers(self, time: float, numbers: Mapping[str, float]) -> None:
        """Go on with other parameters from `time` on, s; states go on, and a late sensor shows it later.

        Raises:
            SimulationError: it could not start with these numbers; nothing has changed.
        """
        self._live(numbers, time)
        self._numbers = numbers
        self._change(time, lambda live, at: live.renumber(at, numbers))

    def advance(self, time: float) -> MachineReading:
        """Step to `time`, s (not before the last command), and read the machine there.

        Raises:
            SimulationError: the step could not be carried to its end.
        """
        self._read(time)
        state, phases, region = self._views[0.0], self._views[self._channels.phase_delay], self._channels.region
        entered = tuple([self._phases[mode] for where, mode in phases.entered if where == region])
        events = tuple(state.events)
        phases.entered, state.events = [], []
        return MachineReading(
            time, self._shown("position"), self._shown("main_position"), self._shown("current"), self._volts,
            self._phases.get(phases.modes.get(region, ""), 0), entered, state.modes, events,
        )  # fmt: skip

    def _live(self, numbers: Mapping[str, float], time: float) -> Live:
        return self._machine.stepped(numbers, self._start, (0.0,), time)

    def _change(self, time: float, change: _Change) -> None:
        for view in self._views.values():
            insort(view.changes, (time, change), key=itemgetter(0))

    def _read(self, time: float) -> None:
        for view in self._views.values():
            view.read(time)

    def _coil(self, time: float) -> CoilReading:
        return CoilReading(time, self._shown("current"), self._volts)

    def _shown(self, name: str) -> float:
        place = self._places.get(name)
        return _NAN if place is None else float(self._views[self._channels.delays[name]].outputs[place])


class _View:
    """The machine as a sensor shows it that is late by a delay, s: a machine that follows by so much.

    Before its start, s, a sensor shows what it shows then.
    """

    def __init__(self, live: Live, start: float, delay: float) -> None:
        self._live, self._start, self._delay = live, start, delay
        self.changes: list[tuple[float, _Change]] = []
        self.entered: list[tuple[str, str]] = []
        self.events: list[Event] = []
        self.read(start)

    def read(self, time: float) -> None:
        """Have it show what it shows at a time, s."""
        time = max(time - self._delay, self._start)
        while self.changes and self.changes[0][0] <= time:
            at, change = self.changes.pop(0)
            self._take(change(self._live, at))
        self._take(self._live.advance(time))

    def _take(self, piece: Piece) -> None:
        self.outputs, self.modes = piece.outputs, piece.modes
        self.entered += piece.entered
        self.events += piece.events
