"""What the plungers do, what happens to them, and how a run ends: numbers that the compiled core and callers share."""

from __future__ import annotations

import enum


class Phase(enum.IntEnum):
    """The mode of the valve, as published on ~/phase."""

    CLOSED = 0
    PILOT = 1
    GAP_HOLD = 2
    MAIN = 3
    OPEN = 4


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
