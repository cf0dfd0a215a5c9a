"""A recording's run in pieces: what its sensors show, with derivatives, and no more than a piece of it at a time.

A long recording has millions of samples, and a fit some fifteen derivatives of each. All that it needs of them are
sums, so that each piece is added up and forgotten. Pieces end with a command, where the core ends a step anyway: they
are what one run would give, to the last digit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.recording_errors import places_of_fields
from valve_sim.identification.plants.valve_sensors import NO_TIMES, recorded, run_from_rest, shown_by
from valve_sim.model import Drive, Valve
from valve_sim.model.runs import Directions, Shown
from valve_sim.recordings import Trace

SAMPLES: Final = 8192
"""Of a piece, at least, positions and currents together: what they need stays near the processor."""


class RunPiece(NamedTuple):
    """What a run, or a piece of it, shows.

    Attributes:
        positions, currents: which samples of the recording, of either kind.
        shown: at these, the current normalised.
    """

    positions: slice
    currents: slice
    shown: Shown


class Cut(NamedTuple):
    """Where a piece lies among commands and samples, and when it ends, s, by the model's clock."""

    commands: slice
    positions: slice
    currents: slice
    end: float


class Intervals(NamedTuple):
    """What differs of a valve by interval between commands.

    Attributes:
        fields: names of f numbers. factors: (c + 1, f) of these, before the first command and after each.
        slopes: (k, c + 1, f) derivatives of these along k directions; None where no derivatives are asked for.
        numbers: (k, n) derivatives of the valve's numbers along the directions, or None.
    """

    fields: Sequence[str]
    factors: Array
    slopes: Array | None = None
    numbers: Array | None = None

    @property
    def changes(self) -> set[int]:
        """After which commands something is not as before."""
        found = np.any(self.factors[1:] != self.factors[:-1], axis=1)
        if self.slopes is not None:
            found |= np.any(self.slopes[:, 1:] != self.slopes[:, :-1], axis=(0, 2))
        return set(np.flatnonzero(found).tolist())

    def values(self, own: Array, places: Sequence[Sequence[int]], interval: int) -> Array:
        """(n,) the numbers of a valve in an interval.

        Args:
            own: (n,) its numbers, where nothing differs. places: of each field among these.
            interval: before the first command 0, and one more after each.
        """
        found = own.copy()
        for where, factor in zip(places, self.factors[interval].tolist(), strict=True):
            found[where] *= factor
        return found

    def moved(self, own: Array, places: Sequence[Sequence[int]], interval: int) -> Array | None:
        """(k, n) derivatives of these; arguments: see `values`."""
        if self.numbers is None or self.slopes is None:
            return None
        found = self.numbers.copy()
        for field, where in enumerate(places):
            found[:, where] *= self.factors[interval, field]
            found[:, where] += own[where] * self.slopes[:, interval, field, None]
        return found


class Course(NamedTuple):
    """A recorded drive that a valve runs through.

    Attributes:
        valve: what is simulated; without gas where it is run in pieces. numbers: (n,) of it.
        trace: whose sample times count. drive: when the voltage changes, s. late: s, by which samples are stamped.
        directions: along which derivatives are carried. intervals: what differs of the valve between commands.
    """

    valve: Valve
    numbers: Array
    trace: Trace
    drive: Drive
    late: float
    directions: Directions | None = None
    intervals: Intervals | None = None

    def whole(self) -> RunPiece:
        """All that it shows.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        if self.intervals is None:
            of = self.valve, self.trace, self.drive, self.late, self.directions
            return RunPiece(slice(None), slice(None), shown_by(*of, numbers=self.numbers))
        first, *others = self.pieces()
        if not others:
            return first
        parts = [first.shown, *(piece.shown for piece in others)]
        return RunPiece(slice(None), slice(None), Shown(*map(np.concatenate, zip(*parts, strict=True))))

    def pieces(self) -> Iterator[RunPiece]:
        """What it shows, piece by piece.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        valve, own, trace, drive, offset, directions, intervals = self
        current_times = trace.coil_current.times if trace.coil_current is not None else NO_TIMES
        numbers, ends = own, None
        if intervals is not None:
            places, ends = places_of_fields(valve, intervals.fields), intervals.changes
            numbers = intervals.values(own, places, 0)
            if directions is not None:
                moved = intervals.moved(own, places, 0)
                assert moved is not None
                directions = replace(directions, numbers=moved)
        of = recorded(valve, trace, drive, offset)
        run, commands = run_from_rest(of, directions, numbers), of.commands
        (delay,) = valve.after_effects("sensor_delay")
        for cut in cuts(trace.times, current_times, drive, (offset, delay), ends):
            if intervals is not None and cut.commands.start:
                after = cut.commands.start
                run.become(intervals.values(own, places, after), intervals.moved(own, places, after))
            times, late = trace.times[cut.positions] - offset, current_times[cut.currents] - offset
            shown = run.piece(commands[cut.commands], cut.end, times, late, first=cut.commands.start)
            yield RunPiece(cut.positions, cut.currents, shown)


def cuts(
    times: Array, current_times: Array, drive: Drive, late: tuple[float, float], ends: set[int] | None = None
) -> Iterator[Cut]:
    """Pieces of at least `SAMPLES` samples, or up to some commands.

    Args:
        times, current_times: s, of the samples. drive: the commands.
        late: s, by which samples are stamped, and positions shown. ends: numbers of commands with which pieces end.
    """
    offset, delay = late
    last = [float(found[-1]) - offset for found in (times, current_times) if len(found)]
    seen = np.searchsorted(times, drive.times + (offset + delay), side="right").tolist()
    seen_currents = np.searchsorted(current_times, drive.times + offset, side="right").tolist()
    command = position = current = 0
    for place, when in enumerate(drive.times.tolist()):
        is_short = (
            seen[place] - position + seen_currents[place] - current < SAMPLES if ends is None else place not in ends
        )
        if is_short or when >= max(last):
            continue
        ahead = _shown_by(when, times, (offset, delay), seen[place])
        ahead_current = _shown_by(when, current_times, (offset, 0.0), seen_currents[place])
        own = slice(command, place + 1), slice(position, ahead), slice(current, ahead_current)
        yield Cut(*own, when)
        command, position, current = place + 1, ahead, ahead_current
    own = slice(command, len(drive.times)), slice(position, len(times)), slice(current, len(current_times))
    yield Cut(*own, max(last))


def _shown_by(when: float, times: Array, late: tuple[float, float], near: int) -> int:
    """How many samples the core shows up to a time; `near` is that but for how sums are rounded."""
    offset, delay = late
    while near < len(times) and (times[near] - offset) - delay <= when:
        near += 1
    while near > 0 and (times[near - 1] - offset) - delay > when:
        near -= 1
    return near
