"""Tables of data loggers: what parts cells, where numbers begin, names, units, and files of other kinds."""

from __future__ import annotations

import math
import sys
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from valve_sim.files.cells import number_in
from valve_sim.files.data_tables import open_table
from valve_sim.files.entries import Entries
from valve_sim.files.recording_map import MapError, TimeAxis, time_axis
from valve_sim.files.tables import TableError

TIMES, LIFTS = np.arange(12) * 1e-3, np.array([0.0, 0.1, 0.5, 1.2, *[1.25] * 8])
MIDNIGHT = datetime(2024, 3, 2, 23, 59, 59, 995_000)
"""What has dates goes on over the end of a day."""


def rows(form: str, *, comma: bool = False) -> str:
    """A line for each row: n, t s, x mm, and d, its date; decimal commas where they are wanted."""
    lines = []
    for n, (t, x) in enumerate(zip(TIMES.tolist(), LIFTS.tolist(), strict=True)):
        number = [f"{value:.6f}" for value in (t, x, 1e3 * t)]
        t_, x_, ms = (text.replace(".", ",") if comma else text for text in number)
        lines.append(form.format(n=n, t=t_, x=x_, ms=ms, d=MIDNIGHT + timedelta(seconds=t)))
    return "\n".join(lines) + "\n"


LABVIEW = (
    "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tOne\n***End_of_Header***\t\n\t\n"
    "Channels\t2\t\t\t\nSamples\t12\t12\t\t\nTime\t14:37:48,5\t14:37:48,5\t\t\nX_Dimension\tTime\tTime\t\t\n"
    "X0\t0,0E+0\t0,0E+0\t\t\nDelta_X\t0,001\t0,001\t\t\n***End_of_Header***\t\t\t\t\n"
)
YOKOGAWA = (
    '"Header Size"  ,8\n"TraceName"    ,"lift  ","CH2   "\n"BlockSize"    ,12,12\n"VUnit"        ,"mm ","V  "\n'
    '"HResolution"  ,1.0E-03,1.0E-03\n"HUnit"        ,"s  ","s  "\n"Date"         ,"2024/03/02","2024/03/02"\n'
    '"Time"         ,"14:37:48.00","14:37:48.00"\n\n'
)
TWINCAT = (
    "Name\tScope Project\nStarttime of export\t133538000000000000\t02.03.2024\t14:37:48\n\n"
    "Name\tvolt\tName\tlift\nData-Type\tREAL64\tData-Type\tREAL64\nSampleTime[ms]\t1\tSampleTime[ms]\t1\n"
    "SymbolBased\tTrue\tSymbolBased\tTrue\nOffset\t0\tOffset\t0\nUnit\tV\tUnit\tmm\nBitMask\t0xFF\tBitMask\t0xFF\n\n"
)
CAMPBELL = '"TOA5","CR1000","CR1000","1234"\n"TIMESTAMP","RECORD","lift","x"\n"TS","RN","mm","m"\n"","","Smp","Avg"\n'
TEKTRONIX = ("Record Length,12", "Sample Interval,1e-3", "Trigger Point,0", ",", ",", "Source,CH1", "Vertical Units,V")
MSO = (
    "Model,MSO44\n\nWaveform Type,ANALOG,,\nHorizontal Scale,0.01,,\nSample Interval,1e-3,,\nRecord Length,12,,\n"
    ",,,\nLabel,coil,lift\n"
)
FORMS: dict[str, tuple[str | bytes, object, str]] = {
    # what is read, the time of its map, and the column of the lift
    "commas": ("t,lift\n" + rows("{t},{x}"), "t", "lift"),
    "semicolons, decimal commas": ("t;lift\n" + rows("{t};{x}", comma=True), "t", "lift"),
    "tabs": ("t\tlift\n" + rows("{t}\t{x}"), "t", "lift"),
    "tabs, decimal commas": ("t\tlift\n" + rows("{t}\t{x}", comma=True), "t", "lift"),
    "bars": ("t | lift\n" + rows("{t} | {x}"), "t", "lift"),
    "blanks, decimal commas": ("t lift\n" + rows(" {t}   {x}", comma=True), "t", "lift"),
    "decimal commas in quotes": ("t,lift,u\n" + rows('"{t}","{x}","9,0"', comma=True), "t", "lift"),
    "sep=;": ("sep=;\nt;lift\n" + rows("{t};{x}", comma=True), "t", "lift"),
    "names in a comment": ("# made by numpy\n# t,lift\n" + rows("{t},{x}"), "t", "lift"),
    "a preamble and empty lines": ('Model,"X 1",\nInterval,0.001\n\nt,lift\n\n' + rows("{t},{x}"), "t", "lift"),
    "no names": (rows("{t},{x}"), 1, "2"),
    "names with commas": ('"t, s","lift, mm"\n' + rows("{t},{x}"), "t, s", "lift, mm"),
    "names on two lines": ('"t\n(s)","lift\n(mm)"\n' + rows("{t},{x}"), "t (s)", "lift (mm)"),
    "a name twice": ("t,ai,ai\n" + rows("{t},9,{x}"), "t", "ai_3"),
    "names that are numbers": ("x,1,2\nsecond,Volt,Volt\n" + rows("{t},9,{x}"), "x", "channel 2"),
    "an index of pandas": (",t,lift\n" + rows("{n},{t},{x}"), "t", "lift"),
    "names, units, sensors": ("t,lift\ns,mm\nai0,ai1\n" + rows("{t},{x}"), "t", "lift"),
    "sensors, names, units": ("ai0,ai1\nt,lift\ns,mm\n" + rows("{t},{x}"), "t", "lift"),
    "units, names": ("s,mm\nt,lift\n" + rows("{t},{x}"), "t", "lift"),
    "by the name of a sensor": ("t,lift\ns,mm\nai0,ai1\n" + rows("{t},{x}"), "t", "ai1"),
    "a comma at each end": ('"t","lift",\n' + rows('"{t}","{x}",'), "t", "lift"),
    "tabs at either end": ("\tt\tlift\t\n" + rows("\t{t}\t{x}\t"), "t", "lift"),
    "old Macintosh": (("t,lift\n" + rows("{t},{x}")).replace("\n", "\r").encode(), "t", "lift"),
    "Windows": (("t,lift\n" + rows("{t},{x}")).replace("\n", "\r\n").encode(), "t", "lift"),
    "UTF-8 with a mark": (("t,lift\n" + rows("{t},{x}")).encode("utf-8-sig"), "t", "lift"),
    "UTF-16 with a mark": (("t,lift\n" + rows("{t},{x}")).encode("utf-16"), "t", "lift"),
    "UTF-16 without": (("t,lift\n" + rows("{t},{x}")).encode("utf-16-le"), "t", "lift"),
    "UTF-16, other order": (("t,lift µ\n" + rows("{t},{x}")).encode("utf-16-be"), "t", "lift µ"),
    "Latin-1": (("t,lift [µ]\n" + rows("{t},{x}")).encode("latin-1"), "t", "lift [µ]"),
    "words beside": ("t,frame,lift,state\n" + rows("{t},valve,{x},run"), "t", "lift"),
    "words of ros2 topic echo --csv": (
        rows("1709390268,{n}000000,base,{x}"), {"column": [1, 2], "unit": ["s", "ns"]}, "4",
    ),
    "seconds and nanoseconds": ("sec,nanosec,lift\n" + rows("1709390268,{n}000000,{x}"), ["sec", "nanosec"], "lift"),
    "seconds and microseconds": (
        "a,b,lift\n" + rows("5,{n}000,{x}"), {"column": ["a", "b"], "unit": ["s", "us"]}, "lift",
    ),
    "milliseconds": ("t,lift\n" + rows("{ms},{x}"), {"column": "t", "unit": "ms"}, "lift"),
    "ISO dates": ("t,lift\n" + rows("{d:%Y-%m-%dT%H:%M:%S.%f},{x}"), "t", "lift"),
    "ISO dates of UTC": ("t,lift\n" + rows("{d:%Y-%m-%d %H:%M:%S.%f}Z,{x}"), "t", "lift"),
    "ISO dates with nanoseconds": ("t,lift\n" + rows("{d:%Y-%m-%d %H:%M:%S.%f}000+01:00,{x}"), "t", "lift"),
    "basic ISO dates": ("t,lift\n" + rows("{d:%Y%m%dT%H%M%S.%f},{x}"), "t", "lift"),
    "German dates": ("t;lift\n" + rows("{d:%d.%m.%Y %H:%M:%S,%f};{x}", comma=True), "t", "lift"),
    "German short dates": ("t;lift\n" + rows("{d:%d.%m.%y %H:%M:%S,%f};{x}", comma=True), "t", "lift"),
    "date and time": ("Date,Time,lift\n" + rows("{d:%Y-%m-%d,%H:%M:%S.%f},{x}"), ["Date", "Time"], "lift"),
    "time of day": ("Time,lift\n" + rows("{d:%H:%M:%S.%f},{x}"), "Time", "lift"),
    "minutes of a spreadsheet": ("Time,lift\n" + rows("{d:%M:%S.%f},{x}"), "Time", "lift"),
    "American dates": (
        "t,lift\n" + rows("{d:%m/%d/%Y %I:%M:%S.%f %p},{x}"),
        {"column": "t", "format": "%m/%d/%Y %I:%M:%S.%f %p"}, "lift",
    ),
    "dates of MATLAB": (
        "t,lift\n" + rows("{d:%d-%b-%Y %H:%M:%S.%f},{x}"), {"column": "t", "format": "%d-%b-%Y %H:%M:%S.%f"}, "lift",
    ),
    "durations of MATLAB": ("Time,lift\n" + rows("{t} sec,{x}"), "Time", "lift"),
    "units in the cells": ("t;lift\n" + rows("{ms} ms;{x} mm", comma=True), {"column": "t", "unit": "ms"}, "lift"),
    "commas alone above": (",,\n" + rows("{t},{x}"), 1, "2"),
    "Fortran": ("t lift\n" + rows("{t}D+00 {x}D+00"), "t", "lift"),
    "LabVIEW": (LABVIEW + "X_Value\tlift\tVoltage 1\tComment\n" + rows("{t}\t{x}\t9\t", comma=True), "X_Value", "lift"),
    "LabVIEW, comments that no row has": (
        LABVIEW + "X_Value\tlift\tVoltage 1\tComment\n" + rows("{t}\t{x}\t9", comma=True), "X_Value", "lift",
    ),
    "R": (
        '"t" "lift"\n' + "".join(f'"{n}" {row}\n' for n, row in enumerate(rows("{t} {x}").splitlines(), 1)),
        "t", "lift",
    ),
    "names behind a mark": ("#,t,lift\n" + rows("{n},{t},{x}"), "t", "lift"),
    "halves of a day": ("Time,lift\n" + rows("{d:%I:%M:%S.%f %p},{x}"), "Time", "lift"),
    "milliseconds of a controller": ("Time,lift\n" + rows("{d:%H:%M:%S;%f},{x}"), "Time", "lift"),
    "two encodings": ("t,lift [µm]\n# ".encode() + b"\xd6ffnung\n" + rows("{t},{x}").encode(), "t", "lift [µm]"),
    "durations of pandas": (",lift\n" + rows("0 days {d:%H:%M:%S.%f},{x}"), "1", "lift"),
    "time of day and milliseconds": (
        "Time,ms,lift\n" + rows("{d:%H:%M:%S},{d.microsecond}e-3,{x}"), ["Time", "ms"], "lift",
    ),
    "days of the year": ("Time,lift\n" + rows("{d:%j:%H:%M:%S.%f},{x}"), "Time", "lift"),
    "whole numbers beyond 2^53": (
        "t,lift\n" + rows("1709390268{n:03d}000000,{x}"), {"column": "t", "unit": "ns"}, "lift",
    ),
    "ticks of Windows": ("t,lift\n" + rows("13353800000{n:03d}0000,{x}"), {"column": "t", "unit": "100ns"}, "lift"),
    "ten thousand comments": ("# gain 1,2\n" * 10_000 + "# t,lift\n" + rows("{t},{x}"), "t", "lift"),
    "Siglent": (
        "Record Length,Analog:12\nVertical Scale,CH1:2.00,CH2:0.2\nModel Number,SDS1104X-E\nSecond,Volt,Volt\n"
        + rows("{t},9,{x}"), "Vertical Scale", "CH2:0.2",
    ),
    "Campbell": (CAMPBELL + rows('"{d:%Y-%m-%d %H:%M:%S.%f}",{n},{x},"NAN"'), "TIMESTAMP", "lift"),
    "Rigol": ("X,lift,CH2,Start,Step\nSequence,Volt,Volt,0,1e-3\n" + rows("{n},{x},9,,"), {"rate": 1000}, "lift"),
    "Yokogawa": (YOKOGAWA + rows(",{x},9"), {"rate": 1000}, "lift"),
    "TwinCAT": (TWINCAT + rows("{ms}\t9\t{ms}\t{x}"), {"column": "Name", "unit": "ms"}, "lift"),
    "Tektronix, rows beside the preamble": (
        "".join(f"{(*TEKTRONIX, *[','] * 5)[n]},,{own}\n" for n, own in enumerate(rows("{t},{x}").splitlines())),
        4, "5",
    ),
    "Tektronix": (MSO + "TIME,CH1,CH2\n" + rows("{t},9,{x}"), "TIME", "lift"),
    "LeCroy": ("LECROY,1,Wave\nSegments,1,Size,12\n#1,02-Mar-2024,0\nTime,lift\n" + rows("{t},{x}"), "Time", "lift"),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_a_form_is_read(form: str, tmp_path: Path) -> None:
    content, time, lift = FORMS[form]
    file = tmp_path / "a.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    table = open_table(file)
    times = table.row_times(time_axis(Entries("map", MapError), time))
    np.testing.assert_allclose(times.times - times.times[0], TIMES, atol=1e-10)
    assert times.kept.all()
    np.testing.assert_allclose(table.column(lift), LIFTS)
    assert table.findings == ()


def test_dates_say_when_a_table_was_written(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("t,lift\n" + rows("{d:%Y-%m-%dT%H:%M:%S.%f},{x}"))
    times = open_table(file).row_times(TimeAxis(("t",)))
    written = MIDNIGHT.replace(tzinfo=timezone.utc)
    assert times.origin + times.times[0] == pytest.approx(written.timestamp(), abs=1e-6)
    days = (written - datetime(1899, 12, 30, tzinfo=timezone.utc)).total_seconds() / 86_400.0  # of a spreadsheet
    file.write_text("t,lift\n" + "".join(f"{days + n / 86_400e3:.12f},{n}\n" for n in range(9)))
    times = open_table(file).row_times(TimeAxis(("t",), (86_400.0,)))
    assert times.origin + times.times[0] == pytest.approx(written.timestamp(), abs=1e-5)


@pytest.mark.parametrize(
    ("text", "time", "words"),
    [
        (
            "t,x\n" + rows("{d:%m/%d/%Y %H:%M:%S},{x}"),
            "t",
            "found '03/02/2024 23:59:59', expected .* time: format:",
        ),
        ("t,x\n" + rows("{d:%d.%m.%Y},{x}"), {"column": "t", "format": "%m/%d/%Y"}, "expected a time as %m/%d/%Y"),
        ("a,b,x\n" + rows("5,{n},{x}"), ["a", "b"], r"does not say which part of a second .* unit: \[s, ns\]"),
        ("t,x\n" + rows("5,{x}"), "t", r"rows have the time of the row before.*column: \[sec, nanosec\]"),
    ],
)
def test_times_that_nobody_can_read_are_refused(text: str, time: object, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(TableError, match=words):
        open_table(tmp_path / "a.csv").row_times(time_axis(Entries("map", MapError), time))


@pytest.mark.parametrize(
    ("place", "line"), [(0, "oops,0.1"), (1, "oops,0.1"), (2, "oops,0.1"), (5, "oops,0.1"), (5, "0.005")]
)
def test_a_broken_row_is_named_and_none_is_lost(place: int, line: str, tmp_path: Path) -> None:
    lines = rows("{t},{x}").splitlines()
    lines[place] = line
    (tmp_path / "a.csv").write_text("\n".join(["t,lift", *lines]))
    table = open_table(tmp_path / "a.csv")
    assert table.names == ("t", "lift")
    assert table.rows == len(TIMES)
    with pytest.raises(TableError, match=f"line {place + 2}: column "):
        table.column("t" if "oops" in line else "lift")


def test_what_stands_before_a_row_with_too_many_cells_is_said_to_be_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,lift\n" + rows("{t},{x}").replace("0.001000,", "0.001,0,", 1))
    table = open_table(tmp_path / "a.csv")
    assert table.names == ("t", "lift")
    assert table.findings == ("line 2 before the numbers left out: '0.000000,0.000000'",)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        ("0.012", "'0.012'"),
        ("End of data", "'End of data'"),
        ("\nmax,over all", "'max,over all'"),
        ("\nMin,0\nMax,1.25", "'Max,1.25'"),
    ],
)
def test_what_follows_the_numbers_is_left_out_and_said(end: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,lift\n" + rows("{t},{x}") + end)
    table = open_table(tmp_path / "a.csv")
    np.testing.assert_allclose(table.column("lift"), LIFTS)
    assert words in table.findings[0]


@pytest.mark.parametrize("line", ["# trigger", "t,lift", "t,x,y"])
def test_comments_and_a_head_that_stands_again_among_the_numbers_are_left_out_and_said(
    line: str, tmp_path: Path
) -> None:
    lines = ["t,lift", *rows("{t},{x}").splitlines()]
    (tmp_path / "a.csv").write_text("\n".join([*lines[:4], line, *lines[4:9], line, *lines[9:]]))
    table = open_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(table.column("lift"), LIFTS)
    assert [
        finding
        for finding in table.findings
        if f"2 lines among the numbers left out, such as {line!r} in line 5" in finding
    ]
    assert table.place(4) == "line 7"


@pytest.mark.parametrize(
    ("head", "interval"),
    [
        (LABVIEW + "Comment\tlift\tu\n", 1e-3),
        ("X,lift,Start,Increment\nSequence,Volt,0,1e-3\n", 1e-3),
        ("# Sample rate;2 kHz\n# n;lift\n", 0.5e-3),
        ("Abtastrate: 2000 Hz\nn;lift\n", 0.5e-3),
        ("Sampling interval [s],0.002\nn,lift\n", 2e-3),
        ("Sample Interval,250 us\nn,lift\n", 0.25e-3),
        ("Sample Period:,2,ms,\nn,lift\n", 2e-3),
        ("Rate of the pump,50\nn,lift\n", 0.0),
        ("Time(s),CH1(V),t0 = 0.0, tInc = 5.0e-05,\n", 50e-6),
        ("Time interval,:50uS,50uS\n\nindex,CH1\n", 50e-6),
        ("Sample Interval,250 \u03bcs\nn,lift\n", 250e-6),
        ("; Samplerate: 20 kHz\nn,lift\n", 50e-6),
        ("; Samplerate: 0.02 MHz\nn,lift\n", 50e-6),
        ("Sampling period [ms],0.05\nn,lift\n", 50e-6),
        ("SampleTime[ms],1\nn,lift\n", 1e-3),
        ("HResolution,5.0E-05,5.0E-05\nn,lift\n", 50e-6),
    ],
)
def test_a_head_states_the_interval_between_rows(head: str, interval: float, tmp_path: Path) -> None:
    mark = next(own for own in ";\t," if own in head.splitlines()[-1])
    (tmp_path / "a.csv").write_text(head + rows("{n}").replace("\n", f"{mark}9\n"))
    assert open_table(tmp_path / "a.csv").interval[0] == pytest.approx(interval)


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("t;p\ns;mm", ("t", "p"), {"t": "s", "p": "mm"}),
        ("t [ms];p (µm)", ("t [ms]", "p (µm)"), {"t [ms]": "ms", "p (µm)": "µm"}),
        ("TIME;CH1\nSecond;Volt", ("TIME", "CH1"), {"TIME": "Second", "CH1": "Volt"}),
        ("# no names here", ("1", "2"), {}),
        ("t / ms;x_um", ("t / ms", "x_um"), {"t / ms": "ms", "x_um": "um"}),
        ("in s;C1 in V", ("in s", "C1 in V"), {"C1 in V": "V"}),
        ("Time, ms;lift (\u03bcm)", ("Time, ms", "lift (\u03bcm)"), {"Time, ms": "ms", "lift (\u03bcm)": "\u00b5m"}),
        ("t_min;valve_in", ("t_min", "valve_in"), {}),
        ("a;a", ("a", "a_2"), {}),
    ],
)
def test_names_and_units(head: str, names: tuple[str, ...], units: dict[str, str], tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text(f"{head}\n0;0\n1;1\n2;4\n", encoding="utf-8" if "\u03bc" in head else "latin-1")
    table = open_table(file)
    assert table.names == names
    assert table.units == units


CELLS = {
    1.0: ("1", "TRUE", "on", "Ein"),
    0.0: ("false", "OFF", "aus"),
    math.nan: ("", "-", "-----", "#N/A", "NaN", "-nan(ind)", "1.#QNAN", "#DIV/0!", "null", "Invalid"),
    math.inf: ("∞", "inf", "1.#INF", "OVERLOAD", "OL", "over range", "*****"),
    -math.inf: ("-∞", "-1.#INF", "-Infinity"),
    1234567.5: ("1234567,5", "1,234,567.5", "1.234.567,5", "1'234'567.5", "1.2345675D6"),
    -2.5: ("-2.5", "\u22122,5"),
    2000.0: ("2000", "2E3", "2e+3"),
    None: ("ERROR 7", "12:00:01", "1_000", "open"),
}


@pytest.mark.parametrize(("value", "cell"), [(value, cell) for value, cells in CELLS.items() for cell in cells])
def test_a_cell_says_a_number(value: float | None, cell: str) -> None:
    found = number_in(cell)
    assert found == value or (found is not None and value is not None and math.isnan(found) and math.isnan(value))


def test_numbers_that_stand_for_infinity_and_for_none_are_these(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,9.9E+37\n1,-9.900000E+37\n2,9.91E+37\n3,1.25\n")
    np.testing.assert_array_equal(open_table(tmp_path / "a.csv").column("x"), [np.inf, -np.inf, np.nan, 1.25])


def test_zones_are_obeyed_where_the_clock_changes_over(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "t,x\n2024-03-31T01:59:59.999+01:00,0\n2024-03-31T03:00:00.000+02:00,1\n2024-03-31T01:00:00.001Z,2\n"
    )
    times = open_table(tmp_path / "a.csv").row_times(TimeAxis(("t",)))
    np.testing.assert_allclose(np.diff(times.times), 1e-3, atol=1e-9)
    last = datetime(2024, 3, 31, 1, 0, 0, 1000, tzinfo=timezone.utc).timestamp()
    assert times.origin + times.times[-1] == pytest.approx(last, abs=1e-6)


def test_bytes_that_a_logger_did_not_write_are_left_out_and_said(tmp_path: Path) -> None:
    lines = ("t,lift\n" + rows("{t},{x}")).encode().splitlines(keepends=True)
    (tmp_path / "a.csv").write_bytes(b"".join([*lines[:6], bytes(512), *lines[6:]]))
    table = open_table(tmp_path / "a.csv")
    np.testing.assert_array_equal(table.column("lift"), LIFTS)
    assert table.findings[0].startswith("512 zero bytes left out")


def test_a_text_of_two_bytes_a_character_that_lost_one_is_said_to_be_broken(tmp_path: Path) -> None:
    data = ("t\tlift\t\n" + rows("{t}\t{x}\t")).encode("utf-16")
    (tmp_path / "a.txt").write_bytes(data[:-99] + data[-98:])
    table = open_table(tmp_path / "a.txt")
    np.testing.assert_array_equal(table.column("lift"), LIFTS[: table.rows])
    assert "unreadable characters: 1, for bytes of the file are missing" in table.findings


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t;x\n0;998\n1;1.001\n2;1.004\n3;\n", r"column x: 1.001 beside numbers without a mark may be .* thousands"),
        ('t,x\n0,998\n1,"1,001"\n2,"1,234,567"\n', r"column x: 1,001 beside numbers without a mark may be"),
        ("t,x\n0,000,1,5\n0,001,1,7\n0,002,1,8\n", "line 2 has 4 whole numbers for 2 names: commas part its cells and"),
    ],
)
def test_marks_that_may_mean_two_things_are_refused(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(TableError, match=words):
        open_table(tmp_path / "a.csv").column("x")


def test_whole_numbers_among_three_decimals_are_no_thousands(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,149.985\n1,150.000\n2,150.015\n3,0\n")
    np.testing.assert_array_equal(open_table(tmp_path / "a.csv").column("x"), [149.985, 150.0, 150.015, 0.0])


def test_cells_stay_in_their_columns_and_a_last_one_may_begin_late(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text("T\tt\tlift\n23\t0\t\n" + "".join(f"\t{row}\t{'' if row < 12 else row}\n" for row in range(1, 20)))
    table = open_table(file)
    assert table.names == ("T", "t", "lift")
    np.testing.assert_array_equal(table.column("t"), np.arange(20))
    assert np.isfinite(table.column("lift")).sum() == 8


def test_a_number_for_a_name_counts_columns_unless_it_names_another(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("x,1,2\nsecond,Volt,Volt\n" + "".join(f"{row},{10 + row},{20 + row}\n" for row in range(3)))
    table = open_table(file)
    assert table.names == ("x", "channel 1", "channel 2")
    assert table.column("channel 2")[0] == table.column("3")[0] == 20
    with pytest.raises(TableError, match="column 2 is ambiguous, for the file calls column 3 so"):
        table.column("2")


def test_empty_cells_are_no_numbers_and_lines_are_counted_as_in_an_editor(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("# x\nt,lift\n0,1\n1,\n\n2,3\n")
    table = open_table(file)
    np.testing.assert_array_equal(table.column("lift"), [1.0, np.nan, 3.0])
    assert table.place(2) == "line 6"


def test_parquet(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    file = tmp_path / "a.parquet"
    stamps = np.array([1_700_000_000_000_000_000 + 1_000_000 * row for row in range(len(TIMES))], "datetime64[ns]")
    parquet.write_table(pyarrow.table({"t": stamps, "lift": LIFTS, "note": [*"abcdefghijkl"]}), file)
    table = open_table(file)
    assert table.names == ("t", "lift", "note")
    np.testing.assert_allclose(np.diff(table.column("t")), 1e-3, atol=3e-7)
    np.testing.assert_array_equal(table.column("lift"), LIFTS)
    with pytest.raises(TableError, match=r"row 1: column note: found 'a', expected a number"):
        table.column("note")


def test_matlab(tmp_path: Path) -> None:
    file = tmp_path / "a.mat"
    signals = [{"label": "coil", "values": TIMES}, {"label": "lift", "values": LIFTS}]  # of Simulink
    both = np.column_stack([TIMES, LIFTS])
    savemat(file, {"t": TIMES, "log": {"lift": LIFTS}, "both": both, "rate": 1000.0, "scope": {"signals": signals}})
    table = open_table(file)
    assert table.names == (
        "t", "log.lift", "both[1]", "both[2]", "scope.signals[1].values", "scope.signals[2].values",
    )  # fmt: skip
    np.testing.assert_array_equal(table.column("log.lift"), LIFTS)
    np.testing.assert_array_equal(table.column("both[2]"), LIFTS)


def test_a_spreadsheet_is_read_with_its_dates_to_the_microsecond(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["only words"])
    sheet = book.create_sheet("measured")
    for row in (["made by the lab"], ["t", "on", "lift"], ["d", None, "mm"]):
        sheet.append(row)
    for t, x in zip(TIMES.tolist(), LIFTS.tolist(), strict=True):
        sheet.append([45353.6 + t / 86400.0, True, x])
        sheet.cell(sheet.max_row, 1).number_format = "yyyy-mm-dd hh:mm:ss.000"
    book.save(tmp_path / "a.xlsx")
    table = open_table(tmp_path / "a.xlsx")
    assert table.names == ("t", "on", "lift")
    assert table.units == {"t": "d", "lift": "mm"}
    times = table.row_times(TimeAxis(("t",), (86400.0,))).times
    np.testing.assert_allclose(times - times[0], TIMES, atol=2e-6)
    np.testing.assert_array_equal(table.column("on"), 1.0)
    np.testing.assert_allclose(table.column("lift"), LIFTS)


def test_tdms_has_its_times_from_the_waveforms(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    about = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_samples": len(TIMES), "unit_string": "mm"}
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject("lab", "lift", LIFTS, about)])
    table = open_table(tmp_path / "a.tdms")
    assert set(table.names) == {"lift", "time"}
    assert table.units["lift"] == "mm"
    np.testing.assert_allclose(table.column("time"), TIMES, atol=1e-12)
    np.testing.assert_array_equal(table.column("lift"), LIFTS)


def test_channels_of_other_rates_have_times_of_their_own(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        about = {"wf_start_offset": 0.0, "wf_samples": len(TIMES)}
        lift = nptdms.ChannelObject("lab", "lift", LIFTS, {**about, "wf_increment": 1e-3})
        coil = nptdms.ChannelObject("lab", "coil", LIFTS[::2], {**about, "wf_increment": 2e-3})
        writer.write_segment([lift, coil, nptdms.ChannelObject("lab", "note", np.arange(12.0))])
    table = open_table(tmp_path / "a.tdms")
    assert table.names == ("note", "time", "lift", "time_2", "coil")
    np.testing.assert_allclose(table.column("time_2"), [*TIMES[::2], *[math.nan] * 6], atol=1e-12)
    np.testing.assert_array_equal(table.column("coil"), [*LIFTS[::2], *[math.nan] * 6])


def test_cells_of_a_head_that_span_two_lines_name_what_is_below(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["Run 12"], ["Time", "Coil", None, "Lift"], [None, "U", "I", None], ["s", "V", "A", "mm"]):
        book.active.append(row)
    book.active.merge_cells("A2:A3")
    book.active.merge_cells("B2:C2")
    for t, x in zip(TIMES.tolist(), LIFTS.tolist(), strict=True):
        book.active.append([t, 9.0, 0.5, x])
    book.save(tmp_path / "a.xlsx")
    table = open_table(tmp_path / "a.xlsx")
    assert table.names == ("Time", "Coil", "I", "Lift")
    assert table.units == {"Time": "s", "Coil": "V", "I": "A", "Lift": "mm"}


@pytest.mark.parametrize(("suffix", "package"), [("xlsx", "openpyxl"), ("tdms", "nptdms"), ("parquet", "pyarrow")])
def test_what_a_kind_of_file_needs_is_said(
    suffix: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (package, f"{package}.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / f"a.{suffix}").write_bytes(b"PAR1")
    with pytest.raises(TableError, match=f"need {package}, which is not installed; pip install {package}"):
        open_table(tmp_path / f"a.{suffix}")


REFUSED = {
    "a.csv": (b"", "is empty"),
    "b.csv": (b"some words\nand more\n", "no table of numbers"),
    "c.mat": (b"no matlab file, though long enough to have a header of its own" * 9, "is not a MATLAB file"),
    "d.mat": (b"MATLAB 7.3 MAT-file, Platform: x".ljust(124) + b"\0\2IM" + bytes(400), "MATLAB 7.3 .*-v7"),
    "e.parquet": (b"PAR1 and then nothing", "is not a Parquet file"),
    "f.xlsx": (b"PK and then nothing", "is not an Excel file"),
    "h.csv": (b"PK\x03\x04 and more", "is an Excel file or a zip archive, expected text; name it .xlsx"),
    "i.txt": (b"\x1f\x8b and more", "is packed by gzip, expected text; unpack it"),
    "j.csv": (b"key = value\n" * 600, "in its first 508 lines; .* at most 500 lines that are no comments: cut off"),
    "g.tdms": (b"TDSm and then nothing", "holds no column of numbers"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_table_is_refused(name: str, tmp_path: Path) -> None:
    needed = {"parquet": "pyarrow", "xlsx": "openpyxl", "tdms": "nptdms"}.get(name.partition(".")[2])
    if needed:
        pytest.importorskip(needed)
    data, expected = REFUSED[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(TableError, match=expected) as caught:
        open_table(tmp_path / name)
    assert "\n" not in str(caught.value)
