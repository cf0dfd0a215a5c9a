"""Which valve drifts, and how often one is named that does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from valve_sim.fleet.trends import DAY, FALSE_ALARMS, drifts, holm, series_of, theil_sen, trend_p_value
from valve_sim.fleet.units import Row

DAYS = np.arange(60.0)


def rows(values: dict[str, np.ndarray], quantity: str = "t2") -> list[Row]:
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
    assert (drift.valve, drift.series.quantity.name) == ("/v7", "t2")
    assert drift.low < 1e-6 < drift.high
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
    assert theil_sen(DAYS, values)[0] == pytest.approx(0.5)
