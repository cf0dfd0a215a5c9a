"""Tables of data loggers: what parts cells, where numbers begin, names, units, and files of other kinds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from valve_sim.files.data_tables import open_table
from valve_sim.files.tables import TableError

TIMES, LIFTS = np.arange(5) * 1e-3, np.array([0.0, 0.1, 0.5, 1.2, 1.25])
TEXTS = {
    "commas": "t,lift\n" + "".join(f"{t},{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "semicolons and decimal commas": "t;lift\n"
    + "".join(f"{t};{x}\n".replace(".", ",") for t, x in zip(TIMES, LIFTS, strict=True)),
    "tabs": "t\tlift\n" + "".join(f"{t}\t{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "blanks and decimal commas": "t lift\n"
    + "".join(f" {t}   {x}\n".replace(".", ",") for t, x in zip(TIMES, LIFTS, strict=True)),
    "names in a comment": "# made by numpy\n# t,lift\n"
    + "".join(f"{t},{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "a preamble and empty lines": 'Model,"X 1",\nSample Interval,0.001\n\nt,lift\n\n'
    + "".join(f"{t},{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "a comma at each end, quotes": '"t","lift",\n'
    + "".join(f'"{t}","{x}",\n' for t, x in zip(TIMES, LIFTS, strict=True)),
    "a time of day beside": "t,lift,clock\n"
    + "".join(f"{t},{x},12:00:01\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "words and quoted decimal commas": "t,lift,state\n"
    + "".join(f'"{t}","{x}",run\n'.replace(".", ",") for t, x in zip(TIMES, LIFTS, strict=True)),
    "ISO dates": "t,lift\n"
    + "".join(f"2024-03-02T23:59:59.{int(1e6 * t):06d}Z,{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "German dates": "t;lift\n"
    + "".join(f"02.03.2024 00:00:00,{int(1e6 * t):06d};{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
    "names above units above sensors": "t,lift\ns,mm\nai0,ai1\n"
    + "".join(f"{t},{x}\n" for t, x in zip(TIMES, LIFTS, strict=True)),
}


@pytest.mark.parametrize(
    ("kind", "encoding"),
    [
        *((kind, "utf-8") for kind in TEXTS),
        *(("tabs", own) for own in ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be")),
    ],
)
def test_text(kind: str, encoding: str, tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(TEXTS[kind], encoding=encoding)
    table = open_table(file)
    assert table.names[:2] == ("t", "lift")
    np.testing.assert_allclose(table.column("t") - table.column("t")[0], TIMES, atol=1e-10)
    np.testing.assert_allclose(table.column("lift"), LIFTS)
    np.testing.assert_array_equal(table.column("2"), table.column("lift"))


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("t;p\ns;mm", ("t", "p"), {"t": "s", "p": "mm"}),
        ("t [ms];p (µm)", ("t [ms]", "p (µm)"), {"t [ms]": "ms", "p (µm)": "µm"}),
        ("TIME;CH1\nSecond;Volt", ("TIME", "CH1"), {"TIME": "Second", "CH1": "Volt"}),
        ("# no names here", ("1", "2"), {}),
        ("a;a", ("a", "a_2"), {}),
    ],
)
def test_names_and_units(head: str, names: tuple[str, ...], units: dict[str, str], tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_text(f"{head}\n0;0\n1;1\n2;4\n", encoding="latin-1")
    table = open_table(file)
    assert table.names == names
    assert table.units == units


def test_cells_that_say_a_number_in_words(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("t,coil,lift\n0,TRUE,1\n1,FALSE,#N/A\n2,on,∞\n3,OFF,-∞\n")
    table = open_table(file)
    np.testing.assert_array_equal(table.column("coil"), [1.0, 0.0, 1.0, 0.0])
    np.testing.assert_array_equal(table.column("lift"), [1.0, np.nan, np.inf, -np.inf])


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
    stamps = np.array([1_700_000_000_000_000_000 + 1_000_000 * row for row in range(5)], "datetime64[ns]")
    parquet.write_table(pyarrow.table({"t": stamps, "lift": LIFTS, "note": ["a", "b", "c", "d", "e"]}), file)
    table = open_table(file)
    assert table.names == ("t", "lift", "note")
    np.testing.assert_allclose(np.diff(table.column("t")), 1e-3, atol=3e-7)
    np.testing.assert_array_equal(table.column("lift"), LIFTS)
    with pytest.raises(TableError, match=r"row 1: column note: found 'a', expected a number"):
        table.column("note")


def test_parquet_without_pyarrow_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    file = tmp_path / "a.parquet"
    file.write_bytes(b"PAR1")
    with pytest.raises(TableError, match=r"need pyarrow, which is not installed; pip install pyarrow"):
        open_table(file)


def test_matlab(tmp_path: Path) -> None:
    file = tmp_path / "a.mat"
    savemat(file, {"t": TIMES, "log": {"lift": LIFTS}, "both": np.column_stack([TIMES, LIFTS]), "rate": 1000.0})
    table = open_table(file)
    assert table.names == ("t", "log.lift", "both[1]", "both[2]")
    np.testing.assert_array_equal(table.column("log.lift"), LIFTS)
    np.testing.assert_array_equal(table.column("both[2]"), LIFTS)


REFUSED = {
    "a.csv": (b"", "is empty"),
    "b.csv": (b"some words\nand more\n", "no table of numbers"),
    "c.mat": (b"no matlab file, though long enough to have a header of its own" * 9, "is not a MATLAB file"),
    "d.mat": (b"MATLAB 7.3 MAT-file, Platform: x".ljust(124) + b"\0\2IM" + bytes(400), "MATLAB 7.3 .*-v7"),
    "e.parquet": (b"PAR1 and then nothing", "is not a Parquet file"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_table_is_refused(name: str, tmp_path: Path) -> None:
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    data, expected = REFUSED[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(TableError, match=expected) as caught:
        open_table(tmp_path / name)
    assert "\n" not in str(caught.value)
