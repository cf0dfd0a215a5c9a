"""What a laboratory adds to a recording, a file an error: theory, "The errors of a recording".

An error of a recording that is linear in its coefficients is a set of columns: what the sensor shows beside the truth
is B b with b ~ N(0, s²), and its size s is learned. An error that acts on the machine has nuisances of the plant in
place of columns, whose size is learned in the same way. `ERRORS` lists all of them, and nothing else does.
"""

from typing import Final

from valve_sim.identification.estimation.errors.bend import BEND
from valve_sim.identification.estimation.errors.clocks import CLOCK_OFFSET, CLOCK_RATE, COMMAND_STAMPS
from valve_sim.identification.estimation.errors.drift import DRIFT
from valve_sim.identification.estimation.errors.error import RecordingError, Seen
from valve_sim.identification.estimation.errors.hum import HUM
from valve_sim.identification.estimation.errors.ringing import RINGING, RINGING_SCATTER
from valve_sim.identification.estimation.errors.scale import SCALE
from valve_sim.identification.estimation.errors.stroke_variation import STROKE_VARIATION
from valve_sim.identification.estimation.errors.supply import SUPPLY
from valve_sim.identification.estimation.errors.zero import ZERO

ERRORS: Final = (
    CLOCK_OFFSET, CLOCK_RATE, COMMAND_STAMPS, ZERO, DRIFT, HUM, SCALE, BEND, RINGING, RINGING_SCATTER, SUPPLY,
    STROKE_VARIATION,
)  # fmt: skip
"""Every error of a recording, in the order in which reports list them."""

__all__ = ["ERRORS", "RecordingError", "Seen"]
