"""Low-pass of the position sensor: a mechanism of the core, which solves it exactly."""

from __future__ import annotations

import math
from typing import Any

from valve_sim.model.effects.entry import Effect, Tag, Values
from valve_sim.model.parameters import Parameter


def _rewrite(record: Any, values: Values) -> None:
    # A time constant, because it is 0, not infinite, while the effect is off.
    record["sensor_time_constant"] = 1.0 / (2.0 * math.pi * values["cutoff_frequency"])


EFFECT = Effect(
    "sensor_bandwidth",
    "the measured positions pass a first-order low-pass",
    (Parameter("cutoff_frequency", "Hz", "of both joints", 1.0, 1e9, 2000.0, math.inf),),
    "laser displacement sensors average",
    title="Slow position sensor",
    on_a_real_valve="The position sensor smooths what it shows: its averaging or filter is too slow for the motion; "
    "the valve itself is well.",
    what_to_do="Set the sensor's averaging or filter to a higher bandwidth, or declare the one that it has.",
    rewrite=_rewrite,
    fields={"sensor_time_constant": 0.0},
    tags=(Tag.SENSOR,),
    changes={"sensor_time_constant": lambda _before, own: 1.0 / (2.0 * math.pi * own.cutoff_frequency)},
)
