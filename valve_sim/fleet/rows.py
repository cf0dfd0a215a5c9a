"""A row of the table from a diagnosis."""

from __future__ import annotations

import math

from valve_sim.fleet.figures import estimates, motion_columns
from valve_sim.fleet.units import Row
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.estimation.declared_values import out_of_tolerance
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.summary import summarise
from valve_sim.traces import Trace, stroke_starts


def row_values(trace: Trace, diagnosis: Diagnosis) -> Row:
    """All columns that say what was found in one trace.

    Raises:
        SimulationError: the corrected valve cannot be simulated at its reference voltage.
    """
    verdict, before, after = diagnosis.verdict, diagnosis.before, diagnosis.after
    plant = diagnosis.plant
    assert isinstance(plant, ValvePlant)
    return {
        "start_time": trace.epoch_ns,
        "duration": float(trace.sample_times[-1] - trace.sample_times[0]),
        "strokes": len(stroke_starts(trace.drive)),
        "samples": len(trace.sample_times),
        "findings": list(trace.findings),
        "verdict": verdict.kind,
        "effects": list(verdict.effects),
        "out_of_tolerance": out_of_tolerance(diagnosis.declared),
        "probability": verdict.probability,
        "summary": summarise(diagnosis),
        "white": bool(before.adequacy.is_white),
        "p_value": float(before.adequacy.p_value),
        **(_errors_of_position(diagnosis) if trace.has_positions else {}),
        **estimates(diagnosis),
        **motion_columns(after.fit, plant),
    }


def _errors_of_position(diagnosis: Diagnosis) -> Row:
    before, after = diagnosis.before, diagnosis.after
    return {
        "noise": before.fit.problem.noise.sigma,
        "rmse_before": before.train_rmse,
        "rmse_before_holdout": _known(before.holdout_rmse),
        "rmse_after": after.train_rmse,
        "rmse_after_holdout": _known(after.holdout_rmse),
    }


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None
