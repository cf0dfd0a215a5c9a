"""Zero: what the sensor shows of nothing, which its data sheet allows to be off.

The position sensor of a valve has none: a closed valve is where it reads 0, and what changes of that afterwards is a
drift. A sensor has one where it says so.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from valve_sim.identification.fit.errors.error import RecordingError, Seen
from valve_sim.identification.plants.protocol import Array


def columns(seen: Seen) -> Array:
    """(n, 1) the same at all times."""
    return np.ones((len(seen.times), 1))


def amount(coefficients: Array, _: Array) -> float:
    """The reading of a closed valve."""
    return float(coefficients[0])


ZERO: Final = RecordingError(
    "zero", "zero of the sensor",
    "read the sensor where what it measures is known to be zero, and take that off", columns=columns, amount=amount,
    is_known=True,
)  # fmt: skip
"""Prior: none but what the sensor says."""
