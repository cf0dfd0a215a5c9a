"""Gain error of the position sensors: applied where a valve is sampled."""

from __future__ import annotations

from valve_sim.model.core.symbols import replaced
from valve_sim.model.effects.entry import Effect, Severity, Tag, Values
from valve_sim.model.parameters import Parameter


def _severity(values: Values, declared: Values) -> Severity | None:
    return Severity(abs(values["gain"] - 1.0), "every position")


EFFECT = Effect(
    "sensor_gain",
    "the position sensors' scale is off",
    (Parameter("gain", "–", "shown over true position, of both joints", 0.01, 100, 1e-3, 1.0),),
    "calibration",
    title="Position sensor's scale",
    on_a_real_valve="The position sensors show all distances too large or too small by the same share; the valve "
    "itself is well.",
    what_to_do="Calibrate the position sensors against a known distance.",
    severity=_severity,
    tags=(Tag.SENSOR,),
    changes={"sensor_gain": replaced("gain")},
)
