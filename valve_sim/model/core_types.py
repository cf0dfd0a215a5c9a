"""The state of a valve and its events, as the compiled core holds them. `effects.record` has the valve's parameters.

All are plain NumPy records: equations can write `p.pilot_mass`, a batch is an array of records, and nothing is
allocated while a valve is being stepped.
"""

from __future__ import annotations

import enum
from typing import Final

import numpy as np

MAXIMUM_TERMS: Final = 8
"""Largest number of compiled force terms that can be on at once."""
MAXIMUM_TERM_PARAMETERS: Final = 48
"""Largest number of parameters that one compiled force term can read."""

STATE_RECORD: Final = np.dtype(
    [
        ("time", "f8"),  # s, the end of the last committed step
        ("x", "f8"),  # m
        ("v", "f8"),  # m/s
        ("u", "f8"),  # normalised coil current; integrated only while the coil heats
        ("w", "f8"),  # the current that pulls, behind the eddy pole; integrated likewise, and with the flux
        ("temperature", "f8"),  # K above the start
        ("mode", "i8"),  # Phase
        ("moving", "i8"),  # 0 at rest, 1 in motion
        ("direction", "i8"),  # +1 opening, -1 closing; the sign of dry friction
        ("volts", "f8"),  # V, as commanded
        ("seen", "f8"),  # V, at the terminals of the coil
        ("path", "i8"),  # 0 driven, 1 freewheeling, 2 blocked by the diode
        ("segment_time", "f8"),  # s, when this voltage began
        ("segment_u", "f8"),  # u at that time
        ("segment_w", "f8"),  # w at that time
        ("peak_current", "f8"),  # largest abs(u) so far
        ("held_by_residual", "i8"),  # 1 while the pull is at the residual floor
        ("unseated_time", "f8"),  # s, when the pilot last left x = 0
        ("step", "f8"),  # s, the step that error control proposes
        ("shown_pilot", "f8"),  # m, as filtered by the sensor
        ("shown_main", "f8"),  # m, likewise
    ],
    align=True,
)
"""The state of a valve in the compiled core: with parameters and commands it determines what follows."""

EVENT_RECORD: Final = np.dtype([("time", "f8"), ("kind", "i8"), ("x", "f8"), ("v", "f8")], align=True)
"""One event of the compiled core; `v` is the velocity before it."""


class Phase(enum.IntEnum):
    """The mode of the valve, as published on ~/phase."""

    CLOSED = 0
    PILOT = 1
    GAP_HOLD = 2
    MAIN = 3
    OPEN = 4


# NumPy integers: Numba would compile a function anew for each Python literal.
CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = np.array(list(Phase))


class EventKind(enum.IntEnum):
    """What happened at an event. The published t1 is PICKED_UP, t2 is REACHED_STOP.

    A valve with one plunger has nothing to pick up; its t1 is UNSEATED.
    """

    UNSEATED = 0
    """The pilot plunger, or the only one, left its seat."""
    PICKED_UP = 1
    """The pilot plunger reached the main plunger and picked it up."""
    HELD_AT_GAP = 2
    """The pilot plunger came to rest against the main plunger, which is too heavy to lift yet."""
    LIFTED = 3
    """The main plunger was lifted from rest at the gap."""
    DROPPED = 4
    """The pilot plunger fell back from rest at the gap."""
    REACHED_STOP = 5
    """All parts reached the core and stayed."""
    BOUNCED_AT_STOP = 6
    """All parts reached the core and rebounded."""
    RELEASED = 7
    """All parts left the core."""
    MAIN_SEATED = 8
    """The main plunger fell back to its seat; the pilot plunger moves on."""
    SEATED = 9
    """The pilot plunger came to rest on its seat."""
    BOUNCED_AT_SEAT = 10
    """The pilot plunger rebounded from its seat, or was pulled off it again at once."""
    STUCK = 11
    """Dry friction stopped the plungers between the contacts."""
    BROKE_AWAY = 12
    """The plungers broke away from where friction held them."""
    CURRENT_GONE = 13
    """The current of the freewheeling path reached 0, and its diode blocks."""
    FLOW_CHOKED = 14
    """The flow of gas through the valve reached the speed of sound."""
    FLOW_SUBSONIC = 15
    """The flow of gas through the valve fell below the speed of sound."""
    FLOW_REVERSED = 16
    """The pressure became higher on the other side of the valve, and gas flows the other way."""


class Outcome(enum.IntEnum):
    """Why a run of the compiled core ended."""

    FINISHED = 0
    STEP_TOO_SMALL = 1
    TOO_MANY_STEPS = 2
    CHATTERING = 3
    FLUX_FOLDS = 4
