"""Inputs beside the repository on which a statement was false: the right value of each, or the issue that mends it.

Folders whose input is written anew by another test are listed with it.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from valve_sim.cli import main

INPUTS = Path(__file__).parents[2] / "shared" / "inputs"
pytestmark = pytest.mark.skipif(not INPUTS.is_dir(), reason=f"the inputs are not beside the repository: {INPUTS}")

STROKES = [
    ("opening", 0.010, {"pilot_reaches_main": 5.30e-3, "reaches_stop": 9.90e-3}),
    ("closing", 0.040, {}),
    ("opening", 0.070, {}),
    ("closing", 0.100, {}),
]
"""The same four in each recording: s, and s after the command."""
RECORDINGS = {
    "csv_date_and_time_columns/date_and_time_columns.csv": 1400,
    "csv_days/excel_days2.csv": 1400,
    "csv_infinity_sign/picoscope_few.csv": 1397,
    "csv_iso_dates/date_iso_us.csv": 1400,
    "csv_last_column_begins_late/late_columns.csv": 1380,
    "csv_names_above_units_above_sensors/three_heads.csv": 1400,
    "csv_on_off/plc_onoff.csv": 1400,
    "csv_quoted_decimal_commas/quoted_numbers.csv": 1400,
    "csv_rigol/rigol_ds1000.csv": 1400,
    "csv_two_text_columns/two_texts.csv": 1400,
    "folder_with_unlisted_recording/b24b_unlisted": 1400,
    "labview_text/labview_one.txt": 1400,
    "mcap_chunk_index_only/b01_chunk_index_only.mcap": 1400,
    "mcap_idl_of_the_lab/b05b_idl_lab.mcap": 1400,
    "mcap_late_log_time/b23b_jittered_log_time.mcap": 1400,
    "mcap_sim_log_wall_publish/b27_sim_log_wall_publish.mcap": 1400,
    "mcap_zstd_messages_without_metadata/b29c_msg_zstd_no_meta": 1400,
    "tab_first_column_mostly_empty/slow_first_tab_time.txt": 1400,
    "wal_half/wal_half": 467,
    "wal_half_with_metadata/wal_half_with_metadata": 467,
}
"""Samples of the position in each."""
SAID = {
    "csv_infinity_sign/picoscope_few.csv": "left out 3 clipped readings",
    "folder_with_unlisted_recording/b24b_unlisted": "other_valve.mcap was not read",
}
ELSEWHERE = {
    "fmi3_start_time": "test/fmu/test_cosimulation.py: FMI 2.0 begins at the master's start time; FMI 3.0 is gone",
    "modbus_function_6": "test/station",
    "monitor_hears_an_old_bag": "test/nodes",
    "noise_of_excited_input": "test/identification/test_reviewed_statements.py",
    "noise_of_uneven_steps_ntc": "test/identification/test_reviewed_statements.py",
    "own_valve": "test/identification/test_reviewed_statements.py",
}
OWN = ("csv_names_that_are_numbers", "parameters_of_another_valve")


def run(*arguments: object) -> Any:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_every_folder_is_held_by_a_test_or_given_to_an_issue() -> None:
    held = {name.partition("/")[0] for name in RECORDINGS} | {*ELSEWHERE, *OWN}
    assert {path.name for path in INPUTS.iterdir() if path.is_dir()} == held


@pytest.mark.parametrize("name", RECORDINGS)
def test_four_strokes_are_read(name: str) -> None:
    path = INPUTS / name
    maps = sorted([*path.parent.glob(f"{path.stem}*.map.yaml")])
    result = run("info", path, "--json", *(["--map", maps[0]] if maps else []))
    assert result.exit_code == 0, result.stderr
    (valve,) = json.loads(result.stdout)["valves"]
    assert valve["signals"]["position"]["samples"] == RECORDINGS[name]
    interval = 1.0 / valve["signals"]["position"]["rate"]
    assert [stroke["kind"] for stroke in valve["strokes"]] == [kind for kind, _, _ in STROKES]
    begins = [stroke["start"] for stroke in valve["strokes"]]
    for start, (_, expected, _) in zip(begins, STROKES, strict=True):
        # Where the late column alone begins later, so does the clock.
        assert start - begins[0] == pytest.approx(expected - 0.010, abs=1.1 * interval)
    for found, (_, _, arrivals) in zip(valve["arrivals"], STROKES, strict=True):
        seen = {event["kind"]: event for event in found["events"]}
        for kind, expected in arrivals.items():
            assert abs(seen[kind]["after_command"] - expected) < 3.0 * seen[kind]["stderr"]
    assert SAID.get(name, "") in " ".join(valve["findings"])


@pytest.mark.parametrize("name", [name for name in RECORDINGS if name.endswith((".csv", ".txt"))])
def test_a_draft_is_readable_and_invents_no_rate(name: str, tmp_path: Path) -> None:
    drafted = run("map", INPUTS / name, "--output", tmp_path / "map.yaml")
    assert drafted.exit_code == 0, drafted.stderr
    # A counter of rows is no time, but its head states an increment.
    assert ("rate:" in (tmp_path / "map.yaml").read_text()) == name.startswith("csv_rigol")
    result = run("info", INPUTS / name, "--map", tmp_path / "map.yaml", "--json")
    assert result.exit_code == 0, result.stderr
    (valve,) = json.loads(result.stdout)["valves"]
    assert valve["duration"] == pytest.approx(0.1399, abs=2.1e-3)


def test_a_number_that_is_a_name_and_counts_another_column_is_refused() -> None:
    path = INPUTS / "csv_names_that_are_numbers" / "keysight_counted.csv"
    result = run("info", path, "--map", f"{path}.map.yaml")
    assert result.exit_code == 2
    assert "is ambiguous" in result.stderr


def test_a_recording_is_not_fitted_with_the_parameters_of_another_valve(tmp_path: Path) -> None:
    folder = INPUTS / "parameters_of_another_valve"
    result = run("identify", folder / "tank_1.mcap", "--params", folder / "two.yaml", "--output", tmp_path)
    assert result.exit_code == 0, result.stderr
    assert re.search(r"^main_damping .* 5\.00 N·s/m$", result.stdout, re.MULTILINE)
