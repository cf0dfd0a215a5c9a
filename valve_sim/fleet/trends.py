"""Which valves drift: a test for trends in all quantities of all valves, with one false-alarm rate for the whole fleet.

The test is Mann and Kendall's: it asks whether later bags tend to show larger (or smaller) values, whatever the form of
the drift, and sees ranks alone, so that single bags cannot make or hide a trend. Values that resemble their neighbours
count for less. Slopes are Theil and Sen's: the median over all pairs of bags. All p-values of the
fleet are corrected together (Holm 1979): the probability that even one valve that does not drift is named is at most
`FALSE_ALARMS`, whatever the quantities have to do with each other.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from valve_sim.fleet.columns import Quantity, quantities
from valve_sim.fleet.units import EXAMINED, Row

FALSE_ALARMS: Final = 0.001
"""Probability that a fleet in which nothing drifts has any valve named."""
FEWEST: Final = 8
"""Bags of a valve below which no trend is looked for: with fewer, even a perfect order is chance too often."""
DAY: Final = 86400e9
"""ns."""
MOST_ALIKE: Final = 0.95
"""Autocorrelation beyond which a series says nothing about its own."""
MOST_PAIRED: Final = 1000
"""Bags of which all pairs are taken for the slope; of more, as many are taken evenly."""

Array = NDArray[np.float64]


class Series(NamedTuple):
    """A quantity of a valve over time: days since 1970, values and standard errors (nan where not known), (n,) each."""

    quantity: Quantity
    days: Array
    values: Array
    errors: Array


class Drift(NamedTuple):
    """A trend that was found.

    Attributes:
        series: in which. slope: per day, with its 95 % interval. p_value: of this series alone.
        adjusted: after correction for all that was tested; below `FALSE_ALARMS`.
    """

    valve: str
    series: Series
    slope: float
    low: float
    high: float
    p_value: float
    adjusted: float

    @property
    def change(self) -> float:
        """From the first bag to the last, along the slope."""
        return self.slope * float(np.ptp(self.series.days))


def series_of(rows: Iterable[Row]) -> dict[str, list[Series]]:
    """By valve, every quantity that was estimated in more than one bag and is not the same in all."""
    by_valve: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row["state"] == EXAMINED:
            by_valve[row["valve"]].append(row)
    found = {}
    for valve, own in sorted(by_valve.items()):
        own.sort(key=lambda row: (row["start_time"], row["source"]))
        candidates = (_series(quantity, own) for quantity in quantities())
        found[valve] = [one for one in candidates if len(one.values) > 1 and np.ptp(one.values) > 0.0]
    return found


def _series(quantity: Quantity, rows: Sequence[Row]) -> Series:
    own = [row for row in rows if row.get(quantity.name) is not None]
    days = np.array([row["start_time"] / DAY for row in own])
    values = np.array([row[quantity.name] for row in own], dtype=np.float64)
    errors = np.array([row.get(quantity.stderr) for row in own], dtype=np.float64)
    return Series(quantity, days, values, errors)


def drifts(series: Mapping[str, Sequence[Series]]) -> list[Drift]:
    """The trends of a fleet, the surest first."""
    tested = [(valve, one, trend_p_value(one.days, one.values)) for valve, own in series.items() for one in own]
    tested = [entry for entry in tested if not math.isnan(entry[2])]
    adjusted = holm([p_value for _, _, p_value in tested])
    found = [
        Drift(valve, one, *theil_sen(one.days, one.values), p_value, corrected)
        for (valve, one, p_value), corrected in zip(tested, adjusted, strict=True)
        if corrected < FALSE_ALARMS
    ]
    return sorted(found, key=lambda drift: drift.p_value)


def trend_p_value(days: Array, values: Array) -> float:
    """Of Mann and Kendall's test, two-sided; nan where there are too few values, or only one time.

    Args:
        days: (n,) when; of bags of one time the order does not matter.
        values: (n,).
    """
    if len(values) < FEWEST or np.ptp(days) == 0.0 or np.ptp(values) == 0.0:
        return math.nan
    p_value = float(stats.kendalltau(days, values).pvalue)
    inflation = _variance_inflation(days, values)
    if inflation <= 1.0:
        return p_value
    return float(2.0 * stats.norm.sf(stats.norm.isf(max(p_value, 1e-300) / 2.0) / math.sqrt(inflation)))


def _variance_inflation(days: Array, values: Array) -> float:
    """By how much values that resemble their neighbours make the statistic vary more: (1 + r)/(1 − r) of an AR(1).

    The autocorrelation r of the ranks of what a straight line leaves is corrected for its bias (Kendall 1954), and,
    where it is above 0, taken one standard error larger: measured, alarms are then as rare as is said from 60 bags on
    for r up to 0.7, and up to five times as frequent with 20.
    """
    count = len(values)
    slope = theil_sen(days, values)[0]
    ranks = stats.rankdata(values - slope * days)
    ranks = ranks - ranks.mean()
    found = float(ranks[1:] @ ranks[:-1]) / max(float(ranks @ ranks), 1e-300)
    likeness = min((found + 2.0 / count) / (1.0 - 4.0 / count), MOST_ALIKE)
    if likeness <= 0.0:
        return 1.0
    likeness = min(likeness + math.sqrt((1.0 - likeness**2) / count), MOST_ALIKE)
    return (1.0 + likeness) / (1.0 - likeness)


def theil_sen(days: Array, values: Array) -> tuple[float, float, float]:
    """Slope per day, and its 95 % interval."""
    if len(values) > MOST_PAIRED:
        chosen = np.linspace(0, len(values) - 1, MOST_PAIRED).astype(np.intp)
        days, values = days[chosen], values[chosen]
    found = stats.theilslopes(values, days - days[0])
    return float(found.slope), float(found.low_slope), float(found.high_slope)


def holm(p_values: Sequence[float]) -> list[float]:
    """Corrected so that each may be compared with the rate of false alarms of all of them together."""
    adjusted, largest = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted
