"""Event tables: what the paper printed, the effects that close it, and what it leaves open."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import fsolve

from valve_sim.files.parameter_files import default_valve, load_valve
from valve_sim.identification.diagnosis.events import PULLS, Quantity, diagnose_events
from valve_sim.identification.plants.event_table import EventPlant, reached, read_event_table
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.identification.reporting.event_report import event_json, event_text, write_valve
from valve_sim.model import Drive, ParameterError, simulate

CONFIG = Path(__file__).parents[3] / "config"


@pytest.fixture(scope="module")
def table():
    return read_event_table(CONFIG / "paper_events.yaml")


@pytest.fixture(scope="module")
def diagnosis(table):
    return diagnose_events(table)


def test_the_table_holds_what_the_paper_printed(table):
    assert [(event.displacement, event.time) for event in table.events] == [(0.26e-3, 5.3e-3), (1.23e-3, 9.9e-3)]
    assert table.valve == load_valve(CONFIG / "published.yaml")
    assert table.voltage == 9.0


def test_the_published_valve_never_opens(table):
    assert all(math.isnan(time) for time in EventPlant(table).times({}))


def test_a_constant_pull_alone_misses_the_second_event_by_a_millisecond(table):
    plant = EventPlant(table)
    t1, t2 = plant.times({"rest_attraction.force": 1.5})
    assert t1 == pytest.approx(5.32e-3, abs=5e-6)
    assert t2 == pytest.approx(10.92e-3, abs=5e-6)
    undamped = plant.times({"rest_attraction.force": 1.5, "main_damping": 0.0})
    assert undamped[1] == pytest.approx(10.65e-3, abs=5e-6)


@pytest.mark.parametrize("displacement", [0.1e-3, 0.26e-3, 0.7e-3, 1.2e-3])
def test_a_displacement_is_reached_when_the_plunger_is_there(displacement):
    valve, drive = default_valve(), Drive.of([0.0], [9.0])
    time = reached(simulate(valve, drive, np.arange(0.0, 0.02, 5e-5)), displacement)
    there = simulate(valve, drive, [time]).pilot_position[0]
    assert there == pytest.approx(displacement, abs=2e-9)


def test_what_is_never_reached_is_later_the_more_is_missing(table):
    plant = EventPlant(table)
    nothing, almost = plant.predict({}), plant.predict({"rest_attraction.force": 1.5, "stroke": 1.2e-3})
    assert nothing[1][0] > almost[1][0] > table.horizon


@pytest.mark.long
def test_no_single_effect_closes_the_table_but_many_pairs_do(diagnosis):
    assert not any(entry.closes for entry in diagnosis.singles)
    closing = {frozenset(entry.effects) for entry in diagnosis.pairs if entry.closes}
    assert frozenset({"rest_attraction", "coil_lag"}) in closing
    assert len(closing) > 4
    report = event_json(diagnosis)
    assert report["verdict"]["kind"] == "insufficient"
    assert report["before"]["errors_ms"] == [None, None]


@pytest.mark.long
def test_the_shipped_valve_meets_both_events_with_the_published_dampings(table, diagnosis):
    for time, event in zip(diagnosis.shipped.times, table.events, strict=True):
        assert time == pytest.approx(event.time, abs=10e-6)
    declared = diagnosis.valve.declared()
    assert [declared[name] for name in DAMPINGS] == [1.0, 4.0]
    assert declared["a0"] == pytest.approx(3.0336, abs=1e-4)
    assert declared["coil_time_constant"] == pytest.approx(0.9934e-3, abs=1e-7)


@pytest.mark.long
def test_the_calibrated_values_have_the_standard_errors_that_the_events_give_them(table, diagnosis):
    """By solving the two events anew, each moved by its uncertainty in turn: no derivative of the model."""
    plant, errors = EventPlant(table), {}
    for moved in range(2):
        times = [
            event.time + (event.uncertainty if index == moved else 0.0) for index, event in enumerate(table.events)
        ]
        found = fsolve(
            lambda values, times=times: 1e3 * (np.array(plant.times({PULLS[0]: values[0], PULLS[1]: 1e-3 * values[1]}))
                                               - times), [3.0, 1.0])  # fmt: skip
        for name, value in zip(PULLS, (found[0], 1e-3 * found[1]), strict=True):
            errors[name] = errors.get(name, 0.0) + (value - diagnosis.shipped.values[name]) ** 2
    for name, square in errors.items():
        assert diagnosis.standard_errors[name] == pytest.approx(math.sqrt(square), rel=0.1)
    tolerances, published = diagnosis.valve.tolerances, table.valve.tolerances
    assert tolerances.declared["coil_time_constant"] == diagnosis.standard_errors["coil_lag.time_constant"]
    added = np.array(tolerances.attraction_covariance) - np.array(published.attraction_covariance)
    assert added[0, 0] == pytest.approx(diagnosis.standard_errors["rest_attraction.force"] ** 2, rel=1e-4)
    assert np.count_nonzero(added) == 1


@pytest.mark.long
def test_a_declared_file_without_tolerances_gives_one_without(tmp_path, table, diagnosis):
    exact = replace(diagnosis, valve=diagnosis.valve.exact())
    path = tmp_path / "exact.yaml"
    text = table.valve_file.read_text()
    path.write_text(text[: text.index("    # One standard deviation")])
    write_valve(tmp_path / "valve.yaml", replace(exact, table=replace(table, valve_file=path)))
    assert load_valve(tmp_path / "valve.yaml") == exact.valve


@pytest.mark.long
def test_the_events_hold_neither_damping(diagnosis):
    for name, published in zip(DAMPINGS, (1.0, 4.0), strict=True):
        low, high = diagnosis.region.interval(name, capped=False)
        assert low == 0.0
        assert math.isinf(high)
        low, high = diagnosis.region.interval(name, capped=True)
        assert low == 0.0
        assert 10.0 * published < high < math.inf


@pytest.mark.long
def test_every_member_of_the_region_gives_the_events(table, diagnosis):
    plant, region = EventPlant(table), diagnosis.region
    for i, j in np.argwhere(region.allowed)[::60]:
        values = dict(zip((*DAMPINGS, *PULLS), (
            region.pilot_damping[i], region.main_damping[j], region.rest_attraction[i, j], region.coil_lag[i, j],
        ), strict=True))  # fmt: skip
        for time, event in zip(plant.times(values), table.events, strict=True):
            assert abs(time - event.time) < 2.0 * event.uncertainty


@pytest.mark.long
def test_it_says_what_would_decide(diagnosis):
    assert diagnosis.measurements[0].power > 100.0
    text = event_text(diagnosis)
    assert "what would decide" in text
    assert {measurement.quantity for measurement in diagnosis.measurements} == set(Quantity)
    listed = [entry["name"] for entry in event_json(diagnosis)["record_next"]]
    assert len(set(listed)) == len(diagnosis.measurements)
    for words in ("closing time after release from 9 V", "time constant of the coil current", "t2 at 7.65 V"):
        assert any(words in name for name in listed), listed
    assert [name for name in listed if name not in text] == []


@pytest.mark.long
def test_the_closing_time_covers_valves_that_touch_their_seat_and_lift_off_it(diagnosis):
    """A strong pull at rest holds heavily damped ones, which take longest, just off their seat."""
    (closing,) = (one for one in diagnosis.measurements if one.quantity is Quantity.CLOSING_TIME)
    assert (closing.lowest, closing.highest) == pytest.approx((11.74, 23.02), abs=0.01)


@pytest.mark.long
def test_the_page_on_the_paper_lists_what_would_decide(diagnosis):
    page = (CONFIG.parent / "docs" / "theory" / "paper.md").read_text()
    rows = [line for line in page.splitlines() if line.startswith("| ") and line.count("|") == 5]
    listed = [int(cells[4]) for row in rows if (cells := [cell.strip() for cell in row.split("|")])[4].isdigit()]
    assert listed == [pytest.approx(one.power, abs=0.51) for one in diagnosis.measurements]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("nothing: 1", "holds no event_table"),
        ("event_table: {valve: 3}", "valve: found 3"),
        ("event_table: {valve: published.yaml, events: []}", "events: found"),
        (
            "event_table: {valve: published.yaml, voltage: 9, ship: [coil_lag], events: [{name: a}]}",
            "displacement: found",
        ),
        ("event_table: [", "expected 'event_table:'"),
    ],
)
def test_a_table_that_cannot_be_used_is_named(tmp_path, text, words):
    path = tmp_path / "table.yaml"
    path.write_text(text)
    (tmp_path / "published.yaml").write_text((CONFIG / "published.yaml").read_text())
    with pytest.raises(ParameterError, match=words) as caught:
        read_event_table(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_effects_that_do_not_close_the_table_are_not_shipped(tmp_path, table):
    text = (CONFIG / "paper_events.yaml").read_text().replace("[rest_attraction, coil_lag]", "[rest_attraction]")
    path = tmp_path / "table.yaml"
    path.write_text(text.replace("published.yaml", str(CONFIG / "published.yaml")))
    with pytest.raises(ParameterError, match="does not close the table"):
        diagnose_events(read_event_table(path))
