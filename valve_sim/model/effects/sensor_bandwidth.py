"""Low-pass of the position sensor: a mechanism of the core, which solves it exactly."""

from __future__ import annotations

import math

from valve_sim.model.effects.entry import Effect, Tag
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    "sensor_bandwidth",
    "the measured positions pass a first-order low-pass",
    (Parameter("cutoff_frequency", "Hz", "cut-off frequency of both joints", 1.0, 1e9, 2000.0, math.inf),),
    "laser displacement sensors average",
    title="Slow position sensor",
    on_a_real_valve="The position sensor smooths what it shows: its averaging or filter is too slow for the motion; "
    "the valve itself is well.",
    what_to_do="Set the sensor's averaging or filter to a higher bandwidth, or declare the one that it has.",
    tags=(Tag.SENSOR,),
    changes={"sensor_time_constant": lambda _before, own: 1.0 / (2.0 * math.pi * own.cutoff_frequency)},
)
