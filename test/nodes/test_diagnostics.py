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
        (GOOD._replace(overruns_now=300), "", Level.WARN, "300 of 999 samples came more than a period late"),
        (GOOD._replace(lateness=0.0204), "", Level.WARN, "1 in 100 by more than 20.4 ms"),
    ],
)
def test_timing(timing: Timing, waiting_for: str, level: Level, message: str) -> None:
    status = timing_status(timing, 1000.0, waiting_for)
    assert status.level == level
    assert message in status.message
    assert (status.values["rate wanted (Hz)"], status.values["lost steps"]) == ("1000", str(timing.lost))


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
        ((-0.5, -0.3, -0.55), False, "/s is stamped 0.3 s behind"),
        (
            (-0.3, -0.3, -0.9),
            False,
            "/s comes 0.3 s to 0.9 s after its stamps, held back by its driver or a busy machin",
        ),
        ((-999 * DAY, -999 * DAY - 1), False, "set its clock"),
        ((-70, -150), False, "set its clock"),
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


@pytest.mark.parametrize(
    ("waits", "says"),
    [
        ((1.4, 1.3, 1.2), "/s comes 1.2 s to 1.4 s after its stamps"),
        ((1.4, 1.399), "/s is stamped 1.4 s behind"),
        ((3.0, 3.2), "/s is stamped 3.0 s behind"),
        ((-1.4, -1.3, -1.2), "/s is stamped 1.2 s ahead"),
    ],
)
def test_what_comes_late_though_clocks_have_agreed_has_waited_and_a_clock_that_was_set_is_told_still(
    waits: tuple[float, ...], says: str
) -> None:
    check, now = StampCheck(), 1_800_000_000 * NANOSECONDS
    for late in (0.002, 0.3):
        check.note("/s", now - round(late * NANOSECONDS), now)
    assert not check.look(is_simulated=False)
    for late in waits:
        check.note("/s", now - round(late * NANOSECONDS), now)
    assert says in check.look(is_simulated=False)


def commanded(**state: Any) -> Status:
    return status_of(RejectionCount(), 9, state.pop("last", None), state.pop("unheard", 0), **state)


UNHEARD = "publishers that offer an incompatible QoS and cannot be heard: 1; publish reliable"


@pytest.mark.parametrize(
    ("status", "level", "message"),
    [
        (commanded(last=1, timed_out=True), Level.WARN, "none for longer than command_timeout: coil de-energised"),
        (commanded(withdrawn=9.0), Level.WARN, "max_voltage was set below the last, of 9 V: coil de-energised"),
        (commanded(unheard=1), Level.WARN, UNHEARD),
        (pressure_status("inlet pressure", 70e6, RejectionCount(), 1), Level.WARN, UNHEARD),
        (pressure_status("inlet pressure", 70e6, RejectionCount(), 0), Level.OK, "accepted"),
        (valve_status(live_valve(phase=Phase.GAP_HOLD), ""), Level.OK, "gap_hold"),
        (valve_status(live_valve(failures=1), "too stiff"), Level.ERROR, "was put back to rest: too stiff"),
    ],
)
def test_a_status_says_what_is_wrong(status: Status, level: Level, message: str) -> None:
    assert (status.level, status.message) == (level, message)
