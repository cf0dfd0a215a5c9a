"""What the sensors show within a step, read from its polynomials: behind a low-pass, with derivatives, in whole rows.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.core import layout as at
from valve_sim.model.core.polynomials import Block, invoke, value_at

ROW_COLUMNS: Final = 9
GAS_COLUMNS: Final = ROW_COLUMNS + 2
"""Of a whole row of output: pilot and main plunger as shown, m; velocity, m/s; attraction, N; phase; the pilot itself,
m; V at the terminals; the current u, and in A; with gas the outlet's pressure, Pa, and the mass flow, kg/s."""
UPWARDS: Final = 6.0
"""Time constants of the low-pass above which its moments are found upwards; so neither way loses two digits."""
NEGLIGIBLE: Final = 1e-17
"""Of a sum: a term that ends its series."""


def lag_moments(b: float, into: Block) -> None:
    """Moments M_k = ∫ e^{−b(1−φ)} φᵏ b dφ over φ from 0 to 1, of a low-pass after b time constants; k to ORDER.

    They obey M_k = 1 − (k/b) M_{k−1}: used upwards where b is large, and downwards from a series of positive terms
    where it is small, so that rounding errors shrink.
    """
    if b > UPWARDS:
        into[0] = -math.expm1(-b)
        for k in range(1, at.ORDER + 1):
            into[k] = 1.0 - k / b * into[k - 1]
        return
    term = b * math.exp(-b)
    total = 0.0
    j = 0
    while j < b or term > NEGLIGIBLE * total:
        total += term / (at.ORDER + 1 + j)
        j += 1
        term *= b / j
    into[at.ORDER] = total
    for k in range(at.ORDER, 0, -1):
        into[k - 1] = (1.0 - into[k]) * b / k


def lagged(b: Block, h: float, shown: float, offset: float) -> float:
    """What the low-pass of a sensor shows of x − offset at h since the start of the step, m; exact for its polynomial.

    Args:
        shown: m, at the start of the step.
    """
    moments = b[at.SCRATCH + at.TERMS :]
    rate = h / b[at.SENSOR_LAG]
    lag_moments(rate, moments)
    power = 1.0
    total: float = (b[at.SERIES_X] - offset) * moments[0]
    for k in range(1, at.ORDER + 1):
        power *= h
        total += b[at.SERIES_X + k] * power * moments[k]
    return shown * math.exp(-rate) + total


def lag_tangents(b: Block, t: Block, h: float, k: int) -> None:
    """Advance the tangents, in direction k, of what the sensors show to h since the start of the step.

    The moments must be those of h, as `lagged` leaves them, and h above 0. By M_k' = 1 − M_k (1 + k/b), the derivative
    of a moment by the time constants b that have passed.
    """
    width = int(b[at.WIDTH])
    moments = b[at.SCRATCH + at.TERMS :]
    rate = h / b[at.SENSOR_LAG]
    left = math.exp(-rate)
    moved = 0.0
    slope = 0.0
    power = 1.0
    for j in range(at.ORDER + 1):
        moved += t[(at.SERIES_X + j) * width + k] * power * moments[j]
        slope += b[at.SERIES_X + j] * power * (1.0 - moments[j] * (1.0 + j / rate))
        power *= h
    longer = -rate / b[at.SENSOR_LAG] * t[at.SENSOR_LAG * width + k]
    pilot = at.SHOWN_PILOT * width + k
    t[pilot] = left * t[pilot] + moved + longer * (slope - left * b[at.SHOWN_PILOT])
    main = at.SHOWN_MAIN * width + k
    if b[at.LIFTED] > 0.0:
        moved -= t[at.GAP * width + k] * moments[0]
        slope -= b[at.GAP] * (1.0 - moments[0])
    else:
        moved = 0.0
        slope = 0.0
    t[main] = left * t[main] + moved + longer * (slope - left * b[at.SHOWN_MAIN])


def shown_pilot(b: Block, h: float) -> float:
    """What the sensor of the pilot plunger shows at h since the start of the step, m, without gain."""
    if b[at.SENSOR_LAG] > 0.0:
        return lagged(b, h, b[at.SHOWN_PILOT], 0.0)
    return value_at(b, at.SERIES_X, h, at.ORDER + 1)


def shown_main(b: Block, h: float) -> float:
    """The position of the main plunger as its sensor shows it, at h after the beginning of the step, m."""
    if b[at.LIFTED] == 0.0:
        return b[at.SHOWN_MAIN] * math.exp(-h / b[at.SENSOR_LAG]) if b[at.SENSOR_LAG] > 0.0 else 0.0
    if b[at.SENSOR_LAG] > 0.0:
        return lagged(b, h, b[at.SHOWN_MAIN], b[at.GAP])
    return float(value_at(b, at.SERIES_X, h, at.ORDER + 1) - b[at.GAP])


def fill(
    b: Block, t: Block, last: float, times: Block, count: int, rows: Block, columns: int, slopes: Block,
    current_times: Block, current_count: int, currents: Block, current_slopes: Block,
) -> None:  # fmt: skip
    """Write the samples of the step up to `last`, s: positions late by the sensor's delay, all else not."""
    start = b[at.TIME]
    delay = b[at.DELAY]
    first = int(b[at.SAMPLED])
    end = first
    while end < count and times[end] - b[at.DELAY] <= last:
        end += 1
    if end > first:
        if columns == 1 and b[at.SENSOR_LAG] == 0.0:
            fill_positions(b, times, first, end, rows)
        else:
            for i in range(first, end):
                h = max(0.0, times[i] - delay - start)
                row = rows[i * columns :]
                row[0] = b[at.GAIN] * shown_pilot(b, h)
                if columns > 1:
                    row[1] = b[at.GAIN] * shown_main(b, h)
        if b[at.WIDTH] > 0.0:
            fill_slopes(b, t, times, first, end, slopes)
        b[at.SAMPLED] = end
    if columns > 1 or current_count > 0:
        fill_others(b, t, last, times, count, rows, columns, current_times, current_count, currents, current_slopes)


def fill_others(
    b: Block, t: Block, last: float, times: Block, count: int, rows: Block, columns: int, current_times: Block,
    current_count: int, currents: Block, current_slopes: Block,
) -> None:  # fmt: skip
    """Write all but positions of the samples up to `last`: whole rows, or the current."""
    first = int(b[at.SAMPLED_ROWS])
    end = first
    if columns > 1:
        while end < count and times[end] <= last:
            end += 1
        fill_rows(b, t, times, first, end, rows, columns)
    else:
        while end < current_count and current_times[end] <= last:
            end += 1
        fill_currents(b, t, current_times, first, end, currents, current_slopes)
    b[at.SAMPLED_ROWS] = end


def fill_slopes(b: Block, t: Block, times: Block, first: int, end: int, slopes: Block) -> None:
    """Write the tangents of the positions of some samples, as the sensor shows them."""
    width = int(b[at.WIDTH])
    start = b[at.TIME]
    delay = b[at.DELAY]
    lag = b[at.SENSOR_LAG]
    for i in range(first, end):
        out = slopes[i * width :]
        h = max(0.0, times[i] - delay - start)
        b[at.ELAPSED] = h
        shown = b[at.X]
        speed = 0.0
        of_shown = at.X * width
        if lag > 0.0 or b[at.MOVING] > 0.0:
            invoke(b[at.SPOT], b, t)
            shown = b[at.ROW_X]
            speed = b[at.ROW_V]
            of_shown = at.ROW_X * width
        if lag > 0.0:
            x = shown
            shown = shown_pilot(b, h)
            speed = (x - shown) / lag
            for k in range(width):
                before = t[at.SHOWN_PILOT * width + k]
                main = t[at.SHOWN_MAIN * width + k]
                if h > 0.0:
                    lag_tangents(b, t, h, k)
                t[at.ROW_X * width + k] = t[at.SHOWN_PILOT * width + k]
                t[at.SHOWN_PILOT * width + k] = before
                t[at.SHOWN_MAIN * width + k] = main
        for k in range(width):
            later = t[at.LATE * width + k] - t[at.DELAY * width + k]
            out[k] = b[at.GAIN] * (t[of_shown + k] + speed * later) + t[at.GAIN * width + k] * shown


def fill_positions(b: Block, times: Block, first: int, end: int, rows: Block) -> None:
    """Write positions alone, of a sensor that filters nothing: most of what a fit asks for."""
    start = b[at.TIME]
    delay = b[at.DELAY]
    gain = b[at.GAIN]
    if b[at.MOVING] == 0.0:
        shown = gain * b[at.X]
        for i in range(first, end):
            rows[i] = shown
        return
    c = b[at.SERIES_X :]
    c0 = c[0]
    c1 = c[1]
    c2 = c[2]
    c3 = c[3]
    c4 = c[4]
    c5 = c[5]
    c6 = c[6]
    c7 = c[7]
    c8 = c[8]
    c9 = c[9]
    c10 = c[10]
    c11 = c[11]
    c12 = c[12]
    c13 = c[13]
    c14 = c[14]
    for i in range(first, end):
        h = max(0.0, times[i] - delay - start)
        high = c7 + h * (c8 + h * (c9 + h * (c10 + h * (c11 + h * (c12 + h * (c13 + h * c14))))))
        rows[i] = gain * (c0 + h * (c1 + h * (c2 + h * (c3 + h * (c4 + h * (c5 + h * (c6 + h * high)))))))


def fill_currents(b: Block, t: Block, times: Block, first: int, end: int, currents: Block, slopes: Block) -> None:
    """Write the currents u of some samples, and of gas the pressures of the outlet, with their tangents."""
    width = int(b[at.WIDTH])
    for i in range(first, end):
        b[at.ELAPSED] = max(0.0, times[i] - b[at.TIME])
        invoke(b[at.ROW], b, t)
        if b[at.DENSITY] > 0.0:
            currents[2 * i] = b[at.CURRENT]
            currents[2 * i + 1] = b[at.OUTLET]
            out = slopes[2 * i * width :]
            for k in range(width):
                out[width + k] = t[at.OUTLET * width + k] + b[at.OUTLET_RATE] * t[at.LATE * width + k]
        else:
            currents[i] = b[at.CURRENT]
            out = slopes[i * width :]
        for k in range(width):
            out[k] = t[at.CURRENT * width + k] + b[at.CURRENT_RATE] * t[at.LATE * width + k]


def fill_rows(b: Block, t: Block, times: Block, first: int, end: int, rows: Block, columns: int) -> None:
    """Write whole rows of some samples, but for the positions that sensors show."""
    for i in range(first, end):
        b[at.ELAPSED] = max(0.0, times[i] - b[at.TIME])
        fill_row(b, t, rows[i * columns :])


def fill_row(b: Block, t: Block, row: Block) -> None:
    """Write a whole row at the time `elapsed` of the step, but for the positions that sensors show."""
    invoke(b[at.ROW], b, t)
    row[2] = b[at.ROW_V]
    row[3] = b[at.PULL]
    row[4] = b[at.MODE]
    row[5] = b[at.ROW_X]
    row[6] = b[at.TERMINAL]
    row[7] = b[at.CURRENT]
    row[8] = b[at.CURRENT] * b[at.RATED]
    if b[at.DENSITY] > 0.0:
        row[9] = b[at.OUTLET]
        row[10] = b[at.MASS_FLOW]


FUNCTIONS: Final = (
    lag_moments, lagged, lag_tangents, shown_pilot, shown_main, fill, fill_others, fill_slopes, fill_positions,
    fill_currents, fill_rows, fill_row,
)  # fmt: skip
"""What is compiled."""
