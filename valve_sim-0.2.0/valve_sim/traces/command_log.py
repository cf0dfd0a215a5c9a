"""The times of commands by the log of their sender: `command_profile` logs stamps, which std_msgs/Float64 lacks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from valve_sim.traces.clocks import SECOND

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from numpy.typing import NDArray

LOG: Final = "commanded"
LOG_TYPE: Final = "sensor_msgs/msg/BatteryState"
LONGEST_WAY: Final = SECOND
"""ns between the stamp of a command and its recording; beyond it, it is another command or another clock."""
SLACK: Final = 3
"""Commands by which a recording may lag behind the log."""


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
