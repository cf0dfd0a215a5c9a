"""A fleet from bags to table and page, in this process: what is done, what is done again, what is said of the rest."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections import Counter
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import BAG_START_NS, Recorder, train_bags
from plants.recording import record as plant_record
from plants.recording import write_bag as write_plant_bag

from valve_sim.cli import main
from valve_sim.files.ledger import Ledger
from valve_sim.files.parameter_files import load_valve
from valve_sim.fleet import columns
from valve_sim.fleet.results import PARTS, Results
from valve_sim.fleet.run import examine_fleet, forecast
from valve_sim.fleet.units import Options, ParameterChoice, Row
from valve_sim.model import Drive, published_times, simulate
from valve_sim.model.errors import ValveError
from valve_sim.traces import write_bag
from valve_sim.traces.synthetic import Sensor, record

from .bags import counted, make_bag

STAMPS_ERR = Recorder(quantisation=0.1e-6, command_jitter=40e-6, sample_rate=10e3)
CONFIG = Path(__file__).parents[2] / "config"


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
    examine_fleet([str(fleet)], output)
    return output


def table(output: Path) -> list[Row]:
    return [dict(row) for row in pq.read_table(output / "fleet.parquet").drop_columns(["start_time"]).to_pylist()]


def by_name(output: Path) -> dict[str, Row]:
    return {Path(row["source"]).name: row for row in table(output)}


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


def test_a_row_holds_what_was_found_with_errors_in_si(examined: Path) -> None:
    row = by_name(examined)["day_1"]
    assert (row["valve"], row["verdict"], row["effects"], row["strokes"]) == ("/tank_1/valve", "none", [], 2)
    assert row["noise"] == pytest.approx(1e-6, rel=0.1)
    # The plant's own values, all of them declared.
    for name, truth in (("t1", 5.3e-3), ("t2", 9.9e-3), ("pilot_damping", 1.0), ("main_damping", 4.0)):
        assert abs(row[name] - truth) < 4.0 * row[f"{name}_stderr"]
    assert 0.0 < row["t2_stderr"] < 50e-6
    assert row["spring_rate_stderr"] < 12.8


@pytest.mark.long
def test_a_bag_of_the_current_alone_has_no_errors_in_metres(tmp_path: Path) -> None:
    drive = Drive.of([0.01, 0.04, 0.07, 0.10], [9.0, 0.0, 12.0, 0.0])
    sensor = Sensor(current_noise=1e-3, voltage_noise=5e-3, has_positions=False)
    valve = load_valve(CONFIG / "energy_consistent.yaml")
    write_bag(tmp_path / "alone.mcap", record(valve, drive, 0.13, 5e3, sensor).trace)
    parameters = ParameterChoice(CONFIG / "energy_consistent.yaml")
    row = examine_fleet([str(tmp_path / "alone.mcap")], tmp_path / "results", parameters=parameters).rows[0]
    assert (row["state"], row["verdict"], row["samples"]) == ("examined", "none", 650)
    assert row["noise"] is row["rmse_before"] is row["rmse_after_holdout"] is None
    assert row["t1"] == pytest.approx(published_times(simulate(valve, Drive.of([0.0], [9.0]), [0.02]))[0], abs=5e-5)
    assert 0.0 < row["t1_stderr"] < 5e-5


def test_the_schema_has_units_and_meanings_in_its_metadata(examined: Path) -> None:
    schema = pq.read_schema(examined / "fleet.parquet")
    assert schema.metadata[b"schema"] == b"valve_sim/fleet/2"
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert (units["t2"], units["spring_rate_stderr"], units["coulomb_friction_force"]) == ("s", "N/m", "N")
    assert all(field.metadata[b"meaning"] for field in schema)


def test_the_same_again_does_nothing_and_changes_nothing(
    fleet: Path, examined: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, asked = table(examined), counted(monkeypatch)
    assert examine_fleet([str(fleet)], examined).done == 0
    assert asked == []
    assert table(examined) == before


def test_a_changed_parameter_file_or_option_is_done_again_and_nothing_else_is(
    fleet: Path, examined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(examined, tmp_path / "results")
    changed = tmp_path / "tank_2.yaml"
    changed.write_text("/**: {ros__parameters: {valve: {spring_rate: 430.0}}}")
    asked = counted(monkeypatch)
    chosen = ParameterChoice(None, (("/tank_2/*", changed),))
    assert forecast([str(fleet)], tmp_path / "results", chosen).units == 1
    examine_fleet([str(fleet)], tmp_path / "results", parameters=chosen)
    assert asked == ["day_3"]
    examine_fleet([str(fleet)], tmp_path / "results", parameters=chosen, options=Options(full=True))
    assert Counter(asked) == {"day_1": 1, "day_2": 1, "day_3": 2}


def test_a_run_that_was_killed_goes_on_from_its_parts(
    fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = counted(monkeypatch)
    monkeypatch.setattr(Results, "compact", lambda self, rows: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        examine_fleet([str(fleet)], tmp_path)
    assert len(asked) == 3
    assert list((tmp_path / PARTS).iterdir())
    assert not (tmp_path / "fleet.parquet").exists()
    (tmp_path / PARTS / "00001-99999.parquet").write_bytes(b"half of a part")
    monkeypatch.undo()
    asked = counted(monkeypatch)
    examine_fleet([str(fleet)], tmp_path)
    assert asked == []
    assert len(table(tmp_path)) == 8
    assert not (tmp_path / PARTS).exists()


def test_a_bag_that_was_moved_or_is_named_alone_is_not_done_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = counted(monkeypatch)
    make_bag(tmp_path / "bags" / "one")
    make_bag(tmp_path / "bags" / "two", seed=2)
    examine_fleet([str(tmp_path / "bags")], tmp_path / "results")
    (tmp_path / "bags" / "one").rename(tmp_path / "bags" / "moved")
    examine_fleet([str(tmp_path / "bags" / "moved")], tmp_path / "results")
    assert sorted(by_name(tmp_path / "results")) == ["moved", "two"]
    assert len(asked) == 2


def test_what_was_lost_is_done_again(fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counted(monkeypatch, "lost")
    examine_fleet([str(fleet)], tmp_path)
    assert Counter(row["state"] for row in table(tmp_path))["lost"] == 3
    monkeypatch.undo()
    asked = counted(monkeypatch)
    examine_fleet([str(fleet)], tmp_path)
    assert len(asked) == 3
    assert Counter(row["state"] for row in table(tmp_path))["lost"] == 0


def test_what_is_followed_is_fitted_alike_whether_effects_are_searched_for_or_not(tmp_path: Path) -> None:
    """Two bags of one valve whose stamps err: the times agree within their errors, and the search changes none."""
    for day in (1, 2):
        made = plant_record(DeclaredPlant({}, dict(CAMPAIGN_VALVE)), train_bags(8)[day], STAMPS_ERR, day)
        write_plant_bag(made, tmp_path / "bags" / f"day_{day}", "/valve", BAG_START_NS + day)
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


def test_a_found_effect_has_a_report_and_a_hostile_name_stays_inside(tmp_path: Path) -> None:
    bag = tmp_path / "bags" / "..%2f..%2fup <script>alert(1)"
    make_bag(bag, force=0.5, seed=1)
    output = tmp_path / "results"
    examine_fleet([str(tmp_path / "bags")], output, options=Options(budget=2.0))
    (row,) = table(output)
    assert row["verdict"] != "none"
    report = output / row["report"]
    assert report.is_file()
    assert report.resolve().is_relative_to((output / "reports").resolve())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bags", "results"]
    assert (report.parent / "corrected.yaml").is_file()
    page = (output / "fleet.html").read_text("utf-8")
    assert "<script>alert" not in page
    assert f'href="{row["report"]}"' in page


def test_a_second_run_on_the_same_folder_is_refused_while_one_writes(fleet: Path, tmp_path: Path) -> None:
    with Results(tmp_path).locked(), pytest.raises(ValveError, match="another run writes there"):
        examine_fleet([str(fleet)], tmp_path)


def test_a_foreign_table_is_refused_and_stays(fleet: Path, tmp_path: Path) -> None:
    (tmp_path / "fleet.parquet").write_bytes(b"mine")
    with pytest.raises(ValveError, match="cannot be read as a table of this program"):
        examine_fleet([str(fleet)], tmp_path)
    assert (tmp_path / "fleet.parquet").read_bytes() == b"mine"


def test_the_page_lists_valves_and_reasons_and_carries_its_data(examined: Path) -> None:
    page = (examined / "fleet.html").read_text("utf-8")
    assert "0 of 2 valves drift; 5 bags without a result" in page
    assert "is empty (0 bytes)" in page
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found
    series: list[Any] = json.loads(found[1])[0]
    assert [len(one["t"]) for one in series] == [len(one["v"]) for one in series]
    assert "://" not in page.replace("http://www.w3.org/2000/svg", "")


def test_a_run_that_is_stopped_says_in_one_short_line_what_it_wrote(tmp_path: Path) -> None:
    parts = [tmp_path / PARTS / f"00001-{number:05d}.parquet" for number in range(1000)]
    words = Ledger([tmp_path / "fleet.html"], parts).words()
    assert words == f"wrote 1000 files in {tmp_path / PARTS}; not written: {tmp_path / 'fleet.html'}"


def test_a_forecast_is_for_the_processors_there_are_and_for_machines_too(
    fleet: Path, examined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 6)
    wanted = ["fleet", str(fleet), "--full", "--dry-run", "--output"]
    known = CliRunner().invoke(main, [*wanted, str(examined)])
    assert known.exit_code == 0, known.output
    assert "would examine about 3 valves" in known.output
    assert "on 6 processors" in known.output
    new = json.loads(CliRunner().invoke(main, [*wanted, str(tmp_path), "--json"]).output)
    assert new["seconds"] is None
    assert new["bags"] > new["units"] > 0
