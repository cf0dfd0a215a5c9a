"""Where everything of one valve stands in its block of doubles.

A block is all that a valve needs: copied it is saved, and an array of blocks is a fleet. Tangents of what stands in a
slot stand in the slot of the same number of a second block, one for each direction.
"""

from __future__ import annotations

from typing import Final

ORDER: Final = 14
"""Of the Taylor series of x; that of v, and of all else, has one term less."""
TERMS: Final = 14
"""Coefficients of a series of anything but x: orders 0 to 13."""
MOST_STATES: Final = 5
"""Of the coil."""
MOST_GUARDS: Final = 16

TIME, X, V, COIL = 0, 1, 2, 3
"""s, m, m/s, and the states of the coil."""
END: Final = 8
"""x, v and the states of the coil at the end of a step."""
END_X, END_V = END, END + 1
STEP, LONGEST, SUSPECT, DEFECT, TOLERANCE, ELAPSED = 15, 16, 17, 18, 19, 20
"""Size of the step, s, and the longest allowed; 1 where something may happen in it; error of its series over what is
tolerated; relative error of a step; the time since its start at which the states are asked for."""
MODE, MOVING, DIRECTION, LIFTED, LIFTED_UP, LIFTED_DOWN, BEYOND, AHEAD, ON_SEAT, CLOSED_NOW = range(21, 31)
"""The mode of the plungers: see `modes.enter`."""
UNSEATED_TIME, VOLTS, SEEN, BLOCKED, PATH, FREEWHEELS, PEAK, END_PEAK = range(32, 40)
"""s; V, commanded and at the terminals; whether the diode blocks; what closes the circuit; the sign of a current that
freewheels, else 0; the largest |u| so far, and after a step."""
GAP, STROKE, RATIO, RESTITUTION_STOP, RESTITUTION_SEAT, COMPLIANCE, DELAY, SENSOR_LAG, GAIN, RATED = range(40, 50)
"""Numbers of the valve after its effects; RATED is the current at u = 1, A."""
RELEASE, MAY_RISE, LAG, MAY_FALL = 50, 51, 52, 53
ACCELERATION, NET, UP, DOWN, UP_RATE, DOWN_RATE, CURRENT, CURRENT_RATE, PULL, TERMINAL, COIL_RATES = range(54, 65)
"""What `look` fills in: m/s², N, N, N, N/s, N/s, –, 1/s, N, V, and the rates of the states of the coil (five)."""
MOVE, REST, AT, SPOT, ROW, LOOK, DECIDE, PREPARE = range(68, 76)
"""Addresses of the kernels, as bits."""
STATES, GUARDS, IS_CHECKED, HAS_PEAK, IS_FLUX, ONE_PLUNGER = range(77, 83)
"""How many states the coil has, how many guards there are; whether series are checked; whether the peak is asked for;
whether the coil follows its flux; whether there is one plunger only."""
SHOWN_PILOT, SHOWN_MAIN = 83, 84
"""m: what the sensors show, behind their low-pass, at the state's time."""
PENDING, ENDS, CHATTER, COUNT, SAMPLED, SAMPLED_ROWS = range(85, 91)
"""Whether a step is known and not yet committed, and what ends it; steps in a row without progress; events; samples
of positions, and of all else, that have been written."""
EDDY, ROW_X, ROW_V, DELTA, OUTCOME = range(91, 96)
"""s; m and m/s of a row of output; tangents of the time of an event, s, stand in the last."""
WIDTH: Final = 96
"""Directions of derivatives; 0 for none."""
LATE: Final = STEP
"""Tangents of the sample times, s, stand in this slot of the tangents."""
PLACE, CURVE, LOW_GUARD, HIGH_GUARD = range(97, 101)
"""Of a curve of splines: address of the kernel of its place; the slot of its first coefficient, 0 where there is no
curve; the numbers of the comparisons with the ends of its interval."""
CURVE_PLACE, CURVE_INTERVALS, CURVE_INDEX, CURVE_LOW, CURVE_HIGH, CURVE_C = range(102, 108)
"""Its place, in intervals from its first knot; how many intervals; which one it is in, and where that begins and ends;
the four coefficients of its cubic there."""
NUMBER_COUNT, WARM = 111, 112
"""How many numbers the valve gives; the place of the temperature among the states of a coil whose currents are
integrated, as many as there are states where there is none, and −1 of any other coil."""
DENSITY, GAS_STEP, GAS_KNOWN, STIFFNESS, CHANGED, REGIME, REGIME_AHEAD, HAS_DEMAND, READS_TIME = range(113, 122)
"""Of gas: the slot of its density among the states, 0 of a valve without gas; the step to be tried next, s; whether the
rate of the density at the state is known from the step before; how many times the gas relaxed in the last step; time of
the last command, s; of the flow, 2 choked, 1 subsonic, negative from the outlet to the inlet; and what it will be after
the event; whether gas leaves the outlet volume; whether forces change with time alone."""
TANK, TANK_RATE, TANK_TIME, DEMAND = range(122, 126)
"""Pressure of the tank at a time, Pa, its rate from then on, Pa/s, and that time, s; pressure behind the demand, Pa."""
DECLARED_TANK, DECLARED_DEMAND, FIRST_DENSITY = range(126, 129)
"""Pa, Pa, kg/m³: the valve's own, for its start."""
FLOW_RATE, FLOW_SLOPE, INLET_DENSITY, DEMAND_DENSITY = range(129, 133)
"""What `flow` fills in: rate of the density, kg/(m³ s), its derivative by the density, 1/s; kg/m³ at both ends."""
STAGE_RATES: Final = 133
"""What `stage` fills in: rates of x, v and the states of the coil (seven)."""
INLET, OUTLET, OUTLET_RATE, CRITICAL, CLOSING, MASS_FLOW = range(140, 146)
"""Pa, Pa, Pa/s; the ratio of pressures at which the flow chokes; N, (G5); kg/s."""
FLOW, FLOW_SLOPES, STAGE, STAGE_SLOPES, BEND, BEND_SLOPES, WATCH = range(146, 153)
"""Addresses of the kernels of gas."""
LIMIT_START, LIMIT_END = 153, 154
"""How the rates of the density at both ends of a step enter its polynomial: see `gas_steps.limit`."""
GAS_RATE, BENT, BENT_START, BENT_END = range(155, 159)
"""Rate of the density at the end of the last step, kg/(m³ s); its own rate, kg/(m³ s²), as `bend` fills it in, and at
both ends of a step."""
SERIES_X: Final = 159
"""ORDER + 1 coefficients of x about the start of the step."""
SERIES_COIL: Final = SERIES_X + ORDER + 1
"""TERMS coefficients of each state of the coil."""
FLAG: Final = SERIES_COIL + MOST_STATES * TERMS
"""The flags of comparisons, 0 or 1."""
GUARD: Final = FLAG + MOST_GUARDS
"""TERMS coefficients of what must not become negative within the step: see `kernels`."""
GUARD_RATE: Final = GUARD + (MOST_GUARDS + 3) * TERMS
"""With derivatives: the rates of what is compared, and its tangents, as `look` fills them in."""
SCRATCH: Final = GUARD_RATE + MOST_GUARDS
"""Room for 3 TERMS numbers of the driver."""
STAGES: Final = 6
"""Of a step of a valve with gas."""
FLIPPED: Final = SCRATCH + 3 * TERMS
FLIPPED_AT: Final = FLIPPED + 1
"""The comparison that changed last, and when, s."""
GAS_K: Final = FLIPPED_AT + 1
"""Rates of x, v and all other states at each stage, and at the end of the step."""
WIDE: Final = 2 + MOST_STATES
"""So many at each."""
GAS_STAGES: Final = GAS_K + (STAGES + 1) * WIDE
"""The density at each stage, and at the end, kg/m³."""
NUMBERS: Final = GAS_STAGES + STAGES + 1
"""The numbers that a valve gives: declared ones and those of its effects."""
MOST_NUMBERS: Final = 128
SIZE: Final = NUMBERS + MOST_NUMBERS

HELD: Final = {
    "time": TIME, "x": X, "v": V, "elapsed": ELAPSED, "direction": DIRECTION, "lifted": LIFTED,
    "lifted up": LIFTED_UP, "lifted down": LIFTED_DOWN, "beyond": BEYOND, "on seat": ON_SEAT, "closed": CLOSED_NOW,
    "unseated_time": UNSEATED_TIME, "seen": SEEN, "blocked": BLOCKED, "peak": PEAK,
    "curve at": CURVE_INDEX, "curve low": CURVE_LOW, "curve high": CURVE_HIGH,
    **{f"curve {power}": CURVE_C + power for power in range(4)},
    "freewheels": FREEWHEELS, "moving": MOVING, "may rise": MAY_RISE, "may fall": MAY_FALL,
    "tank": TANK, "tank rate": TANK_RATE, "tank time": TANK_TIME, "demand": DEMAND,
}  # fmt: skip
"""The slots of what the equations call by these names."""
OF_VALVE: Final = {
    "pilot_gap": GAP, "stroke": STROKE, "pickup_velocity_ratio": RATIO, "restitution_stop": RESTITUTION_STOP,
    "restitution_seat": RESTITUTION_SEAT, "stop_compliance": COMPLIANCE, "sensor_delay": DELAY,
    "sensor_time_constant": SENSOR_LAG, "sensor_gain": GAIN, "release_voltage": RELEASE, "coil_time_constant": LAG,
    "eddy_time_constant": EDDY,
}  # fmt: skip
"""The slots of numbers of the valve that the driver reads."""
OF_GAS: Final = {"inlet_pressure": DECLARED_TANK, "demand_pressure": DECLARED_DEMAND}
"""The slots of numbers of a valve with gas that the driver reads."""
NO_EVENT, CONTACT, TURN, RISE, FALL, CURRENT_GONE, FLAGGED = 0, 1, 2, 3, 4, 5, 6
"""What ends a step; FLAGGED and more is the comparison of that number."""
FLOW_SWITCHED: Final = FLAGGED + MOST_GUARDS
"""What ends a step where the flow of gas became choked or subsonic, or turned round."""
