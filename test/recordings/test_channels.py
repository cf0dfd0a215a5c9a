"""Every row of the table of channels is written, read, mapped and checked as it says."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from valve_sim.files.channels import CHANNELS, SIGNALS, UNITS, Channel, Signal, Signals
from valve_sim.files.recording_map import map_from
from valve_sim.model import Drive, ValveParameters
from valve_sim.recordings import CSV_COLUMNS, Trace, TraceError, describe, read_trace, write_bag, write_csv
from valve_sim.recordings.map_draft import draft_map

if TYPE_CHECKING:
    from pathlib import Path

TIMES = 1e-4 * np.arange(400)
POSITION = 1.23e-3 / (1.0 + np.exp(-(TIMES - 20e-3) / 1e-3))
ROWS = pytest.mark.parametrize("channel", SIGNALS.values(), ids=SIGNALS)


def readings(channel: Channel) -> np.ndarray:
    """Values that the channel can have, no two alike; those of a voltage are its command."""
    if channel.key == "voltage":
        return np.where(TIMES < 10e-3, 0.0, 9.0) + 1e-3 * np.sin(1e3 * TIMES)
    least, most = (
        bound if np.isfinite(bound) else end for bound, end in zip(channel.bounds, (0.0, 100.0), strict=True)
    )
    # 37 and 400 have no common divisor. What only grows would be taken for a counter.
    return least + (most - least) * (1.0 + 37 * np.arange(len(TIMES)) % len(TIMES)) / (2.0 + len(TIMES))


def recording(channel: Channel, values: np.ndarray, times: np.ndarray = TIMES) -> Trace:
    trace = Trace("made here", Drive.of([10e-3], [9.0]), TIMES, POSITION, 0.8 * POSITION)
    return replace(trace, **{channel.name: Signal(times, values)})


def test_keys_and_names_are_those_of_one_channel() -> None:
    assert len({channel.name for channel in CHANNELS.values()}) == len(CHANNELS)
    assert all(hasattr(Signals(), channel.name) for channel in SIGNALS.values())
    topics = [(place.topic, place.field, place.joint) for channel in CHANNELS.values() for place in channel.places]
    assert len(set(topics)) == len(topics)


@ROWS
def test_a_bag_gives_a_channel_back(channel: Channel, tmp_path: Path) -> None:
    # Times of its own, so that a current is not written beside a voltage.
    values, times = readings(channel), TIMES + 50e-6
    write_bag(tmp_path / "a.mcap", recording(channel, values, times))
    found = read_trace(tmp_path / "a.mcap")
    signal = found.signals()[channel.name]
    is_single = channel.key == "voltage"  # in a BatteryState
    assert signal.values == pytest.approx(values, rel=1e-6 if is_single else 0.0, abs=0.0)
    assert signal.times + 1e-9 * found.epoch_ns == pytest.approx(times, abs=1e-9)
    assert describe(found).signals[channel.name].samples == len(times)


@pytest.mark.parametrize(
    "channel", [c for c in SIGNALS.values() if c.key != "voltage"], ids=lambda channel: channel.key
)
def test_a_first_map_names_a_channel_by_its_key(channel: Channel, tmp_path: Path) -> None:
    drive = Drive.of([10e-3, 30e-3], [9.0, 0.0])
    write_bag(tmp_path / "a.mcap", replace(recording(channel, readings(channel), TIMES + 50e-6), drive=drive))
    lines = draft_map(tmp_path / "a.mcap", ValveParameters(), "a test").splitlines()
    assert channel.own_topic is not None
    guesses = [line for line in lines if channel.own_topic.topic in line and not line.startswith("#")]
    assert [guess.partition(":")[0] for guess in guesses] == ([channel.key] if channel.hint else [])


@ROWS
def test_a_table_gives_a_channel_in_every_unit_of_a_map(channel: Channel, tmp_path: Path) -> None:
    rows = np.column_stack([TIMES, np.where(TIMES < 10e-3, 0.0, 9.0), POSITION, readings(channel)])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,u,x,y", comments="", fmt="%.17g")
    for name, unit in UNITS[channel.dimension].items():
        entries = {"time": {"column": "t"}, "command": "u", "position": "x", channel.key: {"column": "y", "unit": name}}
        found = read_trace(tmp_path / "a.csv", recording_map=map_from(entries, "map.yaml")).signals()[channel.name]
        assert found.values == pytest.approx(unit.factor * rows[:, 3] + unit.zero, rel=1e-12)


@pytest.mark.parametrize(
    "channel", [c for c in SIGNALS.values() if c.key != "voltage"], ids=lambda channel: channel.key
)
def test_a_csv_of_simulate_gives_a_channel_back(channel: Channel, tmp_path: Path) -> None:
    columns = dict.fromkeys(CSV_COLUMNS, np.zeros(len(TIMES)))
    columns |= {"time": TIMES, "coil_voltage": np.where(TIMES < 10e-3, 0.0, 9.0), "pilot_position": POSITION}
    write_csv(tmp_path / "a.csv", {**columns, channel.name: readings(channel)})
    assert np.array_equal(read_trace(tmp_path / "a.csv").signals()[channel.name].values, readings(channel))


@pytest.mark.parametrize("channel", [c for c in SIGNALS.values() if np.isfinite(c.bounds[0])], ids=lambda c: c.key)
def test_what_a_sensor_cannot_read_is_said(channel: Channel, tmp_path: Path) -> None:
    values = readings(channel)
    below = 2.0 * channel.bounds[0] - values
    a_few_below = np.where(np.arange(len(values)) % 10 == 0, below, values)
    for readable, is_said in ((values, False), (a_few_below, False), (below, True)):
        write_bag(tmp_path / "a.mcap", recording(channel, readable))
        assert any(channel.title in finding for finding in read_trace(tmp_path / "a.mcap").findings) == is_said


def test_a_csv_without_positions_is_a_recording_of_the_current(tmp_path: Path) -> None:
    nothing, current = np.full(len(TIMES), np.nan), np.sin(1e2 * TIMES)
    columns = dict.fromkeys(CSV_COLUMNS, nothing) | {"time": TIMES, "coil_current": current}
    write_csv(tmp_path / "a.csv", columns | {"coil_voltage": np.where(TIMES < 10e-3, 0.0, 9.0)})
    found = read_trace(tmp_path / "a.csv")
    assert not found.has_positions
    assert found.primary_signal == "current"
    assert np.array_equal(found.primary_samples.values, current)
    columns |= {"coil_current": nothing, "coil_voltage": np.where(TIMES < 10e-3, 0.0, 9.0)}
    write_csv(tmp_path / "b.csv", columns)
    with pytest.raises(TraceError, match="pilot_position: no finite position"):
        read_trace(tmp_path / "b.csv")
