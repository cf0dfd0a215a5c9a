"""Which valve drifts, and how often one is named that does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from valve_sim.fleet.trends import DAY, FALSE_ALARMS, drifts, effects_of, holm, series_of, theil_sen, trend_p_value
from valve_sim.fleet.units import Row

DAYS = np.arange(60.0)


def rows(values: dict[str, np.ndarray], quantity: str = "t2_before") -> list[Row]:
    return [
        {"state": "examined", "source": str(index), "valve": valve, "start_time": int(day * DAY), quantity: value}
        for valve, own in values.items()
        for index, (day, value) in enumerate(zip(DAYS, own, strict=False))
    ]


def test_a_valve_that_drifts_is_named_with_slope_and_change_and_no_other() -> None:
    random = np.random.default_rng(1)
    values = {f"/v{index}": 9.9e-3 + 5e-6 * random.standard_normal(60) for index in range(20)}
    values["/v7"] += 1e-6 * DAYS
    (drift,) = drifts(series_of(rows(values)))
    assert (drift.valve, drift.series.quantity.name) == ("/v7", "t2_before")
    assert drift.slope == pytest.approx(1e-6, rel=0.2)
    assert drift.change == pytest.approx(59e-6, rel=0.2)


def test_single_bags_neither_make_nor_hide_a_trend() -> None:
    random = np.random.default_rng(2)
    still, drifting = 1.0 + 0.01 * random.standard_normal((2, 60))
    drifting += 1e-3 * DAYS
    still[[55, 58, 59]] += 100.0
    drifting[[55, 58, 59]] -= 100.0
    assert [drift.valve for drift in drifts(series_of(rows({"/still": still, "/drifting": drifting})))] == ["/drifting"]


def test_too_few_bags_or_one_value_for_all_say_nothing() -> None:
    assert np.isnan(trend_p_value(DAYS[:7], DAYS[:7]))
    assert np.isnan(trend_p_value(DAYS, np.ones(60)))
    assert np.isnan(trend_p_value(np.zeros(60), DAYS))
    assert drifts(series_of(rows({"/constant": np.ones(60)}))) == []


@pytest.mark.parametrize("likeness", [0.0, 0.4])
def test_false_alarms_are_as_rare_as_is_said_also_where_bags_resemble_their_neighbours(likeness: float) -> None:
    random = np.random.default_rng(3)
    count, level = 300, 0.01
    noise = random.standard_normal((count, 60))
    for at in range(1, 60):
        noise[:, at] = likeness * noise[:, at - 1] + np.sqrt(1.0 - likeness**2) * noise[:, at]
    alarms = sum(trend_p_value(DAYS, own) < level for own in noise)
    # Without the correction, bags as alike as 0.4 alarm in 7 % of cases.
    assert alarms <= stats.binom.ppf(0.999, count, level)


def test_the_rate_of_false_alarms_is_that_of_the_whole_fleet() -> None:
    random = np.random.default_rng(4)
    fleets = [{f"/v{index}": random.standard_normal(12) for index in range(20)} for _ in range(10)]
    assert sum(bool(drifts(series_of(rows(fleet)))) for fleet in fleets) == 0
    assert FALSE_ALARMS <= 0.001


def test_holm() -> None:
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_the_slope_is_the_median_of_all_pairs() -> None:
    values = 2.0 + 0.5 * DAYS
    values[3] = 1e6
    assert theil_sen(DAYS, values) == pytest.approx(0.5)


def series(random: np.random.Generator, kind: str, count: int, bags: int) -> tuple[np.ndarray, np.ndarray]:
    """Values of bags that do not drift, and their standard errors, (count, bags) each."""
    errors = np.exp(0.5 * random.standard_normal((count, bags)))
    noise = {
        "normal": random.standard_normal,
        "one in ten far off": lambda size: (
            random.standard_normal(size) * np.where(random.random(size) < 0.1, 20.0, 1.0)
        ),
        "one-sided": lambda size: random.exponential(size=size),
    }[kind]
    return errors * noise((count, bags)), errors


@pytest.mark.parametrize("kind", ["normal", "one in ten far off", "one-sided"])
def test_false_alarms_of_few_bags_are_as_rare_as_is_said_whatever_their_noise(kind: str) -> None:
    count, level = 200, 0.01
    values, errors = series(np.random.default_rng(5), kind, count, 12)
    alarms = sum(trend_p_value(DAYS[:12], *own) < level for own in zip(values, errors, strict=True))
    assert alarms <= stats.binom.ppf(0.999, count, level)


def test_ten_bags_of_each_of_twenty_valves_show_a_drift_of_fifteen_scatters() -> None:
    random = np.random.default_rng(6)
    values = {f"/v{index}": random.standard_normal(10) for index in range(20)}
    # Every second bag shows less than the one before: for a test of ranks alone, ten bags in an order that is not
    # perfect are too few.
    values["/v7"] = 15.0 * DAYS[:10] / 9.0 + np.where(np.arange(10) % 2, -1.0, 1.0)
    assert [drift.valve for drift in drifts(series_of(rows(values)))] == ["/v7"]


def test_a_drift_that_is_not_straight_is_no_likeness_of_neighbours() -> None:
    random = np.random.default_rng(7)
    for bend in (2.0, 0.3):
        values = 6.0 * (DAYS / 59.0) ** bend + random.standard_normal(60)
        assert trend_p_value(DAYS, values) < 1e-6


def test_a_bag_that_comes_a_year_after_all_others_makes_no_trend() -> None:
    random = np.random.default_rng(8)
    days, values = DAYS[:20].copy(), random.standard_normal(20)
    days[-1], values[-1] = 400.0, 30.0
    assert trend_p_value(days, values) > 0.01


def test_bags_count_by_their_standard_errors() -> None:
    random = np.random.default_rng(9)
    errors = np.where(np.arange(60) % 2, 0.5, 2.0)
    values = errors * random.standard_normal(60) + 2.0 * DAYS / 59.0
    assert trend_p_value(DAYS, values, errors) < 0.1 * trend_p_value(DAYS, values)
    unknown = np.where(np.arange(60) % 4 == 0, np.nan, errors)
    assert trend_p_value(DAYS, values, unknown) < trend_p_value(DAYS, values)
    assert trend_p_value(DAYS, values, np.full(60, np.nan)) == trend_p_value(DAYS, values)


def test_what_a_search_names_has_no_say() -> None:
    still = np.random.default_rng(10).standard_normal(60)
    for column in ("t2", "coulomb_friction_force"):
        named = rows({"/v": DAYS}, column)
        assert drifts(series_of(named)) == []
        assert drifts(series_of([{**row, "t2_before": value} for row, value in zip(named, still, strict=True)])) == []
    assert [one.quantity.name for one in effects_of(named)["/v"]] == ["coulomb_friction_force"]
