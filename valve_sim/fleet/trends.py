"""Which valves drift: a test for trends in all quantities of all valves, with one false-alarm rate for the whole fleet.

The test takes the values of the declared valve, refitted to each bag in the same way. What this model lacks is the same
in all bags of a valve, and cancels. The names that a search finds have no influence.

The test is of the slope of a straight line over the order of the bags: a robust fit (Huber's, 1964, with his correction
of the variance), in which bags count by their standard errors, and what lies far off counts no more than what lies just
outside; the scatter is that of the bags themselves. Single bags cannot make or hide a trend, and neither can one that
comes much later than all others. Values that resemble their neighbours count for less. Slopes that are shown are Theil
and Sen's: the median over all pairs of bags. All p-values of the fleet are corrected together (Holm 1979): the
probability that even one valve that does not drift is named is at most `FALSE_ALARMS`, whatever the quantities have to
do with each other.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from valve_sim.fleet.columns import Quantity, effect_quantities, followed
from valve_sim.fleet.units import EXAMINED, Row

FALSE_ALARMS: Final = 0.001
"""Probability that a fleet in which nothing drifts has any valve named."""
FEWEST: Final = 8
"""Bags of a valve below which no trend is looked for: with fewer, even a perfect order is chance too often."""
DAY: Final = 86400e9
"""ns."""
MOST_ALIKE: Final = 0.95
"""Autocorrelation beyond which a series says nothing about its own."""
FAR_OFF: Final = (2.0, 40.0)
"""Scatters from the line beyond which a bag counts no more: the first, and the second by the number of bags. Of few
bags the scatter is not known well enough to cut closer: with 2 alone, 10 bags alarm four times as often as they may."""
LEAST_WEIGHT, MOST_WEIGHT = 0.5, 2.0
"""Standard errors count from half to twice their median: bags scatter by more than what each says of itself."""
STEPS: Final = 50
"""Of the robust fit at most."""
BENT_FROM: Final = 20
"""Bags from which on the likeness of neighbours is that of what a parabola leaves: a drift is seldom straight."""
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
    """A trend: its slope per day, the p-value of its series alone, and that after correction for all series."""

    valve: str
    series: Series
    slope: float
    p_value: float
    adjusted: float

    @property
    def change(self) -> float:
        """From the first bag to the last, along the slope."""
        return self.slope * float(np.ptp(self.series.days))


def series_of(rows: Iterable[Row]) -> dict[str, list[Series]]:
    """By valve, every quantity that is followed, was estimated in more than one bag and is not the same in all."""
    return {valve: _all_series(followed(), own) for valve, own in _by_valve(rows).items()}


def effects_of(rows: Iterable[Row]) -> dict[str, list[Series]]:
    """By valve, the sizes of the effects that were named in more than one bag: to be shown, not tested.

    An effect is named where it is large enough; that it was not says nothing of its size.
    """
    return {valve: _all_series(effect_quantities(), own) for valve, own in _by_valve(rows).items()}


def _by_valve(rows: Iterable[Row]) -> dict[str, list[Row]]:
    by_valve: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        if row["state"] == EXAMINED:
            by_valve[row["valve"]].append(row)
    for own in by_valve.values():
        own.sort(key=lambda row: (row["start_time"], row["source"]))
    return dict(sorted(by_valve.items()))


def _all_series(wanted: Iterable[Quantity], rows: Sequence[Row]) -> list[Series]:
    candidates = (_series(quantity, rows) for quantity in wanted)
    return [one for one in candidates if len(one.values) > 1 and np.ptp(one.values) > 0.0]


def _series(quantity: Quantity, rows: Sequence[Row]) -> Series:
    own = [row for row in rows if row.get(quantity.name) is not None]
    days = np.array([row["start_time"] / DAY for row in own])
    values = np.array([row[quantity.name] for row in own], dtype=np.float64)
    errors = np.array([row.get(quantity.stderr) for row in own], dtype=np.float64)
    return Series(quantity, days, values, errors)


def drifts(series: Mapping[str, Sequence[Series]]) -> list[Drift]:
    """The trends of a fleet, the surest first."""
    tested = [
        (valve, one, trend_p_value(one.days, one.values, one.errors)) for valve, own in series.items() for one in own
    ]
    tested = [entry for entry in tested if not math.isnan(entry[2])]
    adjusted = holm([p_value for _, _, p_value in tested])
    found = [
        Drift(valve, one, theil_sen(one.days, one.values), p_value, corrected)
        for (valve, one, p_value), corrected in zip(tested, adjusted, strict=True)
        if corrected < FALSE_ALARMS
    ]
    return sorted(found, key=lambda drift: drift.p_value)


def trend_p_value(days: Array, values: Array, errors: Array | None = None) -> float:
    """That a slope as steep as this is chance, two-sided; nan where there are too few values, or only one time.

    Args:
        days: (n,) when, in order; of bags of one time the order does not matter.
        values: (n,). errors: (n,) their standard errors, nan where not known; default all alike.
    """
    count = len(values)
    if count < FEWEST or np.ptp(days) == 0.0 or np.ptp(values) == 0.0:
        return math.nan
    steepness, left = _steepness(stats.rankdata(days), values, _scales(errors, count))
    return float(2.0 * stats.t.sf(abs(steepness) / math.sqrt(_variance_inflation(left)), count - 2))


def _scales(errors: Array | None, count: int) -> Array:
    """Standard errors as weights need them: by their median, none of them far from it."""
    known = np.full(count, math.nan) if errors is None else np.where(np.greater(errors, 0.0), errors, math.nan)
    if np.isnan(known).all():
        return np.ones(count)
    relative = known / np.nanmedian(known)
    return np.clip(np.where(np.isnan(relative), 1.0, relative), LEAST_WEIGHT, MOST_WEIGHT)


def _steepness(places: Array, values: Array, scales: Array) -> tuple[float, Array]:
    """The slope by its standard error, and what the line leaves, by its scales and cut where it is far off, (n,)."""
    count = len(values)
    slope = theil_sen(places, values)
    left = (values - slope * places - np.median(values - slope * places)) / scales
    scatter = _scatter(left)
    cut = scatter * (FAR_OFF[0] + FAR_OFF[1] / count)
    for _ in range(STEPS):
        weights = cut / np.maximum(np.abs(left), cut) / np.square(scales)
        slope, level = _line(places, values, weights)
        before, left = left, (values - level - slope * places) / scales
        if np.abs(left - before).max() <= 1e-6 * scatter:
            break
    inside = float(np.mean(np.abs(left) <= cut))
    left = np.clip(left, -cut, cut)
    correction = (1.0 + 2.0 / count * (1.0 - inside) / inside) / inside if inside > 0.0 else math.inf
    variance = correction**2 * float(left @ left) / (count - 2)
    whole = 1.0 / np.square(scales)
    spread = float(whole @ np.square(places - whole @ places / whole.sum()))
    error = math.sqrt(variance / spread)
    return (slope / error if error > 0.0 else math.inf), left


def _line(places: Array, values: Array, weights: Array) -> tuple[float, float]:
    """Slope of the weighted least-squares line, and its value at place 0."""
    weights = weights / weights.sum()
    away = places - weights @ places
    slope = float((weights * away) @ values / (weights @ np.square(away)))
    return slope, float(weights @ values - slope * (weights @ places))


def _scatter(left: Array) -> float:
    """Standard deviation about a line, from the median; where more than half of all lie on it, from all."""
    spread = 1.4826 * float(np.median(np.abs(left))) or float(np.sqrt(np.mean(np.square(left))))
    return max(spread * math.sqrt(len(left) / (len(left) - 2)), 1e-300)


def _variance_inflation(left: Array) -> float:
    """By how much values that resemble their neighbours make a slope vary more: (1 + r)/(1 − r) of an AR(1).

    The autocorrelation r of the ranks of what a smooth curve leaves is corrected for its bias (Kendall 1954), and,
    where it is above 0, taken one standard error larger: measured, alarms are then as rare as is said for r up to 0.4,
    and for 0.7 twice as frequent with 60 bags, four times with 20.
    """
    count = len(left)
    degree = 2 if count >= BENT_FROM else 1
    curve = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, count), degree)
    ranks = stats.rankdata(left - curve @ np.linalg.lstsq(curve, left, rcond=None)[0])
    ranks = ranks - ranks.mean()
    found = float(ranks[1:] @ ranks[:-1]) / max(float(ranks @ ranks), 1e-300)
    likeness = min((found + (degree + 1) / count) / (1.0 - (degree + 3) / count), MOST_ALIKE)
    if likeness <= 0.0:
        return 1.0
    likeness = min(likeness + math.sqrt((1.0 - likeness**2) / count), MOST_ALIKE)
    return (1.0 + likeness) / (1.0 - likeness)


def theil_sen(days: Array, values: Array) -> float:
    """Slope per day: the median over all pairs."""
    if len(values) > MOST_PAIRED:
        chosen = np.linspace(0, len(values) - 1, MOST_PAIRED).astype(np.intp)
        days, values = days[chosen], values[chosen]
    return float(stats.theilslopes(values, days - days[0]).slope)


def holm(p_values: Sequence[float]) -> list[float]:
    """Corrected so that each may be compared with the rate of false alarms of all of them together."""
    adjusted, largest = [1.0] * len(p_values), 0.0
    for rank, index in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted
