"""The result of commissioning in a file, so that a restarted monitor need not commission again."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from valve_sim.files.json_text import finite_or_none
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.fit.noise import Noise
from valve_sim.identification.monitoring.command_timing import StrokeTiming
from valve_sim.identification.monitoring.commissioning import Commissioning, ScoreBaseline
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.plants.commissioned import CommissionedCurrent
from valve_sim.identification.plants.valve_model import ValveModel, dampings_of
from valve_sim.model import EXACT, ParameterError, Valve

SCHEMA: Final = "valve_sim/commissioning/3"
MEND: Final = "name another file, or, while the valve is healthy, delete this one to commission again"


def save_commissioning(path: Path, commissioning: Commissioning, declared: Valve) -> None:
    """Write the file, whole or not at all.

    Raises:
        ParameterError: it cannot be written.
    """
    body = {"declared": declared.to_mapping(), "commissioning": _to_plain(commissioning)}
    text = json.dumps({"schema": SCHEMA, "sha256": _digest(_round_trip(body)), **body}, indent=1)
    write_whole(path, text + "\n", ParameterError)


def load_commissioning(path: Path, declared: Valve) -> Commissioning | None:
    """Read it again.

    Returns:
        None where there is no such file yet.

    Raises:
        ParameterError: it cannot be read, is damaged, of another schema, or was made with another valve; one line.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror}); {MEND}") from error
    except ValueError as error:
        raise ParameterError(f"{path}: damaged (no JSON); {MEND}") from error
    schema = found.get("schema") if isinstance(found, dict) else None
    if schema != SCHEMA:
        raise ParameterError(f"{path}: found schema {schema!r}, expected {SCHEMA!r}; {MEND}")
    body = {key: found.get(key) for key in ("declared", "commissioning")}
    if _digest(body) != found.get("sha256"):
        raise ParameterError(f"{path}: damaged (its checksum is not that of what it holds); {MEND}")
    difference = _difference(body["declared"], _round_trip(declared.to_mapping()))
    if difference:
        raise ParameterError(f"{path}: was commissioned with {difference}; {MEND}")
    return _from_plain(body["commissioning"], declared)


def _digest(body: Any) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _round_trip(value: Any) -> Any:
    """A value as it is when read again: tuples are lists."""
    return json.loads(json.dumps(value))


def _difference(then: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What the file was made with, in place of what is declared now; empty if that is the same."""
    before, after = _flat(then), _flat(now)
    differing = [name for name in dict.fromkeys([*before, *after]) if before.get(name) != after.get(name)]
    if not differing:
        return ""
    first, more = differing[0], f", and {len(differing) - 1} more" if len(differing) > 1 else ""
    if all(name.startswith("tolerances.") and name not in before for name in differing):
        # As with the shipped valves of earlier versions, whose values were exact.
        return f"exact values, which now have tolerances ({first}: {after[first]}{more})"
    was, has = (values.get(first, "none") for values in (before, after))
    return f"another valve ({first}: {was} there, {has} declared{more})"


def _flat(values: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(values, dict):
        return {prefix: values}
    return {
        name: value
        for key, inner in values.items()
        for name, value in _flat(inner, f"{prefix}.{key}".lstrip(".")).items()
    }


def _to_plain(commissioning: Commissioning) -> dict[str, Any]:
    baseline = commissioning.baseline
    model, noise = ValveModel(baseline.valve), baseline.noise
    values, dampings = {name: model.declared(name) for name in baseline.estimated}, dampings_of(baseline.valve)
    declared_values = {name: value for name, value in values.items() if name not in dampings}
    return {
        "dampings": {name: values[name] for name in dampings},
        **({"declared_values": declared_values} if declared_values else {}),
        "damping_covariance": baseline.covariance.tolist(),
        "lateness": baseline.lateness,
        "scatter": baseline.scatter,
        "jitter": baseline.jitter,
        "noise": noise.__dict__,
        "has_positions": baseline.has_positions,
        "error_sizes": dict(baseline.error_sizes),
        "current": None if baseline.current is None else baseline.current._asdict(),
        "strokes": [
            [stroke.volts, [finite_or_none(shift) for shift in stroke.shifts], finite_or_none(stroke.arrival_spread)]
            for stroke in commissioning.strokes
        ],
        "baselines": [
            [level, {name: score.__dict__ for name, score in score_baselines.items()}]
            for level, score_baselines in commissioning.score_baselines.items()
        ],
    }


def _from_plain(plain: Mapping[str, Any], declared: Valve) -> Commissioning:
    noise, current = plain["noise"], plain["current"]
    values = {**plain["dampings"], **plain.get("declared_values", {})}
    baseline = Baseline(
        replace(ValveModel(declared).with_values(values), tolerances=EXACT),
        plain["lateness"],
        plain["scatter"],
        plain["jitter"],
        Noise(**{**noise, "coefficients": tuple(noise["coefficients"])}),
        np.array(plain["damping_covariance"]),
        None if current is None else CommissionedCurrent(**current),
        tuple(values),
        plain["has_positions"],
        plain["error_sizes"],
    )
    strokes = tuple(
        StrokeTiming(volts, tuple(_or_nan(shift) for shift in shifts), _or_nan(arrival))
        for volts, shifts, arrival in plain["strokes"]
    )
    score_baselines = {
        level: {name: ScoreBaseline(**score) for name, score in entries.items()}
        for level, entries in plain["baselines"]
    }
    return Commissioning(baseline, score_baselines, strokes)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value
