"""A profile of commands sent by a clock, without ROS: each at its time, or an error that says why not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from valve_sim.model import Drive, ValveError
from valve_sim.nodes.realtime import NANOSECONDS, PaceClock, why_restart


class ProfileBrokenOffError(ValveError):
    """The profile was broken off; the message says why."""


class Commanded(NamedTuple):
    """One command that was sent: at which ROS time, ns, which voltage, and how late, s."""

    stamp: int
    volts: float
    lateness: float


def play(
    drive: Drive,
    clock: PaceClock,
    command: Callable[[float], int],
    why_stop: Callable[[], str],
    note: Callable[[Commanded], None],
) -> None:
    """Send each command of a profile at its time.

    Args:
        drive: the commands; their times count from now.
        clock: is followed.
        command: sends a voltage, and returns the ROS time of that in ns.
        why_stop: asked again and again; the reason to break off, or empty.
        note: told what was commanded.

    Raises:
        ProfileBrokenOffError: there was a reason to stop, or the clock jumped.
    """
    last, start = None, None
    for time, volts in zip(drive.times.tolist(), drive.volts.tolist(), strict=True):
        while True:
            if reason := why_stop():
                raise ProfileBrokenOffError(reason)
            reading = clock.read()
            if reading is None:
                clock.sleep_until(0)
                continue
            if reason := why_restart(last, reading) or "":
                raise ProfileBrokenOffError(reason)
            last = reading
            start = reading.nanoseconds if start is None else start
            due = start + round(time * NANOSECONDS)
            if reading.nanoseconds >= due:
                break
            clock.sleep_until(due)
        note(Commanded(command(volts), volts, (reading.nanoseconds - due) / NANOSECONDS))


def as_csv(commanded: Sequence[Commanded]) -> str:
    """The commands as a table, which is a profile too: ROS time, s since the first command, V."""
    rows = [
        f"{entry.stamp},{(entry.stamp - commanded[0].stamp) / NANOSECONDS:.9f},{entry.volts:g}" for entry in commanded
    ]
    return "\n".join(["stamp_ns,time,volts", *rows]) + "\n"
