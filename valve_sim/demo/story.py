"""What the valve has done so far, and its description."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from valve_sim.model import Drive, Phase, Response
from valve_sim.recordings import SensorEvent, StrokeEvents

ENERGISED: Final = 0.030
"""s of model time that the coil is on; the valve needs 10 ms."""
RESTING: Final = 0.030
"""s of model time that it is off; the valve needs 13 ms to close."""
LEAD: Final = 0.005
"""s of model time before the first command, so that the bag shows the valve at rest."""
COARSE: Final = 1e-5
"""s: an error above it is shown."""
BAR: Final = 41
"""Characters that stand for the whole travel: one for 30 µm."""

PAPER: Final[Mapping[str, tuple[str, float]]] = {
    "pilot_reaches_main": ("t1 main picked up", 5.3e-3),
    "reaches_stop": ("t2 core reached", 9.9e-3),
    "main_seats": ("main seated", math.nan),
    "reaches_seat": ("pilot seated", math.nan),
}
"""Arrivals by name: words, and the time after the command that the paper measured at 9 V, s."""

_STEPS: Final[Mapping[tuple[Phase, Phase], str]] = {
    (Phase.CLOSED, Phase.PILOT): "the pilot plunger leaves its seat",
    (Phase.PILOT, Phase.MAIN): "the pilot plunger takes the main plunger along",
    (Phase.PILOT, Phase.GAP_HOLD): "the pilot plunger waits: the main plunger is too heavy yet",
    (Phase.GAP_HOLD, Phase.MAIN): "the main plunger is lifted",
    (Phase.MAIN, Phase.OPEN): "all parts have reached the core: open",
    (Phase.OPEN, Phase.MAIN): "all parts leave the core",
    (Phase.MAIN, Phase.PILOT): "the main plunger is back on its seat",
    (Phase.PILOT, Phase.CLOSED): "the pilot plunger is back on its seat: closed",
}


class Sample(NamedTuple):
    """Joint states of one step: s, m, m, m/s, N."""

    time: float
    pilot: float
    main: float
    velocity: float
    attraction: float


class Story:
    """What the valve has done so far; all times are model time, s."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.commands: list[tuple[float, float]] = []
        self._phases: list[tuple[float, Phase]] = [(-math.inf, Phase.CLOSED)]
        self._currents: list[tuple[float, float]] = [(-math.inf, 0.0)]

    def command(self, when: float, volts: float) -> None:
        """The coil has another voltage, V, from `when` on, s."""
        self.commands.append((when, volts))

    def joint_states(self, when: float, position: Sequence[float], velocity: float, attraction: float) -> None:
        """Positions (pilot, main; m), velocity and attraction of the pilot plunger at `when`, s."""
        self.samples.append(Sample(when, position[0], position[1], velocity, attraction))

    def current(self, when: float, amperes: float) -> None:
        """The coil current at `when`, s."""
        self._currents.append((when, amperes))

    def phase(self, when: float, phase: Phase) -> str | None:
        """A phase began at `when`, s; returns the line to show, if any."""
        step = self._phases[-1][1], phase
        self._phases.append((when, phase))
        words = _STEPS.get(step)
        place = bisect_right(self.commands, when, key=lambda command: command[0]) - 1
        if words is None or place < 0:
            return None
        commanded, volts = self.commands[place]
        # The last of the current lifts a closed pilot plunger by less than an atom: not shown.
        if step == (Phase.CLOSED, Phase.PILOT) and volts == 0.0:
            return None
        return f"{1e3 * (when - commanded):8.2f} ms  {words}"

    def table(self, stroke: float) -> Table:
        """The valve now, with bars as long as its travel; `stroke` in m."""
        table = Table.grid(padding=(0, 2))
        if not self.samples:
            return table
        now = self.samples[-1]
        since = 1e3 * (now.time - self.commands[-1][0]) if self.commands else 0.0
        phase = self._phases[-1][1].name.lower().replace("_", " ")
        table.add_row("pilot plunger", _bar(now.pilot / stroke), f"{1e6 * now.pilot:7.1f} µm")
        table.add_row("main plunger", _bar(now.main / stroke), f"{1e6 * now.main:7.1f} µm")
        table.add_row("velocity", f"{1e3 * now.velocity:.1f} mm/s", f"{self._currents[-1][1]:7.3f} A")
        table.add_row("phase", f"[bold]{phase}[/]", f"{since:7.2f} ms")
        return table

    def first_stroke(self) -> tuple[Response, Drive]:
        """What was heard around the first stroke, and what was commanded; its command is time 0."""
        origin, stop = self.commands[0][0], self.commands[1][0] + RESTING
        heard = [sample for sample in self.samples if origin - LEAD <= sample.time < stop]
        columns = np.array(heard, dtype=np.float64).reshape(-1, len(Sample._fields)).T
        times, pilot, main, velocity, attraction = columns.copy()
        current = _held(self._currents, times)
        phase = _held([(when, float(phase)) for when, phase in self._phases], times).astype(np.uint8)
        response = Response(times - origin, pilot, main, velocity, current, attraction, phase, ())
        commanded, volts = np.array(self.commands[:2]).T
        return response, Drive(commanded - origin, volts)


def _held(announced: Sequence[tuple[float, float]], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """The value in force at each time, s, of what was announced as (time, value), ascending."""
    since, values = np.array(announced, dtype=np.float64).T
    return np.asarray(values[np.searchsorted(since, times, side="right") - 1])


def _bar(share: float) -> str:
    full = round(BAR * min(max(share, 0.0), 1.0))
    return "█" * full + "░" * (BAR - full)


def comparison(strokes: Sequence[StrokeEvents]) -> Table:
    """Event times of the strokes beside the paper's, ms after the command."""
    openings = sum(found.stroke.kind == "opening" for found in strokes)
    table = Table(title="ms after the command", title_justify="left")
    table.add_column("event")
    for number in range(1, openings + 1):
        table.add_column(f"stroke {number}", justify="right")
    table.add_column("paper", justify="right")
    table.add_column("difference", justify="right")
    for kind, (words, paper) in PAPER.items():
        seen = [event for found in strokes for event in found.events if event.kind == kind]
        times = [event.after_command for event in seen]
        cells = [_shown(event) for event in seen[:openings]] + ["–"] * (openings - len(times))
        is_known = times and not math.isnan(paper)
        difference = f"{1e3 * (float(np.mean(times)) - paper):+.3f}" if is_known else "–"
        table.add_row(words, *cells, "–" if math.isnan(paper) else f"{1e3 * paper:.1f}", difference)
    return table


def _shown(event: SensorEvent) -> str:
    """When an event was, ms; with its error where more than its last digits are open, as where messages were lost."""
    error = f" ± {1e3 * event.stderr:.2f}" if event.stderr > COARSE else ""
    return f"{1e3 * event.after_command:.3f}{error}"
