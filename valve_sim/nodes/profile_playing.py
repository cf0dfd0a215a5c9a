"""A profile of commands, without ROS: its node's parameters, and each command sent at its time, or why it is not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from valve_sim.model import Drive, ParameterError, ValveError
from valve_sim.nodes.parameters import NodeSettings, option
from valve_sim.nodes.realtime import NANOSECONDS, ClockJumpedError, PaceClock, when_due
from valve_sim.recordings.synthetic import read_profile


@dataclass(frozen=True)
class ProfileSettings(NodeSettings):
    """Of command_profile."""

    program = "command_profile"

    profile: str = option(
        "",
        "profile to command: rows of time in s and volts, as for `valve-sim simulate --profile`, the last one 0 V",
    )
    valve: str = option("valve", "valve to command: the topic coil_voltage below this name")
    listener: str = option(
        "", "node that must subscribe to the commands, such as the driver of the coil; empty: the node `valve`"
    )
    max_voltage: float = option(
        30.0,
        "a profile with a larger voltage, of either sign, is refused before anything is commanded", "V", 0.0,
    )  # fmt: skip
    patience: float = option(10.0, "time to wait for a node that subscribes to the commands", "s", 0.0)
    output: str = option("commanded.csv", "CSV file of what was commanded when: ROS time in ns, s since the start, V")

    def completed(self) -> ProfileSettings:
        """These settings, if there is a profile."""
        if not self.profile:
            raise ParameterError("profile: not given; expected a file such as record_next.yaml (-p profile:=FILE)")
        return self


def checked_profile(settings: ProfileSettings) -> Drive:
    """The commands, checked: all within max_voltage, and the last one 0 V.

    Raises:
        ValveError: the file cannot be used; one line.
    """
    path = Path(settings.profile).expanduser()
    drive = read_profile(path)
    for time, volts in zip(drive.times.tolist(), drive.volts.tolist(), strict=True):
        if not abs(volts) <= settings.max_voltage:
            raise ParameterError(
                f"{path}: found {volts:g} V at {time:g} s, expected at most {settings.max_voltage:g} V of either sign; "
                "lower it, or raise max_voltage if coil and driver bear it"
            )
    if drive.volts[-1] != 0.0:
        raise ParameterError(
            f"{path}: found {drive.volts[-1]:g} V as the last command; expected 0 V, so that the coil is not left on: "
            "add a last row, the time at which the voltage ends and 0"
        )
    return drive


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
    """Send each command of a profile at its time, which counts from now.

    `command` sends a voltage and returns the ROS time of that, ns. `why_stop` gives a reason to break off, or nothing.

    Raises:
        ProfileBrokenOffError: there was a reason to stop, or the clock jumped.
    """
    offsets = [round(time * NANOSECONDS) for time in drive.times.tolist()]
    left = drive.volts.tolist()
    try:
        for _, late in when_due(clock, offsets, lambda: bool(why_stop())):
            volts = left.pop(0)
            note(Commanded(command(volts), volts, late / NANOSECONDS))
    except ClockJumpedError as jump:
        raise ProfileBrokenOffError(str(jump)) from jump
    if left:
        raise ProfileBrokenOffError(why_stop())


def as_csv(commanded: Sequence[Commanded]) -> str:
    """The commands as a table, which is a profile too: ROS time, s since the first command, V."""
    rows = [
        f"{entry.stamp},{(entry.stamp - commanded[0].stamp) / NANOSECONDS:.9f},{entry.volts:g}" for entry in commanded
    ]
    return "\n".join(["stamp_ns,time,volts", *rows]) + "\n"
