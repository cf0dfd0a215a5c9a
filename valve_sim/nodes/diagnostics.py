"""What nodes say on /diagnostics, without ROS; here: timing, command and valve of valve_node."""

from __future__ import annotations

import enum
import math
from typing import Any, Final, NamedTuple

from valve_sim.nodes.live_machine import LiveMachine
from valve_sim.nodes.realtime import NANOSECONDS, Timing

SLOWEST_ACCEPTED: Final = 0.95
"""Achieved rate over publish_rate below which timing is a warning."""
MOST_OVERRUNS: Final = 0.1
"""Share of a second's steps that may begin more than a period late before timing is a warning."""
LONGEST_LATENESS: Final = 0.01
"""s by which 99 of 100 steps may be late before timing is a warning, however slow the rate."""


class Level(enum.IntEnum):
    """The level of a status, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Status(NamedTuple):
    """One diagnostic_msgs/DiagnosticStatus; `task` follows the node's name and a colon."""

    task: str
    level: Level
    message: str
    values: dict[str, str]


def timing_status(timing: Timing, rate_wanted: float, waiting_for: str) -> Status:
    """Whether the node keeps pace with its clock; `waiting_for`: what it cannot step without, or empty."""
    values = {
        "rate wanted (Hz)": f"{rate_wanted:g}",
        "rate reached (Hz)": number_words(timing.rate, ".1f"),
        "lateness p99 (ms)": number_words(timing.lateness * 1e3, ".3f"),
        "overruns": str(timing.overruns),
        "overruns in the last second": str(timing.overruns_now),
        "lost steps": str(timing.lost),
    }
    if waiting_for:
        return Status("timing", Level.WARN, f"waiting for {waiting_for}", values)
    if timing.lost_now:
        return Status("timing", Level.WARN, f"{timing.lost_now} samples were not published, for lack of time", values)
    if timing.rate < SLOWEST_ACCEPTED * rate_wanted:
        return Status("timing", Level.WARN, "slower than publish_rate", values)
    if timing.overruns_now > MOST_OVERRUNS * timing.steps_now or timing.lateness > LONGEST_LATENESS:
        message = (
            f"{timing.overruns_now} of {timing.steps_now} samples came more than a period late, 1 in 100 by more than "
            f"{timing.lateness * 1e3:.1f} ms: this machine is too busy for publish_rate"
        )
        return Status("timing", Level.WARN, message, values)
    return Status("timing", Level.OK, "keeps pace", values)


class RejectionCount:
    """Counts commands, or pressures, that are ignored; one thread counts, another looks."""

    def __init__(self) -> None:
        self.rejected = 0
        self._last = math.nan
        self._is_last_rejected = False
        self._before = 0

    def accept(self) -> None:
        """Count one that is obeyed."""
        self._is_last_rejected = False

    def reject(self, value: float) -> None:
        """Count one that is ignored."""
        self.rejected += 1
        self._last = value
        self._is_last_rejected = True

    def words(self, unit: str) -> str:
        """How many were rejected since the last call, or that the last one was; empty for neither."""
        rejected = self.rejected
        now, self._before = rejected - self._before, rejected
        if now:
            return f"{now} rejected, the last of {self._last:g} {unit}; the last good one stays"
        if self._is_last_rejected:
            return f"the last, of {self._last:g} {unit}, was rejected; the last good one stays"
        return ""


def command_status(live: LiveMachine[Any], now: int, count: RejectionCount, incompatible_publishers: int) -> Status:
    """Whether commands arrive and are accepted; `now`, ns, of the clock of the valve."""
    age = math.nan if live.last_command is None else (now - live.last_command) / NANOSECONDS
    values = {
        "age (s)": number_words(age, ".3f"),
        "voltage (V)": f"{live.volts:g}",
        "rejected": str(count.rejected),
        "timed out": str(live.timed_out).lower(),
        "publishers of incompatible QoS": str(incompatible_publishers),
    }
    trouble = (
        count.words("V")
        or ("none for longer than command_timeout: coil de-energised" if live.timed_out else "")
        or (f"max_voltage was set below the last, of {live.withdrawn:g} V: coil de-energised" if live.withdrawn else "")
        or unheard_words(incompatible_publishers)
    )
    return _status("command", trouble, "none yet" if math.isnan(age) else "accepted", values)


def pressure_status(task: str, pressure: float, count: RejectionCount, incompatible_publishers: int) -> Status:
    """Whether what is heard of the tank's or the demand's pressure is accepted; `pressure`, Pa, is the one in force."""
    values = {
        "pressure (Pa)": f"{pressure:g}",
        "rejected": str(count.rejected),
        "publishers of incompatible QoS": str(incompatible_publishers),
    }
    return _status(task, count.words("Pa") or unheard_words(incompatible_publishers), "accepted", values)


def _status(task: str, trouble: str, otherwise: str, values: dict[str, str]) -> Status:
    return Status(task, Level.WARN if trouble else Level.OK, trouble or otherwise, values)


def valve_status(live: LiveMachine[Any], failure: str) -> Status:
    """The phase of the valve, and why it was put back to rest last (`failure`, empty if it never was)."""
    values = {**live.facts(), "failures": str(live.failures)}
    if failure:
        return Status("valve", Level.ERROR, f"was put back to rest: {failure}", values)
    return Status("valve", Level.OK, values.get("phase", "runs"), values)


def unheard_words(publishers: int) -> str:
    """A warning of publishers that cannot be heard; empty for none."""
    if not publishers:
        return ""
    return f"publishers that offer an incompatible QoS and cannot be heard: {publishers}; publish reliable"


def number_words(value: float, form: str) -> str:
    """A number in a format, or "none" for NaN."""
    return "none" if math.isnan(value) else format(value, form)
