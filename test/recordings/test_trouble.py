"""Numbers of another unit are refused before anything is fitted to them; what a valve can have is not."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.files.recording_map import load_map
from valve_sim.model import Drive, ValveParameters
from valve_sim.recordings import (
    Signal,
    Trace,
    TraceError,
    another_valve,
    doubtful_units,
    read_trace,
    refuse_doubtful_units,
)

from .bag_makers import clean_trace

VALVE = ValveParameters()
OPENS = default_valve().parameters


def table(seconds: float) -> Trace:
    """The clean opening as a table whose unit of time is so many seconds too large."""
    made = trace()
    drive = Drive(seconds * made.drive.times, made.drive.volts)
    return replace(made, clock="time column", times=seconds * made.times, drive=drive)


def trace(position: float = 1.0, offset: float = 0.0, volts: float = 1.0, amperes: float = 1.0) -> Trace:
    """A clean opening at 9 V and 0.9 A, in units that are so many times too small."""
    made = clean_trace()
    current = 0.9 * np.interp(made.times, [0.01, 0.02, 0.05, 0.06], [0.0, 1.0, 1.0, 0.0])
    return replace(
        made,
        drive=Drive(made.drive.times, volts * made.drive.volts),
        pilot_position=position * made.pilot_position + offset,
        coil_current=Signal(made.times, amperes * current),
        origins={"position": "topic /lvdt", "command": "topic /supply", "current": "topic /clamp"},
    )


def stepping() -> Trace:
    """The voltage where the position should be."""
    made = trace()
    noise = 1e-6 * np.random.default_rng(2).standard_normal(len(made.times))
    return replace(made, pilot_position=1.3e-3 * (made.drive.at(made.times) > 0.0) + noise)


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (trace(position=1e3), r"topic /lvdt: .* travels 1\.23\d m, expected about 0\.00123 m .* unit: mm$"),
        (trace(position=1e6), r"topic /lvdt: .* unit: um$"),
        (trace(position=1e-3), r"topic /lvdt: .* about 1000 times too small"),
        (trace(offset=0.0125), r"topic /lvdt: .* lies at 0\.01\d+ m, expected 0 m .* offset: \(here -0\.0125"),
        (replace(trace(position=1e3), units={"position": "mm"}), r"as if um were taken for mm; .* unit: um$"),
        (replace(trace(position=1e-3), units={"position": "um"}), r"as if mm were taken for um; .* unit: mm$"),
        (replace(trace(position=25.4), units={"position": "in"}), r"as if mm were taken for in; .* unit: mm$"),
        (replace(trace(position=10.0), units={"position": "cm"}), r"as if mm were taken for cm; .* unit: mm$"),
        (stepping(), r"topic /lvdt: .* jumps .* within a sample, .* exchanged with topic /supply"),
        (
            trace(volts=0.1, amperes=10.0),
            r"topic /supply and topic /clamp: .* 0\.9 V and the current 9 A, .* are exchanged; name each by",
        ),
        (table(1e3), r"time: .* takes \d[.\d]* s from the gap to the stop .* another unit of time"),
        (table(1e-3), r"time: .* takes \de-06 s|time: .* takes \d\.\d+e-06 s"),
        (trace(volts=1e3), r"topic /supply: .* reaches 9000 V, expected about 9 V .* unit: mV$"),
        (trace(volts=1e-2), r"topic /supply: .* reaches 0\.09 V only, though the valve moved; .* divider, 100\?"),
        (trace(amperes=1e3), r"topic /clamp: .* reaches 900 A, expected about 0\.9 A .* unit: mA$"),
        (
            replace(trace(amperes=1e-3), units={"current": "mA"}),
            r"topic /clamp: .* reaches 0\.0009 A only, .* as if A were taken for mA; .* unit: A",
        ),
    ],
)
def test_other_units_are_refused_with_the_mend(made: Trace, expected: str) -> None:
    with pytest.raises(TraceError, match=expected) as caught:
        refuse_doubtful_units(made, VALVE)
    assert str(caught.value).startswith("made: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "made",
    [
        trace(),
        table(1.0),
        table(20.0),
        trace(position=3.0),  # declared for a smaller one
        trace(position=0.02),  # a valve that sticks after 25 µm
        trace(offset=2e-3),
        trace(volts=7.0, amperes=7.0),  # peak and hold
        trace(amperes=0.2),  # 50 Ω, declared as 10
    ],
)
def test_what_a_valve_can_have_is_read(made: Trace) -> None:
    assert doubtful_units(made, VALVE) == ()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_inverted_position_is_said(sign: float, tmp_path: Path) -> None:
    made = clean_trace()
    rows = np.column_stack([made.times, made.drive.at(made.times), sign * made.pilot_position])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,u,x", comments="", fmt="%.9g")
    (tmp_path / "map.yaml").write_text("time: t\ncommand: u\nposition: x\n")
    found = read_trace(tmp_path / "a.csv", None, load_map(tmp_path / "map.yaml")).findings
    assert any("it may be inverted; correct it with --map and sign: -1" in line for line in found) == (sign < 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_current_against_the_voltage_is_said(sign: float, tmp_path: Path) -> None:
    made = trace()
    assert made.coil_current is not None
    columns = [made.times, made.drive.at(made.times), made.pilot_position, sign * made.coil_current.values]
    rows = np.column_stack(columns)
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,u,x,i", comments="", fmt="%.9g")
    (tmp_path / "map.yaml").write_text("time: t\ncommand: u\nposition: x\ncurrent: i\n")
    found = read_trace(tmp_path / "a.csv", None, load_map(tmp_path / "map.yaml")).findings
    assert any("column i: the current flows against the voltage" in line for line in found) == (sign < 0.0)


def test_a_voltage_behind_a_divider_of_ten_that_opened_a_valve_is_refused() -> None:
    with pytest.raises(TraceError, match=r"topic /supply: .* reaches 0\.9 V only, though the valve moved; .* divider"):
        refuse_doubtful_units(trace(volts=0.1), OPENS)
    assert doubtful_units(trace(volts=0.6), OPENS) == (), "a true valve may need less than the declared one"
    assert doubtful_units(replace(trace(volts=0.1), pilot_position=trace(position=0.0).pilot_position), OPENS) == ()


def test_a_usual_voltage_is_no_reason_to_simulate(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object) -> None:
        raise AssertionError("compiled code takes most of the time that looking at a recording takes")

    monkeypatch.setattr("valve_sim.model.simulate", fails)
    assert doubtful_units(trace(), OPENS) == ()
    with pytest.raises(AssertionError):
        doubtful_units(trace(volts=0.2), OPENS)


def resting_at(level: float, volts: float = 9.0) -> Trace:
    """An opening whose plunger comes to rest at a level, m."""
    made = trace()
    position = np.minimum(made.pilot_position, level + 1e-7 * np.sin(1e4 * made.times))
    return replace(made, pilot_position=position, drive=Drive(made.drive.times, volts / 9.0 * made.drive.volts))


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (
            trace(position=0.49),
            r"travels 0\.6\d* mm at up to 9 V, 0\.4\d* times the stroke .* \(1\.23 mm, 9 V\), where",
        ),
        (trace(position=2.0), r"travels 2\.\d* mm at up to 9 V, 2 times the stroke .* beyond its stop"),
        (resting_at(0.6e-3, volts=24.0), r"travels 0\.6\d* mm at up to 24 V, .* where at least"),
    ],
)
def test_a_travel_that_the_declared_valve_cannot_have_asks_for_its_parameters(made: Trace, words: str) -> None:
    (line,) = another_valve(made, OPENS)
    assert re.search(words, line), line
    assert line.startswith("topic /lvdt: ")
    assert line.endswith("another valve? Give its parameter file as --params")
    refuse_doubtful_units(made, OPENS)


@pytest.mark.parametrize(
    "made",
    [
        trace(),
        trace(position=0.97),
        resting_at(OPENS.pilot_gap),  # waits for the pressure
        resting_at(0.6e-3, volts=2.0),  # too little to go on
        replace(trace(position=0.5), drive=Drive(np.array([0.02, 0.0248]), np.array([9.0, 0.0]))),  # taken back
        replace(trace(), pilot_position=np.empty(0), times=np.empty(0)),
    ],
    ids=["full", "worn", "gap", "weak", "pulse", "current"],
)
def test_valid_work_is_not_asked_for_another_valve(made: Trace) -> None:
    assert another_valve(made, OPENS) == ()
