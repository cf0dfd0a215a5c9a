"""A voltage measured at the coil's terminals as the input of a model, in place of the commands.

Between two commands it is interpolated by straight lines, and never across one, where it jumps. The model takes a
voltage that is held, so the lines become steps: as few as keep the flux linkage, ∫ V dt, within its noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.model.drives import Drive
from valve_sim.recordings.motion import sample_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valve_sim.files.channels import Signal

    Array = NDArray[np.float64]

FLUX_SIGMAS: Final = 3.5
"""Standard deviations of the flux by the voltage's noise, within which a longer step follows it."""
FINEST_FLUX: Final = 1e-8
"""s: and by this much of the largest voltage, 0.01 mA of 1 A where the coil's time constant is 1 ms."""


GAP: Final = 10.0
"""Usual intervals between samples: a longer gap says as much of the voltage as this one would."""
AT_COMMAND: Final = 1e-8
"""s: a sample this near a command may be before or after it, for rounded stamps."""


class MeasuredInput(NamedTuple):
    """Steps of a measured voltage, in the order of time.

    Attributes:
        command: (m,) index of the command after which each step comes.
        start: (m,) s, by the samples' clock; −inf for a step that begins with its command.
        volts: (m,) V.
    """

    command: NDArray[np.int64]
    start: Array
    volts: Array

    def drive(self, commands: Drive, lateness: float = 0.0, *, freewheels: bool = False) -> Drive:
        """The voltage as a model's input.

        Args:
            commands: as they took effect. lateness: s, by which the samples are stamped late.
            freewheels: whether the coil freewheels while the command is 0; its voltage then follows from the model.
        """
        ends = np.append(commands.times[1:], np.inf)[self.command]
        begins = commands.times[self.command]
        times = np.clip(self.start - lateness, begins, ends)
        volts = self.volts
        if freewheels:
            is_off = commands.volts[self.command] == 0.0
            kept = ~is_off | np.isneginf(self.start)
            times, volts = times[kept], np.where(is_off, 0.0, volts)[kept]
        return Drive(times, volts)


def measured_input(commands: Drive, measured: Signal) -> MeasuredInput:
    """Make steps of a measured voltage.

    Args:
        commands: when and to what the voltage was commanded. measured: samples at the coil's terminals.
    """
    sigma = sample_noise(measured.values)
    finest = FINEST_FLUX * float(np.abs(measured.values).max(initial=0.0))
    edges = np.searchsorted(measured.times, commands.times)
    which, starts, volts = [], [], []
    for index, command in enumerate(commands.volts.tolist()):
        first = int(edges[index])
        stop = int(edges[index + 1]) if index + 1 < len(edges) else len(measured.times)
        begin = float(commands.times[index])
        end = float(commands.times[index + 1]) if index + 1 < len(edges) else np.inf
        steps = [(-np.inf, command)]
        times, values = measured.times[first:stop], measured.values[first:stop]
        is_clear = (times - begin > AT_COMMAND) & (end - times > AT_COMMAND)
        if is_clear.any():
            times, values = times[is_clear], values[is_clear]
            steps = _steps(_with_ends(times, begin, end), np.pad(values, 1, "edge"), sigma, finest)
        for start, level in steps:
            which.append(index)
            starts.append(start)
            volts.append(_told_from_zero(level, command, sigma / np.sqrt(max(1.0, (stop - first) / len(steps)))))
    return MeasuredInput(np.array(which, dtype=np.int64), np.array(starts), np.array(volts))


def _with_ends(times: Array, begin: float, end: float) -> Array:
    return np.concatenate([[min(begin, times[0])], times, [max(end, times[-1]) if np.isfinite(end) else times[-1]]])


def _told_from_zero(level: float, command: float, error: float) -> float:
    """A level; 0 V where it is commanded and nothing else is measured, never 0 V where another voltage is commanded."""
    if command == 0.0:
        return 0.0 if abs(level) <= FLUX_SIGMAS * error else level
    # A command of 0 would let the coil freewheel.
    return level if level != 0.0 else float(np.finfo(np.float64).tiny)


def _steps(times: Array, volts: Array, sigma: float, finest: float) -> list[tuple[float, float]]:
    """When steps begin, s, the first at −inf, and their voltages: cut where the flux is the farthest from a step's."""
    if not np.ptp(volts):
        return [(-np.inf, float(volts[0]))]
    seen = _without_gaps(times)
    flux = np.concatenate([[0.0], np.cumsum(0.5 * (volts[1:] + volts[:-1]) * np.diff(seen))])
    found, waiting = [], [(0, len(times) - 1)]
    while waiting:
        first, last = waiting.pop()
        span = float(seen[last] - seen[first])
        level = float(flux[last] - flux[first]) / span if span > 0.0 else float(volts[first])
        if last - first > 1 and span > 0.0:
            away = np.abs(flux[first : last + 1] - flux[first] - level * (seen[first : last + 1] - seen[first]))
            # Of a random walk that ends where it should, in the middle.
            noise = 0.5 * sigma * span / np.sqrt(last - first)
            if away.max() > finest + FLUX_SIGMAS * noise:
                middle = first + int(np.clip(np.argmax(away), 1, last - first - 1))
                waiting += [(middle, last), (first, middle)]
                continue
        found.append((float(times[first]), level))
    return [(-np.inf, found[0][1]), *found[1:]]


def _without_gaps(times: Array) -> Array:
    """The times with gaps cut short: over one, the noise of the two samples beside it would stand for the voltage."""
    steps = np.diff(times)
    longest = GAP * float(np.median(steps))
    if steps.max() <= longest:
        return times
    return np.concatenate([[0.0], np.cumsum(np.minimum(steps, longest))])
