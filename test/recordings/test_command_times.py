"""Commands are timed by the log that their sender stamped, whenever the recorder got them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from valve_sim.recordings import Trace, read_trace
from valve_sim.recordings.command_times import Commands, commands_by_logs

from .bag_makers import EPOCH, JOINT_STATE, STORE, Message, float_message, good_messages, header, make_mcap

BATTERY = "sensor_msgs/msg/BatteryState"
LOG = "/command_profile/commanded"
MS = 1_000_000
SENT = EPOCH + np.array([10, 14, 21, 25, 40, 44, 61, 65, 80, 84], dtype=np.int64) * MS
VOLTS = np.array([9.0, 0.0, 9.0, 0.0, 12.0, 0.0, 9.0, 0.0, 7.5, 0.0])
LATE = np.random.default_rng(5).integers(0.1 * MS, 3 * MS, len(SENT))


def logged(stamp: int, volts: float, topic: str = LOG) -> Message:
    """A command in a log, which a recorder that finds it at the end of the run still gets."""
    nan = float("nan")
    empty = np.zeros(0, dtype=np.float32)
    message = STORE.types[BATTERY](
        header(stamp), volts, nan, nan, nan, nan, nan, nan, 0, 0, 0, False, empty, empty, "", ""
    )
    return Message(topic, BATTERY, EPOCH + 10**9, bytes(STORE.serialize_cdr(message, BATTERY)))


def read(folder: Path, log: Sequence[Message], *others: Message, apart: int = 0) -> Trace:
    """A recording whose commands came late, with a log; its bag times are `apart`, ns, from its stamps."""
    samples = [message for message in good_messages() if message.type == JOINT_STATE]
    commands = [
        float_message("/valve/coil_voltage", int(time), volts)
        for time, volts in zip(SENT + LATE, VOLTS.tolist(), strict=True)
    ]
    messages = [message._replace(time=message.time + apart) for message in [*samples, *commands, *log, *others]]
    return read_trace(make_mcap(folder / "bag.mcap", messages), "/valve")


def whole_log(shift: int = 0, topic: str = LOG) -> list[Message]:
    return [logged(int(stamp) + shift, volts, topic) for stamp, volts in zip(SENT, VOLTS.tolist(), strict=True)]


def times_of(trace: Trace) -> np.ndarray:
    return trace.epoch_ns - EPOCH + np.rint(1e9 * trace.drive.times).astype(np.int64)


def test_commands_are_timed_as_they_were_sent(tmp_path: Path) -> None:
    trace = read(tmp_path, whole_log())
    np.testing.assert_array_equal(times_of(trace), SENT - EPOCH)
    np.testing.assert_array_equal(trace.drive.volts, VOLTS)
    assert trace.findings == ()


@pytest.mark.parametrize("apart", [0, 10**17])
def test_the_log_may_be_by_the_clock_of_samples_or_of_the_recorder(tmp_path: Path, apart: int) -> None:
    trace = read(tmp_path, whole_log(shift=apart), apart=apart)
    np.testing.assert_array_equal(times_of(trace), SENT - EPOCH)


def test_the_log_of_another_profile_is_not_taken_and_said(tmp_path: Path) -> None:
    log = [logged(int(stamp), volts + 1.0) for stamp, volts in zip(SENT, VOLTS.tolist(), strict=True)]
    trace = read(tmp_path, log)
    np.testing.assert_array_equal(times_of(trace), SENT + LATE - EPOCH)
    assert trace.findings == (f"/valve/coil_voltage: timed as recorded, for {LOG} logs other commands",)


def test_of_two_logs_that_fit_the_one_of_the_shorter_way_is_taken(tmp_path: Path) -> None:
    other = whole_log(shift=-30 * MS, topic="/tank_2/command_profile/commanded")
    trace = read(tmp_path, [*other, *whole_log()], float_message("/tank_2/valve/coil_voltage", int(SENT[0]), 9.0))
    np.testing.assert_array_equal(times_of(trace), SENT - EPOCH)
    assert trace.findings == ()


def test_a_log_that_cannot_be_read_changes_nothing(tmp_path: Path) -> None:
    trace = read(tmp_path, [Message(LOG, BATTERY, EPOCH, b"\x00\x01\x00\x00\x05")])
    np.testing.assert_array_equal(times_of(trace), SENT + LATE - EPOCH)


@pytest.mark.parametrize(("first", "last"), [(0, 10), (2, 10), (0, 7), (3, 6)])
def test_commands_that_the_log_lacks_stay_as_recorded(first: int, last: int) -> None:
    part = slice(first, last)
    found = commands_by_logs(Commands(SENT + LATE, VOLTS), [Commands(SENT[part], VOLTS[part])])
    expected = SENT + LATE
    expected[part] = SENT[part]
    assert found is not None
    np.testing.assert_array_equal(found.times, expected)
    np.testing.assert_array_equal(found.volts, VOLTS)


@pytest.mark.parametrize(("first", "last"), [(0, 10), (2, 10), (0, 7), (3, 6)])
def test_commands_that_the_recorder_missed_are_in_the_log(first: int, last: int) -> None:
    part = slice(first, last)
    found = commands_by_logs(Commands(SENT[part] + LATE[part], VOLTS[part]), [Commands(SENT, VOLTS)])
    assert found is not None
    np.testing.assert_array_equal(found.times, SENT)
    np.testing.assert_array_equal(found.volts, VOLTS)


def test_equal_pulses_that_are_recorded_a_pulse_late_are_told_apart_by_the_first_and_the_last() -> None:
    sent = EPOCH + np.arange(40, dtype=np.int64) * MS
    volts = np.tile([9.0, 0.0], 20)
    found = commands_by_logs(Commands(sent + 2 * MS + MS // 2, volts), [Commands(sent, volts)])
    assert found is not None
    # A pulse later the way is shorter, and all but the last two commands have the same voltages.
    np.testing.assert_array_equal(found.times, sent)
