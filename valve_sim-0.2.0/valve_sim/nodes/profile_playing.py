"""A profile of commands, without ROS: its node's parameters, and each command sent at its time, or why it is not."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple

from valve_sim.model import Drive, Parameter, ParameterError, ValveError
from valve_sim.nodes.parameters import Words, check_given, settings_of, table_of
from valve_sim.nodes.realtime import NANOSECONDS, PaceClock, why_restart
from valve_sim.traces.synthetic import read_profile


class ProfileSettings(NamedTuple):
    """Of command_profile; the table says what each means."""

    profile: str = ""
    valve: str = "valve"
    max_voltage: float = 30.0
    patience: float = 10.0
    output: str = "commanded.csv"


PROFILE: Final = table_of(
    ProfileSettings,
    Words(
        "profile",
        "what to command: rows of time in s and volts, as for `valve-sim simulate --profile`, the last one 0 V",
    ),
    Words("valve", "the node that is commanded, on its topic ~/coil_voltage"),
    Parameter(
        "max_voltage", "V", "a profile with a larger voltage, of either sign, is refused before anything is commanded",
        0.0, math.inf,
    ),
    Parameter("patience", "s", "to wait for a node that hears the commands", 0.0, math.inf),
    Words("output", "CSV file of what was commanded when: ROS time in ns, s since the start, V"),
)  # fmt: skip


def profile_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> ProfileSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    settings = settings_of(ProfileSettings, check_given(given, PROFILE, sources, "command_profile"))
    if not settings.profile:
        raise ParameterError("profile: not given; expected a file such as record_next.yaml (-p profile:=FILE)")
    return settings


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
