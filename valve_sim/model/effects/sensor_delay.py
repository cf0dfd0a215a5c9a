"""Delay of the position sensor: applied where a valve is sampled."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Tag
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    "sensor_delay",
    "the measured positions are late",
    (Parameter("delay", "s", "delay of both joints, not of the current", 0, 1.0, 1e-4, 0.0),),
    "acquisition chains",
    title="Late position sensor",
    on_a_real_valve="The positions are stamped later than they were measured: filters, buffers or the bus; the valve "
    "itself is well.",
    what_to_do="Check the delay of the acquisition chain, and how samples and commands get their time stamps.",
    confused_with=("sensor_bandwidth",),
    tags=(Tag.SENSOR,),
    changes={"sensor_delay": replaced("delay")},
)
