"""Where everything of one machine stands in its block of doubles.

A block is all that a machine is: copied it is saved. Tangents of what stands in a slot stand in the slot of the same
number of a second block, one for each direction of derivatives.
"""

from __future__ import annotations

from typing import Final

ORDER: Final = 8
"""Of the Taylor series: inputs have a corner at each sample, so that steps are short, and a low order serves."""
TERMS: Final = ORDER + 1
MOST_STATES: Final = 12
MOST_INPUTS: Final = 16
MOST_OUTPUTS: Final = 16
MOST_HELD: Final = 16
MOST_REGIONS: Final = 4
MOST_MODES: Final = 8
"""Of a region."""
MOST_GROUPS: Final = 16
"""Combinations of modes with different flows."""
MOST_TRANSITIONS: Final = 32
MOST_SWITCHES: Final = 40
MOST_SLIDERS: Final = 6
MOST_WATCHES: Final = 80
MOST_NUMBERS: Final = 160

(TIME, STEP, LONGEST, TOLERANCE, ELAPSED, DEFECT, SUSPECT, TAKEN, ENDS, IS_PENDING, HELD_ALREADY, HAS_CHANGED, STALLED,
 SAMPLED, EVENTS, GROUP, BASE_GROUP, CASE) = range(18)  # fmt: skip
"""s; size of the step, s, and the longest allowed; relative error of a step; the time since the start of the step at
which states are asked for, s; error of the series over what is tolerated; 1 where something may happen in the step; how
many steps were taken; what ends the step; whether the step is known and not yet taken; whether the guard that ends it
held at its start already; whether an event or a change of inputs is of the same time; steps in a row without progress;
samples written; events; the kernel of the step, and the group of modes; the case that a transition took."""
STATES, INPUTS, OUTPUTS, SWITCHES, SLIDERS, WATCHES, WIDTH, IS_CHECKED, IS_STRAIGHT = range(20, 29)
"""How many there are of each kind, and directions of derivatives; whether series are compared with their equation;
whether an input has a slope."""
AT, LOOK, ENTER, ROW = range(32, 36)
"""Addresses of the kernels, as bits."""
MOVE: Final = 36
"""Those of a step: of each group of modes, free and while it slides."""
JUMP: Final = MOVE + 2 * MOST_GROUPS
"""Of each transition."""
STATE: Final = JUMP + MOST_TRANSITIONS
PEAK: Final = STATE + MOST_STATES
"""The largest size of each state so far, and of its tangents."""
INPUT: Final = PEAK + MOST_STATES
SLOPE: Final = INPUT + MOST_INPUTS
HELD: Final = SLOPE + MOST_INPUTS
MODE: Final = HELD + MOST_HELD
"""Of each region the number of the mode in force."""
FLAG: Final = MODE + MOST_REGIONS
"""Of each switch, 1 while its excess is above 0."""
SLIDES: Final = FLAG + MOST_SWITCHES
"""Of each slider, 1 while the state slides along it."""
MASK: Final = SLIDES + MOST_SLIDERS
"""Of each transition, `HUGE` while it cannot happen, else 0: added to what must not become negative."""
SWITCH_MASK: Final = MASK + MOST_TRANSITIONS
"""Of each switch, `HUGE` while the state slides along it."""
SLIDER_MASK: Final = SWITCH_MASK + MOST_SWITCHES
"""Of each slider, `HUGE` while the state does not slide along it."""
SWITCH_OF: Final = SLIDER_MASK + MOST_SLIDERS
"""Of each slider its switch."""
SLIDER_OF: Final = SWITCH_OF + MOST_SLIDERS
"""Of each switch its slider; −1: none."""
SNAP: Final = SLIDER_OF + MOST_SWITCHES
"""Of each switch the state that is its excess; −1: it is another expression."""
CHECKED: Final = SNAP + MOST_SWITCHES
"""Of each state, 1 where its series is compared with its equation."""
NUMBERS: Final = CHECKED + MOST_STATES
COPIED: Final = NUMBERS + MOST_NUMBERS
"""So much is that of a start; what follows is filled in by each step."""
END: Final = COPIED
"""The states at the time `ELAPSED` after the start of the step."""
RATE: Final = END + MOST_STATES
GUARD: Final = RATE + MOST_STATES
GUARD_RATE: Final = GUARD + MOST_TRANSITIONS
EXCESS: Final = GUARD_RATE + MOST_TRANSITIONS
UNSURE: Final = EXCESS + MOST_SWITCHES
"""Of each switch the size of its excess below which rounding hides its sign."""
EXCESS_RATE: Final = UNSURE + MOST_SWITCHES
ABOVE: Final = EXCESS_RATE + MOST_SWITCHES
BELOW: Final = ABOVE + MOST_SLIDERS
"""Of each slider the rates of its excess on both sides; while the state slides, the share of the upper side less 1, and
that share."""
SPAN: Final = BELOW + MOST_SLIDERS
"""Of each slider by how much those rates differ while nothing slides; 0 where there is no other slider."""
OUT: Final = SPAN + MOST_SLIDERS
SCRATCH: Final = OUT + MOST_OUTPUTS
SERIES: Final = SCRATCH + 2 * TERMS
WATCH: Final = SERIES + MOST_STATES * TERMS
"""Of each watch, something that must not become negative within a step: how far it is sure not to, its event, and the
size below which rounding hides its sign."""
WATCH_SLOTS: Final = 3
WATCH_SERIES: Final = WATCH + WATCH_SLOTS * MOST_WATCHES
SIZE: Final = WATCH_SERIES + MOST_WATCHES * TERMS

DELTA: Final = TIME
"""The tangents of the time of an event stand in this slot of the tangents, s."""
NO_EVENT, OF_TRANSITION, OF_SWITCH, OF_EXIT = 0, 1, 100, 200
"""What ends a step: nothing, or one of these and the number of the transition or switch; of an exit from sliding twice
the number of the slider, and 1 more where it leaves downwards."""
HUGE: Final = 1e300
