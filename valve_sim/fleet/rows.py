"""A row of the table from a diagnosis."""

from __future__ import annotations

import math
from typing import Final

from valve_sim.fleet.figures import followed_columns, valve_columns, with_errors_of_stamps
from valve_sim.fleet.units import Row
from valve_sim.identification.diagnosis.outcome import Diagnosis
from valve_sim.identification.diagnosis.run import DiagnosisSession, begin
from valve_sim.identification.fit.budget import Budget
from valve_sim.identification.fit.declared_values import declared_values, out_of_tolerance
from valve_sim.identification.fit.residual_tests import adequacy
from valve_sim.identification.fit.result import Fit, rmse
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.claims import summarise
from valve_sim.model import Valve
from valve_sim.recordings import Trace, left_out_finding, stroke_starts


def refitted(trace: Trace, declared: Valve, budget: Budget) -> tuple[DiagnosisSession, Fit]:
    """The first stage: a diagnosis that has begun, and the declared valve as it is fitted to every bag.

    Raises:
        SimulationError: the declared valve cannot be simulated.
    """
    begun = begin(ValvePlant([trace], declared), budget=budget)
    return begun, with_errors_of_stamps(begun.declared)


def row_values(trace: Trace, diagnosis: Diagnosis, followed: Fit) -> Row:
    """All columns that say what was found in one trace.

    Args:
        followed: the refitted declared valve, as every bag is fitted.

    Raises:
        SimulationError: the corrected valve cannot be simulated at its reference voltage.
    """
    verdict, before, after = diagnosis.verdict, diagnosis.before, diagnosis.after
    plant = diagnosis.plant
    return {
        **_of_the_trace(trace),
        "verdict": verdict.kind,
        "effects": list(verdict.effects),
        "out_of_tolerance": out_of_tolerance(diagnosis.declared),
        "probability": verdict.probability,
        "summary": summarise(diagnosis),
        "white": bool(before.adequacy.is_white),
        "p_value": float(before.adequacy.p_value),
        **(_errors_of_position(diagnosis) if trace.has_positions else {}),
        **valve_columns(after.fit, plant),
        **followed_columns(valve_columns(followed, plant)),
    }


def row_without_search(trace: Trace, followed: Fit) -> Row:
    """A row where effects were not searched for: what the refitted declared valve leaves is tested, no more.

    Raises:
        SimulationError: the refitted valve cannot be simulated at its reference voltage.
    """
    columns, left, error = valve_columns(followed, followed.problem.plant), adequacy(followed), rmse(followed)
    of_position: Row = {"noise": followed.problem.noise.sigma, "rmse_before": error, "rmse_after": error}
    return {
        **_of_the_trace(trace),
        "verdict": "none" if left.is_white else "insufficient",
        "effects": [],
        "out_of_tolerance": out_of_tolerance(declared_values(followed)),
        "summary": EXPLAINED if left.is_white else NOT_SEARCHED,
        "white": bool(left.is_white),
        "p_value": float(left.p_value),
        **(of_position if trace.has_positions else {}),
        **columns,
        **followed_columns(columns),
    }


EXPLAINED: Final = "The declared valve, refitted, explains the recording."
NOT_SEARCHED: Final = "Something is left that the declared valve does not explain; what it is was not searched for."


def _of_the_trace(trace: Trace) -> Row:
    return {
        "start_time": trace.epoch_ns,
        "duration": float(trace.sample_times[-1] - trace.sample_times[0]),
        "strokes": len(stroke_starts(trace.drive)),
        "samples": len(trace.sample_times),
        "findings": [*trace.findings, *left_out_finding(trace)],
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
