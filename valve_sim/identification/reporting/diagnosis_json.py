"""The content of report.json."""

from __future__ import annotations

import math
from typing import Any

from valve_sim.files.json_text import plain_mapping
from valve_sim.identification.diagnosis.experiment_design import Recommendation
from valve_sim.identification.diagnosis.run import Diagnosis, State
from valve_sim.identification.fit.curves import Unexplained
from valve_sim.identification.plants.protocol import primary_channels
from valve_sim.identification.plants.tolerances import GROUP
from valve_sim.identification.reporting.correction import channels_json, correction_json, names_json
from valve_sim.identification.reporting.declared_values import declared_json
from valve_sim.identification.reporting.findings import interval_json, intervals_json
from valve_sim.identification.reporting.followed_positions import strokes_followed, strokes_json
from valve_sim.identification.reporting.force_curves import Motion, force_curve, motion_of
from valve_sim.identification.reporting.recording_state import recording_json
from valve_sim.identification.reporting.summary import recording_advice, summarise
from valve_sim.identification.reporting.units import in_unit
from valve_sim.identification.reporting.wording import headline, meanings


def to_json(diagnosis: Diagnosis) -> dict[str, Any]:
    """The content of report.json.

    Errors are in `unit`, the one in which people read the response: µm of a position, mA of a current, N of a force. Of
    a position they also stand under the names `noise_um` and `rmse_um`, of a current under `noise_ma` and `rmse_ma`.
    """
    motion = motion_of(diagnosis)
    problem = diagnosis.before.fit.problem
    scale, unit = problem.plant.channels[primary_channels(problem.plant)[0]].readable
    report = {
        "schema": "valve_sim/diagnosis/3",
        "sources": list(diagnosis.sources),
        "unit": unit,
        **in_unit("noise", scale * problem.noise.sigma, unit),
        "before": _state_json(diagnosis.before, scale, unit),
        "verdict": {
            "kind": diagnosis.verdict.kind,
            "effects": list(diagnosis.verdict.effects),
            "confusable_with": {name: list(others) for name, others in diagnosis.verdict.confusable_with.items()},
            "probability": diagnosis.verdict.probability,
            "unnamed": diagnosis.verdict.unnamed,
            "share": diagnosis.verdict.share,
            "ended": "budget" if diagnosis.verdict.is_cut_short else None,
            "worth": {name: worth._asdict() for name, worth in diagnosis.verdict.worth.items()},
            "summary": summarise(diagnosis),
            "headline": headline(diagnosis),
        },
        "meaning": {meaning.name: meaning.to_json() for meaning in meanings(diagnosis)},
        "correction": correction_json(diagnosis),
        "names": names_json(diagnosis),
        "channels": channels_json(diagnosis),
        "after": {**_state_json(diagnosis.after, scale, unit), "effects": _effects_json(diagnosis.after)}
        if diagnosis.verdict.is_corrected
        else None,
        "inclusion": dict(diagnosis.inclusion),
        "recording": recording_json(diagnosis.recording),
        **declared_json(diagnosis.declared),
        "candidates": [
            {
                "effect": " + ".join(candidate.effects),
                "effects": list(candidate.effects),
                "command_errors": candidate.timing,
                "probability": candidate.probability,
                "unnamed": candidate.unnamed,
                "log_evidence": candidate.log_evidence,
                "delta_bic": candidate.delta_bic,
                **_errors(candidate.train_rmse, candidate.holdout_rmse, scale, unit),
                "parameters": intervals_json(candidate.intervals),
            }
            for candidate in diagnosis.candidates
        ],
        "unexplained": None if diagnosis.unexplained is None else _unexplained_json(diagnosis.unexplained, motion),
        "position_from_current": strokes_json(strokes_followed(diagnosis)),
        "force_maps": [_unexplained_json(entry, motion) for entry in diagnosis.maps],
        "record_next": recording_advice(diagnosis) or None,
        "record_next_gain": None if diagnosis.recommendation is None else recommendation_json(diagnosis.recommendation),
        "untried": list(diagnosis.untried),
        "work": {"strokes": diagnosis.work, "allowed": diagnosis.allowed if math.isfinite(diagnosis.allowed) else None},
        "held_out_gain": None if math.isnan(diagnosis.held_out_gain) else diagnosis.held_out_gain,
        "strokes": None if diagnosis.choice is None else diagnosis.choice._asdict(),
        "detection_limits": {name: dict(limits) for name, limits in diagnosis.detection_limits.items()},
    }
    return plain_mapping(report)


def recommendation_json(found: Recommendation) -> dict[str, Any]:
    """What the experiments together are expected to tell apart, the least separated pair first."""
    return {
        "experiment": found.experiment.words,
        "repeats": found.repeats,
        "separates": [
            {"candidates": list(pair), "standard_deviations": deviations} for pair, deviations in found.together
        ],
    }


def _errors(train: float, holdout: float, scale: float, unit: str) -> dict[str, Any]:
    return in_unit("rmse", {"train": scale * train, "holdout": scale * holdout}, unit)


def _state_json(state: State, scale: float, unit: str) -> dict[str, Any]:
    return {
        "parameters": intervals_json({name: i for name, i in state.intervals.items() if "." not in name}),
        **_errors(state.train_rmse, state.holdout_rmse, scale, unit),
        **in_unit(
            "predicted", {"train": scale * state.train_predicted, "holdout": scale * state.holdout_predicted}, unit
        ),
        "white": state.adequacy.is_white,
        "chi2_per_sample": state.fit.chi2 / state.fit.problem.effective_samples,
        "test": {"p_value": state.adequacy.p_value, "worst": state.adequacy.worst},
    }


def _effects_json(state: State) -> dict[str, dict[str, Any]]:
    effects: dict[str, dict[str, Any]] = {}
    for wrong in state.fit.problem.plant.effects.values():
        if wrong.is_declared_value and set(wrong.free_names()) <= set(state.intervals):
            plant = state.fit.problem.plant
            effects[wrong.name] = {
                name: {**interval_json(state.intervals[name]), "was": plant.declared(name)}
                for name in wrong.free_names()
            }
    for name, interval in state.intervals.items():
        effect, dot, parameter = name.partition(".")
        if dot and not name.startswith(GROUP):
            was = state.fit.problem.plant.declared(name)
            effects.setdefault(effect, {})[parameter] = {**interval_json(interval), "was": was}
    for name, value in state.fit.values.items():
        effect, dot, parameter = name.partition(".")
        if dot and effect in effects and parameter not in effects[effect]:
            effects[effect][parameter] = {"value": value, "stderr": 0.0, "ci95": [value, value]}
    return effects


def _unexplained_json(entry: Unexplained, motion: Motion) -> dict[str, Any]:
    """Size and place over the range that the data visited: beyond, only smoothness determines the curve."""
    curve = force_curve(entry, motion)
    return {
        "force_rms_n": curve.rms,
        "where": curve.where,
        "variable": entry.variable,
        "at": list(entry.at),
        "force": list(entry.force),
        "force_stderr": list(entry.stderr),
        "delta_bic": -entry.gain,
    }
