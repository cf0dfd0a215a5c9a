"""The errors that a laboratory may add to a recording, one file each: theory, "The errors of a recording".

An error of a recording that is linear in its coefficients is a set of columns: what the sensor shows beside the truth
is B b with b ~ N(0, s²), and its size s is estimated. An error that acts on the machine has nuisance parameters of the
plant in place of columns, whose size is estimated in the same way. `ERRORS` is the only list of all of them.
"""

from typing import Final

from valve_sim.identification.fit.errors.bend import BEND
from valve_sim.identification.fit.errors.clocks import CLOCK_OFFSET, CLOCK_RATE, COMMAND_STAMPS, INPUT_EDGES
from valve_sim.identification.fit.errors.drift import DRIFT
from valve_sim.identification.fit.errors.error import RecordingError, Seen
from valve_sim.identification.fit.errors.hum import HUM
from valve_sim.identification.fit.errors.ringing import RINGING, RINGING_SCATTER
from valve_sim.identification.fit.errors.scale import SCALE
from valve_sim.identification.fit.errors.stroke_variation import STROKE_VARIATION
from valve_sim.identification.fit.errors.supply import SUPPLY
from valve_sim.identification.fit.errors.zero import ZERO

ERRORS: Final = (
    CLOCK_OFFSET, CLOCK_RATE, COMMAND_STAMPS, INPUT_EDGES, ZERO, DRIFT, HUM, SCALE, BEND, RINGING, RINGING_SCATTER,
    SUPPLY, STROKE_VARIATION,
)  # fmt: skip
"""Every error of a recording, in the order in which reports list them."""

__all__ = ["ERRORS", "RecordingError", "Seen"]
