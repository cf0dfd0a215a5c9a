"""The scale of the position sensors."""

from __future__ import annotations

from valve_sim.core.effects.entry import Effect, replaced
from valve_sim.model.parameters import Parameter

EFFECT = Effect(
    name="sensor_gain",
    title="Position sensor's scale",
    summary="the position sensors' scale is off",
    parameters=(Parameter("gain", "–", "shown over true, both joints", 0.01, 100, 0.001, 1.0),),
    source="calibration",
    on_a_real_valve=(
        "The position sensors show all distances too large or too small by the same share; the valve itself is well."
    ),
    what_to_do="Calibrate the position sensors against a known distance.",
    changes={"sensor_gain": replaced("gain")},
)
