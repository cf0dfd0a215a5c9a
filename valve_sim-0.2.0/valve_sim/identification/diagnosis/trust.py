"""Whether a corrected model may take the place of the declared one: by what it predicts of held-out strokes."""

from __future__ import annotations

import math
from typing import Final

from valve_sim.identification.diagnosis.outcome import Diagnosis, State
from valve_sim.identification.plants.protocol import primary_channels

PREDICTS_BETTER: Final = 10.0
"""Ln of how much more probable held-out strokes must be: odds of 22,000 to 1."""
AS_PREDICTED: Final = 1.2
"""Error over what the posterior predicts of it, beyond which something is left."""


def objection_to(diagnosis: Diagnosis) -> str:
    """Why the corrected model should not be set on a valve; empty where nothing speaks against it."""
    if diagnosis.verdict.kind == "effects" and not diagnosis.held_out_gain > PREDICTS_BETTER:
        if math.isnan(diagnosis.held_out_gain):
            return "no strokes were held out that could confirm it"
        return "it does not predict held-out strokes decisively better than the declared model"
    return what_is_left(diagnosis) if diagnosis.verdict.kind == "none" else ""


def what_is_left(diagnosis: Diagnosis) -> str:
    """A clause that says how much larger the error is than the posterior predicts; empty where it is not."""
    error, expected = _compared(diagnosis.after)
    if not error > AS_PREDICTED * expected:
        return ""
    scale, unit = diagnosis.plant.channels[primary_channels(diagnosis.plant)[0]].readable
    return f"the error is {scale * error:.3g} {unit} where {scale * expected:.3g} {unit} is predicted"


def _compared(state: State) -> tuple[float, float]:
    """The error of held-out strokes and what is predicted of it; of the training strokes where none are held out."""
    if math.isnan(state.holdout_rmse):
        return state.train_rmse, state.train_predicted
    return state.holdout_rmse, state.holdout_predicted
