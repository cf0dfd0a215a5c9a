"""A fleet from bags to table and page, in this process: what is done, what is done again, what is said of the rest."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any, NoReturn

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, record, train_bags, write_bag

from valve_sim.cli import main
from valve_sim.fleet import columns, table
from valve_sim.fleet import run as fleet_run
from valve_sim.fleet.run import examine_fleet
from valve_sim.fleet.sources import Bag
from valve_sim.fleet.units import Options, ParameterChoice, Row
from valve_sim.model.errors import ValveError

from .bags import counted, make_bag

STAMPS_ERR = Recorder(quantisation=0.1e-6, command_jitter=40e-6, sample_rate=10e3)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three bags of two valves, one of them once more, and what can be wrong with a bag."""
    folder = tmp_path_factory.mktemp("fleet")
    make_bag(folder / "day_1", 1.0, "/tank_1/valve", seed=1)
    make_bag(folder / "day_2", 2.0, "/tank_1/valve", seed=2)
    make_bag(folder / "day_3", 3.0, "/tank_2/valve", seed=3)
    shutil.copytree(folder / "day_1", folder / "day_1_again")
    (folder / "empty.mcap").write_bytes(b"")
    shutil.copytree(folder / "day_2", folder / "half_uploaded")
    next((folder / "half_uploaded").glob("*.mcap")).unlink()
    whole = next((folder / "day_3").glob("*.mcap")).read_bytes()
    (folder / "broken.mcap").write_bytes(b"not a bag" + whole[9:])
    with (folder / "sparse.mcap").open("wb") as stream:
        stream.truncate(10_000_000_000)
    return folder


@pytest.fixture(scope="module")
def examined(fleet: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("results")
    examine_fleet([str(fleet)], output, options=Options(search=False))
    return output


def rows_of(output: Path) -> list[Row]:
    return [dict(row) for row in pq.read_table(output / "fleet.parquet").drop_columns(["start_time"]).to_pylist()]


def by_name(output: Path) -> dict[str, Row]:
    return {Path(row["source"]).name: row for row in rows_of(output)}


def test_every_bag_has_a_row_with_a_result_or_the_reason(examined: Path) -> None:
    rows = by_name(examined)
    assert {name: row["state"] for name, row in rows.items()} == {
        "day_1": "examined", "day_1_again": "duplicate", "day_2": "examined", "day_3": "examined",
        "empty.mcap": "unreadable", "half_uploaded": "unreadable", "broken.mcap": "unreadable",
        "sparse.mcap": "unreadable",
    }  # fmt: skip
    reasons = {
        "day_1_again": "the same content as .*/day_1$", "empty.mcap": "is empty", "sparse.mcap": "10 GB are more than",
        "broken.mcap": "is not a .mcap file", "half_uploaded": "holds no .mcap or .db3 file",
    }  # fmt: skip
    for name, words in reasons.items():
        assert re.search(words, rows[name]["error"]), rows[name]["error"]
        assert "\n" not in rows[name]["error"]
    page = (examined / "fleet.html").read_text("utf-8")
    assert "0 of 2 valves drift; 5 bags without a result" in page
    assert "is empty (0 bytes)" in page


def test_a_row_holds_what_was_found_with_errors_in_si_and_the_file_says_which(examined: Path) -> None:
    row = by_name(examined)["day_1"]
    assert (row["valve"], row["verdict"], row["effects"], row["strokes"]) == ("/tank_1/valve", "none", [], 2)
    assert row["noise"] == pytest.approx(1e-6, rel=0.1)
    # The plant's own values, all of them declared.
    for name, truth in (("t1", 5.3e-3), ("t2", 9.9e-3), ("pilot_damping", 1.0), ("main_damping", 4.0)):
        assert abs(row[name] - truth) < 4.0 * row[f"{name}_stderr"]
    assert 0.0 < row["t2_stderr"] < 50e-6
    assert row["spring_rate_stderr"] < 12.8
    units = {field.name: field.metadata[b"unit"].decode() for field in pq.read_schema(examined / "fleet.parquet")}
    assert (units["t2"], units["spring_rate_stderr"], units["coulomb_friction_force"]) == ("s", "N/m", "N")


def test_only_what_is_new_changed_or_was_lost_is_done_again(
    fleet: Path, examined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One story: the same again, another parameter file, another option, a bag that cannot be fetched, a moved bag."""
    output, bags, options = tmp_path / "results", tmp_path / "bags", Options(search=False)
    shutil.copytree(fleet, bags, ignore=lambda folder, names: {"sparse.mcap"} & set(names))
    shutil.copytree(examined, output)
    asked = counted(monkeypatch)
    examine_fleet([str(bags)], output, options=options)
    assert asked == []  # all has moved, and nothing has changed
    before = rows_of(output)
    assert examine_fleet([str(bags)], output, options=options).done == 0
    assert rows_of(output) == before
    changed = tmp_path / "tank_2.yaml"
    changed.write_text("/**: {ros__parameters: {valve: {spring_rate: 430.0}}}")
    chosen = ParameterChoice(None, (("/tank_2/*", changed),))
    examine_fleet([str(bags)], output, parameters=chosen, options=options)
    assert asked == ["day_3"]
    lost = counted(monkeypatch, fails=True)
    examine_fleet([str(bags)], output, parameters=chosen, options=Options(full=True))
    assert sorted(lost) == ["day_1", "day_2", "day_3"]
    assert Counter(row["state"] for row in rows_of(output))["lost"] == 3
    assert by_name(output)["day_1"]["error"] == f"{bags / 'day_1'}: OSError: gone"
    asked = counted(monkeypatch)
    (bags / "day_1").rename(bags / "moved")
    shutil.rmtree(bags / "day_1_again")
    examine_fleet([str(bags)], output, parameters=chosen, options=Options(full=True))
    assert sorted(asked) == ["day_2", "day_3", "moved"]
    assert "lost" not in {row["state"] for row in rows_of(output)}
    (bags / "moved").rename(bags / "again")
    examine_fleet([str(bags / "again")], output, parameters=chosen, options=Options(full=True))
    assert len(asked) == 3 and {"again", "day_2"} <= by_name(output).keys() and "moved" not in by_name(output)
    shutil.copytree(bags / "day_2", bags / "day_4")
    with monkeypatch.context() as patch:
        patch.setattr(fleet_run, "look", gone)
        examine_fleet([str(bags)], output, parameters=chosen, options=Options(full=True))
    assert (by_name(output)["day_4"]["state"], by_name(output)["day_2"]["state"]) == ("lost", "examined")
    assert by_name(output)["day_4"]["error"] == f"{bags / 'day_4'}: OSError: gone"
    examine_fleet([str(bags)], output, parameters=chosen, options=Options(full=True))
    assert by_name(output)["day_4"]["state"] == "duplicate"


def gone(bag: Bag) -> NoReturn:
    raise OSError("gone")


def test_a_run_that_is_stopped_or_whose_disk_gets_full_goes_on_from_what_it_saved(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = counted(monkeypatch)
    examine = fleet_run.examine

    def stopped(unit: Any, output: Path) -> Any:
        if len(asked) == 2:
            raise KeyboardInterrupt
        return examine(unit, output)

    monkeypatch.setattr(fleet_run, "examine", stopped)
    with pytest.raises(KeyboardInterrupt):
        examine_fleet([str(fleet)], tmp_path)
    assert Counter(row["state"] for row in rows_of(tmp_path))["examined"] == 2
    monkeypatch.setattr(fleet_run, "examine", examine)
    monkeypatch.setattr(fleet_run, "SAVED_EVERY", 0.0)

    def gets_full(data: Any, path: Path, **options: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(table.pq, "write_table", gets_full)
        with pytest.raises(ValveError, match="No space left on device") as refused:
            examine_fleet([str(fleet)], tmp_path)
    assert "\n" not in str(refused.value)
    assert len(asked) == 3 and not list(tmp_path.rglob("*.partial"))
    examine_fleet([str(fleet)], tmp_path)
    assert len(asked) == 4 and Counter(row["state"] for row in rows_of(tmp_path))["examined"] == 3


@pytest.mark.long
def test_what_is_followed_is_fitted_alike_whether_effects_are_searched_for_or_not(tmp_path: Path) -> None:
    """Two bags of one valve whose stamps err: the times agree within their errors, and the search changes none."""
    for day in (1, 2):
        made = record(DeclaredPlant({}, dict(CAMPAIGN_VALVE)), train_bags(8)[day], STAMPS_ERR, day)
        write_bag(made, tmp_path / "bags" / f"day_{day}", "/valve", BAG_START_NS + day)
    examine_fleet([str(tmp_path / "bags")], tmp_path / "fits", options=Options(search=False))
    fits = by_name(tmp_path / "fits")
    for row in fits.values():
        assert (row["verdict"], row["white"], row["t1"]) == ("none", True, row["t1_before"])
        for name, truth in (("t1_before", 5.3e-3), ("t2_before", 9.9e-3), ("main_damping_before", 4.0)):
            assert abs(row[name] - truth) < 4.0 * row[f"{name}_stderr"]
    examine_fleet([str(tmp_path / "bags" / "day_1")], tmp_path / "searched", options=Options(budget=1.0))
    searched = by_name(tmp_path / "searched")["day_1"]
    followed = {name: fits["day_1"][name] for own in columns.followed() for name in (own.name, own.stderr)}
    known = {name: value for name, value in followed.items() if value is not None}
    assert len(known) > 20
    assert {name: searched[name] for name in known} == pytest.approx(known, rel=1e-9)


@pytest.mark.long
def test_a_found_effect_has_a_report_and_a_hostile_name_stays_inside(tmp_path: Path) -> None:
    bag = tmp_path / "bags" / "..%2f..%2fup <script>alert(1)"
    make_bag(bag, force=0.5, seed=1)
    output = tmp_path / "results"
    examine_fleet([str(tmp_path / "bags")], output, options=Options(budget=2.0))
    (row,) = rows_of(output)
    assert row["verdict"] != "none"
    report = output / row["report"]
    assert report.is_file()
    assert report.resolve().is_relative_to((output / "reports").resolve())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bags", "results"]
    assert (report.parent / "corrected.yaml").is_file()
    page = (output / "fleet.html").read_text("utf-8")
    assert "<script>alert" not in page
    assert f'href="{row["report"]}"' in page


def test_a_second_run_in_the_folder_and_a_foreign_table_are_refused(fleet: Path, tmp_path: Path) -> None:
    with table.locked(tmp_path), pytest.raises(ValveError, match="another run writes there"):
        examine_fleet([str(fleet)], tmp_path)
    (tmp_path / "fleet.parquet").write_bytes(b"mine")
    with pytest.raises(ValveError, match="cannot be read as a table of this program"):
        examine_fleet([str(fleet)], tmp_path)
    assert (tmp_path / "fleet.parquet").read_bytes() == b"mine"


def test_a_dry_run_counts_bags_and_opens_none(fleet: Path, examined: Path, tmp_path: Path) -> None:
    for output, new in ((examined, 0), (tmp_path, 7)):
        ran = CliRunner().invoke(main, ["fleet", str(fleet), "--dry-run", "--json", "--output", str(output)])
        assert ran.exit_code == 0, ran.output
        told = json.loads(ran.output)
        assert (told["bags"], told["new"]) == (8, new)
    assert list(tmp_path.iterdir()) == []
