"""Where everything of one machine of a user's own stands in its block of doubles; tangents stand in a second block."""

from __future__ import annotations

from typing import Final

ORDER: Final = 8
"""Of the Taylor series: inputs have a corner at each sample, so that steps are short, and a low order serves."""
TERMS: Final = ORDER + 1
MOST_STATES: Final = 12
MOST_INPUTS: Final = 16
MOST_OUTPUTS: Final = 16
MOST_GUARDS: Final = 40
MOST_SLIDING: Final = 4
MOST_NUMBERS: Final = 160

TIME, STEP, LONGEST, TOLERANCE, ELAPSED, DEFECT, TAKEN = range(7)
"""s; size of the step, s, and the longest allowed; relative error of a step; the time since the start of the step at
which states are asked for, s; error of the series over what is tolerated; how many steps were taken."""
MOVE, SLIDE, AT, LOOK, ROW = range(8, 13)
"""Addresses of the kernels, as bits."""
STATES, GUARDS, OUTPUTS, INPUTS, SLIDING, WIDTH = range(16, 22)
"""Slots for the numbers of each kind, and of directions of derivatives."""
STATE: Final = 32
END: Final = STATE + MOST_STATES
"""At the time `ELAPSED` after the start of the step."""
RATE: Final = END + MOST_STATES
BEFORE: Final = RATE + MOST_STATES
"""Rates before an event."""
PEAK: Final = BEFORE + MOST_STATES
"""The largest size of each state so far."""
OUT: Final = PEAK + MOST_STATES
INPUT: Final = OUT + MOST_OUTPUTS
SLOPE: Final = INPUT + MOST_INPUTS
FLAG: Final = SLOPE + MOST_INPUTS
EXCESS: Final = FLAG + MOST_GUARDS
EXCESS_RATE: Final = EXCESS + MOST_GUARDS
SLIDES: Final = EXCESS_RATE + MOST_GUARDS
ALPHA: Final = SLIDES + MOST_SLIDING
SNAP: Final = ALPHA + MOST_SLIDING
"""Of each switch along which it may slide, the state that is its excess; −1: none."""
SLIDE_GUARD: Final = SNAP + MOST_SLIDING
"""Of each switch along which it may slide, its number among the guards."""
SERIES: Final = SLIDE_GUARD + MOST_SLIDING
GUARD_SERIES: Final = SERIES + MOST_STATES * TERMS
ALPHA_SERIES: Final = GUARD_SERIES + MOST_GUARDS * TERMS
NUMBERS: Final = ALPHA_SERIES + MOST_SLIDING * TERMS
SIZE: Final = NUMBERS + MOST_NUMBERS
