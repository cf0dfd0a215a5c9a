"""What the sensors show within a step, read from its polynomials: behind a low-pass, with derivatives, in whole rows.

Functions of the small language of `lowering`; `driver` says what `b` and `t` are.
"""

from __future__ import annotations

import math
from typing import Final

from valve_sim.model.core.layout import (
    CURRENT,
    CURRENT_RATE,
    DELAY,
    DENSITY,
    ELAPSED,
    GAIN,
    GAP,
    LATE,
    LIFTED,
    MODE,
    MOVING,
    ORDER,
    OUTLET,
    OUTLET_RATE,
    RATED,
    ROW,
    ROW_V,
    ROW_X,
    ROWS,
    ROWS_AT,
    ROWS_LANES,
    SAMPLED,
    SAMPLED_ROWS,
    SCRATCH,
    SENSOR_LAG,
    SERIES_X,
    SHOWN_MAIN,
    SHOWN_PILOT,
    SPOT,
    TERMS,
    TIME,
    WIDTH,
    X,
)  # fmt: skip
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
        for k in range(1, ORDER + 1):
            into[k] = 1.0 - k / b * into[k - 1]
        return
    term = b * math.exp(-b)
    total = 0.0
    j = 0
    while j < b or term > NEGLIGIBLE * total:
        total += term / (ORDER + 1 + j)
        j += 1
        term *= b / j
    into[ORDER] = total
    for k in range(ORDER, 0, -1):
        into[k - 1] = (1.0 - into[k]) * b / k


def lagged(b: Block, h: float, shown: float, offset: float) -> float:
    """What the low-pass of a sensor shows of x − offset at h since the start of the step, m; exact for its polynomial.

    Args:
        shown: m, at the start of the step.
    """
    moments = b[SCRATCH + TERMS :]
    rate = h / b[SENSOR_LAG]
    lag_moments(rate, moments)
    power = 1.0
    total: float = (b[SERIES_X] - offset) * moments[0]
    for k in range(1, ORDER + 1):
        power *= h
        total += b[SERIES_X + k] * power * moments[k]
    return shown * math.exp(-rate) + total


def lag_tangents(b: Block, t: Block, h: float, k: int) -> None:
    """Advance the tangents, in direction k, of what the sensors show to h since the start of the step.

    The moments must be those of h, as `lagged` leaves them, and h above 0. By M_k' = 1 − M_k (1 + k/b), the derivative
    of a moment by the time constants b that have passed.
    """
    width = int(b[WIDTH])
    moments = b[SCRATCH + TERMS :]
    rate = h / b[SENSOR_LAG]
    left = math.exp(-rate)
    moved = 0.0
    slope = 0.0
    power = 1.0
    for j in range(ORDER + 1):
        moved += t[(SERIES_X + j) * width + k] * power * moments[j]
        slope += b[SERIES_X + j] * power * (1.0 - moments[j] * (1.0 + j / rate))
        power *= h
    longer = -rate / b[SENSOR_LAG] * t[SENSOR_LAG * width + k]
    pilot = SHOWN_PILOT * width + k
    t[pilot] = left * t[pilot] + moved + longer * (slope - left * b[SHOWN_PILOT])
    main = SHOWN_MAIN * width + k
    if b[LIFTED] > 0.0:
        moved -= t[GAP * width + k] * moments[0]
        slope -= b[GAP] * (1.0 - moments[0])
    else:
        moved = 0.0
        slope = 0.0
    t[main] = left * t[main] + moved + longer * (slope - left * b[SHOWN_MAIN])


def shown_pilot(b: Block, h: float) -> float:
    """What the sensor of the pilot plunger shows at h since the start of the step, m, without gain."""
    if b[SENSOR_LAG] > 0.0:
        return lagged(b, h, b[SHOWN_PILOT], 0.0)
    return value_at(b, SERIES_X, h, ORDER + 1)


def shown_main(b: Block, h: float) -> float:
    """The position of the main plunger as its sensor shows it, at h after the beginning of the step, m."""
    if b[LIFTED] == 0.0:
        return b[SHOWN_MAIN] * math.exp(-h / b[SENSOR_LAG]) if b[SENSOR_LAG] > 0.0 else 0.0
    if b[SENSOR_LAG] > 0.0:
        return lagged(b, h, b[SHOWN_MAIN], b[GAP])
    return float(value_at(b, SERIES_X, h, ORDER + 1) - b[GAP])


def fill(
    b: Block, t: Block, last: float, times: Block, count: int, rows: Block, columns: int, slopes: Block,
    current_times: Block, current_count: int, currents: Block, current_slopes: Block,
) -> None:  # fmt: skip
    """Write the samples of the step up to `last`, s: positions late by the sensor's delay, all else not."""
    start = b[TIME]
    delay = b[DELAY]
    first = int(b[SAMPLED])
    end = first
    while end < count and times[end] - b[DELAY] <= last:
        end += 1
    if end > first:
        if columns == 1 and b[SENSOR_LAG] == 0.0:
            fill_positions(b, times, first, end, rows)
        else:
            for i in range(first, end):
                h = max(0.0, times[i] - delay - start)
                row = rows[i * columns :]
                row[0] = b[GAIN] * shown_pilot(b, h)
                if columns > 1:
                    row[1] = b[GAIN] * shown_main(b, h)
        if b[WIDTH] > 0.0:
            fill_slopes(b, t, times, first, end, slopes)
        b[SAMPLED] = end
    if columns > 1 or current_count > 0:
        fill_others(b, t, last, times, count, rows, columns, current_times, current_count, currents, current_slopes)


def fill_others(
    b: Block, t: Block, last: float, times: Block, count: int, rows: Block, columns: int, current_times: Block,
    current_count: int, currents: Block, current_slopes: Block,
) -> None:  # fmt: skip
    """Write all but positions of the samples up to `last`: whole rows, or the current."""
    first = int(b[SAMPLED_ROWS])
    end = first
    if columns > 1:
        while end < count and times[end] <= last:
            end += 1
        fill_whole_rows(b, t, times, first, end, rows, columns)
    else:
        while end < current_count and current_times[end] <= last:
            end += 1
        if b[WIDTH] > 0.0:
            fill_sloped_currents(b, t, current_times, first, end, currents, current_slopes)
        else:
            fill_currents(b, t, current_times, first, end, currents)
    b[SAMPLED_ROWS] = end


def fill_slopes(b: Block, t: Block, times: Block, first: int, end: int, slopes: Block) -> None:
    """Write the tangents of the positions of some samples, as the sensor shows them."""
    width = int(b[WIDTH])
    start = b[TIME]
    delay = b[DELAY]
    lag = b[SENSOR_LAG]
    for i in range(first, end):
        out = slopes[i * width :]
        h = max(0.0, times[i] - delay - start)
        b[ELAPSED] = h
        shown = b[X]
        speed = 0.0
        of_shown = X * width
        if lag > 0.0 or b[MOVING] > 0.0:
            invoke(b[SPOT], b, t)
            shown = b[ROW_X]
            speed = b[ROW_V]
            of_shown = ROW_X * width
        if lag > 0.0:
            x = shown
            shown = shown_pilot(b, h)
            speed = (x - shown) / lag
            for k in range(width):
                before = t[SHOWN_PILOT * width + k]
                main = t[SHOWN_MAIN * width + k]
                if h > 0.0:
                    lag_tangents(b, t, h, k)
                t[ROW_X * width + k] = t[SHOWN_PILOT * width + k]
                t[SHOWN_PILOT * width + k] = before
                t[SHOWN_MAIN * width + k] = main
        for k in range(width):
            later = t[LATE * width + k] - t[DELAY * width + k]
            out[k] = b[GAIN] * (t[of_shown + k] + speed * later) + t[GAIN * width + k] * shown


def fill_positions(b: Block, times: Block, first: int, end: int, rows: Block) -> None:
    """Write positions alone, of a sensor that filters nothing: most of what a fit asks for."""
    start = b[TIME]
    delay = b[DELAY]
    gain = b[GAIN]
    if b[MOVING] == 0.0:
        shown = gain * b[X]
        for i in range(first, end):
            rows[i] = shown
        return
    c = b[SERIES_X:]
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


def fill_sloped_currents(
    b: Block, t: Block, times: Block, first: int, end: int, currents: Block, slopes: Block
) -> None:
    """Write the currents u of some samples, and their tangents."""
    width = int(b[WIDTH])
    for i in range(first, end):
        b[ELAPSED] = max(0.0, times[i] - b[TIME])
        invoke(b[ROW], b, t)
        if b[DENSITY] > 0.0:
            currents[2 * i] = b[CURRENT]
            currents[2 * i + 1] = b[OUTLET]
            out = slopes[2 * i * width :]
            for k in range(width):
                out[width + k] = t[OUTLET * width + k] + b[OUTLET_RATE] * t[LATE * width + k]
        else:
            currents[i] = b[CURRENT]
            out = slopes[i * width :]
        for k in range(width):
            out[k] = t[CURRENT * width + k] + b[CURRENT_RATE] * t[LATE * width + k]


def fill_currents(b: Block, t: Block, times: Block, first: int, end: int, currents: Block) -> None:
    """Write the currents u of some samples, ROWS_LANES of them at once; what is left over of these is the last one."""
    for i in range(first, end, ROWS_LANES):
        for lane in range(ROWS_LANES):
            b[ROWS + lane] = max(0.0, times[min(i + lane, end - 1)] - b[TIME])
        invoke(b[ROWS_AT], b, t)
        for lane in range(min(ROWS_LANES, end - i)):
            if b[DENSITY] > 0.0:
                currents[2 * (i + lane)] = b[ROWS + 5 * ROWS_LANES + lane]
                currents[2 * (i + lane) + 1] = b[ROWS + 6 * ROWS_LANES + lane]
            else:
                currents[i + lane] = b[ROWS + 5 * ROWS_LANES + lane]


def fill_whole_rows(b: Block, t: Block, times: Block, first: int, end: int, rows: Block, columns: int) -> None:
    """Write whole rows of some samples, ROWS_LANES of them at once; what is left over of these is the last one."""
    for i in range(first, end, ROWS_LANES):
        for lane in range(ROWS_LANES):
            b[ROWS + lane] = max(0.0, times[min(i + lane, end - 1)] - b[TIME])
        invoke(b[ROWS_AT], b, t)
        for lane in range(min(ROWS_LANES, end - i)):
            shown = b[ROWS + lane :]
            row = rows[(i + lane) * columns :]
            row[5] = shown[ROWS_LANES]
            row[2] = shown[2 * ROWS_LANES]
            row[3] = shown[3 * ROWS_LANES]
            row[4] = b[MODE]
            row[6] = shown[4 * ROWS_LANES]
            row[7] = shown[5 * ROWS_LANES]
            row[8] = shown[5 * ROWS_LANES] * b[RATED]
            if b[DENSITY] > 0.0:
                row[9] = shown[6 * ROWS_LANES]
                row[10] = shown[7 * ROWS_LANES]


FUNCTIONS: Final = (
    lag_moments, lagged, lag_tangents, shown_pilot, shown_main, fill, fill_others, fill_slopes, fill_positions,
    fill_sloped_currents, fill_currents, fill_whole_rows,
)  # fmt: skip
"""What is compiled."""
