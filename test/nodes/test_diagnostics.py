"""What the node says about itself, without ROS."""

from __future__ import annotations

import math
from typing import Any

import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Phase
from valve_sim.nodes.diagnostics import (
    Level,
    RejectionCount,
    Status,
    command_status,
    pressure_status,
    timing_status,
    valve_status,
)
from valve_sim.nodes.live_valve import LiveValve
from valve_sim.nodes.monitor_work import InputCount, StampCheck
from valve_sim.nodes.realtime import NANOSECONDS, Timing

GOOD = Timing(999.0, 1e-4, 2, 0, 0, 999, 2)


@pytest.mark.parametrize(
    ("timing", "waiting_for", "level", "message"),
    [
        (GOOD, "", Level.OK, "keeps pace"),
        (GOOD._replace(rate=math.nan), "", Level.OK, "keeps pace"),
        (GOOD._replace(rate=900.0), "", Level.WARN, "slower than publish_rate"),
        (GOOD._replace(lost=9, lost_now=3), "", Level.WARN, "3 samples were not published, for lack of time"),
        (GOOD._replace(lost=9), "", Level.OK, "keeps pace"),
        (GOOD, "/clock", Level.WARN, "waiting for /clock"),
        (GOOD._replace(overruns_now=99), "", Level.OK, "keeps pace"),
    ],
)
def test_timing(timing: Timing, waiting_for: str, level: Level, message: str) -> None:
    status = timing_status(timing, 1000.0, waiting_for)
    assert (status.task, status.level, status.message) == ("timing", level, message)
    assert status.values["rate wanted (Hz)"] == "1000"
    assert status.values["lateness p99 (ms)"] == "0.100"
    assert status.values["lost steps"] == str(timing.lost)


@pytest.mark.parametrize("late", [GOOD._replace(overruns=9280, overruns_now=300), GOOD._replace(lateness=0.0204)])
def test_late_samples_are_a_warning_that_says_how_late(late: Timing) -> None:
    status = timing_status(late, 1000.0, "")
    assert status.level is Level.WARN
    assert f"{late.overruns_now} of 999 samples came more than a period late" in status.message
    assert f"{late.lateness * 1e3:.1f} ms" in status.message


def live_valve(**state: Any) -> LiveValve:
    """A valve that has come to this state."""
    live = LiveValve(default_valve())
    for name, value in state.items():
        setattr(live, name, value)
    return live


def status_of(count: RejectionCount, now: int, last: int | None, unheard: int = 0, **state: Any) -> Status:
    """What /diagnostics has at a time, ns, when the last command came at another."""
    return command_status(live_valve(last_command=last, **state), now, count, unheard)


def test_rejected_commands_are_a_warning_until_a_good_one_comes_and_counted_for_ever() -> None:
    count = RejectionCount()
    assert status_of(count, 0, None).message == "none yet"
    count.reject(math.nan)
    count.reject(99.0)
    status = status_of(count, 3_000_000_000, 1_000_000_000)
    assert status.level is Level.WARN
    assert status.message == "2 rejected, the last of 99 V; the last good one stays"
    assert status.values["rejected"] == "2"
    assert status.values["age (s)"] == "2.000"
    status = status_of(count, 4_000_000_000, 1_000_000_000)
    assert (status.level, status.message) == (
        Level.WARN,
        "the last, of 99 V, was rejected; the last good one stays",
    )
    count.accept()
    status = status_of(count, 5_000_000_000, 5_000_000_000)
    assert (status.level, status.message, status.values["rejected"]) == (Level.OK, "accepted", "2")


def test_a_command_that_timed_out_is_a_warning() -> None:
    status = status_of(RejectionCount(), 9, 1, timed_out=True)
    assert (status.level, status.values["timed out"]) == (Level.WARN, "true")


def test_a_command_that_max_voltage_has_ended_is_a_warning() -> None:
    status = status_of(RejectionCount(), 9, None, withdrawn=9.0)
    assert status.level is Level.WARN
    assert status.message == "max_voltage was set below the last, of 9 V: coil de-energised"


def test_a_publisher_that_cannot_be_heard_is_a_warning() -> None:
    words = "publishers that offer an incompatible QoS and cannot be heard: 1; publish reliable"
    for last_command in (None, 1):
        status = status_of(RejectionCount(), 9, last_command, unheard=1)
        assert (status.level, status.message) == (Level.WARN, words)
    status = pressure_status("inlet pressure", 70e6, RejectionCount(), 1)
    assert (status.level, status.message) == (Level.WARN, words)


def test_the_valve_says_where_it_is_and_why_it_was_put_back() -> None:
    status = valve_status(live_valve(phase=Phase.GAP_HOLD, strokes=3), "")
    assert (status.level, status.message) == (Level.OK, "gap_hold")
    assert (status.values["phase"], status.values["strokes"]) == ("gap_hold", "3")
    assert valve_status(live_valve(failures=1), "too stiff").level is Level.ERROR


def test_a_rejected_tank_pressure_is_a_warning_until_a_good_one_comes() -> None:
    count = RejectionCount()
    status = pressure_status("inlet pressure", 70e6, count, 0)
    assert (status.task, status.level, status.values["pressure (Pa)"]) == ("inlet pressure", Level.OK, "7e+07")
    count.reject(math.nan)
    count.reject(-1.0)
    status = pressure_status("inlet pressure", 70e6, count, 1)
    assert (status.level, status.message) == (Level.WARN, "2 rejected, the last of -1 Pa; the last good one stays")
    assert (status.values["rejected"], status.values["publishers of incompatible QoS"]) == ("2", "1")
    status = pressure_status("inlet pressure", 70e6, count, 1)
    assert status.message == "the last, of -1 Pa, was rejected; the last good one stays"
    count.accept()
    assert pressure_status("inlet pressure", 60e6, count, 0).level is Level.OK


def test_a_monitor_that_waits_says_why_it_could_not_use_what_came() -> None:
    count = InputCount()
    assert count.status(1.0, 0, "samples on /lab").message == "waiting for samples on /lab"
    for _ in range(2):
        count.reject("/lab: joints ['elbow'], expected pilot_plunger among them")
    for now in (2.0, 3.0):  # for as long as nothing else comes
        status = count.status(now, 0, "samples on /lab")
        assert status.level is Level.WARN
        assert status.message == (
            "waiting for samples on /lab; 2 rejected, the last: "
            "/lab: joints ['elbow'], expected pilot_plunger among them"
        )
    count.samples += 1
    assert count.status(4.0, 0, "").level is Level.OK


DAY = 86_400


@pytest.mark.parametrize(
    ("seconds", "is_simulated", "says"),
    [
        (
            (-999 * DAY, -999 * DAY - 3),
            False,
            "/s is stamped 999 days behind this node's clock, which times commands; of a",
        ),
        ((5 * 3600,), False, "/s is stamped 5.0 h ahead of this node's clock"),
        ((-0.5, -0.3, -0.9), False, "/s is stamped 0.3 s behind"),
        ((999 * DAY,), True, "all must be stamped by /clock, or use_sim_time be false"),
        ((-0.5, -0.01, -0.9), False, ""),
        ((), False, ""),
    ],
)
def test_samples_whose_stamps_are_of_another_clock_are_a_warning_with_its_mend(
    seconds: tuple[float, ...], is_simulated: bool, says: str
) -> None:
    check, now = StampCheck(), 1_800_000_000 * NANOSECONDS
    check.note("/s", 5, 0)  # before the first /clock
    for apart in seconds:
        check.note("/s", now + round(apart * NANOSECONDS), now)
    words = check.look(is_simulated=is_simulated)
    assert says in words
    status = InputCount().status(1.0, 0, "a command", 0, words)
    assert (status.level, status.message) == (Level.WARN, words or "waiting for a command")
    assert check.look(is_simulated=is_simulated) == "", "since the last look none came"
