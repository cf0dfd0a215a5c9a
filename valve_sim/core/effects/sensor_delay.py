"""Late positions."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="sensor_delay",
    title="Late position sensor",
    summary="the measured positions are late",
    parameters=(Parameter("delay", "s", "of both joints, not of the current", 0, 1.0, 0.0001, 0.0),),
    source="acquisition chains",
    on_a_real_valve=(
        "The positions are stamped later than they were measured: filters, buffers or the bus; the valve "
        "itself is well."
    ),
    what_to_do="Check the delay of the acquisition chain, and how samples and commands get their time stamps.",
    confused_with=("sensor_bandwidth",),
    changes={"sensor_delay": replaced("delay")},
)
