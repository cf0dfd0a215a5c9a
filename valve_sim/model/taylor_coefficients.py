"""The recurrences of `taylor_series`, written out by `test/model/taylor_source.py`, which says why.

Not to be edited.
"""

# fmt: off
# ruff: noqa: PLR0915

from __future__ import annotations

from typing import Final

from valve_sim.model.compiling import inner

ORDER: Final = 14
"""Of x in a step."""


@inner
def coefficients(series, velocity_series, start, current, attraction, motion):
    """Write the series of x, m/s^k, and of v.

    Here `q` is a1 + a2 x + a3 x², `g` the bracket of (2), `w` the current that pulls and `s` its square.

    Args:
        start: x and v, m and m/s. current: (T, A, 1/τ, B, 1/τ_e). attraction: (a0, a1, a2, a3).
        motion: (L, r, c, 1/m), N, N/m, N·s/m, 1/kg.
    """
    x_0, x_1 = start
    target, a_0, rate, b_0, eddy_rate = current
    a0, a1, a2, a3 = attraction
    load, spring, damping, per_mass = motion
    w_0 = target + a_0 + b_0
    s_0 = w_0 * w_0
    q_0 = a2 * x_0 + a3 * (x_0 * x_0) + a1
    g_0 = x_0 * q_0 + a0
    f_0 = s_0 * g_0 - load
    x_2 = (f_0 - spring * x_0 - damping * 1.0 * x_1) * (per_mass * 0.5)
    a_1 = -a_0 * rate * 1.0
    b_1 = -b_0 * eddy_rate * 1.0
    w_1 = a_1 + b_1
    s_1 = 2.0 * (w_0 * w_1)
    q_1 = a2 * x_1 + a3 * (2.0 * (x_0 * x_1))
    g_1 = x_1 * q_0 + x_0 * q_1
    f_1 = s_1 * g_0 + s_0 * g_1
    x_3 = (f_1 - spring * x_1 - damping * 2.0 * x_2) * (per_mass * 0.16666666666666666)
    a_2 = -a_1 * rate * 0.5
    b_2 = -b_1 * eddy_rate * 0.5
    w_2 = a_2 + b_2
    s_2 = w_1 * w_1 + 2.0 * (w_0 * w_2)
    q_2 = a2 * x_2 + a3 * (x_1 * x_1 + 2.0 * (x_0 * x_2))
    g_2 = x_1 * q_1 + x_2 * q_0 + x_0 * q_2
    f_2 = s_1 * g_1 + s_2 * g_0 + s_0 * g_2
    x_4 = (f_2 - spring * x_2 - damping * 3.0 * x_3) * (per_mass * 0.08333333333333333)
    a_3 = -a_2 * rate * 0.3333333333333333
    b_3 = -b_2 * eddy_rate * 0.3333333333333333
    w_3 = a_3 + b_3
    s_3 = 2.0 * (w_1 * w_2 + w_0 * w_3)
    q_3 = a2 * x_3 + a3 * (2.0 * (x_1 * x_2 + x_0 * x_3))
    g_3 = x_1 * q_2 + x_2 * q_1 + x_3 * q_0 + x_0 * q_3
    f_3 = s_1 * g_2 + s_2 * g_1 + s_3 * g_0 + s_0 * g_3
    x_5 = (f_3 - spring * x_3 - damping * 4.0 * x_4) * (per_mass * 0.05)
    a_4 = -a_3 * rate * 0.25
    b_4 = -b_3 * eddy_rate * 0.25
    w_4 = a_4 + b_4
    s_4 = w_2 * w_2 + 2.0 * (w_1 * w_3 + w_0 * w_4)
    q_4 = a2 * x_4 + a3 * (x_2 * x_2 + 2.0 * (x_1 * x_3 + x_0 * x_4))
    g_4 = x_1 * q_3 + x_2 * q_2 + x_3 * q_1 + x_4 * q_0 + x_0 * q_4
    f_4 = s_1 * g_3 + s_2 * g_2 + s_3 * g_1 + s_4 * g_0 + s_0 * g_4
    x_6 = (f_4 - spring * x_4 - damping * 5.0 * x_5) * (per_mass * 0.03333333333333333)
    a_5 = -a_4 * rate * 0.2
    b_5 = -b_4 * eddy_rate * 0.2
    w_5 = a_5 + b_5
    s_5 = 2.0 * (w_2 * w_3 + w_1 * w_4 + w_0 * w_5)
    q_5 = a2 * x_5 + a3 * (2.0 * (x_2 * x_3 + x_1 * x_4 + x_0 * x_5))
    g_5 = x_1 * q_4 + x_2 * q_3 + x_3 * q_2 + x_4 * q_1 + x_5 * q_0 + x_0 * q_5
    f_5 = s_1 * g_4 + s_2 * g_3 + s_3 * g_2 + s_4 * g_1 + s_5 * g_0 + s_0 * g_5
    x_7 = (f_5 - spring * x_5 - damping * 6.0 * x_6) * (per_mass * 0.023809523809523808)
    a_6 = -a_5 * rate * 0.16666666666666666
    b_6 = -b_5 * eddy_rate * 0.16666666666666666
    w_6 = a_6 + b_6
    s_6 = w_3 * w_3 + 2.0 * (w_2 * w_4 + w_1 * w_5 + w_0 * w_6)
    q_6 = a2 * x_6 + a3 * (x_3 * x_3 + 2.0 * (x_2 * x_4 + x_1 * x_5 + x_0 * x_6))
    g_6 = x_1 * q_5 + x_2 * q_4 + x_3 * q_3 + x_4 * q_2 + x_5 * q_1 + x_6 * q_0 + x_0 * q_6
    f_6 = s_1 * g_5 + s_2 * g_4 + s_3 * g_3 + s_4 * g_2 + s_5 * g_1 + s_6 * g_0 + s_0 * g_6
    x_8 = (f_6 - spring * x_6 - damping * 7.0 * x_7) * (per_mass * 0.017857142857142856)
    a_7 = -a_6 * rate * 0.14285714285714285
    b_7 = -b_6 * eddy_rate * 0.14285714285714285
    w_7 = a_7 + b_7
    s_7 = 2.0 * (w_3 * w_4 + w_2 * w_5 + w_1 * w_6 + w_0 * w_7)
    q_7 = a2 * x_7 + a3 * (2.0 * (x_3 * x_4 + x_2 * x_5 + x_1 * x_6 + x_0 * x_7))
    g_7 = x_1 * q_6 + x_2 * q_5 + x_3 * q_4 + x_4 * q_3 + x_5 * q_2 + x_6 * q_1 + x_7 * q_0 + x_0 * q_7
    f_7 = s_1 * g_6 + s_2 * g_5 + s_3 * g_4 + s_4 * g_3 + s_5 * g_2 + s_6 * g_1 + s_7 * g_0 + s_0 * g_7
    x_9 = (f_7 - spring * x_7 - damping * 8.0 * x_8) * (per_mass * 0.013888888888888888)
    a_8 = -a_7 * rate * 0.125
    b_8 = -b_7 * eddy_rate * 0.125
    w_8 = a_8 + b_8
    s_8 = w_4 * w_4 + 2.0 * (w_3 * w_5 + w_2 * w_6 + w_1 * w_7 + w_0 * w_8)
    q_8 = a2 * x_8 + a3 * (x_4 * x_4 + 2.0 * (x_3 * x_5 + x_2 * x_6 + x_1 * x_7 + x_0 * x_8))
    g_8 = x_1 * q_7 + x_2 * q_6 + x_3 * q_5 + x_4 * q_4 + x_5 * q_3 + x_6 * q_2 + x_7 * q_1 + x_8 * q_0 + x_0 * q_8
    f_8 = s_1 * g_7 + s_2 * g_6 + s_3 * g_5 + s_4 * g_4 + s_5 * g_3 + s_6 * g_2 + s_7 * g_1 + s_8 * g_0 + s_0 * g_8
    x_10 = (f_8 - spring * x_8 - damping * 9.0 * x_9) * (per_mass * 0.011111111111111112)
    a_9 = -a_8 * rate * 0.1111111111111111
    b_9 = -b_8 * eddy_rate * 0.1111111111111111
    w_9 = a_9 + b_9
    s_9 = 2.0 * (w_4 * w_5 + w_3 * w_6 + w_2 * w_7 + w_1 * w_8 + w_0 * w_9)
    q_9 = a2 * x_9 + a3 * (2.0 * (x_4 * x_5 + x_3 * x_6 + x_2 * x_7 + x_1 * x_8 + x_0 * x_9))
    g_9 = (
        x_1 * q_8 + x_2 * q_7 + x_3 * q_6 + x_4 * q_5 + x_5 * q_4 + x_6 * q_3 + x_7 * q_2 + x_8 * q_1 + x_9 * q_0 + x_0
        * q_9
    )
    f_9 = (
        s_1 * g_8 + s_2 * g_7 + s_3 * g_6 + s_4 * g_5 + s_5 * g_4 + s_6 * g_3 + s_7 * g_2 + s_8 * g_1 + s_9 * g_0 + s_0
        * g_9
    )
    x_11 = (f_9 - spring * x_9 - damping * 10.0 * x_10) * (per_mass * 0.00909090909090909)
    a_10 = -a_9 * rate * 0.1
    b_10 = -b_9 * eddy_rate * 0.1
    w_10 = a_10 + b_10
    s_10 = w_5 * w_5 + 2.0 * (w_4 * w_6 + w_3 * w_7 + w_2 * w_8 + w_1 * w_9 + w_0 * w_10)
    q_10 = a2 * x_10 + a3 * (x_5 * x_5 + 2.0 * (x_4 * x_6 + x_3 * x_7 + x_2 * x_8 + x_1 * x_9 + x_0 * x_10))
    g_10 = (
        x_1 * q_9 + x_2 * q_8 + x_3 * q_7 + x_4 * q_6 + x_5 * q_5 + x_6 * q_4 + x_7 * q_3 + x_8 * q_2 + x_9 * q_1 + x_10
        * q_0 + x_0 * q_10
    )
    f_10 = (
        s_1 * g_9 + s_2 * g_8 + s_3 * g_7 + s_4 * g_6 + s_5 * g_5 + s_6 * g_4 + s_7 * g_3 + s_8 * g_2 + s_9 * g_1 + s_10
        * g_0 + s_0 * g_10
    )
    x_12 = (f_10 - spring * x_10 - damping * 11.0 * x_11) * (per_mass * 0.007575757575757576)
    a_11 = -a_10 * rate * 0.09090909090909091
    b_11 = -b_10 * eddy_rate * 0.09090909090909091
    w_11 = a_11 + b_11
    s_11 = 2.0 * (w_5 * w_6 + w_4 * w_7 + w_3 * w_8 + w_2 * w_9 + w_1 * w_10 + w_0 * w_11)
    q_11 = a2 * x_11 + a3 * (2.0 * (x_5 * x_6 + x_4 * x_7 + x_3 * x_8 + x_2 * x_9 + x_1 * x_10 + x_0 * x_11))
    g_11 = (
        x_1 * q_10 + x_2 * q_9 + x_3 * q_8 + x_4 * q_7 + x_5 * q_6 + x_6 * q_5 + x_7 * q_4 + x_8 * q_3 + x_9 * q_2 +
        x_10 * q_1 + x_11 * q_0 + x_0 * q_11
    )
    f_11 = (
        s_1 * g_10 + s_2 * g_9 + s_3 * g_8 + s_4 * g_7 + s_5 * g_6 + s_6 * g_5 + s_7 * g_4 + s_8 * g_3 + s_9 * g_2 +
        s_10 * g_1 + s_11 * g_0 + s_0 * g_11
    )
    x_13 = (f_11 - spring * x_11 - damping * 12.0 * x_12) * (per_mass * 0.00641025641025641)
    a_12 = -a_11 * rate * 0.08333333333333333
    b_12 = -b_11 * eddy_rate * 0.08333333333333333
    w_12 = a_12 + b_12
    s_12 = w_6 * w_6 + 2.0 * (w_5 * w_7 + w_4 * w_8 + w_3 * w_9 + w_2 * w_10 + w_1 * w_11 + w_0 * w_12)
    q_12 = (
        a2 * x_12 + a3 * (x_6 * x_6 + 2.0 * (x_5 * x_7 + x_4 * x_8 + x_3 * x_9 + x_2 * x_10 + x_1 * x_11 + x_0 * x_12))
    )
    g_12 = (
        x_1 * q_11 + x_2 * q_10 + x_3 * q_9 + x_4 * q_8 + x_5 * q_7 + x_6 * q_6 + x_7 * q_5 + x_8 * q_4 + x_9 * q_3 +
        x_10 * q_2 + x_11 * q_1 + x_12 * q_0 + x_0 * q_12
    )
    f_12 = (
        s_1 * g_11 + s_2 * g_10 + s_3 * g_9 + s_4 * g_8 + s_5 * g_7 + s_6 * g_6 + s_7 * g_5 + s_8 * g_4 + s_9 * g_3 +
        s_10 * g_2 + s_11 * g_1 + s_12 * g_0 + s_0 * g_12
    )
    x_14 = (f_12 - spring * x_12 - damping * 13.0 * x_13) * (per_mass * 0.005494505494505495)
    series[0] = x_0
    series[1] = x_1
    series[2] = x_2
    series[3] = x_3
    series[4] = x_4
    series[5] = x_5
    series[6] = x_6
    series[7] = x_7
    series[8] = x_8
    series[9] = x_9
    series[10] = x_10
    series[11] = x_11
    series[12] = x_12
    series[13] = x_13
    series[14] = x_14
    velocity_series[0] = 1.0 * x_1
    velocity_series[1] = 2.0 * x_2
    velocity_series[2] = 3.0 * x_3
    velocity_series[3] = 4.0 * x_4
    velocity_series[4] = 5.0 * x_5
    velocity_series[5] = 6.0 * x_6
    velocity_series[6] = 7.0 * x_7
    velocity_series[7] = 8.0 * x_8
    velocity_series[8] = 9.0 * x_9
    velocity_series[9] = 10.0 * x_10
    velocity_series[10] = 11.0 * x_11
    velocity_series[11] = 12.0 * x_12
    velocity_series[12] = 13.0 * x_13
    velocity_series[13] = 14.0 * x_14
