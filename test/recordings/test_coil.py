"""Current and voltage at the coil's terminals: written and read, as the input, and as the date of late commands."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from valve_sim.files.recording_map import map_from
from valve_sim.model import Drive
from valve_sim.recordings import Signal, Trace, TraceError, describe, find_stroke_parts, read_trace, write_bag
from valve_sim.recordings.cdr import typestore
from valve_sim.recordings.command_times import dates_by_voltage
from valve_sim.recordings.measured_input import measured_input

from .bag_makers import COMMANDS, EPOCH, Message, clean_trace, float_message, good_messages, header, make_mcap

COIL = "sensor_msgs/msg/BatteryState"
TIMES = np.arange(2000) / 20_000.0
COMMANDED = Drive.of([0.010, 0.050], [9.0, 0.0])


def coil(topic: str, time: int, current: float, voltage: float, temperature: float = math.nan) -> Message:
    nothing = np.zeros(0, np.float32)
    message = typestore().types[COIL](
        header(time), voltage, temperature, current, *[math.nan] * 4, 0, 0, 0, True, nothing, nothing, "", ""
    )
    return Message(topic, COIL, time, bytes(typestore().serialize_cdr(message, COIL)))


def coil_messages(
    topic: str = "/valve/measured/coil", *, current: float = 0.5, temperature: float = math.nan
) -> list[Message]:
    """10 kHz over 0.1 s: 9 V and a current from 10 to 50 ms."""
    found = []
    for sample in range(1000):
        is_on = 100 <= sample < 500
        volts, amperes = (9.0, current) if is_on else (0.0, 0.0 * current)
        found.append(coil(topic, EPOCH + 100_000 * sample, amperes, volts, temperature))
    return found


def test_current_and_voltage_come_back_as_written(tmp_path: Path) -> None:
    signals = {"coil_current": Signal(TIMES, np.sin(TIMES)), "coil_voltage": Signal(TIMES, np.cos(TIMES))}
    write_bag(tmp_path / "a.mcap", replace(clean_trace(), **signals))
    found = read_trace(tmp_path / "a.mcap")
    for name, signal in signals.items():
        again = getattr(found, name)
        assert again.times == pytest.approx(TIMES, abs=1e-12)
        assert np.array_equal(again.values, signal.values.astype(np.float32))
    assert found.coil_temperature is None
    assert not [line for line in found.findings if "coil" in line]


def test_signals_of_two_rates_are_written_apart(tmp_path: Path) -> None:
    slow = TIMES[::10]
    trace = replace(clean_trace(), coil_current=Signal(TIMES, TIMES), coil_voltage=Signal(slow, np.cos(slow)))
    write_bag(tmp_path / "a.mcap", trace)
    found = read_trace(tmp_path / "a.mcap")
    assert found.coil_current is not None and found.coil_voltage is not None
    assert np.array_equal(found.coil_current.values, TIMES)
    assert len(found.coil_voltage.values) == len(slow)


def test_the_measured_coil_goes_before_its_own_topics(tmp_path: Path) -> None:
    others = [float_message("/valve/measured/coil_current", EPOCH + 10**7, 0.125)]
    path = make_mcap(
        tmp_path / "a.mcap", sorted([*good_messages(), *others, *coil_messages(temperature=40.0)], key=lambda m: m.time)
    )
    found = read_trace(path)
    assert found.coil_current is not None and found.coil_temperature is not None
    assert found.coil_current.values.max() == 0.5
    assert np.all(found.coil_temperature.values == 40.0)
    path = make_mcap(
        tmp_path / "b.mcap", sorted([*good_messages(), *others, *coil_messages(current=math.nan)], key=lambda m: m.time)
    )
    found = read_trace(path)
    assert found.coil_current is not None and found.coil_voltage is not None
    assert found.coil_current.values.tolist() == [0.125]


def test_current_alone_is_a_recording(tmp_path: Path) -> None:
    commands = [float_message("/valve/coil_voltage", EPOCH + round(time * 1e9), volts) for time, volts in COMMANDS]
    path = make_mcap(tmp_path / "a.mcap", sorted([*commands, *coil_messages()], key=lambda m: m.time))
    found = read_trace(path)
    assert not found.has_positions
    assert found.coil_current is not None and len(found.sample_times) == len(found.coil_current.times) == 1000
    assert [part.kind for part in find_stroke_parts(found)] == ["opening", "closing"]
    summary = describe(found)
    assert summary.position_range is None
    assert summary.signals["coil_current"].rate == pytest.approx(10_000)
    write_bag(tmp_path / "again.mcap", found)
    again = read_trace(tmp_path / "again.mcap")
    assert not again.has_positions
    assert np.array_equal(again.sample_times, found.sample_times)


def test_the_voltage_alone_gives_the_commands(tmp_path: Path) -> None:
    found = read_trace(make_mcap(tmp_path / "a.mcap", coil_messages()))
    assert found.drive.volts.tolist() == [0.0, 9.0, 0.0]
    assert found.drive.times == pytest.approx([0.0, 9.95e-3, 49.95e-3], abs=1e-9)


def test_a_simulated_position_beside_a_measured_coil_is_not_taken(tmp_path: Path) -> None:
    messages = sorted([*good_messages(measured="joint_states"), *coil_messages()], key=lambda m: m.time)
    found = read_trace(make_mcap(tmp_path / "a.mcap", messages))
    assert not found.has_positions
    assert [line for line in found.findings if "/valve/joint_states is a node's output" in line]
    live = sorted([*good_messages(measured="joint_states"), *coil_messages("/valve/coil")], key=lambda m: m.time)
    found = read_trace(make_mcap(tmp_path / "b.mcap", live))
    assert found.has_positions
    assert found.coil_voltage is not None


def test_a_coil_without_any_current_and_no_position_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="measured/coil: no finite current in 1000 samples"):
        read_trace(make_mcap(tmp_path / "a.mcap", coil_messages(current=math.nan)))


def test_a_command_recorded_late_is_dated_by_the_voltage(tmp_path: Path) -> None:
    late = [float_message("/valve/coil_voltage", EPOCH + round((time + 3e-3) * 1e9), volts) for time, volts in COMMANDS]
    positions = [message for message in good_messages() if "coil_voltage" not in message.topic]
    found = read_trace(
        make_mcap(tmp_path / "a.mcap", sorted([*late, *positions, *coil_messages()], key=lambda m: m.time))
    )
    assert found.drive.times == pytest.approx([9.95e-3, 49.95e-3], abs=1e-9)
    assert found.drive_errors is not None
    assert found.drive_errors.times == pytest.approx([1e-4 / math.sqrt(12.0)] * 2)
    assert [line for line in found.findings if "2 of 2 commands were recorded up to 3.05 ms after" in line]


@pytest.mark.parametrize("late", [0.0, 2e-3, 15e-3])
def test_two_samples_a_nanosecond_apart_date_a_command_exactly(late: float) -> None:
    edges = np.array([0.0101234, 0.0523456])
    times = np.sort(np.concatenate([np.arange(0.0, 0.08, 1e-3), edges, edges - 1e-9]))
    volts = np.where((times >= edges[0]) & (times < edges[1]), 9.0, 0.0)
    found = dates_by_voltage(edges + late, np.array([9.0, 0.0]), Signal(times, volts))
    if not late:
        assert found is None
        return
    assert found is not None
    assert found.times == pytest.approx(edges, abs=1e-9)
    assert found.errors.tolist() == [0.0, 0.0]


def test_a_step_to_the_clamp_is_dated_in_the_middle_of_its_samples() -> None:
    times = np.arange(400) / 5e3
    volts = np.where((times > 0.0101) & (times < 0.0501), 9.0, 0.0)
    volts[(times > 0.0501) & (times < 0.053)] = -24.0
    found = dates_by_voltage(np.array([0.012, 0.052]), np.array([9.0, 0.0]), Signal(times, volts))
    assert found is not None
    assert found.times == pytest.approx([0.0101, 0.0501], abs=1e-9)


@pytest.mark.parametrize("recorded", [0.05005, 0.05023])
def test_where_one_command_was_late_or_none_has_a_stamp_all_are_dated(recorded: float) -> None:
    times = np.arange(400) / 5e3
    measured = Signal(times, np.where((times > 0.0101) & (times < 0.0501), 9.0, 0.0))
    for first, has_stamps in ((0.012, True), (0.0101, False)):
        found = dates_by_voltage(np.array([first, recorded]), np.array([9.0, 0.0]), measured, has_stamps=has_stamps)
        assert found is not None
        assert found.times == pytest.approx([0.0101, 0.0501], abs=1e-9)
    assert dates_by_voltage(np.array([0.0101, recorded]), np.array([9.0, 0.0]), measured) is None


def test_a_command_in_a_gap_of_the_samples_is_known_as_well_as_the_gap_is_short() -> None:
    """The voltage is switched on at 10.1 ms, while a recorder misses messages, and off at 50.1 ms."""
    times = np.arange(4000) / 5e4
    kept = (times < 0.0099) | (times > 0.0123)
    volts = np.where((times > 0.0101) & (times < 0.0501), 9.0, 0.0)
    found = dates_by_voltage(np.array([0.0122, 0.0501]), np.array([9.0, 0.0]), Signal(times[kept], volts[kept]))
    assert found is not None
    assert found.times == pytest.approx([0.0111, 0.0501], abs=2e-5)
    assert found.errors == pytest.approx([2.4e-3 / np.sqrt(12.0), 0.0], rel=0.02)
    assert abs(found.times[0] - 0.0101) < np.sqrt(3.0) * found.errors[0]
    assert "1 of 2 commands came while samples are missing" in found.finding


def test_pulses_of_a_modulated_voltage_date_nothing() -> None:
    volts = np.where((TIMES > 0.010) & (TIMES < 0.050) & (np.floor(TIMES * 2000) % 2 == 0), 24.0, 0.0)
    assert dates_by_voltage(np.array([0.011, 0.052]), np.array([12.0, 0.0]), Signal(TIMES, volts)) is None


@pytest.mark.parametrize(("seed", "noise", "lateness"), [(1, 0.0, 20e-6), (2, 0.01, 0.0), (3, 0.01, 20e-6)])
def test_steps_keep_the_flux_of_a_measured_voltage(seed: int, noise: float, lateness: float) -> None:
    random = np.random.default_rng(seed)
    droop = 9.0 - 0.8 * (1.0 - np.exp(-np.maximum(TIMES - 0.010, 0.0) / 4e-3))
    true = np.where((TIMES >= 0.010) & (TIMES < 0.050), droop, 0.0)
    measured = true + noise * random.standard_normal(len(TIMES))
    drive = measured_input(COMMANDED, Signal(TIMES + lateness, measured)).drive(COMMANDED, lateness)
    assert np.all(np.diff(drive.times) >= 0.0)
    assert set(COMMANDED.times) <= set(drive.times)
    ends = np.append(drive.times, 0.060)
    flux = np.interp(TIMES[200:1000], ends, np.concatenate([[0.0], np.cumsum(drive.volts * np.diff(ends))]))
    since = TIMES[200:1000] - 0.010
    expected = 9.0 * since - 0.8 * (since - 4e-3 * (1.0 - np.exp(-since / 4e-3)))
    # V·s. White noise of 10 mV over 40 ms of 20 kHz adds up to 1.4e-5 V·s, 1 standard deviation.
    # The sample at the command is ambiguous, so that the next one holds back to it: 0.25 mV·ms here.
    assert np.max(np.abs(flux - expected)) < 5e-7 + 6e-3 * noise
    assert len(drive.times) < 200


@pytest.mark.parametrize("seed", range(2))
def test_the_samples_beside_a_gap_do_not_stand_for_all_of_it(seed: int) -> None:
    commanded = Drive.of([0.010, 0.050, 0.200, 0.240], [9.0, 0.0, 9.0, 0.0])
    times = np.arange(1500) / 5e3
    times = times[(times < 0.070) | (times > 0.190)]
    true = commanded.volts[np.searchsorted(commanded.times, times, side="right") - 1] * (times >= 0.010)
    measured = Signal(times, true + 5e-3 * np.random.default_rng(seed).standard_normal(len(times)))
    drive = measured_input(commanded, measured).drive(commanded)
    np.testing.assert_array_equal(drive.times, commanded.times)
    assert drive.volts[[1, 3]].tolist() == [0.0, 0.0]
    assert drive.volts[[0, 2]] == pytest.approx([9.0, 9.0], abs=2e-3)


def test_a_constant_voltage_is_one_step_and_off_is_off() -> None:
    noise = 5e-3 * np.random.default_rng(4).standard_normal(len(TIMES))
    drive = measured_input(
        COMMANDED, Signal(TIMES, np.where((TIMES >= 0.010) & (TIMES < 0.050), 9.1, 0.0) + noise)
    ).drive(COMMANDED)
    assert len(drive.times) == 2
    assert drive.volts[0] == pytest.approx(9.1, abs=1e-3)
    assert drive.volts[1] == 0.0


def test_a_clamped_voltage_is_used_unless_the_model_freewheels() -> None:
    clamped = np.where((TIMES >= 0.010) & (TIMES < 0.050), 9.0, 0.0)
    clamped[(TIMES >= 0.050) & (TIMES < 0.052)] = -24.0
    trace = Trace("made", COMMANDED, TIMES[:0], TIMES[:0], coil_voltage=Signal(TIMES, clamped))
    assert trace.input(0.0).volts.min() < -20.0
    assert trace.input(24.0).volts.tolist() == [9.0, 0.0]
    assert trace.input(24.0).times.tolist() == COMMANDED.times.tolist()


def test_zero_volts_where_another_voltage_is_commanded_do_not_let_the_coil_freewheel() -> None:
    drive = measured_input(COMMANDED, Signal(TIMES, np.zeros(len(TIMES)))).drive(COMMANDED)
    assert 0.0 < drive.volts[0] < 1e-100


def test_a_map_may_name_command_and_measured_voltage() -> None:
    entries = {"command": "/driver", "voltage": "/probe", "current": "/clamp"}
    assert set(map_from(entries, "a.yaml").choose(None)[1]) == set(entries)
