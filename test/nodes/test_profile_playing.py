"""A profile played by a clock of the test's own, and what a profile may be."""

from __future__ import annotations

from pathlib import Path

import pytest

from valve_sim.model import Drive, ValveError
from valve_sim.nodes.profile_playing import (
    Commanded,
    ProfileBrokenOffError,
    ProfileSettings,
    as_csv,
    checked_profile,
    play,
)
from valve_sim.nodes.realtime import NANOSECONDS, ClockReading
from valve_sim.recordings.synthetic import read_profile

PULSE = Drive.of([0.1, 0.104], [11.0, 0.0])
START = 50 * NANOSECONDS


class HandClock:
    """Shows what it is told to; sleeping brings it to the deadline, and a little beyond."""

    def __init__(self, late: int = 70_000) -> None:
        self.now, self.late = START, late
        self.jump: int | None = None

    def read(self) -> ClockReading | None:
        return ClockReading(self.now, False)

    def sleep_until(self, deadline: int) -> None:
        self.now = deadline + self.late if self.jump is None else self.now + self.jump

    def wake(self) -> None:
        pass


def played(clock: HandClock, why_stop: str = "", drive: Drive = PULSE) -> list[Commanded]:
    noted: list[Commanded] = []

    def command(volts: float) -> int:
        return clock.now

    play(drive, clock, command, lambda: why_stop, noted.append)
    return noted


def test_each_command_is_sent_at_its_time_and_lateness_does_not_accumulate() -> None:
    noted = played(HandClock())
    assert [entry.volts for entry in noted] == [11.0, 0.0]
    assert [entry.stamp - START for entry in noted] == [100_070_000, 104_070_000]
    assert [entry.lateness for entry in noted] == pytest.approx([70e-6, 70e-6])


def test_a_reason_to_stop_and_a_clock_that_jumps_break_off() -> None:
    with pytest.raises(ProfileBrokenOffError, match="a signal came"):
        played(HandClock(), "a signal came")
    clock = HandClock()
    clock.jump = -NANOSECONDS
    with pytest.raises(ProfileBrokenOffError, match="jumped back by 1 s"):
        played(clock)


def test_the_log_is_a_table_to_the_nanosecond_and_a_profile_again(tmp_path: Path) -> None:
    stamp = 1_700_000_000_123_456_789
    (tmp_path / "log.csv").write_text(as_csv([Commanded(stamp, 9.0, 0.0), Commanded(stamp + 30_000_001, 0.0, 0.0)]))
    rows = (tmp_path / "log.csv").read_text().splitlines()
    assert rows == ["stamp_ns,time,volts", f"{stamp},0.000000000,9", f"{stamp + 30_000_001},0.030000001,0"]
    assert read_profile(tmp_path / "log.csv").times.tolist() == [0.0, 0.030000001]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("[[0.1, 9], [0.2, -31], [0.3, 0]]", "found -31 V at 0.2 s, expected at most 30 V"),
        ("[[0.1, 9], [0.2, 12]]", "found 12 V as the last command; expected 0 V"),
        ("{}", "expected rows of time"),
    ],
)
def test_a_profile_that_may_not_be_commanded_is_refused_in_one_line(tmp_path: Path, rows: str, words: str) -> None:
    path = tmp_path / "profile.yaml"
    path.write_text(rows)
    with pytest.raises(ValveError, match=words) as refused:
        checked_profile(ProfileSettings(str(path)))
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)
