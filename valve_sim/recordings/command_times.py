"""When commands were sent, by the log of their sender, and when they took effect, by a measured voltage.

A command is a std_msgs/Float64, which has no stamp: it is dated by its arrival at the recorder, on a busy machine
milliseconds late. `command_profile` logs stamps beside its commands, and a voltage may have been measured with stamps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.recordings.clocks import SECOND
from valve_sim.recordings.motion import sample_noise
from valve_sim.recordings.voltage_steps import UNIFORM

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from valve_sim.files.channels import Signal

    Array = NDArray[np.float64]

LOG: Final = "commanded"
LOG_TYPE: Final = "sensor_msgs/msg/BatteryState"
LONGEST_WAY: Final = SECOND
"""ns between the stamp of a command and its recording; beyond it, it is another command or another clock."""
SLACK: Final = 3
"""Commands by which a recording may lag behind the log."""
SEEN: Final = 10.0
"""Standard deviations of the voltage's noise that a step has at least, to be dated."""
STAMP_ERROR: Final = 50e-6
"""s: how well a command is dated that the voltage does not show; such a share of it, that both clocks may differ."""
GAP: Final = 10.0
"""Usual intervals between samples of the voltage: a longer one hides a step, which may have been anywhere in it."""
MISSING: Final = 3.0
"""Usual intervals between samples, beyond which some are missing: no command is dated by what is not seen."""
EXACT: Final = 1e-8
"""s: what is known better is taken as exact."""


class Commands(NamedTuple):
    """Commands from one source: times in ns, ascending, and volts, both of shape (n,)."""

    times: NDArray[np.int64]
    volts: NDArray[np.float64]


def logs_among(types: Mapping[str, str]) -> tuple[str, ...]:
    """Topics that log commands, of whichever valve."""
    return tuple(sorted(topic for topic, kind in types.items() if kind == LOG_TYPE and topic.endswith(f"/{LOG}")))


def commands_by_logs(recorded: Commands, logs: Iterable[Commands]) -> Commands | None:
    """The commands as they were sent, by the log of their sender.

    A log is aligned with the commands so that all voltages agree. If several alignments do, as with equal pulses, or
    several logs, the one that covers most commands is taken, then the one with the shortest delay from stamp to
    recording. Commands before and after the log stay as they were recorded; those that only the log has, because the
    recorder started late or ended early, are taken from it.

    Args:
        recorded: the commands, by the times of their recording.
        logs: the same by their stamps, of the same clock; of other valves, too.

    Returns:
        the commands, shape (n,) or longer; None if no log matches these commands.
    """
    fits = [fit for log in logs for fit in _fits(recorded, log)]
    return min(fits, key=lambda fit: fit[:2])[2] if fits else None


def _fits(recorded: Commands, log: Commands) -> Iterator[tuple[int, int, Commands]]:
    """Each alignment of a log: how many commands it lacks, the usual delay to the recording, ns, and the result."""
    count = len(recorded.times)
    beside = np.searchsorted(log.times, recorded.times, side="right") - 1 - np.arange(count)
    for shift in range(int(beside.min()) - SLACK, int(beside.max()) + SLACK + 1):
        begin, end = max(0, -shift), min(count, len(log.times) - shift)
        mine, its = slice(begin, end), slice(begin + shift, end + shift)
        if begin >= end or not np.array_equal(recorded.volts[mine], log.volts[its]):
            continue
        way = int(np.median(np.abs(recorded.times[mine] - log.times[its])))
        times = np.concatenate([recorded.times[:begin], log.times, recorded.times[end:]])
        volts = np.concatenate([recorded.volts[:begin], log.volts, recorded.volts[end:]])
        if way < LONGEST_WAY and (np.diff(times) >= 0).all():
            yield count - (end - begin), way, Commands(times, volts)


class Dates(NamedTuple):
    """Commands that change the voltage, (k,) s and V, standard deviations of their times, s, and what was found."""

    times: Array
    volts: Array
    errors: Array
    finding: str


def dates_by_voltage(times: Array, volts: Array, measured: Signal, *, has_stamps: bool = True) -> Dates | None:
    """Date commands by the steps of a measured voltage; None where it dates them as they were recorded.

    A command's step is the one crossing, in its direction, of the middle between its voltage and the one before, after
    the step of the command before it and until the next command was recorded. Where there are several, as with pulses
    of a modulated voltage, or none, it stays where it was recorded. Where one command was recorded late, all are dated
    so: those that seem to fit are late, too, and would scatter beside the others. A command whose step a gap in the
    samples hides, as where a recorder missed messages, is dated in the middle of the gap.

    Args:
        times: of the commands as recorded, s, ascending, shape (n,). volts: V, shape (n,).
        measured: the voltage at the coil's terminals.
        has_stamps: whether commands may have been recorded in time, up to `STAMP_ERROR`; else all are dated.
    """
    changes = np.flatnonzero(np.diff(volts, prepend=0.0) != 0.0)
    found, errors, lateness = times[changes].copy(), np.full(len(changes), STAMP_ERROR), []
    gaps, recorded = np.zeros(len(changes)), times[changes]
    longest = GAP * float(np.median(np.diff(measured.times))) if len(measured.times) > 1 else np.inf
    for place, step in _steps(times[changes], volts[changes], measured):
        errors[place] = (step.last - step.first) * UNIFORM
        if step.last - step.first > longest:
            gaps[place] = errors[place]
        if not step.first - STAMP_ERROR <= found[place] <= step.last + STAMP_ERROR:
            lateness.append(float(found[place] - step.date))
        found[place] = step.date
    if has_stamps and not lateness:
        if not gaps.any():
            return None
        words = f"{np.count_nonzero(gaps)} of {len(changes)} commands came while samples are missing, and are known "
        words += f"to ± {1e3 * gaps.max():.3g} ms"
        return Dates(np.maximum.accumulate(np.where(gaps > 0.0, found, recorded)), volts[changes], gaps, words)
    worst = max(lateness, key=abs, default=0.0)
    words = f"{len(lateness)} of {len(changes)} commands were recorded up to {1e3 * abs(worst):.3g} ms "
    words += f"{'after' if worst > 0.0 else 'before'} the voltage changed: they are dated by it"
    errors[errors < EXACT] = 0.0
    return Dates(np.maximum.accumulate(found), volts[changes], errors, words)


def within_steps(times: Array, volts: Array, measured: Signal) -> Array | None:
    """When commands took effect, (n,) s: as recorded, but no sooner nor later than between which samples it stepped.

    Where its step is stamped, as valve_node's ~/coil has it, that is when it was; where it lies between two samples,
    what is recorded between them says more than they do. No command gets further from the truth.

    Args:
        times: as recorded, s, ascending, shape (n,). volts: V, each another than the one before, shape (n,).
        measured: the voltage at the coil's terminals.

    Returns:
        None unless the voltage shows every one of them, none in a gap of its samples.
    """
    found, seen = times.copy(), 0
    longest = MISSING * float(np.median(np.diff(measured.times)))
    for place, step in _steps(times, volts, measured):
        if step.last - step.first > longest:
            return None
        found[place] = np.clip(times[place], step.first, step.last)
        seen += 1
    return np.maximum.accumulate(found) if seen == len(times) else None


class _Step(NamedTuple):
    """Time of the sample before a crossing, of the crossing by a straight line, and of the sample after, s."""

    first: float
    date: float
    last: float


def _steps(times: Array, volts: Array, measured: Signal) -> Iterator[tuple[int, _Step]]:
    """The steps of those commands that the voltage shows, with the command's index; each differs from the last."""
    least, before = SEEN * sample_noise(measured.values), -np.inf
    for place, (time, new) in enumerate(zip(times.tolist(), volts.tolist(), strict=True)):
        old = float(volts[place - 1]) if place else 0.0
        until = float(times[place + 1]) if place + 1 < len(times) else np.inf
        step = _crossing(measured, (before, until), (old, new)) if abs(new - old) > least else None
        before = time
        if step is not None:
            before = step.date
            yield place, step


def _crossing(measured: Signal, window: tuple[float, float], levels: tuple[float, float]) -> _Step | None:
    """When a voltage crosses the middle from one level to another, if it does once in a window.

    Beyond its levels, as behind a clamp at release, it says no more than at them.
    """
    times, values = measured
    start, stop = np.searchsorted(times, window, side="right").tolist()
    inside = slice(max(0, start - 1), stop)
    old, new = levels
    middle = 0.5 * (old + new)
    is_over = values[inside] >= middle if new > old else values[inside] <= middle
    crossings = np.flatnonzero(is_over[1:] & ~is_over[:-1]) + 1
    if len(crossings) != 1:
        return None
    after = inside.start + int(crossings[0])
    first, last = times[after - 1], times[after]
    low, high = np.clip(values[after - 1 : after + 1], min(levels), max(levels))
    share = (middle - low) / (high - low)
    return _Step(float(first), float(first + share * (last - first)), float(last))
