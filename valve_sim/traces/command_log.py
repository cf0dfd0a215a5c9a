"""The times of commands by the log of who sent them: `command_profile` stamps each, as std_msgs/Float64 cannot be."""

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
"""ns between the stamp of a command and its recording; what is further apart is another command, or another clock."""
SLACK: Final = 3
"""Commands by which a recording may lag behind the log."""


class Commands(NamedTuple):
    """Commands as somebody knows them: times in ns, ascending, and volts, both of shape (n,)."""

    times: NDArray[np.int64]
    volts: NDArray[np.float64]


def logs_among(types: Mapping[str, str]) -> tuple[str, ...]:
    """Topics that log commands, of whichever valve."""
    return tuple(sorted(topic for topic, kind in types.items() if kind == LOG_TYPE and topic.endswith(f"/{LOG}")))


def commands_by_logs(recorded: Commands, logs: Iterable[Commands]) -> Commands | None:
    """The commands as they were sent, by the log of who sent them.

    A log is laid beside the commands so that every voltage agrees. Where several places do, as with equal pulses, or
    several logs, the one holds that covers most commands, then that of the shortest way from stamp to recording.
    Commands before and after the log stay as they were recorded; those that only the log has, since the recorder came
    late or left early, are taken from it.

    Args:
        recorded: the commands, by the times of their recording.
        logs: the same by their stamps, of the same clock; of other valves, too.

    Returns:
        the commands, shape (n,) or longer; None where no log is of these commands.
    """
    fits = [fit for log in logs for fit in _fits(recorded, log)]
    return min(fits, key=lambda fit: fit[:2])[2] if fits else None


def _fits(recorded: Commands, log: Commands) -> Iterator[tuple[int, int, Commands]]:
    """Where a log fits: how many commands it lacks, the usual way from stamp to recording, ns, and the result."""
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
