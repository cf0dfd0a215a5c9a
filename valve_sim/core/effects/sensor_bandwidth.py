"""Low-pass of the position sensor."""

from __future__ import annotations

import math

from valve_sim.core.effects.entry import Effect
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="sensor_bandwidth",
    title="Slow position sensor",
    summary="the measured positions pass a first-order low-pass",
    parameters=(Parameter("cutoff_frequency", "Hz", "of both joints", 1.0, 1000000000.0, 2000.0, math.inf),),
    source="laser displacement sensors average",
    on_a_real_valve=(
        "The position sensor smooths what it shows: its averaging or filter is too slow for the motion; the "
        "valve itself is well."
    ),
    what_to_do="Set the sensor's averaging or filter to a higher bandwidth, or declare the one that it has.",
    changes={"sensor_time_constant": lambda _before, own: 1.0 / (2.0 * math.pi * own.cutoff_frequency)},
)
