"""Clocks: samples and commands are stamped by two of them, which differ in time and in rate, and stamps scatter."""

from __future__ import annotations

from typing import Final

from valve_sim.identification.fit.errors.error import RecordingError

CLOCK_OFFSET: Final = RecordingError(
    "clock_offset", "offset of the clocks", "stamp samples and commands on one machine, or synchronise the two",
    is_known=True,
)  # fmt: skip
CLOCK_RATE: Final = RecordingError(
    "clock_rate", "rate of the commands' clock to that of the samples",
    "stamp samples and commands on one machine, or synchronise the two", is_known=True,
)  # fmt: skip
INPUT_EDGES: Final = RecordingError(
    "input_edges", "when inputs jumped, between two readings",
    "sample the inputs faster, or record when they are switched", is_known=True,
)  # fmt: skip
COMMAND_STAMPS: Final = RecordingError(
    "command_stamps", "scatter of the commands' stamps",
    "stamp a command where the voltage is switched, or record the voltage", is_known=True,
)  # fmt: skip
