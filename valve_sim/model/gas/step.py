"""One step of plungers, coil and gas together, compiled: the gas implicitly, all else explicitly.

An additive Runge–Kutta pair of order 4(3), ARK4(3)6L[2]SA: Kennedy and Carpenter, Applied Numerical Mathematics 44
(2003) 139–181, with its dense output of order 3. Its explicit part steps the plungers and the coil, its implicit part,
L-stable and stiffly accurate, the outlet's density. So nothing is lost to the infinite slope of the flow where both
pressures are equal: each stage is one equation in the outlet pressure p_o,

    (G6)  ρ(p_o) − h γ f(p_o) = known,     f = (A G(p_i, p_o) − A_d G(p_o, p_d))/V_o,

whose left side only grows with p_o. It is solved by Newton's method in √|p_o − p_i|, in which the flow is smooth, or
in √|p_o − p_d| where that is nearer.

Without gas, each function here is that of `step_memory`.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from valve_sim.model.compiling import inlined, inner
from valve_sim.model.core_types import MAIN, EventKind
from valve_sim.model.gas import step_memory as plain
from valve_sim.model.gas.flow import (
    SAME,
    closing_force,
    density_at,
    density_slope,
    effective_area,
    flow_regime,
    flows,
    inlet_pressure,
    outflow,
    pressure_at,
)
from valve_sim.model.gas.record import for_gas
from valve_sim.model.gas.step_memory import LAST, MECHANICAL_STATES, SMALLEST_SCALE

# NumPy's numbers: Numba compiles a function once for all of them, but anew for each of Python's literals.
FLOW_CHOKED, FLOW_SUBSONIC, FLOW_REVERSED = np.array(list(EventKind)[14:])

STAGES: Final = 6
"""Of the pair; the slopes at its end, in the row after them, are those of the next step's start."""
FIRST_COLUMN: Final = 7
"""Of gas in a row of output, after those of every valve; a row that ends before has none."""
PRESSURE_COLUMN: Final = 1  # in a row of two, as fits ask for it
QUANTITIES: Final = 3
"""Of gas that are stepped: density, mass that came in, mass that went out."""
DENSITY, MASS_IN, MASS_OUT = np.arange(QUANTITIES)
TIMES: Final = np.array([0, 1 / 2, 83 / 250, 31 / 50, 17 / 20, 1])
EXPLICIT: Final = np.array(
    [
        [0, 0, 0, 0, 0],
        [1 / 2, 0, 0, 0, 0],
        [13861 / 62500, 6889 / 62500, 0, 0, 0],
        [-116923316275 / 2393684061468, -2731218467317 / 15368042101831, 9408046702089 / 11113171139209, 0, 0],
        [
            -451086348788 / 2902428689909, -2682348792572 / 7519795681897, 12662868775082 / 11960479115383,
            3355817975965 / 11060851509271, 0,
        ],
        [
            647845179188 / 3216320057751, 73281519250 / 8382639484533, 552539513391 / 3454668386233,
            3354512671639 / 8306763924573, 4040 / 17871,
        ],
    ]
)  # fmt: skip
IMPLICIT: Final = np.array(
    [
        [0, 0, 0, 0, 0],
        [1 / 4, 0, 0, 0, 0],
        [8611 / 62500, -1743 / 31250, 0, 0, 0],
        [5012029 / 34652500, -654441 / 2922500, 174375 / 388108, 0, 0],
        [15267082809 / 155376265600, -71443401 / 120774400, 730878875 / 902184768, 2285395 / 8070912, 0],
        [82889 / 524892, 0, 15625 / 83664, 69875 / 102672, -2260 / 8211],
    ]
)
DIAGONAL: Final = 1 / 4
WEIGHTS: Final = np.array([82889 / 524892, 0, 15625 / 83664, 69875 / 102672, -2260 / 8211, 1 / 4])
EMBEDDED: Final = np.array(
    [
        4586570599 / 29645900160, 0, 178811875 / 945068544, 814220225 / 1159782912, -3700637 / 11593932,
        61727 / 225920,
    ]
)  # fmt: skip
ERRORS: Final = WEIGHTS - EMBEDDED
DENSE: Final = np.array(
    [
        [6943876665148 / 7220017795957, -54480133 / 30881146, 6818779379841 / 7100303317025],
        [0, 0, 0],
        [7640104374378 / 9702883013639, -11436875 / 14766696, 2173542590792 / 12501825683035],
        [-20649996744609 / 7521556579894, 174696575 / 18121608, -31592104683404 / 5083833661969],
        [8854892464581 / 2390941311638, -12120380 / 966161, 61146701046299 / 7138195549469],
        [-11397109935349 / 6675773540249, 3843 / 706, -17219254887155 / 4939391667607],
    ]
)

LOOSER: Final = 30.0
"""By what the tolerance of a step is larger than without gas: the pair is of order 4, and a valve that waits half a
second for its pressure needs no nanosecond."""
SMALLEST_DENSITY: Final = 1e-2
"""Of the inlet's density: below, the error of the outlet's is held absolutely."""
MOST_ITERATIONS: Final = 60
"""Of (G6); three to five are common."""
SOLVED: Final = 1e-5
"""Relative change of the root that ends them: Newton's method leaves about its square."""
STIFF: Final = 1.0
"""Times that the gas relaxes in a step, from which on its dense output may leave what is between the ends."""
MULTIPLIES_ROUNDING: Final = 1e3
"""The same, from which on the dense output would show little but rounding."""
SETTLED: Final = 1e-7
"""Relative change of the density in a step that says no more than its tolerance, while plungers rest."""
REGIME_MARGIN: Final = (1e-6, 1.0)
"""Relative, and in Pa: by how much a limit between choked, subsonic and backward flow is passed before it counts."""
_NO_MARGIN: Final = (0.0, 0.0)
BISECTIONS: Final = 28
"""Halvings of a step that locate such a change."""


@inlined
def _same_tolerance(p, tolerance):
    return tolerance


@for_gas(_same_tolerance)
def tolerance_of(p, tolerance):
    """The tolerance of a step, given that of one without gas."""
    return LOOSER * tolerance


@inlined
def _nothing(p, s, work):
    return None


@for_gas(_nothing)
def start_gas(p, s, work):
    """Put the gas where the integrator starts."""
    work.gas[DENSITY] = s.density
    work.gas[MASS_IN] = s.mass_in
    work.gas[MASS_OUT] = s.mass_out


@for_gas(_nothing)
def commit_gas(p, s, work):
    """Make the end of the step the state."""
    s.density = work.gas_new[DENSITY]
    s.mass_in = work.gas_new[MASS_IN]
    s.mass_out = work.gas_new[MASS_OUT]


@inlined
def _rates_with_gas(p, s, work, t, y, stage, difference):
    """Write y' into row `stage` of work.k, given p_i − p_o."""
    if not s.moving and work.states == MECHANICAL_STATES:
        work.k[stage, 0], work.k[stage, 1] = 0.0, 0.0
        return
    plain.rates(p, s, work, t, y, stage)
    if s.moving:
        mass = p.moving_mass if s.mode >= MAIN else p.pilot_mass
        work.k[stage, 1] -= closing_force(p, s.mode, y[0], difference) / mass


@inner
def rates(p, s, work, t, y, stage):
    """Write y' at the start of a step into row `stage` of work.k."""
    _rates_with_gas(p, s, work, t, y, stage, inlet_pressure(s, t) - pressure_at(p, work.gas[DENSITY]))


@inner
def _outlet_pressure(p, s, area, inlet, share, known, guess):
    """Solve (G6); share is h γ/V_o. Returns p_o, Pa, and the slope of the flows where it was last asked for."""
    low, high = 0.0, math.inf
    pressure, slope = guess, 0.0
    for _ in range(MOST_ITERATIONS):
        mass_in, mass_out, slope = flows(p, s, area, inlet, pressure)
        excess = density_at(p, pressure) - share * (mass_in - mass_out) - known
        if excess > 0.0:
            high = pressure
        else:
            low = pressure
        anchor = inlet
        if p.demand_area > 0.0 and abs(pressure - s.demand_pressure) < abs(pressure - inlet):
            anchor = s.demand_pressure
        apart = pressure - anchor
        root = math.sqrt(max(abs(apart), SAME * anchor))
        change = -excess / (2.0 * root * (density_slope(p, pressure) - share * slope))
        signed = (root if apart >= 0.0 else -root) + change
        better = anchor + signed * abs(signed)
        if low < better < high:
            pressure = better
            if abs(change) <= SOLVED * root:
                break
        elif high - low <= SAME * low:
            break
        else:
            pressure = 0.5 * (low + high) if high < math.inf else 2.0 * pressure
    return pressure, slope


@inner
def _gas_stage(p, s, work, h, stage, pressure):
    """Solve a stage of the gas, which starts from a guess of p_o; write its slopes, and return its p_o."""
    t = s.time + TIMES[stage] * h
    inlet = inlet_pressure(s, t)
    area = effective_area(p, work.y_stage[0])
    if stage == 0:
        mass_in, mass_out, _ = flows(p, s, area, inlet, pressure)
        work.gas_k[stage, DENSITY] = (mass_in - mass_out) / p.outlet_volume
    else:
        known = work.gas[DENSITY]
        for i in range(stage):
            known += h * IMPLICIT[stage, i] * work.gas_k[i, DENSITY]
        share = h * DIAGONAL / p.outlet_volume
        pressure, slope = _outlet_pressure(p, s, area, inlet, share, known, pressure)
        # What the equation says of the flow is exact where the flow's own formula multiplies rounding.
        work.gas_k[stage, DENSITY] = (density_at(p, pressure) - known) / (h * DIAGONAL)
        mass_out = outflow(p, s, pressure)
        mass_in = p.outlet_volume * work.gas_k[stage, DENSITY] + mass_out
        work.stiffness = -h * slope / (p.outlet_volume * density_slope(p, pressure))
    work.gas_k[stage, MASS_IN] = mass_in
    work.gas_k[stage, MASS_OUT] = mass_out
    return pressure


@inner
def try_step(p, s, work, h):
    """One trial step of size h, s, from work.y and work.gas; work.k[0] holds y' there."""
    k, y, y_stage, y_new = work.k, work.y, work.y_stage, work.y_new
    pressure = pressure_at(p, work.gas[DENSITY])
    for stage in range(STAGES):
        for j in range(work.states):
            total = 0.0
            for i in range(stage):
                total += EXPLICIT[stage, i] * k[i, j]
            y_stage[j] = y[j] + h * total
        pressure = _gas_stage(p, s, work, h, stage, pressure)
        if stage > 0:
            t = s.time + TIMES[stage] * h
            _rates_with_gas(p, s, work, t, y_stage, stage, inlet_pressure(s, t) - pressure)
    for j in range(work.states):
        total = 0.0
        for i in range(STAGES):
            total += WEIGHTS[i] * k[i, j]
        y_new[j] = y[j] + h * total
    for j in range(QUANTITIES):
        total = 0.0
        for i in range(STAGES):
            total += WEIGHTS[i] * work.gas_k[i, j]
        work.gas_new[j] = work.gas[j] + h * total
    t = s.time + h
    _rates_with_gas(p, s, work, t, y_new, LAST, inlet_pressure(s, t) - pressure_at(p, work.gas_new[DENSITY]))


@inner
def norm_of_error(p, work, h, tolerance):
    """Root mean square of the error in units of the tolerance; above 1 the step is refused."""
    total = 0.0
    for j in range(work.states):
        error = 0.0
        for i in range(STAGES):
            error += ERRORS[i] * work.k[i, j]
        ratio = h * error / (tolerance * max(abs(work.y[j]), abs(work.y_new[j]), SMALLEST_SCALE[j]))
        total += ratio * ratio
    error = 0.0
    for i in range(STAGES):
        error += ERRORS[i] * work.gas_k[i, DENSITY]
    least = SMALLEST_DENSITY * density_at(p, p.inlet_pressure)
    ratio = h * error / (tolerance * max(work.gas[DENSITY], work.gas_new[DENSITY], least))
    total += ratio * ratio
    return math.sqrt(total / (work.states + 1))


@inner
def fill_dense(p, work):
    """Work out the dense-output coefficients of the step just taken."""
    for power in range(3):
        for j in range(work.states):
            total = 0.0
            for i in range(STAGES):
                total += DENSE[i, power] * work.k[i, j]
            work.dense[j, power] = total
        for j in range(QUANTITIES):
            total = 0.0
            for i in range(STAGES):
                total += DENSE[i, power] * work.gas_k[i, j]
            work.gas_dense[j, power] = total
    for j in range(work.states):
        work.dense[j, 3] = 0.0


@inlined
def density_within(work, h, theta):
    """Of the outlet at the fraction theta of a step, kg/m³: from its dense output, between the ends where it is stiff.

    Between these it can only rise or only fall where nothing but the gas itself changes, while plungers rest.
    """
    start, end = work.gas[DENSITY], work.gas_new[DENSITY]
    if work.stiffness > MULTIPLIES_ROUNDING:
        return start + theta * (end - start)
    dense = work.gas_dense[DENSITY]
    density = start + h * theta * (dense[0] + theta * (dense[1] + theta * dense[2]))
    if work.stiffness > STIFF:
        return min(max(density, min(start, end)), max(start, end))
    return density


@inner
def shorten(p, s, work, h, fraction):
    """End a step at a fraction of it."""
    try_step(p, s, work, h * fraction)
    fill_dense(p, work)


@inlined
def _no_difference(p, s, work, h, theta):
    return 0.0


@for_gas(_no_difference)
def difference_within(p, s, work, h, theta):
    """p_i − p_o at the fraction theta of a step, Pa."""
    return inlet_pressure(s, s.time + theta * h) - pressure_at(p, density_within(work, h, theta))


@inlined
def _no_columns(p, s, work, at, rows, i):
    return None


@for_gas(_no_columns)
def sample_gas(p, s, work, at, rows, i):
    """Fill the columns of gas in row i of the output, `GAS_COLUMNS`: outlet pressure, Pa, and mass flow, kg/s.

    Args:
        at: (h, theta, x): size of the step, s; fraction of it; pilot plunger there, m.
    """
    if rows.shape[1] <= FIRST_COLUMN:
        return
    h, theta, x = at
    t = s.time + theta * h
    outlet = _outlet_within(p, s, work, h, theta)
    rows[i, FIRST_COLUMN] = outlet
    rows[i, FIRST_COLUMN + 1] = flows(p, s, effective_area(p, x), inlet_pressure(s, t), outlet)[0]


@inlined
def _no_pressure(p, s, work, h, theta, rows, i):
    return None


@for_gas(_no_pressure)
def sample_pressure(p, s, work, h, theta, rows, i):
    """Fill `PRESSURE_COLUMN` of row i of an output of two columns; arguments as of `sample_gas`."""
    if rows.shape[1] == PRESSURE_COLUMN + 1:
        rows[i, PRESSURE_COLUMN] = _outlet_within(p, s, work, h, theta)


@inner
def _outlet_within(p, s, work, h, theta):
    """p_o at the fraction theta of a step, Pa; solved for anew where the dense output of a stiff step may not hold."""
    change = abs(work.gas_new[DENSITY] - work.gas[DENSITY])
    has_settled = not s.moving and change <= SETTLED * work.gas_new[DENSITY]
    if work.stiffness > STIFF and 0.0 < theta < 1.0 and not has_settled:
        stiffness = work.stiffness
        try_step(p, s, work, theta * h)
        outlet = pressure_at(p, work.gas_new[DENSITY])
        try_step(p, s, work, h)
        work.stiffness = stiffness
        return outlet
    return pressure_at(p, density_within(work, h, theta))


@inlined
def _no_change(p, s, work, h):
    return 2.0


@for_gas(_no_change)
def regime_change(p, s, work, h):
    """The fraction of a step at which the flow becomes choked or subsonic, or turns round; 2 for not in it."""
    inlet, outlet = inlet_pressure(s, s.time + h), pressure_at(p, work.gas_new[DENSITY])
    if flow_regime(p, s, inlet, outlet, REGIME_MARGIN) == s.flow_regime:
        return 2.0
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        regime = _regime_within(p, s, work, h, middle)
        if regime == s.flow_regime:
            low = middle
        else:
            high = middle
    regime = _regime_within(p, s, work, h, high)
    work.regime_ahead = regime if regime != s.flow_regime else flow_regime(p, s, inlet, outlet, REGIME_MARGIN)
    return high


@inlined
def _regime_within(p, s, work, h, theta):
    inlet = inlet_pressure(s, s.time + theta * h)
    return flow_regime(p, s, inlet, pressure_at(p, density_within(work, h, theta)), _NO_MARGIN)


@inlined
def _no_switch(p, s, work):
    return FLOW_SUBSONIC


@for_gas(_no_switch)
def switch_regime(p, s, work):
    """Enter the regime ahead; return what happened to the flow, an EventKind."""
    before = s.flow_regime
    s.flow_regime = work.regime_ahead
    if s.flow_regime * before < 0.0:
        return FLOW_REVERSED
    return FLOW_CHOKED if abs(s.flow_regime) > 1.5 else FLOW_SUBSONIC
