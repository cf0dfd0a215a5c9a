"""The recurrences of `taylor_series`, with effects, written out by `test/model/taylor_source.py`, which says why.

Not to be edited.
"""

# fmt: off
# ruff: noqa: PLR0915

from __future__ import annotations

from valve_sim.model.compiling import inner


@inner
def coefficients_with_effects(series, velocity_series, start, current, attraction, motion, effects):
    """As `taylor_coefficients`, with forces of effects.

    Besides, `z` is `s` after (7), `y` and `c` are x² and x³, `d` is v², and `e` is the force that decays.

    Args:
        effects: forces, N, for each m²/s² of v² and each m³ of x³; a force that decays, N, and the reciprocal of its
            time constant, 1/s; k of the saturation s (1 + k)/(1 + k s).
    """
    of_v_squared, of_x_cubed, e_0, decay_rate, saturation = effects
    x_0, x_1 = start
    target, a_0, rate, b_0, eddy_rate = current
    a0, a1, a2, a3 = attraction
    load, spring, damping, per_mass = motion
    w_0 = target + a_0 + b_0
    s_0 = w_0 * w_0
    share = 1.0 / (1.0 + saturation * s_0)
    grown = (1.0 + saturation) * share
    folded = saturation * share
    z_0 = grown * s_0
    y_0 = x_0 * x_0
    q_0 = a2 * x_0 + a3 * y_0 + a1
    g_0 = x_0 * q_0 + a0
    v_0 = 1.0 * x_1
    c_0 = x_0 * y_0 if of_x_cubed != 0.0 else 0.0
    d_0 = v_0 * v_0
    f_0 = z_0 * g_0 + e_0 - load
    x_2 = (f_0 - spring * x_0 + of_x_cubed * c_0 - damping * v_0 + of_v_squared * d_0) * (per_mass * 0.5)
    a_1 = -a_0 * rate * 1.0
    b_1 = -b_0 * eddy_rate * 1.0
    w_1 = a_1 + b_1
    s_1 = 2.0 * (w_0 * w_1)
    z_1 = grown * s_1 - folded * (s_1 * z_0)
    e_1 = -e_0 * decay_rate * 1.0
    y_1 = 2.0 * (x_0 * x_1)
    q_1 = a2 * x_1 + a3 * y_1
    g_1 = x_1 * q_0 + x_0 * q_1
    v_1 = 2.0 * x_2
    c_1 = x_1 * y_0 + x_0 * y_1 if of_x_cubed != 0.0 else 0.0
    d_1 = 2.0 * (v_0 * v_1)
    f_1 = z_1 * g_0 + z_0 * g_1 + e_1
    x_3 = (
        (f_1 - spring * x_1 + of_x_cubed * c_1 - damping * v_1 + of_v_squared * d_1) * (per_mass * 0.16666666666666666)
    )
    a_2 = -a_1 * rate * 0.5
    b_2 = -b_1 * eddy_rate * 0.5
    w_2 = a_2 + b_2
    s_2 = w_1 * w_1 + 2.0 * (w_0 * w_2)
    z_2 = grown * s_2 - folded * (s_1 * z_1 + s_2 * z_0)
    e_2 = -e_1 * decay_rate * 0.5
    y_2 = x_1 * x_1 + 2.0 * (x_0 * x_2)
    q_2 = a2 * x_2 + a3 * y_2
    g_2 = x_1 * q_1 + x_2 * q_0 + x_0 * q_2
    v_2 = 3.0 * x_3
    c_2 = x_1 * y_1 + x_2 * y_0 + x_0 * y_2 if of_x_cubed != 0.0 else 0.0
    d_2 = v_1 * v_1 + 2.0 * (v_0 * v_2)
    f_2 = z_1 * g_1 + z_2 * g_0 + z_0 * g_2 + e_2
    x_4 = (
        (f_2 - spring * x_2 + of_x_cubed * c_2 - damping * v_2 + of_v_squared * d_2) * (per_mass * 0.08333333333333333)
    )
    a_3 = -a_2 * rate * 0.3333333333333333
    b_3 = -b_2 * eddy_rate * 0.3333333333333333
    w_3 = a_3 + b_3
    s_3 = 2.0 * (w_1 * w_2 + w_0 * w_3)
    z_3 = grown * s_3 - folded * (s_1 * z_2 + s_2 * z_1 + s_3 * z_0)
    e_3 = -e_2 * decay_rate * 0.3333333333333333
    y_3 = 2.0 * (x_1 * x_2 + x_0 * x_3)
    q_3 = a2 * x_3 + a3 * y_3
    g_3 = x_1 * q_2 + x_2 * q_1 + x_3 * q_0 + x_0 * q_3
    v_3 = 4.0 * x_4
    c_3 = x_1 * y_2 + x_2 * y_1 + x_3 * y_0 + x_0 * y_3 if of_x_cubed != 0.0 else 0.0
    d_3 = 2.0 * (v_1 * v_2 + v_0 * v_3)
    f_3 = z_1 * g_2 + z_2 * g_1 + z_3 * g_0 + z_0 * g_3 + e_3
    x_5 = (f_3 - spring * x_3 + of_x_cubed * c_3 - damping * v_3 + of_v_squared * d_3) * (per_mass * 0.05)
    a_4 = -a_3 * rate * 0.25
    b_4 = -b_3 * eddy_rate * 0.25
    w_4 = a_4 + b_4
    s_4 = w_2 * w_2 + 2.0 * (w_1 * w_3 + w_0 * w_4)
    z_4 = grown * s_4 - folded * (s_1 * z_3 + s_2 * z_2 + s_3 * z_1 + s_4 * z_0)
    e_4 = -e_3 * decay_rate * 0.25
    y_4 = x_2 * x_2 + 2.0 * (x_1 * x_3 + x_0 * x_4)
    q_4 = a2 * x_4 + a3 * y_4
    g_4 = x_1 * q_3 + x_2 * q_2 + x_3 * q_1 + x_4 * q_0 + x_0 * q_4
    v_4 = 5.0 * x_5
    c_4 = x_1 * y_3 + x_2 * y_2 + x_3 * y_1 + x_4 * y_0 + x_0 * y_4 if of_x_cubed != 0.0 else 0.0
    d_4 = v_2 * v_2 + 2.0 * (v_1 * v_3 + v_0 * v_4)
    f_4 = z_1 * g_3 + z_2 * g_2 + z_3 * g_1 + z_4 * g_0 + z_0 * g_4 + e_4
    x_6 = (
        (f_4 - spring * x_4 + of_x_cubed * c_4 - damping * v_4 + of_v_squared * d_4) * (per_mass * 0.03333333333333333)
    )
    a_5 = -a_4 * rate * 0.2
    b_5 = -b_4 * eddy_rate * 0.2
    w_5 = a_5 + b_5
    s_5 = 2.0 * (w_2 * w_3 + w_1 * w_4 + w_0 * w_5)
    z_5 = grown * s_5 - folded * (s_1 * z_4 + s_2 * z_3 + s_3 * z_2 + s_4 * z_1 + s_5 * z_0)
    e_5 = -e_4 * decay_rate * 0.2
    y_5 = 2.0 * (x_2 * x_3 + x_1 * x_4 + x_0 * x_5)
    q_5 = a2 * x_5 + a3 * y_5
    g_5 = x_1 * q_4 + x_2 * q_3 + x_3 * q_2 + x_4 * q_1 + x_5 * q_0 + x_0 * q_5
    v_5 = 6.0 * x_6
    c_5 = x_1 * y_4 + x_2 * y_3 + x_3 * y_2 + x_4 * y_1 + x_5 * y_0 + x_0 * y_5 if of_x_cubed != 0.0 else 0.0
    d_5 = 2.0 * (v_2 * v_3 + v_1 * v_4 + v_0 * v_5)
    f_5 = z_1 * g_4 + z_2 * g_3 + z_3 * g_2 + z_4 * g_1 + z_5 * g_0 + z_0 * g_5 + e_5
    x_7 = (
        (f_5 - spring * x_5 + of_x_cubed * c_5 - damping * v_5 + of_v_squared * d_5) * (per_mass * 0.023809523809523808)
    )
    a_6 = -a_5 * rate * 0.16666666666666666
    b_6 = -b_5 * eddy_rate * 0.16666666666666666
    w_6 = a_6 + b_6
    s_6 = w_3 * w_3 + 2.0 * (w_2 * w_4 + w_1 * w_5 + w_0 * w_6)
    z_6 = grown * s_6 - folded * (s_1 * z_5 + s_2 * z_4 + s_3 * z_3 + s_4 * z_2 + s_5 * z_1 + s_6 * z_0)
    e_6 = -e_5 * decay_rate * 0.16666666666666666
    y_6 = x_3 * x_3 + 2.0 * (x_2 * x_4 + x_1 * x_5 + x_0 * x_6)
    q_6 = a2 * x_6 + a3 * y_6
    g_6 = x_1 * q_5 + x_2 * q_4 + x_3 * q_3 + x_4 * q_2 + x_5 * q_1 + x_6 * q_0 + x_0 * q_6
    v_6 = 7.0 * x_7
    c_6 = (
        x_1 * y_5 + x_2 * y_4 + x_3 * y_3 + x_4 * y_2 + x_5 * y_1 + x_6 * y_0 + x_0 * y_6 if of_x_cubed != 0.0 else 0.0
    )
    d_6 = v_3 * v_3 + 2.0 * (v_2 * v_4 + v_1 * v_5 + v_0 * v_6)
    f_6 = z_1 * g_5 + z_2 * g_4 + z_3 * g_3 + z_4 * g_2 + z_5 * g_1 + z_6 * g_0 + z_0 * g_6 + e_6
    x_8 = (
        (f_6 - spring * x_6 + of_x_cubed * c_6 - damping * v_6 + of_v_squared * d_6) * (per_mass * 0.017857142857142856)
    )
    a_7 = -a_6 * rate * 0.14285714285714285
    b_7 = -b_6 * eddy_rate * 0.14285714285714285
    w_7 = a_7 + b_7
    s_7 = 2.0 * (w_3 * w_4 + w_2 * w_5 + w_1 * w_6 + w_0 * w_7)
    z_7 = grown * s_7 - folded * (s_1 * z_6 + s_2 * z_5 + s_3 * z_4 + s_4 * z_3 + s_5 * z_2 + s_6 * z_1 + s_7 * z_0)
    e_7 = -e_6 * decay_rate * 0.14285714285714285
    y_7 = 2.0 * (x_3 * x_4 + x_2 * x_5 + x_1 * x_6 + x_0 * x_7)
    q_7 = a2 * x_7 + a3 * y_7
    g_7 = x_1 * q_6 + x_2 * q_5 + x_3 * q_4 + x_4 * q_3 + x_5 * q_2 + x_6 * q_1 + x_7 * q_0 + x_0 * q_7
    v_7 = 8.0 * x_8
    c_7 = (
        x_1 * y_6 + x_2 * y_5 + x_3 * y_4 + x_4 * y_3 + x_5 * y_2 + x_6 * y_1 + x_7 * y_0 + x_0 * y_7 if of_x_cubed !=
        0.0 else 0.0
    )
    d_7 = 2.0 * (v_3 * v_4 + v_2 * v_5 + v_1 * v_6 + v_0 * v_7)
    f_7 = z_1 * g_6 + z_2 * g_5 + z_3 * g_4 + z_4 * g_3 + z_5 * g_2 + z_6 * g_1 + z_7 * g_0 + z_0 * g_7 + e_7
    x_9 = (
        (f_7 - spring * x_7 + of_x_cubed * c_7 - damping * v_7 + of_v_squared * d_7) * (per_mass * 0.013888888888888888)
    )
    a_8 = -a_7 * rate * 0.125
    b_8 = -b_7 * eddy_rate * 0.125
    w_8 = a_8 + b_8
    s_8 = w_4 * w_4 + 2.0 * (w_3 * w_5 + w_2 * w_6 + w_1 * w_7 + w_0 * w_8)
    z_8 = (
        grown * s_8 - folded * (s_1 * z_7 + s_2 * z_6 + s_3 * z_5 + s_4 * z_4 + s_5 * z_3 + s_6 * z_2 + s_7 * z_1 + s_8
        * z_0)
    )
    e_8 = -e_7 * decay_rate * 0.125
    y_8 = x_4 * x_4 + 2.0 * (x_3 * x_5 + x_2 * x_6 + x_1 * x_7 + x_0 * x_8)
    q_8 = a2 * x_8 + a3 * y_8
    g_8 = x_1 * q_7 + x_2 * q_6 + x_3 * q_5 + x_4 * q_4 + x_5 * q_3 + x_6 * q_2 + x_7 * q_1 + x_8 * q_0 + x_0 * q_8
    v_8 = 9.0 * x_9
    c_8 = (
        x_1 * y_7 + x_2 * y_6 + x_3 * y_5 + x_4 * y_4 + x_5 * y_3 + x_6 * y_2 + x_7 * y_1 + x_8 * y_0 + x_0 * y_8 if
        of_x_cubed != 0.0 else 0.0
    )
    d_8 = v_4 * v_4 + 2.0 * (v_3 * v_5 + v_2 * v_6 + v_1 * v_7 + v_0 * v_8)
    f_8 = (
        z_1 * g_7 + z_2 * g_6 + z_3 * g_5 + z_4 * g_4 + z_5 * g_3 + z_6 * g_2 + z_7 * g_1 + z_8 * g_0 + z_0 * g_8 + e_8
    )
    x_10 = (
        (f_8 - spring * x_8 + of_x_cubed * c_8 - damping * v_8 + of_v_squared * d_8) * (per_mass * 0.011111111111111112)
    )
    a_9 = -a_8 * rate * 0.1111111111111111
    b_9 = -b_8 * eddy_rate * 0.1111111111111111
    w_9 = a_9 + b_9
    s_9 = 2.0 * (w_4 * w_5 + w_3 * w_6 + w_2 * w_7 + w_1 * w_8 + w_0 * w_9)
    z_9 = (
        grown * s_9 - folded * (s_1 * z_8 + s_2 * z_7 + s_3 * z_6 + s_4 * z_5 + s_5 * z_4 + s_6 * z_3 + s_7 * z_2 + s_8
        * z_1 + s_9 * z_0)
    )
    e_9 = -e_8 * decay_rate * 0.1111111111111111
    y_9 = 2.0 * (x_4 * x_5 + x_3 * x_6 + x_2 * x_7 + x_1 * x_8 + x_0 * x_9)
    q_9 = a2 * x_9 + a3 * y_9
    g_9 = (
        x_1 * q_8 + x_2 * q_7 + x_3 * q_6 + x_4 * q_5 + x_5 * q_4 + x_6 * q_3 + x_7 * q_2 + x_8 * q_1 + x_9 * q_0 + x_0
        * q_9
    )
    v_9 = 10.0 * x_10
    c_9 = (
        x_1 * y_8 + x_2 * y_7 + x_3 * y_6 + x_4 * y_5 + x_5 * y_4 + x_6 * y_3 + x_7 * y_2 + x_8 * y_1 + x_9 * y_0 + x_0
        * y_9 if of_x_cubed != 0.0 else 0.0
    )
    d_9 = 2.0 * (v_4 * v_5 + v_3 * v_6 + v_2 * v_7 + v_1 * v_8 + v_0 * v_9)
    f_9 = (
        z_1 * g_8 + z_2 * g_7 + z_3 * g_6 + z_4 * g_5 + z_5 * g_4 + z_6 * g_3 + z_7 * g_2 + z_8 * g_1 + z_9 * g_0 + z_0
        * g_9 + e_9
    )
    x_11 = (
        (f_9 - spring * x_9 + of_x_cubed * c_9 - damping * v_9 + of_v_squared * d_9) * (per_mass * 0.00909090909090909)
    )
    a_10 = -a_9 * rate * 0.1
    b_10 = -b_9 * eddy_rate * 0.1
    w_10 = a_10 + b_10
    s_10 = w_5 * w_5 + 2.0 * (w_4 * w_6 + w_3 * w_7 + w_2 * w_8 + w_1 * w_9 + w_0 * w_10)
    z_10 = (
        grown * s_10 - folded * (s_1 * z_9 + s_2 * z_8 + s_3 * z_7 + s_4 * z_6 + s_5 * z_5 + s_6 * z_4 + s_7 * z_3 + s_8
        * z_2 + s_9 * z_1 + s_10 * z_0)
    )
    e_10 = -e_9 * decay_rate * 0.1
    y_10 = x_5 * x_5 + 2.0 * (x_4 * x_6 + x_3 * x_7 + x_2 * x_8 + x_1 * x_9 + x_0 * x_10)
    q_10 = a2 * x_10 + a3 * y_10
    g_10 = (
        x_1 * q_9 + x_2 * q_8 + x_3 * q_7 + x_4 * q_6 + x_5 * q_5 + x_6 * q_4 + x_7 * q_3 + x_8 * q_2 + x_9 * q_1 + x_10
        * q_0 + x_0 * q_10
    )
    v_10 = 11.0 * x_11
    c_10 = (
        x_1 * y_9 + x_2 * y_8 + x_3 * y_7 + x_4 * y_6 + x_5 * y_5 + x_6 * y_4 + x_7 * y_3 + x_8 * y_2 + x_9 * y_1 + x_10
        * y_0 + x_0 * y_10 if of_x_cubed != 0.0 else 0.0
    )
    d_10 = v_5 * v_5 + 2.0 * (v_4 * v_6 + v_3 * v_7 + v_2 * v_8 + v_1 * v_9 + v_0 * v_10)
    f_10 = (
        z_1 * g_9 + z_2 * g_8 + z_3 * g_7 + z_4 * g_6 + z_5 * g_5 + z_6 * g_4 + z_7 * g_3 + z_8 * g_2 + z_9 * g_1 + z_10
        * g_0 + z_0 * g_10 + e_10
    )
    x_12 = (
        (f_10 - spring * x_10 + of_x_cubed * c_10 - damping * v_10 + of_v_squared * d_10) * (per_mass *
        0.007575757575757576)
    )
    a_11 = -a_10 * rate * 0.09090909090909091
    b_11 = -b_10 * eddy_rate * 0.09090909090909091
    w_11 = a_11 + b_11
    s_11 = 2.0 * (w_5 * w_6 + w_4 * w_7 + w_3 * w_8 + w_2 * w_9 + w_1 * w_10 + w_0 * w_11)
    z_11 = (
        grown * s_11 - folded * (s_1 * z_10 + s_2 * z_9 + s_3 * z_8 + s_4 * z_7 + s_5 * z_6 + s_6 * z_5 + s_7 * z_4 +
        s_8 * z_3 + s_9 * z_2 + s_10 * z_1 + s_11 * z_0)
    )
    e_11 = -e_10 * decay_rate * 0.09090909090909091
    y_11 = 2.0 * (x_5 * x_6 + x_4 * x_7 + x_3 * x_8 + x_2 * x_9 + x_1 * x_10 + x_0 * x_11)
    q_11 = a2 * x_11 + a3 * y_11
    g_11 = (
        x_1 * q_10 + x_2 * q_9 + x_3 * q_8 + x_4 * q_7 + x_5 * q_6 + x_6 * q_5 + x_7 * q_4 + x_8 * q_3 + x_9 * q_2 +
        x_10 * q_1 + x_11 * q_0 + x_0 * q_11
    )
    v_11 = 12.0 * x_12
    c_11 = (
        x_1 * y_10 + x_2 * y_9 + x_3 * y_8 + x_4 * y_7 + x_5 * y_6 + x_6 * y_5 + x_7 * y_4 + x_8 * y_3 + x_9 * y_2 +
        x_10 * y_1 + x_11 * y_0 + x_0 * y_11 if of_x_cubed != 0.0 else 0.0
    )
    d_11 = 2.0 * (v_5 * v_6 + v_4 * v_7 + v_3 * v_8 + v_2 * v_9 + v_1 * v_10 + v_0 * v_11)
    f_11 = (
        z_1 * g_10 + z_2 * g_9 + z_3 * g_8 + z_4 * g_7 + z_5 * g_6 + z_6 * g_5 + z_7 * g_4 + z_8 * g_3 + z_9 * g_2 +
        z_10 * g_1 + z_11 * g_0 + z_0 * g_11 + e_11
    )
    x_13 = (
        (f_11 - spring * x_11 + of_x_cubed * c_11 - damping * v_11 + of_v_squared * d_11) * (per_mass *
        0.00641025641025641)
    )
    a_12 = -a_11 * rate * 0.08333333333333333
    b_12 = -b_11 * eddy_rate * 0.08333333333333333
    w_12 = a_12 + b_12
    s_12 = w_6 * w_6 + 2.0 * (w_5 * w_7 + w_4 * w_8 + w_3 * w_9 + w_2 * w_10 + w_1 * w_11 + w_0 * w_12)
    z_12 = (
        grown * s_12 - folded * (s_1 * z_11 + s_2 * z_10 + s_3 * z_9 + s_4 * z_8 + s_5 * z_7 + s_6 * z_6 + s_7 * z_5 +
        s_8 * z_4 + s_9 * z_3 + s_10 * z_2 + s_11 * z_1 + s_12 * z_0)
    )
    e_12 = -e_11 * decay_rate * 0.08333333333333333
    y_12 = x_6 * x_6 + 2.0 * (x_5 * x_7 + x_4 * x_8 + x_3 * x_9 + x_2 * x_10 + x_1 * x_11 + x_0 * x_12)
    q_12 = a2 * x_12 + a3 * y_12
    g_12 = (
        x_1 * q_11 + x_2 * q_10 + x_3 * q_9 + x_4 * q_8 + x_5 * q_7 + x_6 * q_6 + x_7 * q_5 + x_8 * q_4 + x_9 * q_3 +
        x_10 * q_2 + x_11 * q_1 + x_12 * q_0 + x_0 * q_12
    )
    v_12 = 13.0 * x_13
    c_12 = (
        x_1 * y_11 + x_2 * y_10 + x_3 * y_9 + x_4 * y_8 + x_5 * y_7 + x_6 * y_6 + x_7 * y_5 + x_8 * y_4 + x_9 * y_3 +
        x_10 * y_2 + x_11 * y_1 + x_12 * y_0 + x_0 * y_12 if of_x_cubed != 0.0 else 0.0
    )
    d_12 = v_6 * v_6 + 2.0 * (v_5 * v_7 + v_4 * v_8 + v_3 * v_9 + v_2 * v_10 + v_1 * v_11 + v_0 * v_12)
    f_12 = (
        z_1 * g_11 + z_2 * g_10 + z_3 * g_9 + z_4 * g_8 + z_5 * g_7 + z_6 * g_6 + z_7 * g_5 + z_8 * g_4 + z_9 * g_3 +
        z_10 * g_2 + z_11 * g_1 + z_12 * g_0 + z_0 * g_12 + e_12
    )
    x_14 = (
        (f_12 - spring * x_12 + of_x_cubed * c_12 - damping * v_12 + of_v_squared * d_12) * (per_mass *
        0.005494505494505495)
    )
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
